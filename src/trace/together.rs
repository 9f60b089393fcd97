//! Closest hits of eight rays that go much the same way: the coarse tree is walked once for all of them, and each block is entered
//! by those that meet it, one after the other, while its parts are at hand. What each ray hits does not depend on it (I2).

use smallvec::SmallVec;

use super::Hit;
use super::closest::{Closest, VisitBlock, Work};
use super::exact::RayError;
use super::policy::Policy;
use super::stack::{Limit, Stack};
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
            high,
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

/// The end of the ray that ends last.
#[inline(always)]
fn last_high<S: Simd, P: Policy>(queries: &[Closest<'_, S, P, Option<Hit>>]) -> f32 {
    queries.iter().fold(0.0, |most, query| if query.high > most { query.high } else { most })
}
