//! The block directory.

use super::SubBoxes;
use super::header::HEADER_BYTES;
use crate::block::{BLOCK_HEADER_BYTES, BlockCheck, BlockLimits, stored_bytes_max};
use crate::error::ModelError;
use crate::geom::Aabb;
use crate::units::BlockId;

/// How many sub-boxes an entry holds.
pub const SUB_BOX_COUNT: usize = 8;

/// Bytes of an entry in the file.
pub(super) const ENTRY_BYTES: usize = 128;

/// What the directory says about one block.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockEntry {
    /// Where the block starts in the file.
    pub offset: u64,
    /// Its length in the file.
    pub stored_bytes: u32,
    /// XXH3-64 of its stored bytes.
    pub checksum: u64,
    /// Triangles in it; at least 1.
    pub triangle_count: u32,
    /// Distinct vertices in it.
    pub vertex_count: u32,
    /// Tight box of its triangles, exact.
    pub bounds: Aabb,
    /// Up to eight boxes that together hold its triangles, as [`SubBoxes`] has them. Lets a ray pass a block by
    /// without loading it.
    pub sub_boxes: [[u8; 6]; SUB_BOX_COUNT],
    /// Lowest and highest material index in the block.
    pub material_range: [u16; 2],
}

/// Reads little-endian numbers one after the other; the caller has checked that there are enough bytes.
pub(super) struct Fields<'a>(pub &'a [u8]);

impl Fields<'_> {
    pub fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut field = [0; N];
        let (head, rest) = self.0.split_at(N);
        field.copy_from_slice(head);
        self.0 = rest;
        field
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    pub fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }

    pub fn u64(&mut self) -> u64 {
        u64::from_le_bytes(self.take())
    }

    pub fn f32(&mut self) -> f32 {
        f32::from_le_bytes(self.take())
    }

    pub fn f64(&mut self) -> f64 {
        f64::from_le_bytes(self.take())
    }

    pub fn aabb(&mut self) -> Aabb {
        Aabb { min: [(); 3].map(|()| self.f64()), max: [(); 3].map(|()| self.f64()) }
    }
}

/// Whether a box is one that triangles can have: finite and not inside out.
pub(super) fn is_sound(bounds: &Aabb) -> bool {
    bounds.min.iter().chain(&bounds.max).all(|x| x.is_finite()) && !bounds.is_empty()
}

pub(super) fn put_aabb(bounds: &Aabb, out: &mut Vec<u8>) {
    out.extend(bounds.min.iter().chain(&bounds.max).flat_map(|x| x.to_le_bytes()));
}

/// What an entry is checked against.
#[derive(Clone, Copy)]
pub(super) struct EntryContext {
    pub limits: BlockLimits,
    pub bounds: Aabb,
    pub material_count: u32,
}

impl BlockEntry {
    /// What the entry promises, for [`crate::block::decode`].
    pub fn check(&self, block: BlockId) -> BlockCheck {
        BlockCheck {
            block,
            checksum: self.checksum,
            triangle_count: self.triangle_count,
            vertex_count: self.vertex_count,
            material_range: self.material_range,
        }
    }

    /// The sub-boxes in use, each holding the triangles that it was made for; together they hold the whole block. If
    /// the entry has none, the bounds are the only one.
    pub fn sub_boxes(&self) -> impl Iterator<Item = Aabb> + use<> {
        let mut boxes = SubBoxes(self.sub_boxes).decode(&self.bounds).peekable();
        let whole = boxes.peek().is_none().then_some(self.bounds);
        boxes.chain(whole)
    }

    pub(super) fn put(&self, out: &mut Vec<u8>) {
        let start = out.len();
        out.extend_from_slice(&self.offset.to_le_bytes());
        out.extend_from_slice(&self.checksum.to_le_bytes());
        out.extend_from_slice(&self.stored_bytes.to_le_bytes());
        out.extend_from_slice(&self.triangle_count.to_le_bytes());
        out.extend_from_slice(&self.vertex_count.to_le_bytes());
        out.extend(self.material_range.iter().flat_map(|material| material.to_le_bytes()));
        put_aabb(&self.bounds, out);
        out.extend_from_slice(self.sub_boxes.as_flattened());
        debug_assert_eq!(out.len() - start, ENTRY_BYTES);
    }

    pub(super) fn get(bytes: &[u8; ENTRY_BYTES]) -> BlockEntry {
        let mut fields = Fields(bytes);
        let (offset, checksum) = (fields.u64(), fields.u64());
        let (stored_bytes, triangle_count, vertex_count) = (fields.u32(), fields.u32(), fields.u32());
        let material_range = [fields.u16(), fields.u16()];
        let bounds = fields.aabb();
        let sub_boxes = [(); SUB_BOX_COUNT].map(|()| fields.take());
        BlockEntry {
            offset,
            stored_bytes,
            checksum,
            triangle_count,
            vertex_count,
            bounds,
            sub_boxes,
            material_range,
        }
    }

    /// Why the entry cannot be right, if it cannot. Blocks follow each other without gaps, so that no two overlap and
    /// every byte of the file is under a checksum.
    pub(super) fn fault(&self, offset: u64, context: &EntryContext) -> Result<(), &'static str> {
        let require = |holds: bool, reason| if holds { Ok(()) } else { Err(reason) };
        let (triangles, vertices) = (self.triangle_count as usize, self.vertex_count as usize);
        let stored = self.stored_bytes as usize;
        require(self.offset == offset, "a block does not start where the one before it ends")?;
        require(
            (BLOCK_HEADER_BYTES..=stored_bytes_max(context.limits)).contains(&stored),
            "a block has an impossible length",
        )?;
        require(triangles >= 1 && vertices >= 1, "a block is empty")?;
        require(
            context.limits.fits(vertices, triangles, false),
            "a block holds more than the block size of the file",
        )?;
        require(vertices <= 3 * triangles, "a block has more vertices than its triangles can use")?;
        require(
            self.material_range[0] <= self.material_range[1]
                && u32::from(self.material_range[1]) < context.material_count,
            "a block uses materials that are not in the table",
        )?;
        require(
            is_sound(&self.bounds) && context.bounds.contains(&self.bounds),
            "the box of a block is not inside the box of the model",
        )
    }
}

/// Parses entries as they come and checks each against those before it.
pub(super) struct DirectoryReader {
    context: EntryContext,
    next_offset: u64,
    triangle_count: u64,
    bounds: Aabb,
}

impl DirectoryReader {
    pub fn new(context: EntryContext) -> DirectoryReader {
        DirectoryReader { context, next_offset: HEADER_BYTES as u64, triangle_count: 0, bounds: Aabb::EMPTY }
    }

    /// Parses whole entries that start at `offset` of the file.
    pub fn parse(
        &mut self,
        bytes: &[u8],
        offset: u64,
        blocks: &mut Vec<BlockEntry>,
    ) -> Result<(), ModelError> {
        for (index, bytes) in bytes.as_chunks::<ENTRY_BYTES>().0.iter().enumerate() {
            let entry = BlockEntry::get(bytes);
            entry.fault(self.next_offset, &self.context).map_err(|reason| ModelError::Damaged {
                part: "directory",
                offset: offset + (index * ENTRY_BYTES) as u64,
                reason,
            })?;
            self.next_offset += u64::from(entry.stored_bytes);
            self.triangle_count += u64::from(entry.triangle_count);
            self.bounds.merge(&entry.bounds);
            blocks.push(entry);
        }
        Ok(())
    }

    /// Where the last block ends.
    pub fn end(&self) -> u64 {
        self.next_offset
    }

    /// Checks the sums over all entries against the header.
    pub fn finish(self, blocks_end: u64, triangle_count: u64) -> Result<(), &'static str> {
        if self.next_offset != blocks_end {
            Err("the blocks do not end where the directory starts")
        } else if self.triangle_count != triangle_count {
            Err("the blocks do not have the number of triangles of the header")
        } else if self.bounds != self.context.bounds {
            Err("the boxes of the blocks do not make up the box of the model")
        } else {
            Ok(())
        }
    }
}
