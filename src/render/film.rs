//! The picture in memory: linear RGB, and which tiles of it are finished.

use std::path::Path;

use super::image;
use super::tiles::TileGrid;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, RenderError};
use crate::units::Bytes;

/// A picture of linear RGB radiance, rows from the top. Drawn from the memory budget until dropped.
#[derive(Debug)]
pub struct Film {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    tile_size: u32,
    finished: Vec<bool>,
    _reservation: Reservation,
}

impl Film {
    /// A black film with no tile finished.
    ///
    /// # Errors
    /// [`BudgetError`] if the budget cannot hold it.
    pub(crate) fn new(grid: &TileGrid, budget: &MemoryBudget) -> Result<Film, BudgetError> {
        let pixel_count = grid.width as usize * grid.height as usize;
        let bytes = Film::bytes_needed(grid);
        let reservation = budget.reserve(bytes, "the film")?;
        Ok(Film {
            width: grid.width,
            height: grid.height,
            pixels: vec![[0.0; 3]; pixel_count],
            tile_size: grid.tile_size,
            finished: vec![false; grid.tile_count()],
            _reservation: reservation,
        })
    }

    /// What [`Film::new`] takes from the budget.
    pub(crate) fn bytes_needed(grid: &TileGrid) -> Bytes {
        let pixel_count = u64::from(grid.width) * u64::from(grid.height);
        Bytes(pixel_count * size_of::<[f32; 3]>() as u64 + grid.tile_count() as u64)
    }

    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row by row from the top. Those of unfinished tiles are black.
    pub fn pixels(&self) -> &[[f32; 3]] {
        &self.pixels
    }

    /// One row, counted from the top.
    ///
    /// # Panics
    /// If `y` is not below the height.
    pub fn row(&self, y: u32) -> &[[f32; 3]] {
        let width = self.width as usize;
        &self.pixels[y as usize * width..][..width]
    }

    /// One pixel.
    ///
    /// # Panics
    /// If it lies outside the film.
    pub fn pixel(&self, x: u32, y: u32) -> [f32; 3] {
        self.row(y)[x as usize]
    }

    /// Whether the tile that holds the pixel was rendered to its end.
    ///
    /// # Panics
    /// If the pixel lies outside the film.
    pub fn is_finished(&self, x: u32, y: u32) -> bool {
        assert!(x < self.width && y < self.height, "pixel ({x}, {y}) lies outside the film");
        let columns = self.width.div_ceil(self.tile_size);
        self.finished[((y / self.tile_size) * columns + x / self.tile_size) as usize]
    }

    /// Whether every tile was.
    pub fn is_complete(&self) -> bool {
        self.finished.iter().all(|finished| *finished)
    }

    /// Writes the picture as PNG, OpenEXR or PFM by the extension of `path`. The file appears under its name only
    /// when it is whole; a failure leaves an existing file as it was.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for an extension that names no format of this build, [`RenderError::Write`] if the
    /// file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), RenderError> {
        image::write(self, path)
    }

    /// Takes over the pixels of a finished tile, given row by row.
    pub(crate) fn set_tile(&mut self, grid: &TileGrid, cell: u32, pixels: &[[f32; 3]]) {
        let area = grid.area(cell);
        for (row, source) in pixels.chunks_exact(area.width as usize).enumerate() {
            let start = (area.y as usize + row) * self.width as usize + area.x as usize;
            self.pixels[start..][..source.len()].copy_from_slice(source);
        }
        self.finished[cell as usize] = true;
    }
}
