//! The loads that a pool has asked a loader for: which, how many, and what has arrived.

use std::collections::VecDeque;
use std::panic::resume_unwind;
use std::time::Instant;

use super::load::LoadStats;
use super::loader::{BlockLoader, Ended, Failure, LoadQueue, LoaderOptions};
use super::suspended::SuspendedRays;
use crate::cache::Pin;
use crate::error::LoadError;
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// A block that a loader brought.
pub(super) struct Arrival<'o> {
    pub block: BlockId,
    pub pin: Pin<'o>,
}

/// See the module.
///
/// Each load in flight holds a slot, from its beginning until the block's rays have run. A pool has at most a quarter of its share
/// of the slots in flight and its tracer pins at most a quarter, unless every block has a slot: so a load always finds one that is
/// not pinned.
pub(super) struct InFlight<'o> {
    queue: LoadQueue<'o>,
    /// Asked for and not collected.
    asked: u32,
    /// Arrived, in the order of arrival.
    arrived: VecDeque<Arrival<'o>>,
    limit: u32,
    /// At most so many now: see [`InFlight::next`].
    window: u32,
    stats: LoadStats,
}

impl<'o> InFlight<'o> {
    /// More than this is never in flight: beyond it, it is bandwidth that is short.
    pub const MAX: u32 = 64;

    /// Bytes that one allocates.
    pub const BYTES: u64 = InFlight::MAX as u64 * size_of::<Arrival<'_>>() as u64;

    /// Most loads in flight of one pool, where there are slots for them.
    pub fn limit_of(options: &LoaderOptions) -> u32 {
        options.loads_in_flight.clamp(1, InFlight::MAX)
    }

    /// `None` if there are too few slots for loads in flight.
    pub fn new(loader: &BlockLoader<'o>) -> Option<InFlight<'o>> {
        let octree = loader.octree();
        let share = octree.cache().slot_count() / octree.tracers_max().max(1).saturating_mul(4);
        let limit = InFlight::limit_of(&loader.options()).min(share);
        (limit > 0).then(|| InFlight {
            queue: LoadQueue::new(loader),
            asked: 0,
            arrived: VecDeque::with_capacity(limit as usize),
            limit,
            window: limit.min(2),
            stats: LoadStats::default(),
        })
    }

    /// Of the loads by the loader.
    pub fn stats(&self) -> LoadStats {
        self.stats
    }

    /// Takes in what has ended.
    pub fn collect(
        &mut self,
        suspended: &mut SuspendedRays,
        counters: &mut TraceCounters,
    ) -> Result<(), LoadError> {
        while self.asked > 0 {
            let Some(ended) = self.queue.collect() else { break };
            self.take_in(ended, suspended, counters)?;
        }
        Ok(())
    }

    /// Asks for the blocks that it is best to load, as many as the window lets; `held` of it are taken.
    pub fn request(&mut self, suspended: &mut SuspendedRays, held: u32) {
        loop {
            // A window is a few loads.
            let in_flight = held + self.asked + self.arrived.len() as u32;
            self.stats.in_flight_peak = self.stats.in_flight_peak.max(in_flight);
            if in_flight >= self.window {
                return;
            }
            let Some(block) = suspended.choose() else { return };
            suspended.begin_load(block);
            self.queue.request(block);
            self.asked += 1;
        }
    }

    /// The block that arrived first, or will. `None` if no rays wait.
    ///
    /// A pool that has to wait widens its window: more loads at the same time would have hidden the wait. One for which blocks wait
    /// narrows it: these were chosen too early, when fewer rays waited for them and it was less sure which would be the best.
    pub fn next(
        &mut self,
        suspended: &mut SuspendedRays,
        counters: &mut TraceCounters,
    ) -> Result<Option<Arrival<'o>>, LoadError> {
        loop {
            if let Some(arrival) = self.arrived.pop_front() {
                if !self.arrived.is_empty() {
                    self.window = (self.window - 1).max(1);
                }
                return Ok(Some(arrival));
            }
            self.request(suspended, 0);
            if self.asked == 0 || suspended.count() == 0 {
                return Ok(None);
            }
            let start = Instant::now();
            let (ended, stall) = self.queue.wait();
            self.stats.stall += stall;
            self.stats.loading += start.elapsed();
            self.window = (self.window + 1).min(self.limit);
            self.take_in(ended, suspended, counters)?;
        }
    }

    fn take_in(
        &mut self,
        Ended { block, result, counters: more }: Ended<'o>,
        suspended: &mut SuspendedRays,
        counters: &mut TraceCounters,
    ) -> Result<(), LoadError> {
        self.asked -= 1;
        counters.merge(&more);
        match result {
            // Its rays may have found it resident meanwhile, loaded by others.
            Ok(pin) if suspended.is_awaited(block) => self.arrived.push_back(Arrival { block, pin }),
            Ok(_) => suspended.end_load(block),
            Err(failure) => {
                suspended.end_load(block);
                match failure {
                    Failure::Load(error) => return Err(error),
                    Failure::Panic(panic) => resume_unwind(panic),
                }
            }
        }
        Ok(())
    }
}
