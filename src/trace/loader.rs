//! [`BlockLoader`]: loads that run beside the rays which do not need them.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::in_flight::InFlight;
use super::load::{self, LoadScratch, pin};
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
    /// Loads that may run at the same time: each has scratch of its own, as much as a tracer. A thread whose pool has nothing to trace
    /// takes part, so one more than there are threads that work for the loader is best. Beside them up to four blocks are read
    /// ahead. At least 1.
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
/// [`BlockLoader::load_next`], once. [`LazyOctree::with_loader`] starts some for the time of a call. A pool that has nothing to trace
/// decodes and builds what was read, for itself or for other pools, and reads what it has asked for while nobody reads ahead: so nothing
/// waits for ever, even if nobody works.
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
    /// Never held over a load or a part of one (I7).
    state: Mutex<State<'o>>,
    /// Notified when a load may be startable, and at the end.
    startable: Condvar,
    /// Notified when a load has ended or could be run by a pool that waits.
    ended: Condvar,
    _reservation: Reservation,
}

struct State<'o> {
    /// Loads of which nothing is there, the oldest first.
    requests: VecDeque<Request>,
    /// Loads of which the bytes are there, the oldest first.
    read: VecDeque<Read>,
    /// For further ones.
    buffers: Vec<Vec<u8>>,
    /// Of the loads that could run.
    scratches: Vec<LoadScratch>,
    /// Reads ahead that have begun and not ended.
    reading: u32,
    /// Blocks that are in `read`, or that somebody reads or loads.
    under_way: Vec<BlockId>,
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

/// A request whose bytes were read.
struct Read {
    request: Request,
    bytes: Vec<u8>,
    counters: TraceCounters,
}

/// How many blocks are read before anybody decodes them.
const READ_AHEAD: usize = 4;

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
        let buffer_bytes = self.source.buffer_bytes().as_usize();
        let state = State {
            requests: VecDeque::with_capacity(requests_max(&options, self.tracers_max()) as usize),
            read: VecDeque::with_capacity(READ_AHEAD),
            buffers: (0..READ_AHEAD).map(|_| Vec::with_capacity(buffer_bytes)).collect(),
            scratches: (0..loads_at_once).map(|_| LoadScratch::new(&*self.source)).collect(),
            reading: 0,
            under_way: Vec::with_capacity(READ_AHEAD + loads_at_once as usize),
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

    /// Runs `run` with a loader for which so many threads work, which end before this returns. Each wants a load of its own at a time,
    /// and so does a pool that has nothing to trace: [`LoaderOptions::loads_at_once`] is raised to one more than their number. If the
    /// system gives fewer threads, fewer work.
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
        let loads_at_once = options.loads_at_once.max(threads.saturating_add(1));
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
        let ahead = READ_AHEAD as u64 * (source.buffer_bytes().0 + size_of::<Read>() as u64);
        Bytes((per_load * u64::from(options.loads_at_once.max(1))).saturating_add(requests + ahead))
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
    /// [`LoaderOptions::loads_at_once`] have work, and four more can read ahead.
    pub fn work(&self) {
        let shared = &*self.shared;
        loop {
            let mut state = shared.state.lock();
            while !state.is_closed && !state.can_read_ahead() && !state.can_load(None) {
                shared.startable.wait(&mut state);
            }
            if state.is_closed {
                return;
            }
            drop(state);
            // So that a pool which has nothing to trace finds bytes, and need not wait for a disk.
            if !self.read_ahead() {
                self.load_next();
            }
        }
    }

    /// Runs one load that waits, if there is any and fewer than [`LoaderOptions::loads_at_once`] run; whether it did. For threads that
    /// have other work too.
    pub fn load_next(&self) -> bool {
        self.load_one(None).is_some()
    }

    /// [`BlockLoader::load_next`], with how long this thread waited for the disk and for others. `of`: see [`State::can_load`].
    fn load_one(&self, of: Option<InboxId>) -> Option<Duration> {
        let shared = &*self.shared;
        let mut state = shared.state.lock();
        if !state.can_load(of) {
            return None;
        }
        let mut scratch = state.scratches.pop()?;
        scratch.forget_ahead();
        let (request, mut counters) = match state.read.pop_front() {
            Some(Read { request, bytes, counters }) => {
                let buffer = scratch.take_ahead(request.block, bytes);
                state.buffers.push(buffer);
                (Some(request), counters)
            }
            None => (state.begin_request(of), TraceCounters::default()),
        };
        let Some(Request { block, inbox }) = request else {
            state.scratches.push(scratch);
            return None;
        };
        drop(state);
        // There may be a buffer.
        shared.startable.notify_one();
        let stall_before = scratch.stats().stall;
        // A scratch holds nothing from load to load, so what a panic leaves in it does no harm.
        let loaded =
            catch_unwind(AssertUnwindSafe(|| pin(shared.octree, block, &mut scratch, &mut counters)));
        scratch.take_filled().for_each(drop);
        let stall = scratch.stats().stall.saturating_sub(stall_before);
        let ended = Ended { block, result: outcome(loaded), counters };
        self.end(inbox, ended, |state| state.scratches.push(scratch));
        Some(stall)
    }

    /// Reads the bytes of a block that is to be loaded, if there is a buffer for them; whether there was something to read. A block that
    /// is there already ends at once.
    fn read_ahead(&self) -> bool {
        let shared = &*self.shared;
        let mut state = shared.state.lock();
        let Some(mut bytes) = state.buffers.pop() else { return false };
        let Some(request) = state.begin_request(None) else {
            state.buffers.push(bytes);
            return false;
        };
        state.reading += 1;
        drop(state);
        let Request { block, inbox } = request;
        let mut counters = TraceCounters::default();
        let done = catch_unwind(AssertUnwindSafe(|| match shared.octree.cache.try_pin(block) {
            Some(pin) => Ok(Some(pin)),
            None => load::read(shared.octree, block, &mut bytes, &mut counters).map(|()| None),
        }));
        let result = match outcome(done) {
            Ok(None) => {
                let mut state = shared.state.lock();
                state.reading -= 1;
                if state.inboxes.iter().any(|known| known.id == inbox) {
                    state.read.push_back(Read { request, bytes, counters });
                } else {
                    state.buffers.push(bytes);
                    state.under_way.retain(|other| *other != block);
                }
                drop(state);
                shared.startable.notify_one();
                shared.ended.notify_all();
                return true;
            }
            Ok(Some(pin)) => Ok(pin),
            Err(failure) => Err(failure),
        };
        self.end(inbox, Ended { block, result, counters }, |state| {
            state.reading -= 1;
            state.buffers.push(bytes);
        });
        true
    }

    /// Tells the pool that asked, and gives back what the load has used.
    fn end(&self, inbox: InboxId, ended: Ended<'o>, give_back: impl FnOnce(&mut State<'o>)) {
        let shared = &*self.shared;
        let block = ended.block;
        let mut ended = Some(ended);
        let mut state = shared.state.lock();
        give_back(&mut state);
        state.under_way.retain(|other| *other != block);
        if let Some(inbox) = state.inboxes.iter_mut().find(|known| known.id == inbox) {
            inbox.ended.extend(ended.take());
        }
        drop(state);
        shared.ended.notify_all();
        shared.startable.notify_one();
        // If the pool is gone the pin goes back here, without the lock.
        drop(ended);
    }

    /// Ends [`BlockLoader::work`] on all threads, when their loads have ended. What waits is left to the pools.
    pub fn close(&self) {
        self.shared.state.lock().is_closed = true;
        self.shared.startable.notify_all();
    }
}

impl State<'_> {
    /// The first request that can begin, of a pool or of any. What is under way for another pool is waited for: then it is there.
    fn startable(&self, of: Option<InboxId>) -> Option<usize> {
        self.requests.iter().position(|request| {
            of.is_none_or(|of| request.inbox == of) && !self.under_way.contains(&request.block)
        })
    }

    fn begin_request(&mut self, of: Option<InboxId>) -> Option<Request> {
        let request = self.requests.remove(self.startable(of)?)?;
        self.under_way.push(request.block);
        Some(request)
    }

    /// Whether a load can run. `of`: for a pool that waits, which reads nothing but what it asked for itself, and only if nobody reads
    /// ahead: while it does, other loads end and nobody traces for them.
    fn can_load(&self, of: Option<InboxId>) -> bool {
        let can_read = of.is_none() || self.reading == 0;
        !self.scratches.is_empty() && (!self.read.is_empty() || (can_read && self.startable(of).is_some()))
    }

    fn can_read_ahead(&self) -> bool {
        !self.buffers.is_empty() && self.startable(None).is_some()
    }
}

/// What came of something that may panic.
fn outcome<T>(done: std::thread::Result<Result<T, LoadError>>) -> Result<T, Failure> {
    match done {
        Ok(result) => result.map_err(Failure::Load),
        Err(panic) => Err(Failure::Panic(panic)),
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

    /// The load that ends first, and how long this thread waited for it; until then it takes part in loading. To be called only if
    /// there are loads that were asked for and not collected.
    pub fn wait(&self) -> (Ended<'o>, Duration) {
        let shared = &*self.loader.shared;
        let mut stall = Duration::ZERO;
        loop {
            let mut state = shared.state.lock();
            if let Some(ended) = self.take(&mut state) {
                return (ended, stall);
            }
            if state.can_load(Some(self.inbox)) {
                drop(state);
                stall += self.loader.load_one(Some(self.inbox)).unwrap_or_default();
            } else {
                let start = Instant::now();
                shared.ended.wait(&mut state);
                stall += start.elapsed();
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
        let State { requests, read, buffers, under_way, inboxes, .. } = &mut *state;
        requests.retain(|request| request.inbox != self.inbox);
        read.retain_mut(|ahead| {
            let stays = ahead.request.inbox != self.inbox;
            if !stays {
                buffers.push(std::mem::take(&mut ahead.bytes));
                under_way.retain(|block| *block != ahead.request.block);
            }
            stays
        });
        let place = inboxes.iter().position(|inbox| inbox.id == self.inbox);
        let inbox = place.map(|place| inboxes.swap_remove(place));
        drop(state);
        // What was under way for this pool may be what others wait for.
        self.loader.shared.startable.notify_all();
        self.loader.shared.ended.notify_all();
        // Pins go back without the lock.
        drop(inbox);
    }
}

impl std::fmt::Debug for BlockLoader<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BlockLoader").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests;
