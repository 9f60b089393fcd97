//! Least recently used: the paper's policy.

use crate::units::BlockId;

use super::ReplacementPolicy;
use super::rings::Rings;

/// Evicts the block whose last use is the longest ago.
#[derive(Debug, Default)]
pub struct Lru {
    slots: Rings,
}

/// The only list.
const BY_USE: u32 = 0;

impl Lru {
    /// A policy for a cache yet to be made.
    pub fn new() -> Lru {
        Lru::default()
    }

    /// The resident slots, least recently used first.
    pub fn order(&self) -> impl Iterator<Item = u32> + '_ {
        self.slots.iter(BY_USE)
    }
}

impl ReplacementPolicy for Lru {
    const BYTES_PER_SLOT: u64 = Rings::BYTES_PER_SLOT;

    fn start(&mut self, slot_count: u32) {
        self.slots = Rings::new(slot_count, 1);
    }

    fn admit(&mut self, slot: u32, _block: BlockId) {
        self.slots.push(BY_USE, slot);
    }

    fn hit(&mut self, slot: u32) {
        self.slots.remove(slot);
        self.slots.push(BY_USE, slot);
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        let victim = self.order().find(|slot| evict(*slot));
        if let Some(slot) = victim {
            self.slots.remove(slot);
        }
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.slots.contains(slot)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evict_first(lru: &mut Lru) -> Option<u32> {
        let mut victim = None;
        lru.victim(&mut |slot| {
            victim = Some(slot);
            true
        });
        victim
    }

    #[test]
    fn evicts_the_longest_unused_and_skips_what_is_refused() {
        let mut lru = Lru::new();
        lru.start(4);
        assert_eq!(evict_first(&mut lru), None);
        for slot in [2, 0, 3, 1] {
            lru.admit(slot, BlockId(slot));
        }
        lru.hit(0);
        lru.hit(1);
        assert_eq!(lru.order().collect::<Vec<_>>(), [2, 3, 0, 1]);
        let mut offered = Vec::new();
        lru.victim(&mut |slot| {
            offered.push(slot);
            slot == 0
        });
        assert_eq!(offered, [2, 3, 0]);
        assert!(!lru.is_resident(0) && lru.is_resident(2));
        assert_eq!((evict_first(&mut lru), evict_first(&mut lru)), (Some(2), Some(3)));
        lru.admit(2, BlockId(9));
        assert_eq!(lru.order().collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn works_with_no_slot_and_with_one() {
        let mut none = Lru::new();
        none.start(0);
        assert_eq!(evict_first(&mut none), None);
        let mut one = Lru::new();
        one.start(1);
        one.admit(0, BlockId(5));
        one.hit(0);
        assert_eq!((evict_first(&mut one), evict_first(&mut one)), (Some(0), None));
    }
}
