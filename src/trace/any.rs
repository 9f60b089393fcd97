//! Any hit: whether something lies between a ray's ends, in whatever order is found first.

use super::closest::{Prepared, Work, lanes_in_use};
use super::exact::{ExactRay, RayError};
use super::policy::{Candidate, Policy};
use super::stack::{Limit, Stack};
use super::unvisited::{Next, UnvisitedAny};
use super::{MaterialSet, Occlusion};
use crate::geom::Ray;
use crate::octree::{Child, Fine, LocalRay, QueryRay, RayGroup, Reached, TriangleLocation, splat_interval};
use crate::simd::{ErrorBounds, Interval, LANES, Operation, Simd};
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// One any-hit query on its way.
pub(super) struct Any<'a, S: Simd, P: Policy> {
    pub local: &'a mut LocalRay,
    /// What the policy needs of the ray.
    prepared: P::Ray<S>,
    /// Holds the ray's interval.
    pub outer: Interval<S::F>,
    /// Lies inside the ray's interval.
    inner: Interval<S::F>,
    /// Whether blocks have the frame of the coarse tree.
    shares_frame: bool,
    query: &'a QueryRay,
    ray: &'a Ray,
    ignore: Option<&'a MaterialSet>,
    /// An ignored material was hit.
    pub filtered: bool,
}

/// Whether the ray is blocked; `None` if the pins are not to load and blocks were missing, which are then in
/// `unvisited`. To go on, call it again with that and `is_resumed`.
#[inline(always)]
pub(super) fn occlusion<S: Simd, P: Policy>(
    simd: S,
    work: &mut Work<'_, '_>,
    Prepared { group, lane, query, local }: Prepared<'_>,
    ray: &Ray,
    ignore: Option<&MaterialSet>,
    unvisited: &mut UnvisitedAny,
    is_resumed: bool,
) -> Result<Option<Occlusion>, RayError> {
    let coarse = &work.octree.coarse;
    if let Some(reason) = group.prepare(simd, lane, ray, &work.octree.space, query, local) {
        return Err(RayError::Invalid(reason));
    }
    let mut any: Any<'_, S, P> = Any {
        filtered: is_resumed && unvisited.filtered,
        ..Any::new(simd, work, (group, lane), ray, ignore, (query, local))
    };
    work.exact.reset();
    let mut stack = Stack::new(work.stack);
    let (mut child, mut listed) = unvisited.begin(is_resumed);
    loop {
        work.counters.box_tests += 1;
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = match coarse.sub_boxes.get(block as usize) {
                Some(sub_boxes) => sub_boxes,
                // What is missing may make it needless to cut a part of the model that was not cut yet.
                None if !unvisited.is_empty() && work.octree.would_cut(block) => {
                    work.counters.box_tests -= 1;
                    unvisited.stopped_at = Some(BlockId(block));
                    break;
                }
                None => match work.octree.reach(block)? {
                    Reached::Block(sub_boxes) => sub_boxes,
                    Reached::Cell(root) => {
                        work.counters.box_tests -= 1;
                        child = root;
                        continue;
                    }
                },
            };
            let (_, hits) = any.local.test.boxes.test_packed(simd, sub_boxes, any.outer.low, any.outer.high);
            if hits != 0 {
                match work.pins.get(work.octree, BlockId(block), work.scratch, work.counters)? {
                    Some(slot) => {
                        work.counters.block_visits += 1;
                        let visit = VisitBlock::<S, P> {
                            any: &mut any,
                            slot,
                            hits,
                            stack: stack.above(),
                            exact: work.exact,
                            counters: work.counters,
                        };
                        if simd.enter(visit) {
                            return Ok(Some(Occlusion::Blocked));
                        }
                        if !any.shares_frame {
                            any.local.enter_frame(simd, any.query, &coarse.frame);
                        }
                    }
                    None => {
                        work.counters.box_tests -= 1;
                        if !unvisited.push(BlockId(block)) {
                            unvisited.stopped_at = Some(BlockId(block));
                            break;
                        }
                    }
                }
            }
        } else {
            let node = coarse.node(child);
            let (near, hits) = any.local.test.boxes.test(simd, &node.bounds, any.outer.low, any.outer.high);
            if hits != 0 {
                // In order of distance: what blocks a ray is often near, and then fewer blocks are touched.
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
                stack.return_to(simd, coarse, block, &any.local.test.boxes, &any.outer);
            }
            Next::Waiting => {}
            Next::End => break,
        }
        child = stack.pop(Limit::NONE);
        if child == Child::NONE {
            break;
        }
    }
    if !unvisited.is_empty() {
        unvisited.filtered = any.filtered;
        return Ok(None);
    }
    Ok(Some(if any.filtered { Occlusion::Filtered } else { Occlusion::Clear }))
}

/// The traversal of one block; gives whether a triangle of it blocks the ray. A function of its own, so that the registers
/// are its own.
pub(super) struct VisitBlock<'v, 'r, S: Simd, P: Policy> {
    pub any: &'v mut Any<'r, S, P>,
    pub slot: &'v [u8],
    /// Which of the block's sub-boxes the ray meets.
    pub hits: u32,
    /// Its entries stay where they are.
    pub stack: Stack<'v>,
    pub exact: &'v mut ExactRay,
    pub counters: &'v mut TraceCounters,
}

impl<S: Simd, P: Policy> Operation<S> for VisitBlock<'_, '_, S, P> {
    type Output = bool;

    #[inline(always)]
    fn run(self, simd: S) -> bool {
        let VisitBlock { any, slot, hits, mut stack, exact, counters } = self;
        let fine = Fine::new(slot);
        if !any.shares_frame {
            any.local.enter_frame(simd, any.query, &fine.frame());
        }
        let bounds = any.local.bounds(simd, any.query, fine.extents(), fine.vertex_error());
        let prefetch = |child| fine.prefetch(simd, child);
        let (groups, used) = fine.groups();
        let mut child = match hits & used {
            0 => return false,
            hits => stack.push_unsorted(groups, hits, prefetch),
        };
        loop {
            while child.is_leaf() {
                if child == Child::NONE {
                    return false;
                }
                if any.visit_leaf(simd, (&fine, &bounds), child, exact, counters) {
                    return true;
                }
                child = stack.pop(Limit::NONE);
            }
            let node = fine.node(child);
            counters.box_tests += 1;
            let (_, hits) = any.local.test.boxes.test(simd, &node.bounds, any.outer.low, any.outer.high);
            child = match hits {
                0 => stack.pop(Limit::NONE),
                _ => stack.push_unsorted(&node.children, hits, prefetch),
            };
        }
    }
}

impl<'a, S: Simd, P: Policy> Any<'a, S, P> {
    /// A query that begins, for ray `lane` of a group, prepared into `query` and `local`.
    #[inline(always)]
    pub fn new(
        simd: S,
        work: &Work<'_, '_>,
        (group, lane): (&RayGroup, usize),
        ray: &'a Ray,
        ignore: Option<&'a MaterialSet>,
        (query, local): (&'a QueryRay, &'a mut LocalRay),
    ) -> Any<'a, S, P> {
        let (outer, inner) = if query.is_plain() {
            let (low, high) = group.outer(lane);
            (splat_interval(simd, low, high), group.inner(simd, lane))
        } else {
            let (low, high) = query.local_inner(ray.t_min, ray.t_max);
            let outer = splat_interval(simd, query.local_low(ray.t_min), query.local_high(ray.t_max));
            (outer, splat_interval(simd, low, high))
        };
        Any {
            prepared: P::prepare(simd, work.octree.tier, &local.test.triangles),
            local,
            outer,
            inner,
            shares_frame: work.octree.space.is_shared,
            query,
            ray,
            ignore,
            filtered: false,
        }
    }

    /// Whether one of these triangles of a packet, whose first is number `first` of the leaf, is of a material that is not ignored.
    #[inline(always)]
    fn is_any_not_ignored(&self, fine: &Fine<'_>, leaf: Child, first: usize, mut triangles: u32) -> bool {
        let Some(ignore) = self.ignore else { return true };
        while triangles != 0 {
            let at = TriangleLocation { leaf, lane: first + triangles.trailing_zeros() as usize };
            if !ignore.contains(fine.material(at)) {
                return true;
            }
            triangles &= triangles - 1;
        }
        false
    }

    #[inline(always)]
    fn visit_leaf(
        &mut self,
        simd: S,
        (fine, bounds): (&Fine<'_>, &ErrorBounds<S>),
        leaf: Child,
        exact: &mut ExactRay,
        counters: &mut TraceCounters,
    ) -> bool {
        let count = leaf.triangle_count();
        let edge = fine.edge(leaf);
        counters.triangle_tests += count as u64;
        let triangles_of_leaf = fine.leaf(P::EXPANDED, leaf);
        let mut first = 0;
        while first < count {
            let packet = triangles_of_leaf.packet(simd, first);
            let lanes = lanes_in_use(count - first);
            // Lanes that may be hit, and those of them that need no decision.
            let triangles = &self.local.test.triangles;
            let (possible, certain, seen) = P::candidates_and_certain(
                simd,
                &self.prepared,
                triangles,
                &packet,
                (bounds, edge),
                &self.outer,
                &self.inner,
            );
            let (mut possible, certain) = (possible & lanes, certain & lanes);
            if certain != 0 && self.is_any_not_ignored(fine, leaf, first, certain) {
                return true;
            }
            while possible != 0 {
                let i = possible.trailing_zeros();
                possible &= possible - 1;
                let at = TriangleLocation { leaf, lane: first + i as usize };
                let settle = Settle {
                    any: &mut *self,
                    fine,
                    at,
                    lane: i as usize,
                    seen: &seen,
                    is_certain: certain >> i & 1 == 1,
                    exact,
                    counters,
                };
                if simd.enter(settle) {
                    return true;
                }
            }
            first += LANES;
        }
        false
    }
}

/// Whether a triangle that may be hit is hit and is not ignored. A function of its own: seldom needed, and what it takes
/// would be made ready for every leaf.
struct Settle<'v, 'r, S: Simd, P: Policy> {
    any: &'v mut Any<'r, S, P>,
    fine: &'v Fine<'v>,
    at: TriangleLocation,
    /// Its place in the packet.
    lane: usize,
    seen: &'v P::Seen<S>,
    is_certain: bool,
    exact: &'v mut ExactRay,
    counters: &'v mut TraceCounters,
}

impl<S: Simd, P: Policy> Operation<S> for Settle<'_, '_, S, P> {
    type Output = bool;

    #[inline(always)]
    fn run(self, simd: S) -> bool {
        let Settle { any, fine, at, lane, seen, is_certain, exact, counters } = self;
        let ignored = any.ignore.is_some_and(|set| set.contains(fine.material(at)));
        if ignored && any.filtered {
            return false;
        }
        let hit = is_certain || {
            let candidate = Candidate {
                lane,
                vertices: &fine.exact_vertices(at),
                ray: any.ray,
                query: any.query,
                t_min: any.ray.t_min,
                t_max: any.ray.t_max,
            };
            P::settle(simd, seen, &candidate, exact, counters).is_some()
        };
        any.filtered |= hit && ignored;
        hit && !ignored
    }
}
