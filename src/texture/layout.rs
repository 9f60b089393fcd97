//! Names of pictures, and how many tiles one has and in which order.

use std::path::PathBuf;

/// Side of a tile in texels.
pub const TILE_SIDE: u32 = 64;

/// Bytes of a tile: four for each texel.
pub(super) const TILE_BYTES: usize = (TILE_SIDE * TILE_SIDE * 4) as usize;

/// Longest side of a picture.
pub(super) const SIDE_MAX: u32 = 1 << 16;

/// A picture of [`Textures`](super::Textures), by its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TextureId(pub u32);

/// What the bytes of a picture mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Encoding {
    /// Colours in sRGB; alpha is linear.
    Srgb,
    /// Numbers from 0 to 1.
    Linear,
}

/// A picture as materials name it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ImageKey {
    /// The image file.
    pub path: PathBuf,
    /// What its bytes mean.
    pub encoding: Encoding,
}

/// One picture among the tiles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Image {
    pub key: ImageKey,
    pub width: u32,
    pub height: u32,
    pub first_tile: u32,
    /// Whether any texel is not opaque.
    pub has_alpha: bool,
    /// The least and the greatest byte of each channel.
    pub extremes: [[u8; 4]; 2],
}

/// One size of a picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Level {
    pub width: u32,
    pub height: u32,
    pub first_tile: u32,
}

impl Level {
    pub fn tiles_across(self) -> u32 {
        self.width.div_ceil(TILE_SIDE)
    }

    pub fn tile_count(self) -> u32 {
        // Sides are at most 65,536, so at most 2^20 tiles.
        self.tiles_across() * self.height.div_ceil(TILE_SIDE)
    }
}

/// The sizes of a picture, from its own down to one texel; halved and rounded up.
pub(super) fn levels(width: u32, height: u32, first_tile: u32) -> impl Iterator<Item = Level> + Clone {
    let first = Level { width, height, first_tile };
    std::iter::successors(Some(first), |level| {
        let next = Level {
            width: level.width.div_ceil(2),
            height: level.height.div_ceil(2),
            first_tile: level.first_tile + level.tile_count(),
        };
        (level.width > 1 || level.height > 1).then_some(next)
    })
}

/// Tiles of a picture.
pub(super) fn tile_count(width: u32, height: u32) -> u32 {
    levels(width, height, 0).map(Level::tile_count).sum()
}
