//! Where blocks come from: disk, mapped file, memory; later a network.

use std::sync::Arc;

use crate::error::SourceError;
use crate::model::Model;
use crate::units::BlockId;

/// Serves the stored bytes of a compiled model's blocks. Shared by all threads; never holds a lock while it reads.
///
/// A source returns bytes as they are: checking them is the decoder's work (I5).
pub trait BlockSource: Send + Sync {
    /// Header, directory and materials, read and checked when the source was opened.
    fn model(&self) -> &Arc<Model>;

    /// Reads the stored bytes of `block` into `into` (cleared first; its capacity is reused, so a buffer with
    /// capacity for the largest stored block is never reallocated).
    ///
    /// # Errors
    /// [`SourceError`]; `into` then holds nothing useful.
    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError>;
}
