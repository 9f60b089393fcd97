//! The image in tiles, tiles in cells, all along one Hilbert curve.

use std::sync::Arc;

use crate::error::ScheduleError;
pub use crate::render::Region;
use crate::render::tiles::{TileGrid, hilbert_index};
use crate::units::TileId;

/// Some of the cells of one tile: bit k is the k-th cell of the tile along the curve.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TileCells {
    /// The tile.
    pub tile: TileId,
    /// The set of cells.
    pub cells: u64,
}

impl TileCells {
    /// How many cells there are.
    pub fn count(&self) -> u32 {
        self.cells.count_ones()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.cells == 0
    }
}

/// An image in square tiles, each of 1, 4, 16 or 64 square cells. A cell is the smallest part of the image that is handed
/// out, finished or remembered; tiles and cells at the right and lower border hold fewer pixels or are missing.
///
/// Tiles are numbered along a Hilbert curve through the image, cells of a tile along the same curve, so that
/// `tile * cells_per_tile + cell` grows along one curve through all cells: neighbours in number are neighbours in the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageGrid {
    width: u32,
    height: u32,
    tile_side: u32,
    cell_side: u32,
    columns: u32,
    /// The place of each tile, counted row by row.
    places: Arc<[u32]>,
}

/// More tiles would be too many to keep books on.
const TILES_MAX: u64 = 1 << 22;

impl ImageGrid {
    /// The grid of an image of `width` by `height` pixels with tiles of `tile_side` and cells of `cell_side` pixels a side.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] if a side is 0, if `tile_side` is not 1, 2, 4 or 8 times `cell_side`, or beyond 2^22 tiles.
    pub fn new(width: u32, height: u32, tile_side: u32, cell_side: u32) -> Result<ImageGrid, ScheduleError> {
        let error = |what, reason| Err(ScheduleError::Option { what, reason });
        if width == 0 || height == 0 {
            return error("image size", "there must be at least one pixel");
        }
        if cell_side == 0 || ![1, 2, 4, 8].iter().any(|n| Some(tile_side) == cell_side.checked_mul(*n)) {
            return error("tile size", "a tile's side must be 1, 2, 4 or 8 times the side of its cells");
        }
        let (columns, rows) = (width.div_ceil(tile_side), height.div_ceil(tile_side));
        if u64::from(columns) * u64::from(rows) > TILES_MAX {
            return error("tile size", "the image would have more than 2^22 tiles: take larger ones");
        }
        let places = TileGrid { width, height, tile_size: tile_side }.hilbert_order().into();
        Ok(ImageGrid { width, height, tile_side, cell_side, columns, places })
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Side of a tile in pixels.
    pub fn tile_side(&self) -> u32 {
        self.tile_side
    }

    /// Side of a cell in pixels.
    pub fn cell_side(&self) -> u32 {
        self.cell_side
    }

    /// How many tiles there are.
    pub fn tile_count(&self) -> u32 {
        self.places.len() as u32
    }

    /// Cells of a whole tile: 1, 4, 16 or 64.
    pub fn cells_per_tile(&self) -> u32 {
        (self.tile_side / self.cell_side).pow(2)
    }

    /// Column and row of a tile, counted in tiles. `tile` must be below [`ImageGrid::tile_count`].
    pub(crate) fn place(&self, tile: TileId) -> [u32; 2] {
        let place = self.places[tile.0 as usize];
        [place % self.columns, place / self.columns]
    }

    /// Tiles across and down.
    pub(crate) fn sides(&self) -> [u32; 2] {
        [self.columns, self.height.div_ceil(self.tile_side)]
    }

    /// Side of the square that the curve fills, in tiles.
    fn curve_side(&self) -> u32 {
        self.sides()[0].max(self.sides()[1]).next_power_of_two()
    }

    /// The cells of `tile` that lie in the image. None for a tile that does not exist.
    pub fn cells_of(&self, tile: TileId) -> u64 {
        let Some(region) = self.tile_region(tile) else { return 0 };
        let count = self.cells_per_tile();
        let all = ones(0, count);
        if region.width == self.tile_side && region.height == self.tile_side {
            return all;
        }
        (0..count).filter(|cell| self.square(tile, *cell, 1).is_some()).fold(0, |set, cell| set | 1 << cell)
    }

    /// The pixels of a tile, if it exists.
    pub fn tile_region(&self, tile: TileId) -> Option<Region> {
        (tile.0 < self.tile_count()).then(|| self.square(tile, 0, self.cells_per_tile())).flatten()
    }

    /// The pixels of the `count` cells from `cell` on: a square if both are a power of four and a multiple of it.
    fn square(&self, tile: TileId, cell: u32, count: u32) -> Option<Region> {
        let [column, row] = self.place(tile);
        let index = hilbert_index(self.curve_side(), column, row) * u64::from(self.cells_per_tile());
        let blocks = (index + u64::from(cell)) / u64::from(count);
        let side = count.isqrt() * self.cell_side;
        let blocks_across = self.curve_side() * (self.tile_side / side);
        let [x, y] = hilbert_place(blocks_across, blocks).map(|place| u64::from(place) * u64::from(side));
        let (x, y) = (u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        (x < self.width && y < self.height).then(|| Region {
            x,
            y,
            width: side.min(self.width - x),
            height: side.min(self.height - y),
        })
    }

    /// Cuts a set of cells into squares of at most `cells_max` cells each, in the order of the curve: what a worker renders one after
    /// the other. Cells that do not exist are left out.
    pub fn squares(&self, cells: TileCells, cells_max: u32) -> Vec<(TileCells, Region)> {
        let exists = self.cells_of(cells.tile);
        let wanted = cells.cells & exists;
        let mut squares = Vec::new();
        let mut cell = 0;
        while cell < self.cells_per_tile() {
            let mut count = 64;
            let is_whole = |count| {
                let block = ones(cell, count) & exists;
                cell % count == 0 && count <= self.cells_per_tile() && block != 0 && block & !wanted == 0
            };
            while count > 1 && (count > cells_max || !is_whole(count)) {
                count /= 4;
            }
            if is_whole(count)
                && let Some(region) = self.square(cells.tile, cell, count)
            {
                let cells = TileCells { tile: cells.tile, cells: ones(cell, count) & exists };
                squares.push((cells, region));
            }
            cell += count;
        }
        squares
    }

    /// How many pixels a set of cells holds.
    pub fn pixels(&self, cells: TileCells) -> u64 {
        self.squares(cells, 64).iter().map(|(_, region)| region.pixels()).sum()
    }
}

/// `count` bits from `start` on; both at most 64.
pub(crate) fn ones(start: u32, count: u32) -> u64 {
    let bits = u64::MAX.checked_shr(64 - count).unwrap_or(0);
    bits.checked_shl(start).unwrap_or(0)
}

/// The inverse of [`hilbert_index`]: column and row of the cell number `index` of a square of `side` (a power of two) cells.
fn hilbert_place(side: u32, index: u64) -> [u32; 2] {
    let (mut x, mut y) = (0, 0);
    let mut rest = index;
    // From the smallest quadrant to the largest.
    let mut half = 1;
    while half < side {
        let digit = (rest & 3) as u32;
        let right = digit >> 1;
        let lower = (digit ^ right) & 1;
        if lower == 0 {
            if right == 1 {
                x = half - 1 - x;
                y = half - 1 - y;
            }
            std::mem::swap(&mut x, &mut y);
        }
        x += half * right;
        y += half * lower;
        rest >>= 2;
        half *= 2;
    }
    [x, y]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_the_inverse_of_indices() {
        for side in [1, 2, 4, 8, 16, 32] {
            for index in 0..u64::from(side * side) {
                let [x, y] = hilbert_place(side, index);
                assert_eq!(hilbert_index(side, x, y), index, "{side}");
            }
        }
    }

    #[test]
    fn every_pixel_lies_in_one_cell() {
        for (width, height, tile, cell) in [
            (1, 1, 64, 8),
            (100, 37, 16, 8),
            (130, 70, 64, 8),
            (65, 9, 8, 8),
            (31, 200, 12, 3),
            (40, 3, 8, 1),
        ] {
            let grid = ImageGrid::new(width, height, tile, cell).unwrap();
            for cells_max in [1, 4, 5, 64] {
                let mut seen = vec![0u8; (width * height) as usize];
                for tile in (0..grid.tile_count()).map(TileId) {
                    let whole = TileCells { tile, cells: grid.cells_of(tile) };
                    let mut cells = 0;
                    for (part, region) in grid.squares(TileCells { tile, cells: !0 }, cells_max) {
                        assert_eq!(cells & part.cells, 0);
                        assert!(part.count() <= cells_max);
                        assert_eq!(grid.pixels(part), region.pixels());
                        cells |= part.cells;
                        for y in region.y..region.y + region.height {
                            for x in region.x..region.x + region.width {
                                seen[(y * width + x) as usize] += 1;
                            }
                        }
                    }
                    assert_eq!(cells, whole.cells);
                    assert_eq!(grid.pixels(whole), grid.tile_region(tile).unwrap().pixels());
                }
                assert!(seen.iter().all(|count| *count == 1), "{width} x {height} / {tile} / {cell}");
            }
            assert_eq!(grid.cells_of(TileId(grid.tile_count())), 0);
        }
    }

    #[test]
    fn cells_in_number_are_neighbours_in_the_image() {
        let grid = ImageGrid::new(256, 256, 64, 8).unwrap();
        let cells = (0..16).flat_map(|tile| (0..64).map(move |cell| (TileId(tile), cell)));
        let places: Vec<Region> = cells.map(|(tile, cell)| grid.square(tile, cell, 1).unwrap()).collect();
        for pair in places.windows(2) {
            assert_eq!(pair[0].x.abs_diff(pair[1].x) + pair[0].y.abs_diff(pair[1].y), 8);
        }
    }

    #[test]
    fn sides_that_make_no_sense_are_refused() {
        for (width, height, tile, cell) in
            [(0, 1, 8, 8), (1, 0, 8, 8), (9, 9, 0, 0), (9, 9, 24, 8), (9, 9, 8, 16), (1 << 20, 1 << 20, 8, 8)]
        {
            assert!(ImageGrid::new(width, height, tile, cell).is_err());
        }
    }
}
