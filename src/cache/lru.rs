//! Least recently used: the paper's policy.

use crate::units::BlockId;

use super::ReplacementPolicy;

/// Evicts the block whose last pin is the longest ago. A doubly linked list through the slots, so that every event
/// is a few writes.
#[derive(Debug, Default)]
pub struct Lru {
    /// One link per slot and a last one that closes the ring: its `newer` is the least recently used slot, its
    /// `older` the most recently used one.
    links: Vec<Link>,
}

#[derive(Clone, Copy, Debug)]
struct Link {
    older: u32,
    newer: u32,
}

impl Lru {
    /// A policy for a cache yet to be made.
    pub fn new() -> Lru {
        Lru::default()
    }

    /// The resident slots, least recently used first.
    pub fn order(&self) -> impl Iterator<Item = u32> + '_ {
        let end = self.end();
        std::iter::successors(self.links.last().map(|link| link.newer), |slot| {
            Some(self.links[*slot as usize].newer)
        })
        .take_while(move |slot| *slot != end)
    }

    /// Index of the link that closes the ring.
    fn end(&self) -> u32 {
        // Slot numbers are u32 and the ring has one link more than slots, so its last index fits.
        self.links.len().saturating_sub(1) as u32
    }

    fn unlink(&mut self, slot: u32) {
        let Link { older, newer } = self.links[slot as usize];
        self.links[older as usize].newer = newer;
        self.links[newer as usize].older = older;
        // A link to itself: not resident.
        self.links[slot as usize] = Link { older: slot, newer: slot };
    }

    fn link_newest(&mut self, slot: u32) {
        let end = self.end();
        let newest = self.links[end as usize].older;
        self.links[slot as usize] = Link { older: newest, newer: end };
        self.links[newest as usize].newer = slot;
        self.links[end as usize].older = slot;
    }
}

impl ReplacementPolicy for Lru {
    const BYTES_PER_SLOT: u64 = size_of::<Link>() as u64;

    fn start(&mut self, slot_count: u32) {
        self.links = (0..=slot_count).map(|slot| Link { older: slot, newer: slot }).collect();
    }

    fn admit(&mut self, slot: u32, _block: BlockId) {
        self.link_newest(slot);
    }

    fn hit(&mut self, slot: u32) {
        self.unlink(slot);
        self.link_newest(slot);
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        let victim = self.order().find(|slot| evict(*slot));
        if let Some(slot) = victim {
            self.unlink(slot);
        }
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.links[slot as usize].newer != slot
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
