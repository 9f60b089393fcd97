//! Eight rays that go much the same way: the coarse tree is walked once for all of them, and each block is entered by those that meet
//! it, one after the other, while its parts are at hand. What each ray hits does not depend on it (I2).

use smallvec::SmallVec;

use super::any::{Any, VisitBlock as VisitBlockForAny};
use super::closest::{Closest, VisitBlock, Work};
use super::exact::RayError;
use super::policy::Policy;
use super::stack::{Limit, Stack};
use super::{Hit, MaterialSet, Occlusion};
use crate::geom::Ray;
use crate::octree::{Child, LocalRay, QueryRay, RayGroup, Reached};
use crate::simd::{LANES, RayBundle, Simd};
use crate::units::BlockId;

/// Eight rays made ready.
pub(super) struct Lanes {
    queries: [QueryRay; LANES],
    locals: [LocalRay; LANES],
}

impl Lanes {
    /// No rays yet.
    pub const UNSET: Lanes = Lanes { queries: [QueryRay::UNSET; _], locals: [LocalRay::UNSET; _] };
}

/// Puts the least hit of each of eight rays into `hits`, which are empty at first. `bundle` is that of `group`. All blocks have the
/// coarse tree's frame, and the pins load.
#[inline(always)]
pub(super) fn closest_hits_together<S: Simd, P: Policy>(
    simd: S,
    work: &mut Work<'_, '_>,
    (group, bundle): (&RayGroup, &RayBundle),
    rays: &[Ray],
    hits: &mut [Option<Hit>],
    lanes: &mut Lanes,
) -> Result<(), RayError> {
    let coarse = &work.octree.coarse;
    let mut queries = SmallVec::<[Closest<'_, S, P, Option<Hit>>; LANES]>::new();
    let prepared = lanes.queries.iter_mut().zip(&mut lanes.locals);
    for (lane, ((ray, kept), (query, local))) in rays.iter().zip(hits).zip(prepared).enumerate() {
        if let Some(reason) = group.prepare(simd, lane, ray, &work.octree.space, query, local) {
            return Err(RayError::Invalid(reason));
        }
        let (low, high) = group.outer(lane);
        queries.push(Closest {
            prepared: P::prepare(simd, work.octree.tier, &local.test.triangles),
            local,
            low,
            limit: Limit::new(high),
            shares_frame: true,
            query,
            ray,
            t_min: ray.t_min,
            t_max: ray.t_max,
            after: None,
            kept,
        });
    }
    let low = simd.splat(group.first_low());
    let mut high = last_high(&queries);
    let mut stack = Stack::new(work.stack);
    let mut child = Child::COARSE_ROOT;
    let mut box_tests = 0;
    loop {
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = match coarse.sub_boxes.get(block as usize) {
                Some(sub_boxes) => sub_boxes,
                None => match work.octree.reach(block)? {
                    Reached::Block(sub_boxes) => sub_boxes,
                    Reached::Cell(root) => {
                        child = root;
                        continue;
                    }
                },
            };
            let (boxes, used) = sub_boxes.unpack_for_tests(simd);
            let (mut nears, mut mets) = ([low; LANES], [0; LANES]);
            let mut any_met = 0;
            for (closest, (near, met)) in queries.iter().zip(nears.iter_mut().zip(&mut mets)) {
                let (boxes_of_ray, interval) = (&closest.local.test.boxes, closest.interval(simd));
                let (entry, bits) = boxes_of_ray.test(simd, &boxes, interval.low, interval.high);
                (*near, *met) = (entry, bits & used);
                any_met |= *met;
            }
            box_tests += LANES as u64;
            // The pins load.
            if any_met != 0
                && let Some(slot) = work.pins.get(work.octree, BlockId(block), work.scratch, work.counters)?
            {
                for (closest, (near, met)) in queries.iter_mut().zip(nears.into_iter().zip(mets)) {
                    if met == 0 {
                        continue;
                    }
                    work.counters.block_visits += 1;
                    work.exact.reset();
                    simd.enter(VisitBlock::<S, P, Option<Hit>> {
                        closest,
                        slot,
                        near,
                        hits: met,
                        stack: stack.above(),
                        exact: work.exact,
                        counters: work.counters,
                    });
                }
                high = last_high(&queries);
            }
        } else {
            box_tests += 1;
            let node = coarse.node(child);
            let (near, met) = bundle.test(simd, &node.bounds, low, simd.splat(high));
            if met != 0 {
                let prefetch = |child| coarse.prefetch(simd, child);
                child = stack.push_sorted(simd, &node.children, near, met, prefetch);
                continue;
            }
        }
        child = stack.pop(Limit::new(high));
        if child == Child::NONE {
            break;
        }
    }
    work.counters.box_tests += box_tests;
    Ok(())
}

/// Puts what lies between the ends of each of eight rays into `out`. Otherwise as [`closest_hits_together`].
#[inline(always)]
pub(super) fn occlusions_together<S: Simd, P: Policy>(
    simd: S,
    work: &mut Work<'_, '_>,
    (group, bundle): (&RayGroup, &RayBundle),
    rays: &[Ray],
    ignore: Option<&MaterialSet>,
    out: &mut [Occlusion],
    lanes: &mut Lanes,
) -> Result<(), RayError> {
    let coarse = &work.octree.coarse;
    let mut queries = SmallVec::<[Any<'_, S, P>; LANES]>::new();
    let prepared = lanes.queries.iter_mut().zip(&mut lanes.locals);
    let mut high = 0.0;
    for (lane, (ray, (query, local))) in rays.iter().zip(prepared).enumerate() {
        if let Some(reason) = group.prepare(simd, lane, ray, &work.octree.space, query, local) {
            return Err(RayError::Invalid(reason));
        }
        let (_, end) = group.outer(lane);
        high = if end > high { end } else { high };
        queries.push(Any::new(simd, work, (group, lane), ray, ignore, (query, local)));
    }
    let (low, high) = (simd.splat(group.first_low()), simd.splat(high));
    // Bit `i`: nothing blocks ray `i` so far.
    let mut open: u32 = (1 << LANES) - 1;
    let mut stack = Stack::new(work.stack);
    let mut child = Child::COARSE_ROOT;
    let mut box_tests = 0;
    while child != Child::NONE {
        if child.is_leaf() {
            let block = child.block_index();
            let sub_boxes = match coarse.sub_boxes.get(block as usize) {
                Some(sub_boxes) => sub_boxes,
                None => match work.octree.reach(block)? {
                    Reached::Block(sub_boxes) => sub_boxes,
                    Reached::Cell(root) => {
                        child = root;
                        continue;
                    }
                },
            };
            let (boxes, used) = sub_boxes.unpack_for_tests(simd);
            let mut mets = [0; LANES];
            let mut any_met = 0;
            for (lane, (any, met)) in queries.iter().zip(&mut mets).enumerate() {
                if open >> lane & 1 == 1 {
                    let (_, bits) = any.local.test.boxes.test(simd, &boxes, any.outer.low, any.outer.high);
                    *met = bits & used;
                    any_met |= *met;
                    box_tests += 1;
                }
            }
            // The pins load.
            if any_met != 0
                && let Some(slot) = work.pins.get(work.octree, BlockId(block), work.scratch, work.counters)?
            {
                for (lane, (any, met)) in queries.iter_mut().zip(mets).enumerate() {
                    if met == 0 {
                        continue;
                    }
                    work.counters.block_visits += 1;
                    work.exact.reset();
                    let is_blocked = simd.enter(VisitBlockForAny::<S, P> {
                        any,
                        slot,
                        hits: met,
                        stack: stack.above(),
                        exact: work.exact,
                        counters: work.counters,
                    });
                    open &= !(u32::from(is_blocked) << lane);
                }
                if open == 0 {
                    break;
                }
            }
        } else {
            box_tests += 1;
            let node = coarse.node(child);
            let (near, met) = bundle.test(simd, &node.bounds, low, high);
            if met != 0 {
                // In order of distance: what blocks a ray is often near, and then fewer blocks are touched.
                let prefetch = |child| coarse.prefetch(simd, child);
                child = stack.push_sorted(simd, &node.children, near, met, prefetch);
                continue;
            }
        }
        child = stack.pop(Limit::NONE);
    }
    work.counters.box_tests += box_tests;
    for (lane, (out, any)) in out.iter_mut().zip(&queries).enumerate() {
        *out = match (open >> lane & 1, any.filtered) {
            (0, _) => Occlusion::Blocked,
            (_, true) => Occlusion::Filtered,
            (_, false) => Occlusion::Clear,
        };
    }
    Ok(())
}

/// The end of the ray that ends last.
#[inline(always)]
fn last_high<S: Simd, P: Policy>(queries: &[Closest<'_, S, P, Option<Hit>>]) -> f32 {
    queries.iter().fold(0.0, |most, query| {
        let high = query.limit.high();
        if high > most { high } else { most }
    })
}
