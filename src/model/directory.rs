//! The block directory.

use crate::geom::Aabb;

/// How many sub-boxes an entry holds.
pub const SUB_BOX_COUNT: usize = 8;

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
    /// Up to eight boxes that together hold its triangles, in 256ths of `bounds`, rounded outward:
    /// `min x, y, z, max x, y, z`. A box with min > max is unused. Lets a ray pass a block by without loading it.
    pub sub_boxes: [[u8; 6]; SUB_BOX_COUNT],
    /// Lowest and highest material index in the block.
    pub material_range: [u16; 2],
}
