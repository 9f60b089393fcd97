//! What decides which resident block makes room for a missing one.

use crate::units::BlockId;

/// Orders the resident slots by how soon they should make room. A plain sequential structure: the cache calls it under
/// its own short lock, so an implementation needs no synchronisation; it must neither block nor panic.
///
/// The methods see every event that replacement policies in use need: recency lists (LRU, 2Q), reference bits and
/// hands (CLOCK, SIEVE), queues with ghosts of evicted blocks (S3-FIFO; `admit` names the block). Nothing that an
/// implementation does can break the cache's memory safety, but one that does not offer every slot in
/// [`ReplacementPolicy::victim`] causes [`NoSlot`](crate::error::LoadError::NoSlot) errors.
pub trait ReplacementPolicy: Send + 'static {
    /// Bytes that [`ReplacementPolicy::start`] allocates for each slot; taken from the memory budget.
    const BYTES_PER_SLOT: u64;

    /// Called once, before all others: slots are numbered `0 .. slot_count`. The only call that may allocate.
    fn start(&mut self, slot_count: u32);

    /// `slot`, which was not resident, now holds `block`.
    fn admit(&mut self, slot: u32, block: BlockId);

    /// The block in `slot` was used again. Under contention the cache drops such calls rather than wait.
    fn hit(&mut self, slot: u32);

    /// Offers resident slots to `evict`, the best victim first, until it answers `true` (then that slot is no longer
    /// resident) or all were offered. It answers `false` for a pinned slot, which stays resident.
    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool);

    /// Whether `slot` is resident in the policy's eyes; for consistency checks.
    fn is_resident(&self, slot: u32) -> bool;
}
