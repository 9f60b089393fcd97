//! Which blocks were ever brought in.

use std::sync::atomic::{AtomicU64, Ordering};

use crate::units::{BlockId, Bytes};

/// A set of blocks that only grows, shared by all threads: one bit per block.
#[derive(Debug)]
pub(crate) struct TouchedBlocks {
    words: Box<[AtomicU64]>,
}

impl TouchedBlocks {
    /// The empty set for `block_count` blocks.
    pub fn new(block_count: usize) -> TouchedBlocks {
        TouchedBlocks { words: (0..block_count.div_ceil(64)).map(|_| AtomicU64::new(0)).collect() }
    }

    /// What [`TouchedBlocks::new`] allocates.
    pub fn bytes_needed(block_count: usize) -> Bytes {
        Bytes(block_count.div_ceil(64) as u64 * 8)
    }

    /// Adds `block`. Called per load, not per ray.
    ///
    /// # Panics
    /// If there is no such block.
    pub fn insert(&self, block: BlockId) {
        self.words[block.0 as usize / 64].fetch_or(1 << (block.0 % 64), Ordering::Relaxed);
    }

    /// How many blocks are in the set.
    pub fn count(&self) -> u64 {
        self.words.iter().map(|word| u64::from(word.load(Ordering::Relaxed).count_ones())).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_count_once() {
        let set = TouchedBlocks::new(130);
        for block in [0, 63, 64, 129, 64, 0] {
            set.insert(BlockId(block));
        }
        assert_eq!(set.count(), 4);
        assert_eq!(TouchedBlocks::bytes_needed(130), Bytes(24));
    }
}
