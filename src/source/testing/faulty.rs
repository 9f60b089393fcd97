//! A source that fails, cuts short and flips bits.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use crate::error::{LoadError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::source::BlockSource;
use crate::units::{BlockId, Bytes, CellId};

/// How often each fault strikes, as a share of all reads from 0 to 1. All zero by default: transparent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FaultRates {
    /// The read fails with an I/O error.
    pub io_errors: f64,
    /// The read returns only a part of the block, as if all were well.
    pub short_reads: f64,
    /// One bit of the block is wrong.
    pub bit_flips: f64,
}

/// Wraps a source and breaks some reads. What happens to the nth read of a block depends on the seed, the block and n
/// alone, not on the order of blocks or threads; so a read that failed may succeed when it is tried again.
#[derive(Debug)]
pub struct FaultySource<S> {
    source: S,
    seed: u64,
    rates: FaultRates,
    reads: Vec<AtomicU32>,
    faults: AtomicU64,
}

impl<S: BlockSource> FaultySource<S> {
    /// Breaks reads of `source` as often as `rates` says.
    pub fn new(source: S, seed: u64, rates: FaultRates) -> FaultySource<S> {
        let reads = (0..source.model().block_id_count()).map(|_| AtomicU32::new(0)).collect();
        FaultySource { source, seed, rates, reads, faults: AtomicU64::new(0) }
    }

    /// How many faults struck so far.
    pub fn fault_count(&self) -> u64 {
        self.faults.load(Ordering::Relaxed)
    }
}

/// The splitmix64 generator: Steele, Lea, Flood, "Fast Splittable Pseudorandom Number Generators", OOPSLA 2014.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn strikes(&mut self, rate: f64) -> bool {
        // 53 random bits make an even number in 0 .. 1.
        ((self.next() >> 11) as f64) < rate * (1u64 << 53) as f64
    }

    fn below(&mut self, count: usize) -> usize {
        (self.next() % count.max(1) as u64) as usize
    }
}

impl<S: BlockSource> BlockSource for FaultySource<S> {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn buffer_bytes(&self) -> Bytes {
        self.source.buffer_bytes()
    }

    fn cut_cell(&self, cell: CellId) -> Result<Arc<[BlockEntry]>, LoadError> {
        self.source.cut_cell(cell)
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.source.read_block(block, into)?;
        let nth = self.reads.get(block.0 as usize).map_or(0, |reads| reads.fetch_add(1, Ordering::Relaxed));
        let mut random = Random(self.seed ^ (u64::from(block.0) << 32 | u64::from(nth)));
        let struck = |holds: bool| {
            self.faults.fetch_add(u64::from(holds), Ordering::Relaxed);
            holds
        };
        if struck(random.strikes(self.rates.io_errors)) {
            return Err(SourceError::Io {
                what: format!("block {}", block.0),
                name: "a source that was asked to fail".to_owned(),
                error: io::Error::other("an injected error"),
            });
        }
        if struck(random.strikes(self.rates.short_reads)) {
            into.truncate(random.below(into.len()));
        }
        if struck(random.strikes(self.rates.bit_flips)) && !into.is_empty() {
            let at = random.below(into.len());
            into[at] ^= 1 << random.below(8);
        }
        Ok(())
    }
}
