//! Pixels of cells as they travel, and the picture that the coordinator puts together from them.

use crate::budget::MemoryBudget;
use crate::error::BudgetError;
use crate::render::{Canvas, Film};
use crate::schedule::{ImageGrid, TileCells};
use crate::units::TileId;

const PIXEL_BYTES: usize = 12;

/// Appends pixels as they travel: three little-endian f32 each.
pub(super) fn put_pixels(pixels: impl IntoIterator<Item = [f32; 3]>, into: &mut Vec<u8>) {
    into.extend(pixels.into_iter().flatten().flat_map(f32::to_le_bytes));
}

/// Reads what [`put_pixels`] wrote; bytes at the end that make no pixel are left out.
fn take_pixels(bytes: &[u8]) -> Vec<[f32; 3]> {
    let number = |bytes: &[u8]| {
        let mut four = [0; 4];
        four.copy_from_slice(bytes);
        f32::from_le_bytes(four)
    };
    bytes.chunks_exact(PIXEL_BYTES).map(|pixel| [0, 4, 8].map(|at| number(&pixel[at..at + 4]))).collect()
}

/// The picture at the coordinator: pixels, and who rendered which cell.
pub(super) struct Picture {
    canvas: Canvas,
    grid: ImageGrid,
    /// By cell along the curve: the number of the lane that rendered it.
    owners: Vec<Option<u32>>,
}

impl Picture {
    pub fn new(grid: ImageGrid, budget: &MemoryBudget) -> Result<Picture, BudgetError> {
        let canvas = Canvas::new(grid.width(), grid.height(), budget)?;
        let cells = grid.tile_count() as usize * grid.cells_per_tile() as usize;
        Ok(Picture { canvas, owners: vec![None; cells], grid })
    }

    /// Whether `bytes` are the pixels of just these cells.
    pub fn fits(&self, cells: TileCells, bytes: &[u8]) -> bool {
        let exists = self.grid.cells_of(cells.tile);
        let is_there = cells.tile.0 < self.grid.tile_count() && cells.cells & !exists == 0;
        is_there && self.grid.pixels(cells) * PIXEL_BYTES as u64 == bytes.len() as u64
    }

    /// Takes over the cells `fresh` of those that `bytes` hold, and gives the bytes of these alone. `bytes` must fit `cells`.
    pub fn take(&mut self, cells: TileCells, bytes: &[u8], fresh: u64, owner: u32) -> Vec<u8> {
        let mut kept = Vec::new();
        let mut rest = bytes;
        for (cell, region) in self.grid.squares(cells, 1) {
            let length = (region.pixels() as usize * PIXEL_BYTES).min(rest.len());
            let (pixels, tail) = rest.split_at(length);
            rest = tail;
            if cell.cells & fresh != 0 {
                self.canvas.set(region, &take_pixels(pixels));
                kept.extend_from_slice(pixels);
                let index = cells.tile.0 as usize * self.grid.cells_per_tile() as usize;
                self.owners[index + cell.cells.trailing_zeros() as usize] = Some(owner);
            }
        }
        kept
    }

    pub fn film(&self) -> &Film {
        self.canvas.film()
    }

    pub fn into_film(self) -> Film {
        self.canvas.into_film()
    }

    /// The picture in the colours of those who rendered it.
    pub fn map(&self, colour: impl Fn(u32) -> [f32; 3], budget: &MemoryBudget) -> Result<Film, BudgetError> {
        let mut map = Canvas::new(self.grid.width(), self.grid.height(), budget)?;
        for tile in (0..self.grid.tile_count()).map(TileId) {
            for (cell, region) in self.grid.squares(TileCells { tile, cells: u64::MAX }, 1) {
                let index = tile.0 as usize * self.grid.cells_per_tile() as usize;
                let owner = self.owners[index + cell.cells.trailing_zeros() as usize];
                let colour = owner.map_or([0.0; 3], &colour);
                let rows = region.y..region.y + region.height;
                let pixels: Vec<[f32; 3]> = rows
                    .flat_map(|y| (region.x..region.x + region.width).map(move |x| (x, y)))
                    .map(|(x, y)| {
                        let [r, g, b] = self.film().pixel(x, y);
                        // Bright enough to show the colour, contrast enough to show the picture.
                        let luminance = (0.2126 * r + 0.7152 * g + 0.0722 * b).clamp(0.0, 1.0);
                        let brightness = 0.15 + 1.05 * luminance.sqrt();
                        colour.map(|channel| channel * brightness)
                    })
                    .collect();
                map.set(region, &pixels);
            }
        }
        Ok(map.into_film())
    }

    pub fn owners(&self) -> &[Option<u32>] {
        &self.owners
    }
}
