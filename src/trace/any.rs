//! Any hit: whether something lies between a ray's ends, in whatever order is found first.

use super::closest::{Work, lanes_in_use, leaf_packet};
use super::exact::{ExactRay, RayError};
use super::stack::Stack;
use super::{MaterialSet, Occlusion};
use crate::geom::Ray;
use crate::octree::{Child, Fine, LocalRay, QueryRay, ROOT, TriangleLocation, prepare, splat_interval};
use crate::simd::{Interval, LANES, Simd};
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// One any-hit query on its way.
struct Any<'a, S: Simd> {
    local: &'a mut LocalRay<S>,
    /// Holds the ray's interval.
    outer: Interval<S::F>,
    /// Lies inside the ray's interval.
    inner: Interval<S::F>,
    query: &'a QueryRay,
    ray: &'a Ray,
    ignore: Option<&'a MaterialSet>,
    /// An ignored material was hit.
    filtered: bool,
}

/// Whether the ray is blocked.
#[inline(always)]
pub(super) fn occlusion<S: Simd, const CERTIFIED: bool>(
    simd: S,
    work: &mut Work<'_, '_>,
    (query, local): (&mut QueryRay, &mut LocalRay<S>),
    ray: &Ray,
    ignore: Option<&MaterialSet>,
) -> Result<Occlusion, RayError> {
    let coarse = &work.octree.coarse;
    if let Some(reason) = prepare(simd, ray, &work.octree.space, query, local) {
        return Err(RayError::Invalid(reason));
    }
    let high = query.local_high(ray.t_max);
    let (inner_low, inner_high) = query.local_inner(ray.t_min, ray.t_max);
    let mut any = Any {
        local,
        outer: splat_interval(simd, query.local_low(ray.t_min), high),
        inner: splat_interval(simd, inner_low, inner_high),
        query,
        ray,
        ignore,
        filtered: false,
    };
    work.exact.reset();
    let mut stack = Stack::new(work.stack);
    let mut child = Child::node(ROOT);
    loop {
        work.counters.box_tests += 1;
        let mut next = None;
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = &coarse.sub_boxes[block as usize];
            let (_, hits) = any.local.boxes.test_packed(simd, sub_boxes, any.outer.low, any.outer.high);
            if hits != 0 {
                work.counters.block_visits += 1;
                let slot = work.pins.get(work.octree, BlockId(block), work.scratch, work.counters)?;
                let fine = Fine::new(slot);
                if any.visit_block::<CERTIFIED>(simd, &fine, &mut stack, work.exact, work.counters) {
                    return Ok(Occlusion::Blocked);
                }
                any.local.enter_frame(simd, any.query, &coarse.frame);
            }
        } else {
            let node = &coarse.nodes[child.node_index()];
            let (near, hits) = any.local.boxes.test(simd, &node.bounds, any.outer.low, any.outer.high);
            next = stack.push_sorted(simd, node, near, hits);
        }
        if next.is_none() {
            next = stack.pop(0, f32::INFINITY);
        }
        match next {
            Some(entry) => child = entry.child,
            None => break,
        }
    }
    Ok(if any.filtered { Occlusion::Filtered } else { Occlusion::Clear })
}

impl<S: Simd> Any<'_, S> {
    /// Whether a triangle of the block blocks the ray.
    #[inline(always)]
    fn visit_block<const CERTIFIED: bool>(
        &mut self,
        simd: S,
        fine: &Fine<'_>,
        stack: &mut Stack<'_>,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> bool {
        self.local.enter_frame(simd, self.query, &fine.frame());
        let (low, high) = fine.extents();
        self.local.set_reach(self.query, low, high, fine.vertex_error());
        let floor = stack.len();
        let mut node = &fine.nodes[ROOT as usize];
        loop {
            counters.box_tests += 1;
            let (near, hits) = self.local.boxes.test(simd, &node.bounds, self.outer.low, self.outer.high);
            let mut next = stack.push_unsorted(simd, node, near, hits);
            loop {
                if next.is_none() {
                    next = stack.pop(floor, f32::INFINITY);
                }
                let Some(entry) = next else { return false };
                if !entry.child.is_leaf() {
                    node = &fine.nodes[entry.child.node_index()];
                    break;
                }
                if self.visit_leaf::<CERTIFIED>(simd, fine, entry.child, entry.edge, exact, counters) {
                    return true;
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
        exact: &mut ExactRay,
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
                if self.blocks(fine, at, certain >> i & 1 == 1, exact, counters) {
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
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> bool {
        let ignored = self.ignore.is_some_and(|set| set.contains(fine.material(at)));
        if ignored && self.filtered {
            return false;
        }
        let hit = certain || {
            counters.decisions += 1;
            let vertices = fine.exact_vertices(at);
            let (ray, fallbacks) = (self.ray, &mut counters.exact_fallbacks);
            exact.decide(ray, ray.t_min, ray.t_max, &vertices, fallbacks).is_some()
        };
        self.filtered |= hit && ignored;
        hit && !ignored
    }
}
