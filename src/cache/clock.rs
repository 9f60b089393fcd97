//! CLOCK: recency in one mark per slot.

use crate::units::BlockId;

use super::ReplacementPolicy;

/// Evicts the first block on a hand's way around the slots that was not used since the hand passed it last (Corbato,
/// "A Paging Experiment with the Multics System", 1968). A hit is one write and moves nothing.
///
/// A block that was just admitted counts as not used: the hand has a whole way to go until it comes there.
#[derive(Debug, Default)]
pub struct Clock {
    marks: Vec<Mark>,
    hand: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mark {
    Empty,
    Idle,
    Used,
}

impl Clock {
    /// A policy for a cache yet to be made.
    pub fn new() -> Clock {
        Clock::default()
    }
}

impl ReplacementPolicy for Clock {
    const BYTES_PER_SLOT: u64 = size_of::<Mark>() as u64;

    fn start(&mut self, slot_count: u32) {
        self.marks = vec![Mark::Empty; slot_count as usize];
        self.hand = 0;
    }

    fn admit(&mut self, slot: u32, _block: BlockId) {
        self.marks[slot as usize] = Mark::Idle;
    }

    fn hit(&mut self, slot: u32) {
        self.marks[slot as usize] = Mark::Used;
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        // Twice around: at the second time no mark is left.
        for _ in 0..2 * self.marks.len() {
            let slot = self.hand;
            self.hand = (slot + 1) % self.marks.len();
            match self.marks[slot] {
                Mark::Empty => {}
                Mark::Used => self.marks[slot] = Mark::Idle,
                Mark::Idle if evict(slot as u32) => {
                    self.marks[slot] = Mark::Empty;
                    return;
                }
                Mark::Idle => {}
            }
        }
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.marks[slot as usize] != Mark::Empty
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spares_what_was_used_once_around() {
        let mut clock = Clock::new();
        clock.start(3);
        (0..3).for_each(|slot| clock.admit(slot, BlockId(slot)));
        clock.hit(0);
        let mut victims = Vec::new();
        for _ in 0..4 {
            clock.victim(&mut |slot| {
                victims.push(slot);
                true
            });
        }
        assert_eq!(victims, [1, 2, 0]);
        assert!((0..3).all(|slot| !clock.is_resident(slot)));
    }
}
