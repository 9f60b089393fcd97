//! Any hit: whether something lies between a ray's ends, in whatever order is found first.

use super::closest::{Work, lanes_in_use, leaf_packet};
use super::{MaterialSet, Occlusion};
use crate::error::LoadError;
use crate::geom::Ray;
use crate::octree::{Child, Fine, LocalRay, QueryRay, ROOT, TriangleLocation, splat_interval};
use crate::simd::{Interval, LANES, Simd};
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// One any-hit query on its way.
struct Any<'m, S: Simd> {
    query: QueryRay,
    local: LocalRay<S>,
    /// Holds the ray's interval.
    outer: Interval<S::F>,
    /// Lies inside the ray's interval.
    inner: Interval<S::F>,
    ignore: Option<&'m MaterialSet>,
    /// An ignored material was hit.
    filtered: bool,
}

/// Whether the ray is blocked. The ray is valid.
#[inline(always)]
pub(super) fn occlusion<S: Simd, const CERTIFIED: bool>(
    simd: S,
    work: &mut Work<'_, '_>,
    ray: &Ray,
    ignore: Option<&MaterialSet>,
) -> Result<Occlusion, LoadError> {
    let coarse = &work.octree.coarse;
    let query = QueryRay::new(ray, coarse.frame.scale, &work.octree.model.bounds);
    let high = query.local_high(ray.t_max);
    let (inner_low, inner_high) = query.local_inner(ray.t_min, ray.t_max);
    let mut any = Any {
        local: LocalRay::new(simd, &query, &coarse.frame),
        outer: splat_interval(simd, query.local_low(ray.t_min), high),
        inner: splat_interval(simd, inner_low, inner_high),
        query,
        ignore,
        filtered: false,
    };
    let coarse_boxes = any.local.boxes;
    work.stack.truncate(0);
    let mut next = Some(Child::node(ROOT));
    while let Some(child) = next {
        work.counters.box_tests += 1;
        let pushed = if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = &coarse.sub_boxes[block as usize];
            let (_, hits) = coarse_boxes.test_packed(simd, sub_boxes, any.outer.low, any.outer.high);
            if hits != 0 && any.visit_block::<CERTIFIED>(simd, work, BlockId(block))? {
                return Ok(Occlusion::Blocked);
            }
            None
        } else {
            let node = &coarse.nodes[child.node_index()];
            let (near, hits) = coarse_boxes.test(simd, &node.bounds, any.outer.low, any.outer.high);
            work.stack.push_sorted(simd, node, near, hits)
        };
        next = pushed.or_else(|| work.stack.pop(0, high)).map(|entry| entry.child);
    }
    Ok(if any.filtered { Occlusion::Filtered } else { Occlusion::Clear })
}

impl<S: Simd> Any<'_, S> {
    /// Whether a triangle of the block blocks the ray.
    #[inline(always)]
    fn visit_block<const CERTIFIED: bool>(
        &mut self,
        simd: S,
        work: &mut Work<'_, '_>,
        block: BlockId,
    ) -> Result<bool, LoadError> {
        work.counters.block_visits += 1;
        let slot = work.pins.get(work.octree, block, work.scratch, work.counters)?;
        let fine = Fine::new(slot);
        self.local.enter_frame(simd, &self.query, &fine.frame());
        let (low, high) = fine.extents();
        self.local.set_reach(&self.query, low, high, fine.vertex_error());
        let floor = work.stack.len();
        let mut node = &fine.nodes[ROOT as usize];
        loop {
            work.counters.box_tests += 1;
            let (near, hits) = self.local.boxes.test(simd, &node.bounds, self.outer.low, self.outer.high);
            let mut next = work.stack.push_unsorted(simd, node, near, hits);
            loop {
                let entry = match next {
                    Some(entry) => entry,
                    None => match work.stack.pop(floor, f32::INFINITY) {
                        Some(entry) => entry,
                        None => return Ok(false),
                    },
                };
                if !entry.child.is_leaf() {
                    node = &fine.nodes[entry.child.node_index()];
                    break;
                }
                if self.visit_leaf::<CERTIFIED>(simd, &fine, entry.child, entry.edge, work.counters) {
                    return Ok(true);
                }
                next = None;
            }
        }
    }

    #[inline(always)]
    fn visit_leaf<const CERTIFIED: bool>(
        &mut self,
        simd: S,
        fine: &Fine<'_>,
        leaf: Child,
        edge: f32,
        counters: &mut TraceCounters,
    ) -> bool {
        let (start, count) = leaf.triangle_range();
        counters.triangle_tests += count as u64;
        let mut first = 0;
        while first < count {
            let packet = leaf_packet(simd, fine, start, count, first);
            let lanes = lanes_in_use(count - first);
            // Lanes that may be hit, and those of them that need no decision.
            let (possible, certain) = if CERTIFIED {
                let triangles = &self.local.triangles;
                triangles.survivors_and_certain(simd, &packet, edge, &self.outer, &self.inner)
            } else {
                let (hits, _) = self.local.triangles.decide(simd, &packet, &self.outer);
                (hits, hits)
            };
            let (mut possible, certain) = (possible & lanes, certain & lanes);
            if certain != 0 && self.ignore.is_none() {
                return true;
            }
            while possible != 0 {
                let i = possible.trailing_zeros();
                possible &= possible - 1;
                let at = TriangleLocation { start, count, lane: first + i as usize };
                if self.blocks(fine, at, certain >> i & 1 == 1, counters) {
                    return true;
                }
            }
            first += LANES;
        }
        false
    }

    /// Whether a triangle that may be hit is hit and is not ignored.
    #[inline(always)]
    fn blocks(
        &mut self,
        fine: &Fine<'_>,
        at: TriangleLocation,
        certain: bool,
        counters: &mut TraceCounters,
    ) -> bool {
        let ignored = self.ignore.is_some_and(|set| set.contains(fine.material(at)));
        if ignored && self.filtered {
            return false;
        }
        let hit = certain || {
            counters.decisions += 1;
            let vertices = fine.exact_vertices(at);
            self.query.exact.intersect(&vertices, &mut counters.exact_fallbacks).is_some()
        };
        self.filtered |= hit && ignored;
        hit && !ignored
    }
}
