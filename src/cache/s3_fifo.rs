//! S3-FIFO: three queues, no order of use.

use crate::units::BlockId;

use super::ReplacementPolicy;
use super::ghosts::Ghosts;
use super::rings::Rings;

/// New blocks pass through a small queue, a tenth of the slots, and only those that were used at least twice there go on to the
/// main queue; a block that comes back soon after it was evicted from the small one goes to the main one at once (Yang,
/// Zhang, Qiu, Yue and Rashmi, "FIFO queues are all you need for cache eviction", SOSP 2023, algorithm 1).
///
/// Of the policies of its time it is the one that was made for block traffic too; SIEVE, its simpler successor (NSDI
/// 2024), gives up the memory of evicted blocks and by its authors' own account falls behind LRU on block traces with
/// scans.
#[derive(Debug, Default)]
pub struct S3Fifo {
    queues: Rings,
    slots: Vec<Slot>,
    /// Slots in the small queue and in the main one.
    counts: [u32; 2],
    ghosts: Ghosts,
}

#[derive(Clone, Copy, Debug)]
struct Slot {
    block: u32,
    queue: u8,
    /// Uses since it entered its queue, less those that spared it since; at most [`USES_MAX`].
    uses: u8,
}

const SMALL: u8 = 0;
const MAIN: u8 = 1;
const USES_MAX: u8 = 3;
/// Uses in the small queue that lead to the main one.
const USES_TO_STAY: u8 = 2;

impl S3Fifo {
    /// A policy for a cache yet to be made.
    pub fn new() -> S3Fifo {
        S3Fifo::default()
    }

    fn push(&mut self, queue: u8, slot: u32) {
        self.queues.push(queue.into(), slot);
        self.counts[usize::from(queue)] += 1;
        self.slots[slot as usize].queue = queue;
    }

    fn remove(&mut self, slot: u32) -> Slot {
        let record = self.slots[slot as usize];
        self.queues.remove(slot);
        self.counts[usize::from(record.queue)] -= 1;
        record
    }

    fn evicted(&mut self, slot: u32) {
        let record = self.remove(slot);
        if record.queue == SMALL {
            self.ghosts.insert(record.block);
        }
    }
}

impl ReplacementPolicy for S3Fifo {
    const BYTES_PER_SLOT: u64 = Rings::BYTES_PER_SLOT + size_of::<Slot>() as u64 + Ghosts::BYTES_PER_GHOST;

    fn start(&mut self, slot_count: u32) {
        self.queues = Rings::new(slot_count, 2);
        self.slots = vec![Slot { block: 0, queue: SMALL, uses: 0 }; slot_count as usize];
        self.counts = [0; 2];
        // As many as the main queue holds.
        self.ghosts = Ghosts::new(slot_count - slot_count / 10);
    }

    fn admit(&mut self, slot: u32, block: BlockId) {
        self.slots[slot as usize] = Slot { block: block.0, queue: SMALL, uses: 0 };
        let queue = if self.ghosts.remove(block.0) { MAIN } else { SMALL };
        self.push(queue, slot);
    }

    fn hit(&mut self, slot: u32) {
        let uses = &mut self.slots[slot as usize].uses;
        *uses = (*uses + 1).min(USES_MAX);
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        // How many slots in a row each queue's old end was refused: as many as it holds, and there is nothing in it.
        let mut refused = [0; 2];
        loop {
            let has_more = |queue: u8| refused[usize::from(queue)] < self.counts[usize::from(queue)];
            let small_is_full = self.counts[0] >= ((self.counts[0] + self.counts[1]) / 10).max(1);
            let queue = match (has_more(SMALL), has_more(MAIN)) {
                (true, main) if small_is_full || !main => SMALL,
                (_, true) => MAIN,
                _ => return,
            };
            let Some(slot) = self.queues.oldest(queue.into()) else { return };
            let uses = self.slots[slot as usize].uses;
            let spared = if queue == SMALL { uses >= USES_TO_STAY } else { uses > 0 };
            if !spared && evict(slot) {
                self.evicted(slot);
                return;
            }
            self.remove(slot);
            if spared {
                self.slots[slot as usize].uses = if queue == SMALL { 0 } else { uses - 1 };
                self.push(MAIN, slot);
                refused[usize::from(MAIN)] = 0;
            } else {
                // Pinned, so in use: to the new end of its queue.
                self.push(queue, slot);
                refused[usize::from(queue)] += 1;
            }
        }
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.queues.contains(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evict_first(policy: &mut S3Fifo) -> Option<u32> {
        let mut victim = None;
        policy.victim(&mut |slot| {
            victim = Some(slot);
            true
        });
        victim
    }

    #[test]
    fn a_scan_passes_through_the_small_queue_only() {
        let mut policy = S3Fifo::new();
        policy.start(10);
        (0..10).for_each(|slot| policy.admit(slot, BlockId(slot)));
        (0..9).for_each(|slot| (0..2).for_each(|_| policy.hit(slot)));
        // The nine that were used twice are promoted, the tenth goes.
        assert_eq!(evict_first(&mut policy), Some(9));
        for block in 100..120 {
            policy.admit(9, BlockId(block));
            assert_eq!(evict_first(&mut policy), Some(9), "block {block} displaced a block in use");
        }
        // What comes back soon stays.
        policy.admit(9, BlockId(119));
        assert_eq!(policy.slots[9].queue, MAIN);
        assert_eq!(evict_first(&mut policy), Some(0));
        assert!(!policy.is_resident(0) && policy.is_resident(9));
    }

    #[test]
    fn works_with_no_slot_and_with_one() {
        let mut none = S3Fifo::new();
        none.start(0);
        assert_eq!(evict_first(&mut none), None);
        let mut one = S3Fifo::new();
        one.start(1);
        one.admit(0, BlockId(5));
        (0..5).for_each(|_| one.hit(0));
        one.victim(&mut |_| false);
        assert_eq!((evict_first(&mut one), evict_first(&mut one)), (Some(0), None));
    }
}
