//! What every geometry cache can do.

use crate::error::LoadError;
use crate::units::{BlockId, Bytes};

use super::Pin;

/// Holds the built form of blocks in a fixed number of slots of one size. Shared by all threads.
///
/// What is in a slot is the caller's: the cache knows bytes, not trees.
pub trait GeometryCache: Send + Sync {
    /// Pins `block`: if it is not resident, takes a free or evicted slot, calls `fill` on the slot's bytes (64-byte
    /// aligned, initialised, contents unspecified) and publishes it. Concurrent calls for one missing block run one
    /// `fill`; the others wait. No lock is held during `fill` (I7). If `fill` fails or panics the block stays absent,
    /// and one of those that wait becomes the next to fill.
    ///
    /// `fill` must not call back into the same cache: a load that waits for another load can wait forever.
    ///
    /// # Errors
    /// What `fill` returned, or [`LoadError::NoSlot`] if every slot is pinned and none is being filled.
    /// With at least `threads * pins` slots, where no thread ever holds more than `pins` pins (the one that it is
    /// asking for and the one that it is giving back included), `NoSlot` cannot happen.
    ///
    /// # Panics
    /// If `block` is not below the number of blocks that the cache was made for, and if `fill` panics.
    fn pin<'c>(
        &'c self,
        block: BlockId,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<(), LoadError>,
    ) -> Result<Pin<'c>, LoadError>;

    /// Pins `block` if it is resident; never waits, never loads. A success counts as a hit, a failure as nothing.
    ///
    /// # Panics
    /// If `block` is not below the number of blocks that the cache was made for.
    fn try_pin(&self, block: BlockId) -> Option<Pin<'_>>;

    /// Whether `block` is resident; out of date as soon as it is said. Not a use of the block.
    ///
    /// # Panics
    /// If `block` is not below the number of blocks that the cache was made for.
    fn is_resident(&self, block: BlockId) -> bool;

    /// How many slots there are.
    fn slot_count(&self) -> u32;

    /// How many of them may be in use now: all, unless the cache follows the free memory.
    fn slot_limit(&self) -> u32 {
        self.slot_count()
    }

    /// Size of each slot.
    fn slot_bytes(&self) -> Bytes;

    /// What happened so far. Exact when no other thread is inside a call.
    fn stats(&self) -> CacheStats;
}

/// What a cache did since it was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CacheStats {
    /// Pins of resident blocks.
    pub hits: u64,
    /// Pins that had to fill, failed fills included.
    pub misses: u64,
    /// Resident blocks that lost their slot.
    pub evictions: u64,
    /// Pins that waited for another thread's fill or for a slot.
    pub stalls: u64,
    /// Bytes of slots filled; failed fills not included.
    pub filled_bytes: u64,
}
