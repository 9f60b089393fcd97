//! What is known about a block before it is read.

use crate::error::BlockError;
use crate::units::BlockId;

/// What the directory promises about a block; the decoder holds the block's bytes to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockCheck {
    /// Which block, for errors.
    pub block: BlockId,
    /// [`checksum`] of its stored bytes.
    pub checksum: u64,
    /// Triangles in it.
    pub triangle_count: u32,
    /// Vertices in it.
    pub vertex_count: u32,
    /// Lowest and highest material index in it.
    pub material_range: [u16; 2],
}

/// XXH3-64, the checksum of every part of a compiled file. It finds accidents, not attacks.
pub fn checksum(bytes: &[u8]) -> u64 {
    xxhash_rust::xxh3::xxh3_64(bytes)
}

/// Offset and reason of a damage, before the block's name is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fault(pub usize, pub &'static str);

impl Fault {
    pub fn of(self, block: BlockId) -> BlockError {
        BlockError { block, offset: self.0 as u64, reason: self.1 }
    }
}
