//! The compiled file: header, block directory, materials, precision record. Bytes to structures and back; no I/O.

mod directory;
mod material;

pub use directory::{BlockEntry, SUB_BOX_COUNT};
pub use material::MaterialRecord;

use crate::block::BlockLimits;
use crate::geom::{Aabb, Precision};

/// What a compiled file says about itself, parsed and checked: everything but the blocks.
#[derive(Clone, Debug)]
pub struct Model {
    /// How positions are held.
    pub precision: Precision,
    /// Sizes that hold for every block.
    pub limits: BlockLimits,
    /// Box of all triangles.
    pub bounds: Aabb,
    /// Triangles in the file.
    pub triangle_count: u64,
    /// One entry per block, in file order.
    pub blocks: Vec<BlockEntry>,
    /// Material table; never empty (a model without materials has one default entry).
    pub materials: Vec<MaterialRecord>,
    /// What the file was compiled from.
    pub source: SourceRecord,
}

/// Enough about the model file to notice that it changed since it was compiled. All zero if there was no file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SourceRecord {
    /// Size of the model file in bytes.
    pub file_bytes: u64,
    /// Modification time in nanoseconds since 1970, of the model file and the material files it names (latest).
    pub modified_ns: u64,
    /// XXH3 over size, first and last 64 KiB of the model file.
    pub fingerprint: u64,
}
