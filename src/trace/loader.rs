//! [`BlockLoader`]: loads that run beside the rays which do not need them.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use parking_lot::{Condvar, Mutex};

use super::in_flight::InFlight;
use super::load::{LoadScratch, pin};
use crate::budget::Reservation;
use crate::cache::Pin;
use crate::error::{LoadError, TraceError};
use crate::octree::{LazyOctree, tracer_bytes};
use crate::source::BlockSource;
use crate::stats::TraceCounters;
use crate::units::{BlockId, Bytes};

/// How a [`BlockLoader`] is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoaderOptions {
    /// Loads that may run at the same time: each has scratch of its own, as much as a tracer. At least 1.
    pub loads_at_once: u32,
    /// Most loads that one pool asks for before the first of them has ended; a quarter of the pool's share of the slots if that is
    /// less, and never more than 64. A pool asks for as few as keep it busy, because the later it chooses a block the more rays
    /// wait for it. At least 1.
    pub loads_in_flight: u32,
}

impl Default for LoaderOptions {
    /// For one disk beside one or two tracing threads.
    fn default() -> LoaderOptions {
        LoaderOptions { loads_at_once: 2, loads_in_flight: 8 }
    }
}

/// Reads, checks, decodes and builds blocks for the pools of rays that were made with it ([`BlockLoader::ray_pool`]), while these trace
/// rays of other blocks.
///
/// It has no threads (I8): loads run on those that call [`BlockLoader::work`], until [`BlockLoader::close`], or
/// [`BlockLoader::load_next`], once. [`LazyOctree::with_loader`] starts some for the time of a call. A pool that has nothing to trace while
/// nobody works loads for itself, so nothing waits for ever.
///
/// A load that fails is an error of the pool that asked for it, and one that panics (in a source, say) panics there.
///
/// Handles are clones of each other.
///
/// ```
/// # use std::sync::Arc;
/// # use outcrop::block::{BlockLimits, Codec};
/// # use outcrop::geom::{Precision, Ray};
/// # use outcrop::octree::OctreeOptions;
/// # use outcrop::source::{MemorySource, testing::memory_model};
/// # use outcrop::units::Bytes;
/// # use outcrop::{LazyOctree, MemoryBudget};
/// use outcrop::trace::{Answers, ClosestRequest, LoaderOptions, OnMissing, PoolOptions};
/// # let triangle = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
/// # let limits = BlockLimits { block_bytes_max: 4096 };
/// # let bytes = memory_model(&[triangle], limits, Codec::Raw, Precision::Float32)?;
/// # let source = Arc::new(MemorySource::new(bytes)?);
/// # let budget = MemoryBudget::new(Bytes::mib(64));
/// # let octree = LazyOctree::open(source, &budget, OctreeOptions::default())?;
/// let mut answers = Answers::with_capacity(1);
/// let ray = Ray::new([0.1, 0.1, 5.0], [0.0, 0.0, -1.0]);
/// octree.with_loader(2, LoaderOptions::default(), |loader| {
///     let mut pool = loader.ray_pool(PoolOptions::default())?;
///     let request = ClosestRequest { ray, after: None, tag: 7 };
///     pool.closest_hits(&[request], OnMissing::Wait { weight: 1 }, &mut answers)?;
///     while pool.resume(&mut answers)? {}
///     Ok::<(), outcrop::error::TraceError>(())
/// })??;
/// assert_eq!(answers.hits[0].1.map(|hit| hit.t), Some(5.0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct BlockLoader<'o> {
    shared: Arc<Shared<'o>>,
}

struct Shared<'o> {
    octree: &'o LazyOctree,
    options: LoaderOptions,
    /// Never held over a load (I7).
    state: Mutex<State<'o>>,
    /// Notified when a load may be startable, and at the end.
    startable: Condvar,
    /// Notified when a load has ended or a worker has left.
    ended: Condvar,
    _reservation: Reservation,
}

struct State<'o> {
    /// Loads not begun, the oldest first.
    requests: VecDeque<Request>,
    /// Of the loads that could run.
    scratches: Vec<LoadScratch>,
    /// Loads begun and not ended.
    running: u32,
    /// Threads in [`BlockLoader::work`].
    workers: u32,
    inboxes: Vec<Inbox<'o>>,
    last_inbox: InboxId,
    is_closed: bool,
}

/// Never given twice, so that what is late for one pool does not reach another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct InboxId(u64);

struct Request {
    block: BlockId,
    inbox: InboxId,
}

/// What a pool has not yet collected.
struct Inbox<'o> {
    id: InboxId,
    ended: Vec<Ended<'o>>,
}

/// A load that has ended.
pub(super) struct Ended<'o> {
    pub block: BlockId,
    /// Holds the block until its rays have run.
    pub result: Result<Pin<'o>, Failure>,
    /// What the load adds to the counters.
    pub counters: TraceCounters,
}

pub(super) enum Failure {
    Load(LoadError),
    Panic(Box<dyn Any + Send>),
}

impl LazyOctree {
    /// A loader for pools of this octree.
    ///
    /// # Errors
    /// [`TraceError::Budget`] if the budget has no room for [`BlockLoader::bytes_needed`].
    pub fn block_loader(&self, options: LoaderOptions) -> Result<BlockLoader<'_>, TraceError> {
        let bytes = BlockLoader::bytes_needed(&options, &*self.source, self.tracers_max());
        let reservation = self.budget.reserve(bytes, "a loader's scratch")?;
        let loads_at_once = options.loads_at_once.max(1);
        let state = State {
            requests: VecDeque::with_capacity(requests_max(&options, self.tracers_max()) as usize),
            scratches: (0..loads_at_once).map(|_| LoadScratch::new(&*self.source)).collect(),
            running: 0,
            workers: 0,
            inboxes: Vec::with_capacity(self.tracers_max() as usize),
            last_inbox: InboxId(0),
            is_closed: false,
        };
        let shared = Shared {
            octree: self,
            options,
            state: Mutex::new(state),
            startable: Condvar::new(),
            ended: Condvar::new(),
            _reservation: reservation,
        };
        Ok(BlockLoader { shared: Arc::new(shared) })
    }

    /// Runs `run` with a loader for which so many threads work, which end before this returns. Each wants a load of its own at a time:
    /// [`LoaderOptions::loads_at_once`] is raised to their number. If the system gives fewer threads, fewer work.
    ///
    /// # Errors
    /// As for [`LazyOctree::block_loader`]; then `run` is not called.
    ///
    /// # Panics
    /// If `run` does.
    pub fn with_loader<'o, R>(
        &'o self,
        threads: u32,
        options: LoaderOptions,
        run: impl FnOnce(&BlockLoader<'o>) -> R,
    ) -> Result<R, TraceError> {
        let loads_at_once = options.loads_at_once.max(threads);
        let loader = self.block_loader(LoaderOptions { loads_at_once, ..options })?;
        std::thread::scope(|scope| {
            let closes = Closes(&loader);
            for number in 0..threads {
                let named = std::thread::Builder::new().name(format!("block loader {number}"));
                if named.spawn_scoped(scope, || loader.work()).is_err() {
                    break;
                }
            }
            let result = run(closes.0);
            drop(closes);
            Ok(result)
        })
    }
}

/// Most requests that wait at one time.
fn requests_max(options: &LoaderOptions, tracers_max: u32) -> u64 {
    u64::from(tracers_max.max(1)) * u64::from(InFlight::limit_of(options))
}

/// Lets the workers go, on unwinding too.
struct Closes<'l, 'o>(&'l BlockLoader<'o>);

impl Drop for Closes<'_, '_> {
    fn drop(&mut self) {
        self.0.close();
    }
}

impl<'o> BlockLoader<'o> {
    /// What a loader takes from the budget, for an octree of that many tracers.
    pub fn bytes_needed(options: &LoaderOptions, source: &dyn BlockSource, tracers_max: u32) -> Bytes {
        let per_load = tracer_bytes(source).0;
        let per_request = (size_of::<Request>() + size_of::<Ended<'_>>()) as u64;
        let requests = per_request * requests_max(options, tracers_max);
        Bytes((per_load * u64::from(options.loads_at_once.max(1))).saturating_add(requests))
    }

    /// The octree whose blocks it loads.
    pub fn octree(&self) -> &'o LazyOctree {
        self.shared.octree
    }

    /// How it was made.
    pub fn options(&self) -> LoaderOptions {
        self.shared.options
    }

    /// Loads what is asked for until the loader is closed. For threads of the caller's; as many as
    /// [`LoaderOptions::loads_at_once`] have work.
    pub fn work(&self) {
        let shared = &*self.shared;
        shared.state.lock().workers += 1;
        let _leaves = Leaves(shared);
        loop {
            let mut state = shared.state.lock();
            while !state.is_closed && !state.can_start() {
                shared.startable.wait(&mut state);
            }
            if state.is_closed {
                return;
            }
            drop(state);
            self.load_next();
        }
    }

    /// Runs one load that waits, if there is any and fewer than [`LoaderOptions::loads_at_once`] run; whether it did. For threads that
    /// have other work too.
    pub fn load_next(&self) -> bool {
        let shared = &*self.shared;
        let mut state = shared.state.lock();
        if !state.can_start() {
            return false;
        }
        let (Some(request), Some(mut scratch)) = (state.requests.pop_front(), state.scratches.pop()) else {
            return false;
        };
        state.running += 1;
        drop(state);
        let Request { block, inbox } = request;
        let mut counters = TraceCounters::default();
        // A scratch holds nothing from load to load, so what a panic leaves in it does no harm.
        let loaded =
            catch_unwind(AssertUnwindSafe(|| pin(shared.octree, block, &mut scratch, &mut counters)));
        scratch.take_filled().for_each(drop);
        let result = match loaded {
            Ok(Ok(pin)) => Ok(pin),
            Ok(Err(error)) => Err(Failure::Load(error)),
            Err(panic) => Err(Failure::Panic(panic)),
        };
        let mut ended = Some(Ended { block, result, counters });
        let mut state = shared.state.lock();
        state.running -= 1;
        state.scratches.push(scratch);
        if let Some(inbox) = state.inboxes.iter_mut().find(|known| known.id == inbox) {
            inbox.ended.extend(ended.take());
        }
        drop(state);
        shared.ended.notify_all();
        shared.startable.notify_one();
        // If the pool is gone the pin goes back here, without the lock.
        drop(ended);
        true
    }

    /// Ends [`BlockLoader::work`] on all threads, when their loads have ended. What waits is left to the pools.
    pub fn close(&self) {
        self.shared.state.lock().is_closed = true;
        self.shared.startable.notify_all();
    }
}

impl State<'_> {
    fn can_start(&self) -> bool {
        !self.requests.is_empty() && !self.scratches.is_empty()
    }
}

/// A worker that ends.
struct Leaves<'s, 'o>(&'s Shared<'o>);

impl Drop for Leaves<'_, '_> {
    fn drop(&mut self) {
        self.0.state.lock().workers -= 1;
        self.0.ended.notify_all();
    }
}

/// A pool's side of a loader.
pub(super) struct LoadQueue<'o> {
    loader: BlockLoader<'o>,
    inbox: InboxId,
}

impl<'o> LoadQueue<'o> {
    pub fn new(loader: &BlockLoader<'o>) -> LoadQueue<'o> {
        let loader = loader.clone();
        let mut state = loader.shared.state.lock();
        state.last_inbox.0 += 1;
        let inbox = state.last_inbox;
        let ended = Vec::with_capacity(InFlight::limit_of(&loader.shared.options) as usize);
        state.inboxes.push(Inbox { id: inbox, ended });
        drop(state);
        LoadQueue { loader, inbox }
    }

    /// Asks for a block.
    pub fn request(&self, block: BlockId) {
        let request = Request { block, inbox: self.inbox };
        self.loader.shared.state.lock().requests.push_back(request);
        self.loader.shared.startable.notify_one();
    }

    /// A load that has ended, if any has.
    pub fn collect(&self) -> Option<Ended<'o>> {
        self.take(&mut self.loader.shared.state.lock())
    }

    /// The load that ends first. To be called only if there are loads that were asked for and not collected.
    pub fn wait(&self) -> Ended<'o> {
        let shared = &*self.loader.shared;
        let mut state = shared.state.lock();
        loop {
            if let Some(ended) = self.take(&mut state) {
                return ended;
            }
            if state.workers == 0 && state.can_start() {
                // Nobody else will.
                drop(state);
                self.loader.load_next();
                state = shared.state.lock();
            } else {
                shared.ended.wait(&mut state);
            }
        }
    }

    fn take(&self, state: &mut State<'o>) -> Option<Ended<'o>> {
        let inbox = state.inboxes.iter_mut().find(|inbox| inbox.id == self.inbox)?;
        // The first come is the first served.
        if inbox.ended.is_empty() { None } else { Some(inbox.ended.remove(0)) }
    }
}

impl Drop for LoadQueue<'_> {
    fn drop(&mut self) {
        let mut state = self.loader.shared.state.lock();
        state.requests.retain(|request| request.inbox != self.inbox);
        let place = state.inboxes.iter().position(|inbox| inbox.id == self.inbox);
        let inbox = place.map(|place| state.inboxes.swap_remove(place));
        drop(state);
        // Pins go back without the lock.
        drop(inbox);
    }
}

impl std::fmt::Debug for BlockLoader<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BlockLoader").finish_non_exhaustive()
    }
}
