//! [`RayPool`]: queries that do not wait for blocks while other rays can run.

use super::any::occlusion;
use super::closest::{Prepared, closest_hit};
use super::in_flight::{Arrival, InFlight};
use super::loader::BlockLoader;
use super::policy::Policy;
use super::suspended::{Query, SuspendedRays};
use super::tracer::{Query as Kernel, enter};
use super::unvisited::{UnvisitedAny, UnvisitedClosest};
use super::way::Way;
use super::{Answers, AnyRequest, ClosestRequest, LoadStats, MaterialSet, OnMissing, Tracer};
use crate::access::{BlockSketch, QueryKind};
use crate::budget::Reservation;
use crate::cache::Pin;
use crate::error::TraceError;
use crate::octree::{LazyOctree, LocalRay, QueryRay, RayGroup};
use crate::simd::{AnyOperation, Simd, dispatch};
use crate::stats::TraceCounters;
use crate::units::{BlockId, Bytes};

/// How a pool is made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PoolOptions {
    /// How many rays should wait before it pays to load for them; see [`RayPool::wants_rays`]. More rays share a load the
    /// more wait, so larger pictures and smaller caches want larger pools; each takes about 400 bytes. With 0, none waits.
    pub suspended: u32,
    /// Materials that any-hit queries ignore.
    pub ignore: Option<MaterialSet>,
    /// How many rays, at most, are asked for at once because of the answer to a closest-hit query: shadow rays and the ray that
    /// goes on. While there is no room for so many, closest-hit queries wait longer than for their blocks, as long as any-hit
    /// queries wait that could make room. With 0 no room is kept.
    pub children: u32,
}

impl Default for PoolOptions {
    fn default() -> PoolOptions {
        PoolOptions { suspended: 1 << 14, ignore: None, children: 8 }
    }
}

impl PoolOptions {
    /// Places for rays: some more than wait before a load, for the children of those that the load sets free.
    fn capacity(&self) -> u32 {
        if self.suspended == 0 {
            0
        } else {
            let more = (self.suspended / 4).saturating_add(1).max(self.children);
            self.suspended.saturating_add(more)
        }
    }

    /// Where fewer places are left, those are to end that can.
    fn kept_free(&self) -> u32 {
        if self.children == 0 { 0 } else { (self.capacity() / 10).max(self.children) }
    }
}

/// Answers queries on one thread, in whatever order costs the fewest block loads.
///
/// A ray that reaches a block which is not resident looks at those behind it that are, which may be gone later, and is put aside,
/// without a pin, until that block is loaded. Blocks are loaded in turn, in the order of the file (or, if many of them are in memory at
/// once, to and fro by planes through the model), those for which little waits in a later turn. What waits for a block then runs,
/// unless room is short ([`PoolOptions::children`]). There are no rounds: rays may be added at any time, and so can those that answers
/// lead to.
///
/// Answers are those of a [`Tracer`], whatever the pool's size and order, in the tiers `Certified` and `Exact` (I2). When the pool is full,
/// rays load what they need, depth first: nothing fails and nothing grows.
///
/// A pool from [`LazyOctree::ray_pool`] loads blocks on its own thread and traces nothing meanwhile. One from
/// [`BlockLoader::ray_pool`] has the loader load them, and traces on as long as there is anything to trace.
///
/// ```
/// # use std::sync::Arc;
/// # use outcrop::block::{BlockLimits, Codec};
/// # use outcrop::geom::{Precision, Ray};
/// # use outcrop::octree::OctreeOptions;
/// # use outcrop::source::{MemorySource, testing::memory_model};
/// # use outcrop::units::Bytes;
/// # use outcrop::{LazyOctree, MemoryBudget};
/// use outcrop::trace::{Answers, ClosestRequest, OnMissing, PoolOptions};
/// # let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
/// # let limits = BlockLimits { block_bytes_max: 4096 };
/// # let bytes = memory_model(&[triangle], limits, Codec::Raw, Precision::Float32)?;
/// # let source = Arc::new(MemorySource::new(bytes)?);
/// # let budget = MemoryBudget::new(Bytes::mib(64));
/// # let octree = LazyOctree::open(source, &budget, OctreeOptions::default())?;
/// let mut pool = octree.ray_pool(PoolOptions::default())?;
/// let mut answers = Answers::with_capacity(2);
/// let down = |x, tag| {
///     ClosestRequest { ray: Ray::new([x, 0.1, 5.0], [0.0, 0.0, -1.0]), after: None, tag }
/// };
/// pool.closest_hits(&[down(0.1, 7), down(9.0, 8)], OnMissing::Wait { weight: 1 }, &mut answers)?;
/// // More rays could be added here, and after each resumption.
/// while pool.resume(&mut answers)? {}
/// answers.hits.sort_by_key(|(tag, _)| *tag);
/// assert_eq!(answers.hits[0].1.map(|hit| hit.t), Some(5.0));
/// assert_eq!(answers.hits[1], (8, None));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct RayPool<'o> {
    tracer: Tracer<'o>,
    suspended: SuspendedRays,
    wanted: u32,
    children: u32,
    /// How many closest-hit queries may run in this resumption.
    closest_max: usize,
    ignore: Option<MaterialSet>,
    /// Blocks that rays wait for and that were loaded for others.
    loaded: Vec<BlockId>,
    /// The block whose rays did not all run in one resumption.
    current: Option<Current<'o>>,
    /// `None` if the pool's own thread loads.
    in_flight: Option<InFlight<'o>>,
    _reservation: Reservation,
}

/// How many blocks loaded for others are remembered.
const LOADED_MAX: usize = 256;

/// A block whose rays run.
struct Current<'o> {
    block: BlockId,
    /// Of a block that came by a loader: keeps it until all its rays have run.
    pin: Option<Pin<'o>>,
}

impl LazyOctree {
    /// A pool of rays for the calling thread, or for one that it is sent to. Counts as a tracer.
    ///
    /// # Errors
    /// [`TraceError::Budget`] if the budget has no room for it ([`RayPool::bytes_needed`] and a tracer's scratch),
    /// [`TraceError::TooManyTracers`] if `tracers_max` tracers live already.
    pub fn ray_pool(&self, options: PoolOptions) -> Result<RayPool<'_>, TraceError> {
        RayPool::new(self, options, None)
    }
}

impl<'o> BlockLoader<'o> {
    /// As [`LazyOctree::ray_pool`], but this loads its blocks while rays of other blocks run. With fewer than four slots for each
    /// tracer there is no slot to spare for a load in flight, and the pool's thread loads.
    ///
    /// # Errors
    /// As for [`LazyOctree::ray_pool`].
    pub fn ray_pool(&self, options: PoolOptions) -> Result<RayPool<'o>, TraceError> {
        RayPool::new(self.octree(), options, InFlight::new(self))
    }
}

impl<'o> RayPool<'o> {
    /// Most closest-hit queries, and most any-hit queries, that one call of [`RayPool::resume`] answers.
    pub const RESUMED_MAX: usize = 1024;

    fn new(
        octree: &'o LazyOctree,
        options: PoolOptions,
        in_flight: Option<InFlight<'o>>,
    ) -> Result<RayPool<'o>, TraceError> {
        let tracer = octree.tracer()?;
        let block_count = octree.model().block_id_count() as usize;
        let bytes = RayPool::bytes_needed(&options, block_count);
        let reservation = octree.budget.reserve(bytes, "a pool of suspended rays")?;
        Ok(RayPool {
            tracer,
            suspended: SuspendedRays::new(
                options.capacity(),
                block_count,
                InFlight::MAX,
                options.kept_free(),
                Way::through(octree),
            ),
            wanted: options.suspended,
            children: options.children,
            closest_max: 0,
            ignore: options.ignore.filter(|set| !set.is_empty()),
            loaded: Vec::with_capacity(LOADED_MAX),
            current: None,
            in_flight,
            _reservation: reservation,
        })
    }

    /// What [`LazyOctree::ray_pool`] and [`BlockLoader::ray_pool`] take from the budget for a model of `block_count`
    /// blocks, without the tracer's scratch.
    pub fn bytes_needed(options: &PoolOptions, block_count: usize) -> Bytes {
        let suspended = SuspendedRays::bytes_needed(options.capacity(), block_count, InFlight::MAX);
        Bytes(suspended.0 + (LOADED_MAX * size_of::<BlockId>()) as u64 + InFlight::BYTES)
    }

    /// Finds for each ray the hit with the least (t, triangle id). Appends to `answers` what is known at the end of the
    /// call; the other answers come from [`RayPool::resume`].
    ///
    /// # Errors
    /// [`TraceError::InvalidRay`], or [`TraceError::Load`] if a block that a ray reached cannot be brought in. The pool is
    /// not to be used for answers after that.
    pub fn closest_hits(
        &mut self,
        requests: &[ClosestRequest],
        on_missing: OnMissing,
        answers: &mut Answers,
    ) -> Result<(), TraceError> {
        let level = self.tracer.octree.level;
        dispatch(level, Closest { pool: self, requests, on_missing, block: None, answers })?;
        self.note_loaded();
        Ok(())
    }

    /// Finds for each ray whether anything lies between its ends, leaving triangles of the ignored materials apart. As
    /// [`RayPool::closest_hits`] otherwise. A ray that waits does so for the block that most others wait for.
    ///
    /// # Errors
    /// As for [`RayPool::closest_hits`].
    pub fn occluded(
        &mut self,
        requests: &[AnyRequest],
        on_missing: OnMissing,
        answers: &mut Answers,
    ) -> Result<(), TraceError> {
        let level = self.tracer.octree.level;
        dispatch(level, Any { pool: self, requests, on_missing, block: None, answers })?;
        self.note_loaded();
        Ok(())
    }

    /// Makes one block resident, if rays wait, and runs those that wait for it, at most [`RayPool::RESUMED_MAX`] of each kind, and
    /// of closest-hit queries no more than have room for their children ([`PoolOptions::children`]), but one if there is nothing
    /// else; appends to `answers`. Returns whether rays waited when it was called.
    ///
    /// With a loader, it asks for the next blocks and runs the rays of one that has arrived. If none has, this thread takes part in
    /// loading, of what other pools asked for too, or waits.
    ///
    /// # Errors
    /// As for [`RayPool::closest_hits`], for any load that was asked for.
    ///
    /// # Panics
    /// If a load in the loader did.
    pub fn resume(&mut self, answers: &mut Answers) -> Result<bool, TraceError> {
        let Some(Current { block, pin }) = self.next_block()? else { return Ok(false) };
        if pin.is_none() {
            self.tracer.pins.loads = true;
            let Tracer { octree, pins, scratch, counters, .. } = &mut self.tracer;
            pins.get(octree, block, scratch, counters)?;
        }
        // Without a pin of the pool's, it may lose its slot again while they run, but not before the first of them has
        // passed it.
        let level = self.tracer.octree.level;
        let on_missing = OnMissing::Wait { weight: 1 };
        // One if there are no others, so that it always goes on.
        let least = usize::from(self.suspended.any_count(block) == 0);
        self.closest_max = self.closest_room().clamp(least, RayPool::RESUMED_MAX);
        dispatch(level, Closest { pool: self, requests: &[], on_missing, block: Some(block), answers })?;
        dispatch(level, Any { pool: self, requests: &[], on_missing, block: Some(block), answers })?;
        // What did not run goes on with the next call.
        let current = Current { block, pin };
        if self.suspended.is_awaited(block) {
            self.current = Some(current);
        } else {
            self.leave(current);
        }
        Ok(true)
    }

    /// How many closest-hit queries may be answered until their children have no room.
    fn closest_room(&self) -> usize {
        self.suspended.room().checked_div(self.children).map_or(usize::MAX, |rays| rays as usize)
    }

    /// Ends work on a block. It can be chosen again if rays still wait for it.
    fn leave(&mut self, current: Current<'o>) {
        if current.pin.is_some() {
            self.suspended.end_load(current.block);
        }
    }

    /// How many rays wait for a block.
    pub fn suspended_count(&self) -> u32 {
        self.suspended.count()
    }

    /// How many more can wait; beyond that, rays load what they need, depth first.
    pub(crate) fn room(&self) -> u32 {
        self.suspended.room()
    }

    /// Lets a tracer answer at once, loading what is missing on this thread: for rays that follow each other through the same
    /// blocks. What it loads, the rays that wait have at no cost.
    pub(crate) fn at_once<R>(&mut self, ask: impl FnOnce(&mut Tracer<'o>) -> R) -> R {
        self.tracer.pins.loads = true;
        let answer = ask(&mut self.tracer);
        self.note_loaded();
        answer
    }

    /// Whether it is better to add rays, if there are any, than to load a block for those that wait.
    pub fn wants_rays(&self) -> bool {
        self.suspended.count() < self.wanted.max(1)
    }

    /// What this pool did so far.
    pub fn counters(&self) -> TraceCounters {
        TraceCounters { suspended_peak: u64::from(self.suspended.peak()), ..self.tracer.counters() }
    }

    /// Which blocks its rays entered since this was called last; see [`Tracer::take_touched`].
    pub fn take_touched(&mut self) -> BlockSketch {
        self.tracer.take_touched()
    }

    /// How its loads went so far.
    pub fn load_stats(&self) -> LoadStats {
        let mut stats = self.tracer.load_stats();
        if let Some(in_flight) = &self.in_flight {
            stats.merge(&in_flight.stats());
        }
        stats
    }

    /// The octree it traces.
    pub fn octree(&self) -> &'o LazyOctree {
        self.tracer.octree()
    }

    /// Remembers which of the blocks that were loaded for others rays wait for: they can run at no cost.
    fn note_loaded(&mut self) {
        for block in self.tracer.scratch.take_filled() {
            if self.suspended.is_awaited(block) && self.loaded.len() < LOADED_MAX {
                self.loaded.push(block);
            }
        }
    }

    /// The block to run next.
    fn next_block(&mut self) -> Result<Option<Current<'o>>, TraceError> {
        if let Some(in_flight) = &mut self.in_flight {
            let held = self.current.as_ref().is_some_and(|current| current.pin.is_some());
            in_flight.collect(&mut self.suspended, &mut self.tracer.counters)?;
            in_flight.request(&mut self.suspended, u32::from(held));
        }
        if let Some(current) = self.current.take() {
            // Where nothing ends elsewhere, nothing is gained by leaving.
            let ends =
                |of: &SuspendedRays| of.any_count(current.block) > 0 || !of.any_elsewhere(current.block);
            if self.closest_room() > 0 || ends(&self.suspended) {
                return Ok(Some(current));
            }
            self.leave(current);
        }
        while let Some(block) = self.loaded.pop() {
            if self.suspended.is_awaited(block) && self.tracer.octree.cache.is_resident(block) {
                return Ok(Some(Current { block, pin: None }));
            }
        }
        if let Some(in_flight) = &mut self.in_flight {
            let arrival = in_flight.next(&mut self.suspended, &mut self.tracer.counters)?;
            return Ok(arrival.map(|Arrival { block, pin }| Current { block, pin: Some(pin) }));
        }
        Ok(self.suspended.choose().map(|block| Current { block, pin: None }))
    }
}

/// Place of the request that was taken last; 0 if none was, as where rays that waited go on.
fn index_of_last<R>(requests: &[R], left: &std::slice::Iter<'_, R>) -> usize {
    (requests.len() - left.len()).saturating_sub(1)
}

/// The longest queue among those that a query could join.
fn longest_queue(suspended: &SuspendedRays, unvisited: &UnvisitedAny) -> BlockId {
    let blocks = unvisited.blocks();
    // The first of equals, which is the nearest.
    blocks.iter().rev().copied().max_by_key(|block| suspended.weight(*block)).unwrap_or(blocks[0])
}

/// New closest-hit queries, and those that wait for a resident block.
struct Closest<'a, 'o> {
    pool: &'a mut RayPool<'o>,
    requests: &'a [ClosestRequest],
    on_missing: OnMissing,
    block: Option<BlockId>,
    answers: &'a mut Answers,
}

impl AnyOperation for Closest<'_, '_> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        enter(simd, self.pool.tracer.octree, self)
    }
}

impl Kernel for Closest<'_, '_> {
    #[inline(always)]
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError> {
        let Closest { pool, requests, on_missing, block, answers } = self;
        let RayPool { tracer, suspended, closest_max, .. } = pool;
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        let (loads, new_weight) = on_missing.parts();
        let mut work = tracer.work();
        let mut unvisited = UnvisitedClosest::UNSET;
        let mut new = requests.iter();
        let mut resumed = 0;
        loop {
            // A new ray, or else one that waited for the block. Its answer is written where it belongs.
            let (ray, after, mut is_resumed, mut place, weight);
            if let Some(request) = new.next() {
                work.counters.rays += 1;
                (ray, after, is_resumed, place, weight) =
                    (request.ray, request.after, false, None, new_weight);
                answers.hits.push((request.tag, None));
            } else {
                if resumed == *closest_max {
                    break;
                }
                let Some(block) = block else { break };
                let Some(waiting) = suspended.next_closest(block) else { break };
                resumed += 1;
                let record = suspended.record(waiting);
                let Query::Closest { after: then, best, rest } = record.query else { continue };
                unvisited = rest;
                (ray, after, is_resumed, place, weight) =
                    (record.ray, then, true, Some(waiting), record.weight);
                answers.hits.push((record.tag, best));
            }
            work.pins.begin_query(QueryKind::Closest);
            work.pins.loads = loads && place.is_none();
            let group = RayGroup::new(simd, std::slice::from_ref(&ray), &work.octree.space);
            let last = answers.hits.len() - 1;
            loop {
                let prepared = Prepared { group: &group, lane: 0, query: &mut query, local: &mut local };
                let best = &mut answers.hits[last].1;
                let is_done = closest_hit::<S, P, _>(
                    simd,
                    &mut work,
                    prepared,
                    &ray,
                    after,
                    &mut unvisited,
                    is_resumed,
                    best,
                )
                .map_err(|error| error.at(index_of_last(requests, &new)))?;
                if is_done {
                    break;
                }
                place = place.or_else(|| suspended.take_place());
                if let Some(place) = place.take() {
                    let (tag, best) = answers.hits.swap_remove(last);
                    // The nearest: what lies behind it may turn out to be needless.
                    let block = unvisited.blocks()[0];
                    suspended.wait(
                        place,
                        block,
                        ray,
                        tag,
                        weight,
                        Query::Closest { after, best, rest: unvisited },
                    );
                    break;
                }
                // The pool is full: depth first.
                (work.pins.loads, is_resumed) = (true, true);
            }
            if let Some(place) = place {
                suspended.free_place(place);
            }
        }
        Ok(())
    }
}

/// New any-hit queries, and those that wait for a resident block.
struct Any<'a, 'o> {
    pool: &'a mut RayPool<'o>,
    requests: &'a [AnyRequest],
    on_missing: OnMissing,
    block: Option<BlockId>,
    answers: &'a mut Answers,
}

impl AnyOperation for Any<'_, '_> {
    type Output = Result<(), TraceError>;

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> Self::Output {
        enter(simd, self.pool.tracer.octree, self)
    }
}

impl Kernel for Any<'_, '_> {
    #[inline(always)]
    fn each<S: Simd, P: Policy>(self, simd: S) -> Result<(), TraceError> {
        let Any { pool, requests, on_missing, block, answers } = self;
        let RayPool { tracer, suspended, ignore, .. } = pool;
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        let (loads, new_weight) = on_missing.parts();
        let mut work = tracer.work();
        let mut unvisited = UnvisitedAny::UNSET;
        let mut new = requests.iter();
        let mut resumed = 0;
        loop {
            let (ray, tag, mut is_resumed, mut place, weight);
            if let Some(request) = new.next() {
                work.counters.rays += 1;
                (ray, tag, is_resumed, place, weight) = (request.ray, request.tag, false, None, new_weight);
            } else {
                if resumed == RayPool::RESUMED_MAX {
                    break;
                }
                let Some(block) = block else { break };
                let Some(waiting) = suspended.next_any(block) else { break };
                resumed += 1;
                let record = suspended.record(waiting);
                let Query::Any(rest) = record.query else { continue };
                unvisited = rest;
                (ray, tag, is_resumed, place, weight) =
                    (record.ray, record.tag, true, Some(waiting), record.weight);
            }
            work.pins.begin_query(QueryKind::Occlusion);
            work.pins.loads = loads && place.is_none();
            let group = RayGroup::new(simd, std::slice::from_ref(&ray), &work.octree.space);
            loop {
                let prepared = Prepared { group: &group, lane: 0, query: &mut query, local: &mut local };
                let answer = occlusion::<S, P>(
                    simd,
                    &mut work,
                    prepared,
                    &ray,
                    ignore.as_ref(),
                    &mut unvisited,
                    is_resumed,
                )
                .map_err(|error| error.at(index_of_last(requests, &new)))?;
                if let Some(answer) = answer {
                    answers.occlusions.push((tag, answer));
                    break;
                }
                place = place.or_else(|| suspended.take_place());
                if let Some(place) = place.take() {
                    let block = longest_queue(suspended, &unvisited);
                    suspended.wait(place, block, ray, tag, weight, Query::Any(unvisited));
                    break;
                }
                // The pool is full: depth first.
                (work.pins.loads, is_resumed) = (true, true);
            }
            if let Some(place) = place {
                suspended.free_place(place);
            }
        }
        Ok(())
    }
}

impl std::fmt::Debug for RayPool<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RayPool").finish_non_exhaustive()
    }
}
