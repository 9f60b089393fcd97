//! A source that fails, cuts short and flips bits.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use crate::error::{LoadError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::procedural::random::Random;
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

impl<S: BlockSource> BlockSource for FaultySource<S> {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn buffer_bytes(&self) -> Bytes {
        self.source.buffer_bytes()
    }

    fn gives_attributes(&self) -> bool {
        self.source.gives_attributes()
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.source.read_attributes(page, into)
    }

    fn cut_cell(&self, cell: CellId) -> Result<Arc<[BlockEntry]>, LoadError> {
        self.source.cut_cell(cell)
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.source.read_block(block, into)?;
        let nth = self.reads.get(block.0 as usize).map_or(0, |reads| reads.fetch_add(1, Ordering::Relaxed));
        let mut random = Random::new(self.seed ^ (u64::from(block.0) << 32 | u64::from(nth)));
        let struck = |holds: bool| {
            self.faults.fetch_add(u64::from(holds), Ordering::Relaxed);
            holds
        };
        if struck(random.unit() < self.rates.io_errors) {
            return Err(SourceError::Io {
                what: format!("block {}", block.0),
                name: "a source that was asked to fail".to_owned(),
                error: io::Error::other("an injected error"),
            });
        }
        if struck(random.unit() < self.rates.short_reads) {
            into.truncate(random.below(into.len().max(1)));
        }
        if struck(random.unit() < self.rates.bit_flips) && !into.is_empty() {
            let at = random.below(into.len());
            into[at] ^= 1 << random.below(8);
        }
        Ok(())
    }
}
