//! The compiled file: header, block directory, materials, precision record. Bytes to structures and back; no I/O.
//!
//! `header | blocks | directory | materials`, without gaps; in a file with attributes
//! `header | blocks | pages | directory | materials | directory of the pages`; behind that, if materials name images, the table of
//! images. `docs/format.md` gives every byte.

mod attributes;
mod cells;
mod directory;
mod header;
mod images;
mod material;
mod read;
mod sub_boxes;
mod working;
mod write;

use crate::block::{BlockCheck, BlockData, BlockLimits, DecodeScratch, decode};
use crate::error::BlockError;
use crate::geom::{Aabb, Precision};
use crate::units::{BlockId, Bytes};

pub use attributes::{AttributePages, PageEntry};
pub use cells::{CellEntry, Cells};
pub use directory::{BlockEntry, SUB_BOX_COUNT};
pub use header::{FORMAT_VERSION, HEADER_BYTES};
pub use images::{ImageMap, MaterialImages};
pub use material::MaterialRecord;
pub use read::ModelReader;
pub use sub_boxes::SubBoxes;
pub use write::{ModelWriter, NewBlock, SealedModel};

pub(crate) use header::Section;
pub(crate) use material::table_bytes;
pub(crate) use working::{
    CELL_RECORD_BYTES, CellRecord, RECORD_BYTES, RefinementRecord, WORKING_HEADER_BYTES, WorkingHeader,
    WorkingOptions,
};

/// What a compiled file says about itself, parsed and checked: everything but the blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// How positions are held.
    pub precision: Precision,
    /// Sizes that hold for every block.
    pub limits: BlockLimits,
    /// Box of all triangles.
    pub bounds: Aabb,
    /// Triangles in the file.
    pub triangle_count: u64,
    /// One entry per block, in file order; empty for a model that is compiled lazily.
    pub blocks: Vec<BlockEntry>,
    /// The cells of a model that is compiled lazily, whose blocks are not known before a ray reaches them; else none.
    pub cells: Cells,
    /// Material table; never empty (a model without materials has one default entry).
    pub materials: Vec<MaterialRecord>,
    /// What the file was compiled from.
    pub source: SourceRecord,
    /// How the file was compiled, if it says so.
    pub compiled: Option<CompileRecord>,
    /// Where the attributes of triangle corners are; empty if no triangle has any.
    pub attributes: AttributePages,
}

impl Model {
    /// Memory that the model holds while it is open, for the memory budget (I1).
    pub fn resident_bytes(&self) -> Bytes {
        let images = |material: &MaterialRecord| {
            let images = material.images.as_deref();
            images.map_or(0, |images| {
                size_of::<MaterialImages>() + images.all().map(|(map, _)| map.path.capacity()).sum::<usize>()
            })
        };
        let names: usize =
            self.materials.iter().map(|material| material.name.capacity() + images(material)).sum();
        let blocks = self.blocks.capacity() * size_of::<BlockEntry>();
        let materials = self.materials.capacity() * size_of::<MaterialRecord>();
        let own = (size_of::<Model>() + blocks + materials + names) as u64;
        Bytes(own + self.cells.resident_bytes().0 + self.attributes.resident_bytes())
    }

    /// Blocks are numbered below this: how many there are, or, for a model that is compiled lazily, how many there can come to be.
    pub fn block_id_count(&self) -> u32 {
        // A file has at most 2^32 - 1 blocks.
        self.blocks.len() as u32 + self.cells.block_id_count()
    }

    /// About how many blocks there are, known or not.
    pub fn expected_block_count(&self) -> u32 {
        self.blocks.len() as u32 + self.cells.block_count_expected()
    }

    /// Lowest and highest material of each part of the model: of its blocks, or of its cells.
    pub fn material_ranges(&self) -> impl Iterator<Item = [u16; 2]> + '_ {
        let cells = self.cells.entries().iter().map(|cell| cell.material_range);
        self.blocks.iter().map(|block| block.material_range).chain(cells)
    }

    /// Length of the largest stored block: what a read buffer must hold.
    pub fn stored_bytes_max(&self) -> Bytes {
        Bytes(self.blocks.iter().map(|entry| u64::from(entry.stored_bytes)).max().unwrap_or(0))
    }

    /// The directory entry of a block.
    pub fn entry(&self, block: BlockId) -> Option<&BlockEntry> {
        self.blocks.get(block.0 as usize)
    }

    /// What the directory promises about a block, for [`decode`]; `None` if there is no such block.
    pub fn check(&self, block: BlockId) -> Option<BlockCheck> {
        self.entry(block).map(|entry| entry.check(block))
    }

    /// Decodes the stored bytes of `block` as [`decode`] does, with everything that the file says about it.
    ///
    /// # Errors
    /// [`BlockError`] if there is no such block or the bytes are not its bytes.
    pub fn decode_block(
        &self,
        block: BlockId,
        bytes: &[u8],
        scratch: &mut DecodeScratch,
        data: &mut BlockData,
    ) -> Result<(), BlockError> {
        let entry = self.entry(block);
        let entry = entry.ok_or(BlockError { block, offset: 0, reason: "the file has no such block" })?;
        self.decode_entry(block, entry, bytes, scratch, data)
    }

    /// [`Model::decode_block`] for a block that `entry` describes.
    pub(crate) fn decode_entry(
        &self,
        block: BlockId,
        entry: &BlockEntry,
        bytes: &[u8],
        scratch: &mut DecodeScratch,
        data: &mut BlockData,
    ) -> Result<(), BlockError> {
        decode(bytes, &entry.check(block), self.precision, self.limits, scratch, data)
    }
}

/// Enough about the model file to notice that it changed since it was compiled. All zero if there was no file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SourceRecord {
    /// Size of the model file in bytes.
    pub file_bytes: u64,
    /// Modification time in nanoseconds since 1970, of the model file and the material or buffer files it names (latest).
    pub modified_ns: u64,
    /// XXH3 over size, first and last 64 KiB of the model file, and of each of those files: see
    /// [`source_record`](crate::import::source_record).
    pub fingerprint: u64,
}

/// Enough about a compile to notice that other options would make another model of the same source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompileRecord {
    /// Who chose [`Model::precision`].
    pub precision: PrecisionOrigin,
    /// Triangles of the source that were left out because a coordinate was not finite.
    pub skipped: u64,
}

/// Who chose how positions are held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PrecisionOrigin {
    /// The caller of the compile.
    Given,
    /// The compile, by what the source holds.
    Automatic {
        /// Whether the bound on what rounding may move was met; the finest lattice that holds a large model may miss it.
        tolerance_met: bool,
    },
}
