//! The geometry cache: preallocated slots, an associative table from block to slot, pins, replacement policies, and
//! one fetch per missing block.

use std::ops::Deref;

use crate::error::LoadError;
use crate::units::{BlockId, Bytes};

/// Holds the built form of blocks in a fixed number of slots of one size. Shared by all threads.
///
/// What is in a slot is the caller's: the cache knows bytes, not trees.
pub trait GeometryCache: Send + Sync {
    /// Pins `block`: if it is not resident, takes a free or evicted slot, calls `fill` on the slot's bytes (64-byte
    /// aligned, contents unspecified) and publishes it. Concurrent calls for one missing block run one `fill`; the
    /// others wait. No lock is held during `fill` (I7). If `fill` fails or panics the block stays absent, and one of
    /// those that wait becomes the next to fill.
    ///
    /// # Errors
    /// What `fill` returned, or [`LoadError::NoSlot`] if every slot is pinned or being filled by threads that hold pins.
    fn pin<'c>(
        &'c self,
        block: BlockId,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<(), LoadError>,
    ) -> Result<Pin<'c>, LoadError>;

    /// Pins `block` if it is resident; never waits, never loads.
    fn try_pin(&self, block: BlockId) -> Option<Pin<'_>>;

    /// How many slots there are.
    fn slot_count(&self) -> u32;

    /// Size of each slot.
    fn slot_bytes(&self) -> Bytes;

    /// What happened so far.
    fn stats(&self) -> CacheStats;

    /// Gives back one pin of `block`. Called by [`Pin`] only.
    #[doc(hidden)]
    fn unpin(&self, block: BlockId);
}

/// What a cache did since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Pins of resident blocks.
    pub hits: u64,
    /// Pins that had to fill.
    pub misses: u64,
    /// Resident blocks that lost their slot.
    pub evictions: u64,
    /// Pins that waited for another thread's fill or for a slot.
    pub stalls: u64,
    /// Bytes of slots filled.
    pub filled_bytes: u64,
}

/// A resident block that cannot be evicted while this lives. Dropped on unwinding too, so a panic leaks no pin.
pub struct Pin<'c> {
    cache: &'c dyn GeometryCache,
    block: BlockId,
    bytes: &'c [u8],
}

impl<'c> Pin<'c> {
    /// For implementations of [`GeometryCache`]: `bytes` must stay as they are until `unpin(block)`.
    pub fn new(cache: &'c dyn GeometryCache, block: BlockId, bytes: &'c [u8]) -> Pin<'c> {
        Pin { cache, block, bytes }
    }

    /// Which block.
    pub fn block(&self) -> BlockId {
        self.block
    }
}

impl Deref for Pin<'_> {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        self.bytes
    }
}

impl Drop for Pin<'_> {
    fn drop(&mut self) {
        self.cache.unpin(self.block);
    }
}
