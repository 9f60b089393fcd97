//! Closest hit: children in the order of distance, everything beyond the best hit pruned.

use super::Hit;
use super::load::{LoadScratch, Pins};
use super::stack::Stack;
use crate::error::LoadError;
use crate::geom::Ray;
use crate::octree::{Child, Fine, LazyOctree, LocalRay, QueryRay, ROOT, TriangleLocation, splat_interval};
use crate::simd::{Interval, LANES, Packet, Simd};
use crate::stats::TraceCounters;
use crate::units::{BlockId, TriangleId};

/// What a traversal works with, borrowed from the tracer.
pub(super) struct Work<'t, 'o> {
    pub octree: &'o LazyOctree,
    pub pins: &'t mut Pins<'o>,
    pub scratch: &'t mut LoadScratch,
    pub stack: &'t mut Stack,
    pub counters: &'t mut TraceCounters,
}

/// One closest-hit query on its way.
struct Closest<S: Simd> {
    query: QueryRay,
    local: LocalRay<S>,
    interval: Interval<S::F>,
    /// `interval.high` as a number.
    high: f32,
    /// Only hits strictly after this count.
    after: Option<(f64, TriangleId)>,
    best: Option<Hit>,
}

/// The least hit by (t, id) among those strictly greater than `after` (I3). The ray is valid.
#[inline(always)]
pub(super) fn closest_hit<S: Simd, const CERTIFIED: bool>(
    simd: S,
    work: &mut Work<'_, '_>,
    ray: &Ray,
    after: Option<(f64, TriangleId)>,
) -> Result<Option<Hit>, LoadError> {
    let mut ray = *ray;
    if let Some((t, _)) = after {
        // Written so that NaN changes nothing.
        if t > ray.t_min {
            ray.t_min = t;
        }
        if ray.t_min > ray.t_max {
            return Ok(None);
        }
    }
    let coarse = &work.octree.coarse;
    let query = QueryRay::new(&ray, coarse.frame.scale, &work.octree.model.bounds);
    let high = query.local_high(ray.t_max);
    let mut closest = Closest {
        local: LocalRay::new(simd, &query, &coarse.frame),
        interval: splat_interval(simd, query.local_low(ray.t_min), high),
        query,
        high,
        after,
        best: None,
    };
    // The coarse tree keeps the ray in its own frame; blocks with another base change a copy.
    let coarse_boxes = closest.local.boxes;
    work.stack.truncate(0);
    let mut next = Some(Child::node(ROOT));
    while let Some(child) = next {
        work.counters.box_tests += 1;
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = &coarse.sub_boxes[block as usize];
            let (_, hits) =
                coarse_boxes.test_packed(simd, sub_boxes, closest.interval.low, closest.interval.high);
            if hits != 0 {
                closest.visit_block::<CERTIFIED>(simd, work, BlockId(block))?;
            }
            next = work.stack.pop(0, closest.high).map(|entry| entry.child);
        } else {
            let node = &coarse.nodes[child.node_index()];
            let (near, hits) =
                coarse_boxes.test(simd, &node.bounds, closest.interval.low, closest.interval.high);
            next = match work.stack.push_sorted(simd, node, near, hits) {
                Some(entry) => Some(entry.child),
                None => work.stack.pop(0, closest.high).map(|entry| entry.child),
            };
        }
    }
    Ok(closest.best)
}

impl<S: Simd> Closest<S> {
    #[inline(always)]
    fn visit_block<const CERTIFIED: bool>(
        &mut self,
        simd: S,
        work: &mut Work<'_, '_>,
        block: BlockId,
    ) -> Result<(), LoadError> {
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
            let (near, hits) =
                self.local.boxes.test(simd, &node.bounds, self.interval.low, self.interval.high);
            let mut next = work.stack.push_sorted(simd, node, near, hits);
            loop {
                let entry = match next {
                    Some(entry) => entry,
                    None => match work.stack.pop(floor, self.high) {
                        Some(entry) => entry,
                        None => return Ok(()),
                    },
                };
                if !entry.child.is_leaf() {
                    node = &fine.nodes[entry.child.node_index()];
                    break;
                }
                self.visit_leaf::<CERTIFIED>(simd, &fine, entry.child, entry.edge, work.counters);
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
    ) {
        let (start, count) = leaf.triangle_range();
        counters.triangle_tests += count as u64;
        let mut first = 0;
        while first < count {
            let packet = leaf_packet(simd, fine, start, count, first);
            let lanes = lanes_in_use(count - first);
            if CERTIFIED {
                let mut survivors =
                    self.local.triangles.survivors(simd, &packet, edge, &self.interval) & lanes;
                while survivors != 0 {
                    let lane = first + survivors.trailing_zeros() as usize;
                    survivors &= survivors - 1;
                    self.decide(simd, fine, TriangleLocation { start, count, lane }, counters);
                }
            } else {
                let (hits, [t, u, v]) = self.local.triangles.decide(simd, &packet, &self.interval);
                let mut hits = hits & lanes;
                if hits != 0 {
                    let [t, u, v] = [t, u, v].map(|x| simd.to_array(x));
                    while hits != 0 {
                        let i = hits.trailing_zeros() as usize;
                        hits &= hits - 1;
                        let at = TriangleLocation { start, count, lane: first + i };
                        let t = self.query.from_local(t[i]);
                        self.offer(simd, fine, at, t, f64::from(u[i]), f64::from(v[i]));
                    }
                }
            }
            first += LANES;
        }
    }

    /// The certified decision for one triangle that the reject test let through.
    #[inline(always)]
    fn decide(&mut self, simd: S, fine: &Fine<'_>, at: TriangleLocation, counters: &mut TraceCounters) {
        counters.decisions += 1;
        let vertices = fine.exact_vertices(at);
        if let Some(hit) = self.query.exact.intersect(&vertices, &mut counters.exact_fallbacks) {
            self.offer(simd, fine, at, hit.t, hit.u, hit.v);
        }
    }

    /// Takes a hit if it is the least so far.
    #[inline(always)]
    fn offer(&mut self, simd: S, fine: &Fine<'_>, at: TriangleLocation, t: f64, u: f64, v: f64) {
        let triangle = fine.id(at);
        let better = self.best.is_none_or(|best| (t, triangle) < (best.t, best.triangle));
        if !better || self.after.is_some_and(|after| (t, triangle) <= after) {
            return;
        }
        self.best =
            Some(Hit { t, u, v, triangle, material: fine.material(at), vertices: fine.exact_vertices(at) });
        // Hits beyond the range of f64 all have t = f64::MAX, and only an infinite end admits them.
        if t < f64::MAX {
            self.query.exact.t_max = t;
        }
        self.high = self.query.local_high(t);
        self.interval.high = simd.splat(self.high);
    }
}

/// Eight triangles of a leaf, from the one at `first` on.
#[inline(always)]
pub(super) fn leaf_packet<S: Simd>(
    simd: S,
    fine: &Fine<'_>,
    start: usize,
    count: usize,
    first: usize,
) -> Packet<S> {
    if fine.is_expanded() {
        Packet::from_rows(simd, &fine.rows[9 * start..], count, first)
    } else {
        let end = (first + LANES).min(count);
        Packet::from_indices(simd, fine.vertices(), &fine.indices()[start + first..start + end])
    }
}

/// A bit for each of the first `count` lanes.
#[inline(always)]
pub(super) fn lanes_in_use(count: usize) -> u32 {
    if count >= LANES { 0xff } else { (1 << count) - 1 }
}
