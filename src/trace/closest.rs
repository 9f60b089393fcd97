//! Closest hit: children in the order of distance, everything beyond the best hit pruned.

use super::Hit;
use super::exact::{ExactRay, RayError};
use super::keep::Keep;
use super::load::{LoadScratch, Pins};
use super::policy::{Candidate, Policy};
use super::stack::{Entries, Limit, Stack};
use super::unvisited::{Next, UnvisitedClosest};
use crate::geom::{Ray, TriangleHit};
use crate::octree::{
    Child, Fine, LazyOctree, LocalRay, QueryRay, RayGroup, Reached, TriangleLocation, splat_interval,
};
use crate::simd::{ErrorBounds, Interval, LANES, Operation, Simd};
use crate::stats::TraceCounters;
use crate::units::{BlockId, TriangleId};

/// What a traversal works with, borrowed from the tracer.
pub(super) struct Work<'t, 'o> {
    pub octree: &'o LazyOctree,
    pub pins: &'t mut Pins<'o>,
    pub scratch: &'t mut LoadScratch,
    pub stack: &'t mut Entries,
    pub exact: &'t mut ExactRay,
    pub counters: &'t mut TraceCounters,
}

/// A ray of a group, and what it is prepared into.
pub(super) struct Prepared<'p> {
    pub group: &'p RayGroup,
    pub lane: usize,
    pub query: &'p mut QueryRay,
    pub local: &'p mut LocalRay,
}

/// One closest-hit query on its way.
pub(super) struct Closest<'r, S: Simd, P: Policy, K: Keep> {
    pub local: &'r mut LocalRay,
    /// What the policy needs of the ray.
    pub prepared: P::Ray<S>,
    /// Where the part of the ray begins where hits would be kept, in the coarse tree's frame. A single number, like those of the
    /// ray: see [`BoxRay`](crate::simd::BoxRay).
    pub low: f32,
    /// Where it ends. What waits beyond need not be visited. There is no second copy of that number beside `low`: the two would be
    /// written one by one and read at once, for which a processor waits until both are in its cache.
    pub limit: Limit,
    /// Whether blocks have the frame of the coarse tree.
    pub shares_frame: bool,
    pub query: &'r QueryRay,
    pub ray: &'r Ray,
    /// Where hits may begin: `ray.t_min` or the `t` in `after`.
    pub t_min: f64,
    /// Where the hits that would be kept end: the best hit's `t`, or the ray's end.
    pub t_max: f64,
    /// Only hits strictly after this count.
    pub after: Option<(f64, TriangleId)>,
    pub kept: &'r mut K,
}

/// Offers to `kept`, which is empty at first, hits strictly greater than `after` by (t, id): all that it would keep (I3).
///
/// Gives whether it is done. If the pins are not to load it may not be: then blocks that were missing are in `unvisited`, and the
/// nearest of them is what it waits for. It has looked behind them at what was there, which may be gone when they come, and which
/// may have made some of them needless. To go on, call it again with `unvisited` and `kept` as they were left, and `is_resumed`.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "what a query is made of, and where it stopped")]
pub(super) fn closest_hit<S: Simd, P: Policy, K: Keep>(
    simd: S,
    work: &mut Work<'_, '_>,
    Prepared { group, lane, query, local }: Prepared<'_>,
    ray: &Ray,
    after: Option<(f64, TriangleId)>,
    unvisited: &mut UnvisitedClosest,
    is_resumed: bool,
    kept: &mut K,
) -> Result<bool, RayError> {
    let coarse = &work.octree.coarse;
    if let Some(reason) = group.prepare(simd, lane, ray, &work.octree.space, query, local) {
        return Err(RayError::Invalid(reason));
    }
    // Written so that NaN changes nothing.
    let t_min = match after {
        Some((t, _)) if t > ray.t_min => t,
        _ => ray.t_min,
    };
    if t_min > ray.t_max {
        return Ok(true);
    }
    // As `offer` left them.
    let end = kept.end();
    let t_max = end.filter(|end| *end < f64::MAX).unwrap_or(ray.t_max);
    let (low, high) = if query.is_plain() && after.is_none() && end.is_none() {
        group.outer(lane)
    } else {
        (query.local_low(t_min), query.local_high(end.unwrap_or(ray.t_max)))
    };
    let mut closest: Closest<'_, S, P, K> = Closest {
        prepared: P::prepare(simd, work.octree.tier, &local.test.triangles),
        local,
        low,
        limit: Limit::new(high),
        shares_frame: work.octree.space.is_shared,
        query,
        ray,
        t_min,
        t_max,
        after,
        kept,
    };
    work.exact.reset();
    let mut stack = Stack::new(work.stack);
    let (mut child, mut listed) = unvisited.begin(is_resumed);
    let mut box_tests = 0;
    loop {
        box_tests += 1;
        let (local, interval) = (&closest.local, closest.interval(simd));
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = match coarse.sub_boxes.get(block as usize) {
                Some(sub_boxes) => sub_boxes,
                // What is missing may make it needless to cut a part of the model that was not cut yet.
                None if !unvisited.is_empty()
                    && work.octree.would_cut(block)
                    && simd.enter(StillNeeds {
                        closest: &closest,
                        octree: work.octree,
                        unvisited: &mut *unvisited,
                    }) =>
                {
                    box_tests -= 1;
                    unvisited.stopped_at = Some(BlockId(block));
                    break;
                }
                None => match work.octree.reach(block)? {
                    Reached::Block(sub_boxes) => sub_boxes,
                    Reached::Cell(root) => {
                        box_tests -= 1;
                        child = root;
                        continue;
                    }
                },
            };
            let (near, hits) = local.test.boxes.test_packed(simd, sub_boxes, interval.low, interval.high);
            if hits != 0 {
                if !closest.kept.pass(|| stack.least_near(simd, near, hits), closest.query) {
                    break;
                }
                let block = BlockId(block);
                match work.pins.get(work.octree, block, work.scratch, work.counters)? {
                    Some(slot) => {
                        work.counters.block_visits += 1;
                        let visit = VisitBlock::<S, P, K> {
                            closest: &mut closest,
                            slot,
                            near,
                            hits,
                            stack: stack.above(),
                            exact: work.exact,
                            counters: work.counters,
                        };
                        simd.enter(visit);
                        if !closest.shares_frame {
                            closest.local.enter_frame(simd, closest.query, &coarse.frame);
                        }
                    }
                    None => {
                        // This test is made again.
                        box_tests -= 1;
                        if !unvisited.push(block) {
                            simd.enter(StillNeeds {
                                closest: &closest,
                                octree: work.octree,
                                unvisited: &mut *unvisited,
                            });
                            if !unvisited.push(block) {
                                unvisited.stopped_at = Some(block);
                                break;
                            }
                        }
                    }
                }
            }
        } else {
            let node = coarse.node(child);
            let (near, hits) = local.test.boxes.test(simd, &node.bounds, interval.low, interval.high);
            if hits != 0 {
                child =
                    stack.push_sorted(simd, &node.children, near, hits, |child| coarse.prefetch(simd, child));
                continue;
            }
        }
        match listed.next(unvisited) {
            Next::Listed(block) => {
                child = block;
                continue;
            }
            Next::Stopped(block) => {
                // By the whole ray, which meets that block; what lies behind hits that were found since then is not popped.
                let whole = splat_interval(simd, closest.low, closest.query.local_high(ray.t_max));
                stack.return_to(simd, coarse, block, &closest.local.test.boxes, &whole);
            }
            Next::Waiting => {}
            Next::End => break,
        }
        child = stack.pop(closest.limit);
        if child == Child::NONE {
            break;
        }
    }
    work.counters.box_tests += box_tests;
    Ok(unvisited.is_empty()
        || !simd.enter(StillNeeds { closest: &closest, octree: work.octree, unvisited: &mut *unvisited }))
}

/// The traversal of one block. A function of its own, so that the registers are its own.
pub(super) struct VisitBlock<'v, 'r, S: Simd, P: Policy, K: Keep> {
    pub closest: &'v mut Closest<'r, S, P, K>,
    pub slot: &'v [u8],
    /// Where the ray enters the block's sub-boxes, and which.
    pub near: S::F,
    pub hits: u32,
    /// Its entries stay where they are.
    pub stack: Stack<'v>,
    pub exact: &'v mut ExactRay,
    pub counters: &'v mut TraceCounters,
}

impl<S: Simd, P: Policy, K: Keep> Operation<S> for VisitBlock<'_, '_, S, P, K> {
    type Output = ();

    #[inline(always)]
    fn run(self, simd: S) {
        let VisitBlock { closest, slot, near, hits, mut stack, exact, counters } = self;
        let fine = Fine::new(slot);
        if !closest.shares_frame {
            closest.local.enter_frame(simd, closest.query, &fine.frame());
        }
        let bounds = closest.local.bounds(simd, closest.query, fine.extents(), fine.vertex_error());
        let mut box_tests = 0;
        let prefetch = |child| fine.prefetch(simd, child);
        let (groups, used) = fine.groups();
        let mut child = match hits & used {
            0 => return,
            hits => stack.push_sorted(simd, groups, near, hits, prefetch),
        };
        loop {
            while child.is_leaf() {
                if child == Child::NONE {
                    counters.box_tests += box_tests;
                    return;
                }
                closest.visit_leaf(simd, (&fine, &bounds), child, exact, counters);
                child = stack.pop(closest.limit);
            }
            let node = fine.node(child);
            box_tests += 1;
            let (boxes, interval) = (&closest.local.test.boxes, closest.interval(simd));
            let (near, hits) = boxes.test(simd, &node.bounds, interval.low, interval.high);
            child = match hits {
                0 => stack.pop(closest.limit),
                _ => stack.push_sorted(simd, &node.children, near, hits, prefetch),
            };
        }
    }
}

/// What becomes of a triangle that a kernel let through. A function of its own: seldom needed, and what it takes would be
/// made ready for every leaf.
struct Settle<'v, 'r, S: Simd, P: Policy, K: Keep> {
    closest: &'v mut Closest<'r, S, P, K>,
    fine: &'v Fine<'v>,
    at: TriangleLocation,
    /// Its place in the packet.
    lane: usize,
    seen: &'v P::Seen<S>,
    exact: &'v mut ExactRay,
    counters: &'v mut TraceCounters,
}

impl<S: Simd, P: Policy, K: Keep> Operation<S> for Settle<'_, '_, S, P, K> {
    type Output = ();

    #[inline(always)]
    fn run(self, simd: S) {
        let Settle { closest, fine, at, lane, seen, exact, counters } = self;
        let vertices = fine.exact_vertices(at);
        let candidate = Candidate {
            lane,
            vertices: &vertices,
            ray: closest.ray,
            query: closest.query,
            t_min: closest.t_min,
            t_max: closest.t_max,
        };
        if let Some(hit) = P::settle(simd, seen, &candidate, exact, counters) {
            closest.offer(fine, at, hit, vertices);
        }
    }
}

/// Drops the missing blocks that lie behind what was found since they were seen. Gives whether any are left. A function of its own:
/// seldom needed. Its tests are not counted.
struct StillNeeds<'v, 'r, S: Simd, P: Policy, K: Keep> {
    closest: &'v Closest<'r, S, P, K>,
    octree: &'v LazyOctree,
    unvisited: &'v mut UnvisitedClosest,
}

impl<S: Simd, P: Policy, K: Keep> Operation<S> for StillNeeds<'_, '_, S, P, K> {
    type Output = bool;

    #[inline(always)]
    fn run(self, simd: S) -> bool {
        let StillNeeds { closest, octree, unvisited } = self;
        let (boxes, interval) = (&closest.local.test.boxes, closest.interval(simd));
        for place in 0..unvisited.take() {
            let block = unvisited.taken(place);
            // What is listed was found, so there always are.
            if let Some(sub_boxes) = octree.sub_boxes(block) {
                let (_, hits) = boxes.test_packed(simd, sub_boxes, interval.low, interval.high);
                if hits == 0 {
                    continue;
                }
            }
            unvisited.push(block);
        }
        !unvisited.is_empty()
    }
}

impl<S: Simd, P: Policy, K: Keep> Closest<'_, S, P, K> {
    /// The part of the ray where hits would be kept.
    #[inline(always)]
    pub fn interval(&self, simd: S) -> Interval<S::F> {
        splat_interval(simd, self.low, self.limit.high())
    }

    #[inline(always)]
    fn visit_leaf(
        &mut self,
        simd: S,
        (fine, bounds): (&Fine<'_>, &ErrorBounds<S>),
        leaf: Child,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) {
        let count = leaf.triangle_count();
        let edge = fine.edge(leaf);
        counters.triangle_tests += count as u64;
        let triangles_of_leaf = fine.leaf(P::EXPANDED, leaf);
        let mut first = 0;
        while first < count {
            let packet = triangles_of_leaf.packet(simd, first);
            let lanes = lanes_in_use(count - first);
            let triangles = &self.local.test.triangles;
            let (candidates, seen) =
                P::candidates(simd, &self.prepared, triangles, &packet, (bounds, edge), &self.interval(simd));
            let mut candidates = candidates & lanes;
            while candidates != 0 {
                let lane = candidates.trailing_zeros() as usize;
                candidates &= candidates - 1;
                let at = TriangleLocation { leaf, lane: first + lane };
                simd.enter(Settle { closest: &mut *self, fine, at, lane, seen: &seen, exact, counters });
            }
            first += LANES;
        }
    }

    /// Takes a hit if it is one to be kept.
    #[inline(always)]
    fn offer(
        &mut self,
        fine: &Fine<'_>,
        at: TriangleLocation,
        TriangleHit { t, u, v }: TriangleHit,
        vertices: [[f64; 3]; 3],
    ) {
        let triangle = fine.id(at);
        let admitted = match self.after {
            Some(after) => (t, triangle) > after || after.0.is_nan(),
            None => true,
        };
        if !self.kept.wants((t, triangle)) || !admitted {
            return;
        }
        let hit = Hit { t, u, v, triangle, material: fine.material(at), vertices };
        let Some(end) = self.kept.keep(hit) else { return };
        // Hits beyond the range of f64 all have t = f64::MAX, and only an infinite end admits them.
        if end < f64::MAX {
            self.t_max = end;
        }
        self.limit = Limit::new(self.query.local_high(end));
    }
}

/// A bit for each of the first `count` lanes.
#[inline(always)]
pub(crate) fn lanes_in_use(count: usize) -> u32 {
    (1 << count.min(LANES)) - 1
}
