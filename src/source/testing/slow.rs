//! A source that takes its time.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use crate::error::{LoadError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::source::BlockSource;
use crate::units::{BlockId, Bytes, CellId};

/// Wraps a source and delays its reads like a device: every read waits for its latency, alone, and all reads share one
/// bandwidth.
#[derive(Debug)]
pub struct SlowSource<S> {
    source: S,
    latency: Duration,
    bytes_per_second: Option<u64>,
    start: Instant,
    /// When the line is free again, in nanoseconds after `start`.
    free_ns: AtomicU64,
}

impl<S: BlockSource> SlowSource<S> {
    /// Delays reads of `source` by `latency`, and so that at most `bytes_per_second` (not 0) come through if given.
    pub fn new(source: S, latency: Duration, bytes_per_second: Option<u64>) -> SlowSource<S> {
        SlowSource { source, latency, bytes_per_second, start: Instant::now(), free_ns: AtomicU64::new(0) }
    }

    /// How long a read of so many bytes has to wait from now on.
    fn delay(&self, bytes: usize) -> Duration {
        let Some(rate) = self.bytes_per_second else { return self.latency };
        // Some 500 years in nanoseconds fit into 64 bits.
        let now = self.start.elapsed().as_nanos() as u64;
        let transfer = (bytes as u128 * 1_000_000_000 / u128::from(rate.max(1))) as u64;
        let mut end = 0;
        let _ = self.free_ns.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |free| {
            end = free.max(now).saturating_add(transfer);
            Some(end)
        });
        self.latency + Duration::from_nanos(end - now)
    }
}

impl<S: BlockSource> BlockSource for SlowSource<S> {
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
        let delay = self.delay(into.len());
        if !delay.is_zero() {
            std::thread::sleep(delay);
        }
        Ok(())
    }
}
