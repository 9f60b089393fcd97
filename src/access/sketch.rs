//! Which blocks were entered, roughly and in a few bytes.

use serde::{Deserialize, Serialize};

use crate::units::BlockId;

/// Bits of a sketch.
const BITS: u64 = 512;

/// A set of blocks in 64 bytes: the model's blocks, in the order of their numbers, fall into 512 runs of equal length, and a run is
/// in the set if one of its blocks is. Blocks that are near each other in number are near each other in space, so what two sketches
/// have in common tells of common blocks and of common neighbourhoods. Of a model of up to 512 blocks it is exact.
///
/// Only good for guesses: nothing that shows may depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct BlockSketch {
    words: [u64; (BITS / 64) as usize],
}

impl BlockSketch {
    /// Adds a block of a model of `block_count` blocks. One beyond them counts as the last.
    pub fn add(&mut self, block: BlockId, block_count: u32) {
        self.add_scaled(block, BlockSketch::scale(block_count));
    }

    /// What [`BlockSketch::add_scaled`] needs to know of a model: runs for each block, times 2^32, so that no entry of a block has
    /// to divide.
    pub(crate) fn scale(block_count: u32) -> u64 {
        (BITS << 32) / u64::from(block_count.max(1))
    }

    /// [`BlockSketch::add`] without a division.
    #[inline]
    pub(crate) fn add_scaled(&mut self, block: BlockId, scale: u64) {
        let bit = (u64::from(block.0).saturating_mul(scale) >> 32).min(BITS - 1);
        self.words[(bit / 64) as usize] |= 1 << (bit % 64);
    }

    /// Adds all that another holds.
    pub fn merge(&mut self, other: &BlockSketch) {
        self.words.iter_mut().zip(other.words).for_each(|(word, other)| *word |= other);
    }

    /// Whether nothing is in it.
    pub fn is_empty(&self) -> bool {
        self.words == BlockSketch::default().words
    }

    /// How many runs are in it.
    pub fn count(&self) -> u32 {
        self.words.iter().map(|word| word.count_ones()).sum()
    }

    /// How many runs are in both.
    pub fn common(&self, other: &BlockSketch) -> u32 {
        self.words.iter().zip(other.words).map(|(word, other)| (word & other).count_ones()).sum()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Against sets of runs reckoned by division.
    #[test]
    fn a_sketch_is_the_set_of_runs() {
        for count in [1u32, 2, 3, 500, 512, 513, 1000, 4096, 99_991, u32::MAX] {
            let run = |block: u32| u64::from(block.min(count - 1)) * BITS / u64::from(count);
            let mut sets = [BTreeSet::new(), BTreeSet::new()];
            let mut sketches = [BlockSketch::default(); 2];
            assert!(sketches[0].is_empty());
            for step in 0..300u32 {
                let block = step.wrapping_mul(2_654_435_761) % count;
                let which = (step % 2) as usize;
                // Scaled numbers round down, by less than a run.
                let exact = run(block);
                let mut one = BlockSketch::default();
                one.add(BlockId(block), count);
                let bit =
                    (0..BITS).find(|bit| one.words[(bit / 64) as usize] >> (bit % 64) & 1 == 1).unwrap();
                assert!(bit == exact || bit + 1 == exact, "{block} of {count}: {bit} for {exact}");
                sets[which].insert(bit);
                sketches[which].merge(&one);
            }
            let sizes = [0, 1].map(|which: usize| sets[which].len() as u32);
            assert_eq!(sketches.map(|sketch| sketch.count()), sizes);
            assert_eq!(sketches[0].common(&sketches[1]), sets[0].intersection(&sets[1]).count() as u32);
            // Up to 512 blocks each has a run of its own.
            if count <= 512 {
                let mut all = BlockSketch::default();
                (0..count).for_each(|block| all.add(BlockId(block), count));
                assert_eq!(all.count(), count);
            }
            let mut beyond = BlockSketch::default();
            beyond.add(BlockId(u32::MAX), count);
            assert_eq!(beyond.count(), 1);
        }
    }
}
