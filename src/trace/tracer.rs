//! [`Tracer`]: one thread's way into an octree.

use std::marker::PhantomData;

use super::all::{Receiver, all_hits};
use super::any::occlusion;
use super::closest::{Prepared, Work, closest_hit};
use super::crossings::PendingCrossings;
use super::exact::ExactRay;
use super::keep::WaitingHits;
use super::load::{LoadScratch, Pins};
use super::policy::{Certified, Fast, Policy, Selected};
use super::stack::{Entries, UNUSED};
use super::together::{Lanes, closest_hits_together, occlusions_together};
use super::unvisited::{UnvisitedAny, UnvisitedClosest};
use super::{Hit, LoadStats, MaterialSet, Occlusion};
use crate::access::{BlockSketch, QueryKind};
use crate::budget::Reservation;
use crate::error::{LoadError, TraceError};
use crate::geom::Ray;
use crate::octree::{LazyOctree, LocalRay, QueryRay, RayGroup, Tier, TracerPermit, tracer_bytes};
use crate::simd::{AnyOperation, LANES, Operation, Simd, dispatch};
use crate::stats::TraceCounters;
use crate::units::{BlockId, TriangleId};

/// Answers queries on one thread, with memory of its own.
///
/// It keeps the blocks that it entered last pinned, so that entering them again is cheap; see
/// [`Tracer::release_pins`].
pub struct Tracer<'o> {
    pub(super) octree: &'o LazyOctree,
    pub(super) pins: Pins<'o>,
    pub(super) scratch: LoadScratch,
    stack: Box<Entries>,
    exact: ExactRay,
    waiting: Box<WaitingHits>,
    pending: Box<PendingCrossings>,
    pub(super) counters: TraceCounters,
    _reservation: Reservation,
    _permit: TracerPermit<'o>,
}

impl LazyOctree {
    /// A tracer for the calling thread, or for one that it is sent to.
    ///
    /// # Errors
    /// [`TraceError::Budget`] if the budget has no room for its scratch, [`TraceError::TooManyTracers`] if `tracers_max` tracers
    /// live already.
    pub fn tracer(&self) -> Result<Tracer<'_>, TraceError> {
        let permit = self.permit()?;
        let reservation = self.budget.reserve(tracer_bytes(&*self.source), "a tracer's scratch")?;
        Ok(Tracer {
            octree: self,
            pins: Pins::new(self),
            scratch: LoadScratch::new(&*self.source),
            stack: Box::new([UNUSED; _]),
            exact: ExactRay::new(),
            waiting: Box::new(WaitingHits::new()),
            pending: Box::new(PendingCrossings::new()),
            counters: TraceCounters::default(),
            _reservation: reservation,
            _permit: permit,
        })
    }
}

impl<'o> Tracer<'o> {
    /// The octree it traces.
    pub fn octree(&self) -> &'o LazyOctree {
        self.octree
    }

    /// Finds for each ray the hit with the least (t, triangle id), and puts it at the ray's place in `hits`.
    ///
    /// Rays that go much the same way are quicker if they follow each other, and some hundred at a time (8 to 256, by a multiple of 8) are
    /// quicker than one by one or thousands, whose hits leave the processor's first cache before they are looked at.
    ///
    /// # Errors
    /// [`TraceError::InvalidRay`], or [`TraceError::Load`] if a block that a ray reached cannot be brought in; `hits` is
    /// not to be used then.
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        assert_eq!(rays.len(), hits.len(), "one place for each ray");
        dispatch(self.octree.level, ClosestHits { tracer: self, rays, after: &[], hits })
    }

    /// [`Tracer::closest_hits`] for one ray.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    pub fn closest_hit(&mut self, ray: &Ray) -> Result<Option<Hit>, TraceError> {
        let mut hit = [None];
        self.closest_hits(std::slice::from_ref(ray), &mut hit)?;
        Ok(hit[0])
    }

    /// Finds for each ray the least hit by (t, triangle id) that is strictly greater than the ray's pair in `after`: the
    /// next surface behind a known one, with no epsilon and however many surfaces coincide. A NaN `t` in `after`
    /// admits every hit.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        assert!(rays.len() == hits.len() && rays.len() == after.len(), "one place for each ray");
        dispatch(self.octree.level, ClosestHits { tracer: self, rays, after, hits })
    }

    /// Finds for each ray whether anything lies between its ends, leaving triangles of the materials in `ignore` apart.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`].
    ///
    /// # Panics
    /// If the slices differ in length.
    pub fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        assert_eq!(rays.len(), out.len(), "one place for each ray");
        // A set that ignores nothing would only cost a look at each material.
        let ignore = ignore.filter(|set| !set.is_empty());
        dispatch(self.octree.level, Occlusions { tracer: self, rays, ignore, out })
    }

    /// The slot of `block`, pinned until another block takes its place; loaded if it is missing. For traversals outside this room.
    #[inline(always)]
    pub(crate) fn slot(&mut self, block: BlockId) -> Result<&[u8], LoadError> {
        let loaded = self.pins.get(self.octree, block, &mut self.scratch, &mut self.counters)?;
        // The pins of a tracer load, so that there is always a slot.
        Ok(loaded.unwrap_or_default())
    }

    /// What this tracer did so far.
    pub fn counters(&self) -> TraceCounters {
        self.counters
    }

    /// How its loads went so far.
    pub fn load_stats(&self) -> LoadStats {
        self.scratch.stats()
    }

    /// Which blocks rays entered since this was called last, roughly, and which ones the tracer had pinned then.
    pub fn take_touched(&mut self) -> BlockSketch {
        self.pins.take_touched()
    }

    /// Lets go of all blocks, so that other tracers can have their slots. Do it before a long pause.
    pub fn release_pins(&mut self) {
        self.pins.clear();
    }

    /// Gives all hits of each ray, in order, to what `receiver` makes of the place for crossings.
    pub(super) fn receive_hits<'t, R: Receiver>(
        &'t mut self,
        rays: &[Ray],
        receiver: impl FnOnce(&'t mut PendingCrossings) -> R,
    ) -> Result<(), TraceError> {
        let (work, waiting, pending) = self.parts();
        let mut receiver = receiver(pending);
        dispatch(work.octree.level, AllHits { work, waiting, rays, receiver: &mut receiver })
    }

    #[inline(always)]
    pub(super) fn work(&mut self) -> Work<'_, 'o> {
        self.parts().0
    }

    /// What a traversal works with, and where hits and crossings wait.
    #[inline(always)]
    fn parts(&mut self) -> (Work<'_, 'o>, &mut WaitingHits, &mut PendingCrossings) {
        let work = Work {
            octree: self.octree,
            pins: &mut self.pins,
            scratch: &mut self.scratch,
            stack: &mut self.stack,
            exact: &mut self.exact,
            counters: &mut self.counters,
        };
        (work, &mut self.waiting, &mut self.pending)
    }
}

struct ClosestHits<'a, 'o> {
    tracer: &'a mut Tracer<'o>,
    rays: &'a [Ray],
    /// One for each ray, or none at all.
    after: &'a [(f64, TriangleId)],
    hits: &'a mut [Option<Hit>],
}

impl AnyOperation for ClosestHits<'_, '_> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        enter(simd, self.tracer.octree, self)
    }
}

impl Query for ClosestHits<'_, '_> {
    #[inline(always)]
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError> {
        let mut work = self.tracer.work();
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        let (mut unvisited, mut lanes) = (UnvisitedClosest::UNSET, Lanes::UNSET);
        // What is written down of a query is one ray's.
        let may_join = self.after.is_empty() && work.octree.space.is_shared && !work.pins.writes_down();
        let mut index = 0;
        for (rays, hits) in self.rays.chunks(LANES).zip(self.hits.chunks_mut(LANES)) {
            let group = RayGroup::new(simd, rays, &work.octree.space);
            if let Some(bundle) = group.bundle()
                && may_join
            {
                work.counters.rays += LANES as u64;
                hits.fill(None);
                let bundle = (&group, bundle);
                closest_hits_together::<S, P>(simd, &mut work, bundle, rays, hits, &mut lanes)
                    .map_err(|error| error.at(index))?;
                index += LANES;
                continue;
            }
            for (lane, (ray, hit)) in rays.iter().zip(hits).enumerate() {
                work.counters.rays += 1;
                work.pins.begin_query(QueryKind::Closest);
                let after = self.after.get(index).copied();
                *hit = None;
                let prepared = Prepared { group: &group, lane, query: &mut query, local: &mut local };
                let rest = &mut unvisited;
                closest_hit::<S, P, _>(simd, &mut work, prepared, ray, after, rest, false, hit)
                    .map_err(|error| error.at(index))?;
                index += 1;
            }
        }
        Ok(())
    }
}

struct Occlusions<'a, 'o> {
    tracer: &'a mut Tracer<'o>,
    rays: &'a [Ray],
    ignore: Option<&'a MaterialSet>,
    out: &'a mut [Occlusion],
}

impl AnyOperation for Occlusions<'_, '_> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        enter(simd, self.tracer.octree, self)
    }
}

impl Query for Occlusions<'_, '_> {
    #[inline(always)]
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError> {
        let mut work = self.tracer.work();
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        let (mut unvisited, mut lanes) = (UnvisitedAny::UNSET, Lanes::UNSET);
        // What is written down of a query is one ray's.
        let may_join = work.octree.space.is_shared && !work.pins.writes_down();
        let mut index = 0;
        for (rays, out) in self.rays.chunks(LANES).zip(self.out.chunks_mut(LANES)) {
            let group = RayGroup::new(simd, rays, &work.octree.space);
            if let Some(bundle) = group.bundle()
                && may_join
            {
                work.counters.rays += LANES as u64;
                let bundle = (&group, bundle);
                occlusions_together::<S, P>(simd, &mut work, bundle, rays, self.ignore, out, &mut lanes)
                    .map_err(|error| error.at(index))?;
                index += LANES;
                continue;
            }
            for (lane, (ray, out)) in rays.iter().zip(out).enumerate() {
                work.counters.rays += 1;
                work.pins.begin_query(QueryKind::Occlusion);
                let prepared = Prepared { group: &group, lane, query: &mut query, local: &mut local };
                let rest = &mut unvisited;
                let answer = occlusion::<S, P>(simd, &mut work, prepared, ray, self.ignore, rest, false)
                    .map_err(|error| error.at(index))?;
                // The pins load, so that there is always an answer.
                *out = answer.unwrap_or_default();
                index += 1;
            }
        }
        Ok(())
    }
}

struct AllHits<'a, 'o> {
    work: Work<'a, 'o>,
    waiting: &'a mut WaitingHits,
    rays: &'a [Ray],
    receiver: &'a mut dyn Receiver,
}

impl AnyOperation for AllHits<'_, '_> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        enter(simd, self.work.octree, self)
    }
}

impl Query for AllHits<'_, '_> {
    #[inline(always)]
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError> {
        let AllHits { mut work, waiting, rays, receiver } = self;
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        for (index, ray) in rays.iter().enumerate() {
            work.counters.rays += 1;
            receiver.begin(index, ray);
            let group = RayGroup::new(simd, std::slice::from_ref(ray), &work.octree.space);
            let prepared = Prepared { group: &group, lane: 0, query: &mut query, local: &mut local };
            all_hits::<S, P>(simd, &mut work, prepared, ray, waiting, receiver)
                .map_err(|error| error.at(index))?;
        }
        Ok(())
    }
}

/// A query over a slice of rays, generic over what an octree was opened with.
pub(super) trait Query: Sized {
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError>;
}

/// [`Query::each`] as an operation, so that each combination is a function of its own.
struct Each<Q, P>(Q, PhantomData<P>);

impl<S: Simd, Q: Query, P: Policy> Operation<S> for Each<Q, P> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run(self, simd: S) -> Self::Output {
        self.0.each::<S, P>(simd)
    }
}

/// Runs `query` with the policy and the layout of `octree`: decided once per call.
#[inline(always)]
pub(super) fn enter<S: Simd, Q: Query>(simd: S, octree: &LazyOctree, query: Q) -> Result<(), TraceError> {
    // Compiled for each of these where it may be the fastest.
    if S::IS_FASTEST {
        match (octree.tier, octree.layout.expanded) {
            (Tier::Certified, true) => return simd.enter(Each::<Q, Certified<true>>(query, PhantomData)),
            (Tier::Certified, false) => return simd.enter(Each::<Q, Certified<false>>(query, PhantomData)),
            (Tier::Fast, true) => return simd.enter(Each::<Q, Fast>(query, PhantomData)),
            _ => {}
        }
    }
    simd.enter(Each::<Q, Selected>(query, PhantomData))
}

impl std::fmt::Debug for Tracer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Tracer").field("counters", &self.counters).finish_non_exhaustive()
    }
}
