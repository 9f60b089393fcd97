//! CLOCK as a replacement policy: shows that the trait carries policies other than LRU.

use outcrop::cache::ReplacementPolicy;
use outcrop::units::BlockId;

/// One reference bit per slot and a hand that clears them.
#[derive(Default)]
pub struct Clock {
    resident: Vec<bool>,
    referenced: Vec<bool>,
    hand: usize,
}

impl ReplacementPolicy for Clock {
    const BYTES_PER_SLOT: u64 = 2;

    fn start(&mut self, slot_count: u32) {
        self.resident = vec![false; slot_count as usize];
        self.referenced = vec![false; slot_count as usize];
    }

    fn admit(&mut self, slot: u32, _block: BlockId) {
        self.resident[slot as usize] = true;
    }

    fn hit(&mut self, slot: u32) {
        self.referenced[slot as usize] = true;
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        // Twice around: at the second time no reference bit is left.
        for _ in 0..2 * self.resident.len() {
            let slot = self.hand;
            self.hand = (slot + 1) % self.resident.len();
            let spared = std::mem::take(&mut self.referenced[slot]);
            if self.resident[slot] && !spared && evict(slot as u32) {
                self.resident[slot] = false;
                return;
            }
        }
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.resident[slot as usize]
    }
}
