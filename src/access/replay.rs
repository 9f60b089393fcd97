//! A trace through a cache that holds no geometry.

use super::AccessTrace;
use crate::cache::{Policy, ReplacementPolicy, WithPolicy};
use crate::units::BlockId;

/// What a replay came to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReplayCounts {
    /// Entries into blocks.
    pub accesses: u64,
    /// Entries that found the block missing.
    pub loads: u64,
    /// Distinct blocks entered.
    pub touched: u64,
}

impl ReplayCounts {
    /// 1 is the least that is possible; 0 for an empty trace.
    pub fn loads_per_touched_block(&self) -> f64 {
        if self.touched == 0 { 0.0 } else { self.loads as f64 / self.touched as f64 }
    }
}

/// Runs `trace` through a cache of `slot_count` slots with a policy of this library.
///
/// `pins` is how many blocks each stream keeps pinned, as a tracer does: found by the low bits of their number, so rounded down to
/// a power of two, and left out where they would leave no slot free. Entering a block that the stream has pinned is no event for
/// the policy. With 0 the policy sees every entry.
///
/// Accesses are taken in the order of the file, one at a time, so a replay of a trace of one tracer with the pins of that tracer
/// gives exactly the loads of the run; with several, loads that coincide in a run come one after the other here.
pub fn replay(trace: &AccessTrace, policy: Policy, slot_count: u32, pins: u32) -> ReplayCounts {
    policy.with(With { trace, slot_count, pins })
}

struct With<'t> {
    trace: &'t AccessTrace,
    slot_count: u32,
    pins: u32,
}

impl WithPolicy for With<'_> {
    type Output = ReplayCounts;

    fn run<P: ReplacementPolicy + Default>(self) -> ReplayCounts {
        replay_with(self.trace, P::default(), self.slot_count, self.pins)
    }
}

/// [`replay`] with any policy, one not yet started.
pub fn replay_with<P: ReplacementPolicy>(
    trace: &AccessTrace,
    policy: P,
    slot_count: u32,
    pins: u32,
) -> ReplayCounts {
    let mut cache = Simulated::new(trace, policy, slot_count, pins);
    trace.visit_accesses(|stream, block| cache.access(stream, block));
    cache.counts
}

const NOWHERE: u32 = u32::MAX;

struct Simulated<P> {
    policy: P,
    /// The slot of each block, or [`NOWHERE`].
    slots: Vec<u32>,
    touched: Vec<bool>,
    /// The block in each slot, and how many streams have it pinned.
    blocks: Vec<(u32, u32)>,
    free: Vec<u32>,
    /// `mask + 1` blocks for each stream.
    pinned: Vec<u32>,
    mask: u32,
    counts: ReplayCounts,
}

impl<P: ReplacementPolicy> Simulated<P> {
    fn new(trace: &AccessTrace, mut policy: P, slot_count: u32, pins: u32) -> Simulated<P> {
        // More slots than blocks are never used.
        let slot_count = slot_count.min(trace.block_count());
        policy.start(slot_count);
        // One stream gives its old pin back before it takes the next, so one slot for each place is enough.
        let room = slot_count / trace.stream_count().max(1);
        let places: u32 = match pins.min(room) {
            0 => 0,
            places => 1 << places.ilog2(),
        };
        Simulated {
            policy,
            slots: vec![NOWHERE; trace.block_count() as usize],
            touched: vec![false; trace.block_count() as usize],
            blocks: vec![(NOWHERE, 0); slot_count as usize],
            free: (0..slot_count).rev().collect(),
            pinned: vec![NOWHERE; trace.stream_count() as usize * places as usize],
            mask: places.saturating_sub(1),
            counts: ReplayCounts::default(),
        }
    }

    fn access(&mut self, stream: u32, block: u32) {
        self.counts.accesses += 1;
        let place = stream as usize * (self.mask as usize + 1) + (block & self.mask) as usize;
        match self.pinned.get(place).copied() {
            Some(pinned) if pinned == block => return,
            Some(pinned) if pinned != NOWHERE => self.blocks[self.slots[pinned as usize] as usize].1 -= 1,
            _ => {}
        }
        let slot = self.bring_in(block);
        if let Some(pin) = self.pinned.get_mut(place) {
            *pin = if slot == NOWHERE { NOWHERE } else { block };
            if slot != NOWHERE {
                self.blocks[slot as usize].1 += 1;
            }
        }
    }

    /// The slot of `block`, or [`NOWHERE`] if it can have none.
    fn bring_in(&mut self, block: u32) -> u32 {
        let slot = self.slots[block as usize];
        if slot != NOWHERE {
            self.policy.hit(slot);
            return slot;
        }
        self.counts.loads += 1;
        self.counts.touched += u64::from(!std::mem::replace(&mut self.touched[block as usize], true));
        let Some(slot) = self.free.pop().or_else(|| self.evict()) else { return NOWHERE };
        self.slots[block as usize] = slot;
        self.blocks[slot as usize] = (block, 0);
        self.policy.admit(slot, BlockId(block));
        slot
    }

    fn evict(&mut self) -> Option<u32> {
        let mut taken = None;
        let Simulated { policy, blocks, .. } = self;
        policy.victim(&mut |slot| {
            let is_idle = blocks.get(slot as usize).is_some_and(|(_, pins)| *pins == 0);
            if taken.is_none() && is_idle {
                taken = Some(slot);
                return true;
            }
            false
        });
        let slot = taken?;
        self.slots[self.blocks[slot as usize].0 as usize] = NOWHERE;
        Some(slot)
    }
}
