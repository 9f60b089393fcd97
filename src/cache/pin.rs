//! A pin: the right to read a resident block.

use std::ops::Deref;

use crate::units::BlockId;

/// Takes pins back. A cache keeps its implementation to itself: whoever can reach it could give back a pin that
/// another thread still reads through.
pub trait PinOwner: Send + Sync {
    /// Gives back one pin of `block`. Called once for each [`Pin`], when it is dropped.
    fn unpin(&self, block: BlockId);
}

/// A resident block that cannot be evicted while this lives. Dropped on unwinding too, so a panic leaks no pin.
pub struct Pin<'c> {
    owner: &'c dyn PinOwner,
    block: BlockId,
    /// Valid until `unpin`, which is less than `'c`; handed out only for as long as the pin is borrowed.
    bytes: &'c [u8],
}

impl<'c> Pin<'c> {
    /// For implementations of [`GeometryCache`](super::GeometryCache): `bytes` stay as they are until `owner` gets
    /// the pin back.
    pub fn new(owner: &'c dyn PinOwner, block: BlockId, bytes: &'c [u8]) -> Pin<'c> {
        Pin { owner, block, bytes }
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
        self.owner.unpin(self.block);
    }
}

impl std::fmt::Debug for Pin<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Pin").finish_non_exhaustive()
    }
}
