//! From blocks to the bytes around them.

use super::attributes::{AttributePages, PageEntry};
use super::directory::{BlockEntry, ENTRY_BYTES, EntryContext, SUB_BOX_COUNT};
use super::header::{
    FEATURE_ATTRIBUTES, FEATURE_IMAGES, FEATURE_RECORD, FEATURE_ZSTD, HEADER_BYTES, Header, Section,
};
use super::material::table_bytes;
use super::{CompileRecord, MaterialRecord, SourceRecord, SubBoxes};
use crate::block::attributes::PageCheck;
use crate::block::{BlockLimits, Codec, checksum};
use crate::error::ModelError;
use crate::geom::{Aabb, Precision};
use crate::units::{BlockId, Bytes};

/// A block that [`crate::block::encode`] made, on its way into the file.
#[derive(Clone, Copy, Debug)]
pub struct NewBlock<'a> {
    /// Its bytes.
    pub stored: &'a [u8],
    /// Triangles in it.
    pub triangle_count: u32,
    /// Vertices in it.
    pub vertex_count: u32,
    /// Tight box of its triangles in the positions that it decodes to.
    pub bounds: Aabb,
    /// See [`SubBoxes::quantize`].
    pub sub_boxes: SubBoxes,
    /// Lowest and highest material in it.
    pub material_range: [u16; 2],
}

/// Collects what the header and the directory say while blocks are written one after the other. No I/O: the caller leaves
/// [`HEADER_BYTES`] free at the start of the file, writes the stored blocks after them in the order in which they were given to
/// [`ModelWriter::push`], the pages of attributes if there are any ([`ModelWriter::push_page`]), then the tail, and at last the
/// header. Without its header the file does not open.
#[derive(Clone, Debug)]
pub struct ModelWriter {
    precision: Precision,
    limits: BlockLimits,
    codecs: u64,
    bounds: Aabb,
    triangle_count: u64,
    end: u64,
    blocks: Vec<BlockEntry>,
    pages: AttributePages,
}

/// The bytes that complete a compiled file.
#[derive(Clone, Debug)]
pub struct SealedModel {
    /// For the start of the file.
    pub header: [u8; HEADER_BYTES],
    /// For the end of the file, right after the last block or page: directories and materials.
    pub tail: Vec<u8>,
    /// Where the tail goes.
    pub tail_offset: u64,
    /// Length of the whole file.
    pub file_bytes: u64,
}

impl ModelWriter {
    /// An empty model.
    ///
    /// # Errors
    /// [`ModelError::Limit`] if the limits cannot be used.
    pub fn new(precision: Precision, limits: BlockLimits) -> Result<ModelWriter, ModelError> {
        limits.validate().map_err(|reason| ModelError::Limit { reason })?;
        Ok(ModelWriter {
            precision,
            limits,
            codecs: 0,
            bounds: Aabb::EMPTY,
            triangle_count: 0,
            end: HEADER_BYTES as u64,
            blocks: Vec::new(),
            pages: AttributePages::default(),
        })
    }

    /// Memory that a block takes in the writer.
    pub const BYTES_PER_BLOCK: u64 = size_of::<BlockEntry>() as u64;

    /// Makes room for `count` more blocks, and not more.
    pub fn reserve(&mut self, count: usize) {
        self.blocks.reserve_exact(count);
    }

    /// Where the next block, or page of attributes, goes in the file.
    pub fn next_offset(&self) -> u64 {
        self.end
    }

    /// Blocks so far.
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Triangles so far.
    pub fn triangle_count(&self) -> u64 {
        self.triangle_count
    }

    /// Box of the blocks so far.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// Memory that the writer holds, for the memory budget (I1); [`ModelWriter::seal`] takes as much again.
    pub fn resident_bytes(&self) -> Bytes {
        Bytes((self.blocks.capacity() * size_of::<BlockEntry>()) as u64 + self.pages.resident_bytes())
    }

    /// Memory that a page takes in the writer.
    pub const BYTES_PER_PAGE: u64 = size_of::<PageEntry>() as u64;

    /// Makes room for `count` pages more, and not more.
    pub fn reserve_pages(&mut self, count: usize) {
        self.pages.reserve(count);
    }

    /// Takes note of the next page of attributes, which the caller writes at [`ModelWriter::next_offset`] (as it was before), or of
    /// one without any. All blocks must have come; pages come in the order of their triangles.
    ///
    /// # Errors
    /// [`ModelError::Limit`] if the page is not one of this library.
    pub fn push_page(&mut self, stored: &[u8], check: Option<PageCheck>) -> Result<(), ModelError> {
        let limit = |reason| ModelError::Limit { reason };
        if self.pages.entries().len() >= u32::MAX as usize {
            return Err(limit("a file holds at most 2^32 - 1 pages of attributes"));
        }
        let mut entry = PageEntry { offset: self.end, ..PageEntry::default() };
        if let Some(PageCheck { checksum, uv_count, normal_count, .. }) = check {
            let codec = stored.get(1).copied().and_then(Codec::from_id);
            let codec = codec.ok_or(limit("a page was not encoded by this library"))?;
            if codec == Codec::Zstd {
                self.codecs |= FEATURE_ZSTD;
            }
            let stored_bytes = u32::try_from(stored.len()).map_err(|_| limit("a page is too long"))?;
            entry = PageEntry { checksum, stored_bytes, uv_count, normal_count, ..entry };
        }
        self.end += u64::from(entry.stored_bytes);
        self.pages.push(entry);
        Ok(())
    }

    /// Takes note of the next block, which the caller writes at [`ModelWriter::next_offset`] (as it was before).
    ///
    /// # Errors
    /// [`ModelError::Limit`] if the block is not one that the file can hold.
    pub fn push(&mut self, block: &NewBlock<'_>) -> Result<BlockId, ModelError> {
        let limit = |reason| ModelError::Limit { reason };
        let id = u32::try_from(self.blocks.len()).ok().filter(|id| *id < u32::MAX);
        let id = id.ok_or(limit("a file holds at most 2^32 - 1 blocks; choose a larger block size"))?;
        let codec = block.stored.get(1).copied().and_then(Codec::from_id);
        let codec = codec.ok_or(limit("a block was not encoded by this library"))?;
        let entry = BlockEntry {
            offset: self.end,
            stored_bytes: u32::try_from(block.stored.len()).unwrap_or(u32::MAX),
            checksum: checksum(block.stored),
            triangle_count: block.triangle_count,
            vertex_count: block.vertex_count,
            bounds: block.bounds,
            sub_boxes: block.sub_boxes.0,
            material_range: block.material_range,
        };
        // The size of the material table is not known yet; `seal` checks the materials.
        let context = EntryContext { limits: self.limits, bounds: block.bounds, material_count: 1 << 16 };
        entry.fault(self.end, &context).map_err(limit)?;
        if codec == Codec::Zstd {
            self.codecs |= FEATURE_ZSTD;
        }
        self.end += u64::from(entry.stored_bytes);
        self.triangle_count += u64::from(entry.triangle_count);
        self.bounds.merge(&entry.bounds);
        self.blocks.push(entry);
        Ok(BlockId(id))
    }

    /// Completes the file. If `materials` is empty, the default material is written. `compiled`: what the file tells of its compile, if
    /// anything.
    ///
    /// # Errors
    /// [`ModelError::Limit`] if there is no block, there are too many materials, a name is too long, or a block uses a
    /// material that is not in the table.
    pub fn seal(
        self,
        materials: &[MaterialRecord],
        source: SourceRecord,
        compiled: Option<CompileRecord>,
    ) -> Result<SealedModel, ModelError> {
        let limit = |reason| ModelError::Limit { reason };
        if self.blocks.is_empty() {
            return Err(limit("the model has no triangles"));
        }
        let (table, material_count) = table_bytes(materials)?;
        let highest = self.blocks.iter().map(|entry| entry.material_range[1]).max().unwrap_or(0);
        if u32::from(highest) >= material_count {
            return Err(limit("a block uses a material that is not in the table"));
        }

        let mut tail = Vec::with_capacity(self.blocks.len() * ENTRY_BYTES);
        for entry in &self.blocks {
            entry.put(&mut tail);
        }
        let directory_bytes = tail.len();
        tail.extend_from_slice(&table);
        let section = |start: usize, end: usize| Section {
            offset: self.end + start as u64,
            bytes: (end - start) as u64,
            checksum: checksum(&tail[start..end]),
        };
        let materials_end = tail.len();
        let (directory, materials_section) =
            (section(0, directory_bytes), section(directory_bytes, materials_end));
        for entry in self.pages.entries() {
            entry.put(&mut tail);
        }
        let pages = Section {
            offset: self.end + materials_end as u64,
            bytes: (tail.len() - materials_end) as u64,
            checksum: checksum(&tail[materials_end..]),
        };
        // `push_page` keeps the count below 2^32.
        let attributes = (!self.pages.is_empty()).then_some((pages, self.pages.entries().len() as u32));
        let pages_end = tail.len();
        tail.extend_from_slice(&super::images::table_bytes(materials)?);
        let images = (tail.len() > pages_end).then(|| Section {
            offset: self.end + pages_end as u64,
            bytes: (tail.len() - pages_end) as u64,
            checksum: checksum(&tail[pages_end..]),
        });
        let materials = materials_section;
        let file_bytes = self.end + tail.len() as u64;
        let mut features = self.codecs;
        if attributes.is_some() {
            features |= FEATURE_ATTRIBUTES;
        }
        if images.is_some() {
            features |= FEATURE_IMAGES;
        }
        if compiled.is_some() {
            features |= FEATURE_RECORD;
        }
        let header = Header {
            features,
            precision: self.precision,
            limits: self.limits,
            bounds: self.bounds,
            triangle_count: self.triangle_count,
            // `push` keeps the count below 2^32.
            block_count: self.blocks.len() as u32,
            material_count,
            directory,
            materials,
            source,
            attributes,
            images,
            compiled,
        };
        Ok(SealedModel { header: header.to_bytes(), tail_offset: self.end, file_bytes, tail })
    }
}

const _: () = assert!(size_of::<BlockEntry>() <= ENTRY_BYTES && SUB_BOX_COUNT == 8);
