//! Cells: parts of a model of which all is known but how they are cut into blocks.

use crate::block::BlockLimits;
use crate::geom::Aabb;
use crate::units::{BlockId, Bytes, CellId};

/// Blocks are numbered cell by cell, each cell beginning at a multiple of this, so that a table finds the cell of a block.
const PAGE_SHIFT: u32 = 4;

/// A cell of a model that is compiled lazily.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CellEntry {
    /// Tight box of its triangles, exact.
    pub bounds: Aabb,
    /// Triangles in it; at least 1.
    pub triangle_count: u32,
    /// Lowest and highest material in it.
    pub material_range: [u16; 2],
    /// Number of its first block.
    pub first_block: BlockId,
    /// Most blocks that it can be cut into: as many numbers are its own.
    pub block_count_max: u32,
    /// About how many it will be cut into.
    pub block_count_expected: u32,
}

impl CellEntry {
    /// So few triangles fit a block of any form whatever their vertices are.
    pub(crate) fn triangles_that_always_fit(limits: BlockLimits) -> usize {
        // Three vertices of 24 bytes and 10 bytes each; less than a 46th of the block, so the vertices are not too many.
        (limits.block_bytes_max as usize / (3 * 24 + 10)).max(1)
    }
}

/// The cells of a model, none for a compiled file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cells {
    entries: Vec<CellEntry>,
    /// The cell of each run of `1 << PAGE_SHIFT` block numbers.
    cell_of_page: Vec<u32>,
}

impl Cells {
    /// Cells of these boxes, numbers of triangles and of vertices, and materials; gives block numbers to them. `None` if there are not
    /// enough.
    pub(crate) fn new(
        cells: impl Iterator<Item = (Aabb, [u32; 2], [u16; 2])>,
        limits: BlockLimits,
    ) -> Option<Cells> {
        let per_block = CellEntry::triangles_that_always_fit(limits) as u32;
        let mut into = Cells::default();
        // Blocks are about two thirds full.
        let block_bytes = (limits.block_bytes_max as usize * 2 / 3).max(1);
        for (bounds, [triangle_count, vertex_count], material_range) in cells {
            let pages = (triangle_count / per_block + 1).div_ceil(1 << PAGE_SHIFT);
            let first_block = u32::try_from(into.cell_of_page.len()).ok()?.checked_mul(1 << PAGE_SHIFT)?;
            // A number of 31 bits, so that trees can tell blocks from nodes, and cells have room above.
            if u64::from(first_block) + (u64::from(pages) << PAGE_SHIFT) >= 1 << 30 {
                return None;
            }
            let cell = into.entries.len() as u32;
            into.cell_of_page.resize(into.cell_of_page.len() + pages as usize, cell);
            let block_count_max = pages << PAGE_SHIFT;
            let first_block = BlockId(first_block);
            let bytes = BlockLimits::decoded_bytes(vertex_count as usize, triangle_count as usize, false);
            let expected = bytes.div_ceil(block_bytes).max(1) as u32;
            into.entries.push(CellEntry {
                bounds,
                triangle_count,
                material_range,
                first_block,
                block_count_max,
                block_count_expected: expected.min(block_count_max),
            });
        }
        Some(into)
    }

    /// Whether there are none, as in a compiled file.
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// About how many blocks there will be.
    pub fn block_count_expected(&self) -> u32 {
        // Each is at most its share of the numbers.
        self.entries.iter().map(|cell| cell.block_count_expected).sum()
    }

    /// All of them, by number.
    pub fn entries(&self) -> &[CellEntry] {
        &self.entries
    }

    /// One of them.
    pub fn get(&self, cell: CellId) -> Option<&CellEntry> {
        self.entries.get(cell.0 as usize)
    }

    /// How many block numbers the cells have together.
    pub fn block_id_count(&self) -> u32 {
        // `new` saw to it.
        (self.cell_of_page.len() << PAGE_SHIFT) as u32
    }

    /// The cell that a block number belongs to, and which of its blocks it would be.
    pub fn cell_of(&self, block: BlockId) -> Option<(CellId, usize)> {
        let cell = *self.cell_of_page.get((block.0 >> PAGE_SHIFT) as usize)?;
        let first = self.entries[cell as usize].first_block;
        Some((CellId(cell), (block.0 - first.0) as usize))
    }

    /// Memory that they take.
    pub fn resident_bytes(&self) -> Bytes {
        Bytes((self.entries.capacity() * size_of::<CellEntry>() + self.cell_of_page.capacity() * 4) as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_number_belongs_to_one_cell() {
        let limits = BlockLimits { block_bytes_max: 4096 };
        let counts = [1, 10_000, 49, 50, 131_072];
        let known = counts.iter().map(|&count| (Aabb::EMPTY, [count, count], [0, 0]));
        let cells = Cells::new(known, limits).unwrap();
        let mut next = 0;
        for (index, (cell, count)) in (0..).zip(cells.entries().iter().zip(counts)) {
            assert_eq!(cell.first_block.0, next);
            let fits = CellEntry::triangles_that_always_fit(limits) as u32;
            assert!(limits.fits(3 * fits as usize, fits as usize, true));
            assert!(cell.block_count_max >= count.div_ceil(fits));
            for local in [0, cell.block_count_max - 1] {
                assert_eq!(cells.cell_of(BlockId(next + local)), Some((CellId(index), local as usize)));
            }
            next += cell.block_count_max;
        }
        assert_eq!(cells.block_id_count(), next);
        assert_eq!(cells.cell_of(BlockId(next)), None);
        let huge = std::iter::repeat_n((Aabb::EMPTY, [1 << 17, 1 << 17], [0, 0]), 1 << 19);
        assert_eq!(Cells::new(huge, limits), None);
    }
}
