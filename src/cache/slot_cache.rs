//! The geometry cache of one process.

use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, LoadError};
use crate::units::{BlockId, Bytes};

use super::arena::SLOT_ALIGNMENT;
use super::shim::Native;
use super::table::Table;
use super::{CacheStats, GeometryCache, Lru, Pin, ReplacementPolicy};

/// A fixed number of slots in one allocation, found through one atomic word per block.
///
/// A hit is one atomic read-modify-write, plus a touch of the replacement policy that is dropped rather than waited
/// for; giving a pin back is one atomic read-modify-write. Neither a hit nor a miss allocates. The slots' memory is
/// taken from the budget at once but from the operating system only as slots are first used, so a large cache costs a
/// small model nothing.
///
/// ```
/// use outcrop::cache::{GeometryCache, Lru, SlotCache};
/// use outcrop::units::{BlockId, Bytes};
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// let budget = outcrop::MemoryBudget::new(Bytes::mib(1));
/// let cache = SlotCache::new(4, Bytes::kib(64), 1000, Lru::new(), &budget)?;
/// let pin = cache.pin(BlockId(17), &mut |slot| {
///     slot[0] = 42; // read, decode, build
///     Ok(())
/// })?;
/// assert_eq!(pin[0], 42);
/// assert!(cache.try_pin(BlockId(17)).is_some());
/// # Ok(())
/// # }
/// ```
pub struct SlotCache<P: ReplacementPolicy = Lru> {
    table: Table<P, Native>,
    _reservation: Reservation,
}

impl<P: ReplacementPolicy> SlotCache<P> {
    /// `slot_count` empty slots of `slot_bytes` each (rounded up to a multiple of 64) for blocks `0 .. block_count`.
    /// With fewer slots than the threads pin at once, [`GeometryCache::pin`] can fail; with none it always does.
    ///
    /// # Errors
    /// [`BudgetError`] if the budget, or the operating system, does not have [`SlotCache::bytes_needed`] bytes left.
    pub fn new(
        slot_count: u32,
        slot_bytes: Bytes,
        block_count: u32,
        policy: P,
        budget: &MemoryBudget,
    ) -> Result<SlotCache<P>, BudgetError> {
        let bytes_needed = Self::bytes_needed(slot_count, slot_bytes, block_count);
        let reservation = budget.reserve(bytes_needed, "the geometry cache")?;
        let refused = BudgetError {
            purpose: "the geometry cache (the operating system refuses the memory)",
            needed: bytes_needed,
            available: Bytes(0),
            limit: budget.limit(),
        };
        let table = stride(slot_bytes)
            .and_then(|stride| Table::new(slot_count, stride, block_count, policy))
            .ok_or(refused)?;
        Ok(SlotCache { table, _reservation: reservation })
    }

    /// What [`SlotCache::new`] takes from the budget: slots, table and policy. `u64::MAX` if no machine has so much.
    pub fn bytes_needed(slot_count: u32, slot_bytes: Bytes, block_count: u32) -> Bytes {
        let bytes = stride(slot_bytes)
            .and_then(|stride| Table::<P, Native>::bytes_needed(slot_count, stride, block_count));
        Bytes(bytes.unwrap_or(u64::MAX))
    }

    /// From now on uses at most `limit` slots, evicting what is beyond it and giving its memory back to the operating
    /// system (on Linux; whole pages). Never waits for a load or for a pin: slots that are pinned or being filled stay,
    /// and a call that would otherwise fail with [`LoadError::NoSlot`] goes beyond the limit, never beyond
    /// [`GeometryCache::slot_count`]. Call it again later for what could not be given back. May be called from any thread at any time.
    pub fn limit_slots(&self, limit: u32) {
        self.table.limit_slots(limit);
    }

    /// Slots that hold a block or are being filled.
    pub fn slots_used(&self) -> u32 {
        self.table.slots_used().0
    }

    /// Checks that words, free slots and policy agree about every slot and every block; the first disagreement as
    /// text. For tests and fuzzing: takes the lock for as long as it takes to look at every block and slot.
    ///
    /// # Errors
    /// What is wrong; then there is a bug in this module or in the policy.
    pub fn validate(&self) -> Result<(), String> {
        self.table.validate()
    }
}

/// Distance between slots.
fn stride(slot_bytes: Bytes) -> Option<usize> {
    usize::try_from(slot_bytes.0).ok()?.checked_next_multiple_of(SLOT_ALIGNMENT)
}

impl<P: ReplacementPolicy> GeometryCache for SlotCache<P> {
    fn pin<'c>(
        &'c self,
        block: BlockId,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<(), LoadError>,
    ) -> Result<Pin<'c>, LoadError> {
        self.table.pin(block, fill)
    }

    fn try_pin(&self, block: BlockId) -> Option<Pin<'_>> {
        self.table.try_pin(block)
    }

    fn is_resident(&self, block: BlockId) -> bool {
        self.table.is_resident(block)
    }

    fn slot_count(&self) -> u32 {
        self.table.slot_count()
    }

    fn slot_limit(&self) -> u32 {
        self.table.slots_used().1.min(self.slot_count())
    }

    fn slot_bytes(&self) -> Bytes {
        Bytes(self.table.slot_bytes() as u64)
    }

    fn stats(&self) -> CacheStats {
        self.table.stats()
    }
}

impl<P: ReplacementPolicy> std::fmt::Debug for SlotCache<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SlotCache").finish_non_exhaustive()
    }
}
