//! Replacement policies as their papers' text says them, on plain lists.

use std::collections::{BTreeMap, VecDeque};

/// What a twin has to answer.
pub trait Naive {
    fn admit(&mut self, slot: u32, block: u32);
    fn hit(&mut self, slot: u32);
    /// The slot that goes, which must not be refused.
    fn victim(&mut self, refused: &dyn Fn(u32) -> bool) -> Option<u32>;
}

/// Slots in order of use.
#[derive(Default)]
pub struct NaiveLru(Vec<u32>);

impl Naive for NaiveLru {
    fn admit(&mut self, slot: u32, _block: u32) {
        self.0.push(slot);
    }

    fn hit(&mut self, slot: u32) {
        self.0.retain(|other| *other != slot);
        self.0.push(slot);
    }

    fn victim(&mut self, refused: &dyn Fn(u32) -> bool) -> Option<u32> {
        let index = self.0.iter().position(|slot| !refused(*slot))?;
        Some(self.0.remove(index))
    }
}

/// Resident slots and whether each was used since the hand was there; the hand stands behind the slot that it saw last.
#[derive(Default)]
pub struct NaiveClock {
    used: BTreeMap<u32, bool>,
    hand: u32,
}

impl Naive for NaiveClock {
    fn admit(&mut self, slot: u32, _block: u32) {
        self.used.insert(slot, false);
    }

    fn hit(&mut self, slot: u32) {
        self.used.insert(slot, true);
    }

    fn victim(&mut self, refused: &dyn Fn(u32) -> bool) -> Option<u32> {
        let around: Vec<u32> =
            self.used.range(self.hand..).chain(self.used.range(..self.hand)).map(|(slot, _)| *slot).collect();
        for slot in around.iter().chain(&around) {
            let was_used = self.used.insert(*slot, false) == Some(true);
            if !was_used && !refused(*slot) {
                self.used.remove(slot);
                self.hand = slot + 1;
                return Some(*slot);
            }
        }
        None
    }
}

/// Two queues of (slot, block, uses), oldest first, and the blocks that went from the first.
pub struct NaiveS3Fifo {
    small: VecDeque<(u32, u32, u8)>,
    main: VecDeque<(u32, u32, u8)>,
    /// `None`: came back meanwhile.
    ghosts: VecDeque<Option<u32>>,
    ghosts_max: usize,
}

impl NaiveS3Fifo {
    pub fn new(slots: u32) -> NaiveS3Fifo {
        let ghosts_max = (slots - slots / 10) as usize;
        NaiveS3Fifo { small: VecDeque::new(), main: VecDeque::new(), ghosts: VecDeque::new(), ghosts_max }
    }

    fn forget(&mut self, block: u32) -> bool {
        let ghost = self.ghosts.iter_mut().find(|ghost| **ghost == Some(block));
        ghost.is_some_and(|ghost| ghost.take().is_some())
    }

    fn remember(&mut self, block: u32) {
        self.forget(block);
        self.ghosts.push_back(Some(block));
        if self.ghosts.len() > self.ghosts_max {
            self.ghosts.pop_front();
        }
    }
}

impl Naive for NaiveS3Fifo {
    fn admit(&mut self, slot: u32, block: u32) {
        let queue = if self.forget(block) { &mut self.main } else { &mut self.small };
        queue.push_back((slot, block, 0));
    }

    fn hit(&mut self, slot: u32) {
        for entry in self.small.iter_mut().chain(&mut self.main).filter(|entry| entry.0 == slot) {
            entry.2 = (entry.2 + 1).min(3);
        }
    }

    fn victim(&mut self, refused: &dyn Fn(u32) -> bool) -> Option<u32> {
        let (mut small_refused, mut main_refused) = (0, 0);
        loop {
            let small_left = small_refused < self.small.len();
            let main_left = main_refused < self.main.len();
            let small_is_due = self.small.len() >= ((self.small.len() + self.main.len()) / 10).max(1);
            if small_left && (small_is_due || !main_left) {
                let (slot, block, uses) = self.small.pop_front()?;
                if uses >= 2 {
                    self.main.push_back((slot, block, 0));
                    main_refused = 0;
                } else if refused(slot) {
                    self.small.push_back((slot, block, uses));
                    small_refused += 1;
                } else {
                    self.remember(block);
                    return Some(slot);
                }
            } else if main_left {
                let (slot, block, uses) = self.main.pop_front()?;
                if uses > 0 {
                    self.main.push_back((slot, block, uses - 1));
                    main_refused = 0;
                } else if refused(slot) {
                    self.main.push_back((slot, block, 0));
                    main_refused += 1;
                } else {
                    return Some(slot);
                }
            } else {
                return None;
            }
        }
    }
}
