//! Blocks that were evicted not long ago.

/// The last so many blocks that were inserted, less those that were taken out again; exact, in memory set aside at the
/// start.
#[derive(Debug, Default)]
pub(super) struct Ghosts {
    /// The last insertions, the one of `turn` at `turn % len`.
    ring: Vec<u32>,
    /// Where each block stands: open addressing, probed one place after the other, at most half full.
    table: Vec<Place>,
    turn: u64,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    block: u32,
    /// Where in the ring, or [`FREE`].
    at: u32,
}

const FREE: u32 = u32::MAX;

impl Ghosts {
    /// Bytes for each block that is remembered: the ring, and a table of less than four places for each.
    pub const BYTES_PER_GHOST: u64 = (size_of::<u32>() + 4 * size_of::<Place>()) as u64;

    pub fn new(count: u32) -> Ghosts {
        let places = if count == 0 { 0 } else { (2 * count as usize).next_power_of_two() };
        Ghosts {
            ring: vec![FREE; count as usize],
            table: vec![Place { block: 0, at: FREE }; places],
            turn: 0,
        }
    }

    /// Where the search for `block` begins.
    fn home(&self, block: u32) -> usize {
        // Fibonacci hashing: neighbours in number are often evicted together.
        (u64::from(block).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize & (self.table.len() - 1)
    }

    fn find(&self, block: u32) -> Option<usize> {
        if self.table.is_empty() {
            return None;
        }
        let mut place = self.home(block);
        // At most half full, so a free place comes.
        while self.table[place].at != FREE {
            if self.table[place].block == block {
                return Some(place);
            }
            place = (place + 1) & (self.table.len() - 1);
        }
        None
    }

    /// Remembers `block` and forgets the oldest.
    pub fn insert(&mut self, block: u32) {
        if self.ring.is_empty() {
            return;
        }
        self.remove(block);
        let at = (self.turn % self.ring.len() as u64) as usize;
        let oldest = self.ring[at];
        if let Some(place) = self.find(oldest).filter(|place| self.table[*place].at as usize == at) {
            self.vacate(place);
        }
        self.ring[at] = block;
        self.turn += 1;
        let mut place = self.home(block);
        while self.table[place].at != FREE {
            place = (place + 1) & (self.table.len() - 1);
        }
        self.table[place] = Place { block, at: at as u32 };
    }

    /// Forgets `block`; whether it was remembered.
    pub fn remove(&mut self, block: u32) -> bool {
        let place = self.find(block);
        if let Some(place) = place {
            self.vacate(place);
        }
        place.is_some()
    }

    /// Frees a place and moves up those behind it that would not be found any more.
    fn vacate(&mut self, mut hole: usize) {
        let mask = self.table.len() - 1;
        let mut place = hole;
        loop {
            place = (place + 1) & mask;
            if self.table[place].at == FREE {
                break;
            }
            let from_home = place.wrapping_sub(self.home(self.table[place].block)) & mask;
            if from_home >= place.wrapping_sub(hole) & mask {
                self.table[hole] = self.table[place];
                hole = place;
            }
        }
        self.table[hole].at = FREE;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    #[test]
    fn remembers_as_a_queue_of_blocks_does() {
        let mut random = 1u32;
        for count in [0, 1, 2, 3, 7, 64] {
            let mut ghosts = Ghosts::new(count);
            // A block that was taken out leaves its place in the queue empty.
            let mut queue: VecDeque<Option<u32>> = VecDeque::new();
            for _ in 0..5000 {
                random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                let block = (random >> 16) % (3 * count + 2);
                let before = queue.iter_mut().find(|entry| **entry == Some(block));
                let was_there = before.is_some();
                if let Some(entry) = before {
                    *entry = None;
                }
                if random >> 9 & 1 == 0 {
                    assert_eq!(ghosts.remove(block), was_there);
                } else {
                    ghosts.insert(block);
                    queue.push_back(Some(block));
                    if queue.len() > count as usize {
                        queue.pop_front();
                    }
                }
            }
            for block in 0..3 * count + 2 {
                assert_eq!(ghosts.find(block).is_some(), queue.contains(&Some(block)));
            }
        }
    }
}
