//! The picture in memory: linear RGB, and which tiles of it are finished.

use std::path::Path;

use glam::DVec3;

use super::image;
use super::settings::RenderSettings;
use super::tiles::TileGrid;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, RenderError};
use crate::stats::TraceCounters;
use crate::units::Bytes;

/// What the samples of a pixel say about its error; see [`RenderSettings::keep_statistics`](super::RenderSettings::keep_statistics).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PixelStatistics {
    /// Samples taken.
    pub samples: u32,
    /// Standard deviation of the mean, in the channel where it is greatest. An estimate on the safe side, from how blocks of samples differ
    /// and, with adaptive sampling, from the contrast with the neighbours; infinite for a single sample.
    pub deviation: f32,
    /// Half of the difference between the means of the first and of the second half of the samples: in distribution like the error of the
    /// pixel, a little too large for samples that are stratified. Zero for a single sample.
    pub half_difference: [f32; 3],
    /// The most that any channel may lack because rays and lamps were cut off. Proven, against ray trees of at most
    /// [`work_budget`](super::RenderSettings::work_budget) rays in which nothing is cut.
    pub lost: f32,
    /// How far the mean of its first samples lay outside of the range of its neighbours' means, and how far their samples lie apart, after
    /// [`Around`](super::around::Around); 0 unless sampling is adaptive.
    pub(crate) stands_out: f32,
    pub(crate) surround: f32,
}

impl PixelStatistics {
    /// Of a pixel without samples.
    pub(crate) const NONE: PixelStatistics = PixelStatistics {
        samples: 0,
        deviation: f32::INFINITY,
        half_difference: [0.0; 3],
        lost: 0.0,
        stands_out: 0.0,
        surround: 0.0,
    };
}

/// What tracing the samples of a pixel took, all its rays together: tests of what was looked at, whatever was in memory. At most
/// `u32::MAX` is counted. See [`RenderSettings::keep_costs`](super::RenderSettings::keep_costs).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelCost {
    /// Nodes visited, one 8-wide box test each ([`TraceCounters::box_tests`](crate::stats::TraceCounters::box_tests)).
    pub box_tests: u32,
    /// Triangles given to the reject test ([`TraceCounters::triangle_tests`](crate::stats::TraceCounters::triangle_tests)).
    pub triangle_tests: u32,
}

impl PixelCost {
    /// Adds what happened between two looks at the same counters.
    pub(crate) fn add(&mut self, before: &TraceCounters, after: &TraceCounters) {
        let add =
            |sum: &mut u32, count: u64| *sum = sum.saturating_add(u32::try_from(count).unwrap_or(u32::MAX));
        add(&mut self.box_tests, after.box_tests - before.box_tests);
        add(&mut self.triangle_tests, after.triangle_tests - before.triangle_tests);
    }
}

/// A colour as films hold it.
pub(crate) fn to_f32(colour: DVec3) -> [f32; 3] {
    colour.to_array().map(|channel| channel as f32)
}

/// What a film keeps beside its pixels.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Kept {
    pub statistics: bool,
    pub costs: bool,
}

impl Kept {
    pub fn by(settings: &RenderSettings) -> Kept {
        Kept { statistics: settings.keep_statistics, costs: settings.keep_costs }
    }
}

/// A picture of linear RGB radiance, rows from the top. Drawn from the memory budget until dropped.
#[derive(Debug)]
pub struct Film {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    /// As many, or none.
    statistics: Vec<PixelStatistics>,
    costs: Vec<PixelCost>,
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
        Film::keeping(grid, Kept::default(), budget)
    }

    /// [`Film::new`] with more beside each pixel.
    pub(crate) fn keeping(grid: &TileGrid, kept: Kept, budget: &MemoryBudget) -> Result<Film, BudgetError> {
        let pixel_count = grid.width as usize * grid.height as usize;
        let reservation = budget.reserve(Film::bytes_needed(grid, kept), "the film")?;
        Ok(Film {
            width: grid.width,
            height: grid.height,
            pixels: vec![[0.0; 3]; pixel_count],
            statistics: vec![PixelStatistics::NONE; if kept.statistics { pixel_count } else { 0 }],
            costs: vec![PixelCost::default(); if kept.costs { pixel_count } else { 0 }],
            tile_size: grid.tile_size,
            finished: vec![false; grid.tile_count()],
            _reservation: reservation,
        })
    }

    /// What [`Film::keeping`] takes from the budget.
    pub(crate) fn bytes_needed(grid: &TileGrid, kept: Kept) -> Bytes {
        let pixel_count = u64::from(grid.width) * u64::from(grid.height);
        let statistics = if kept.statistics { size_of::<PixelStatistics>() } else { 0 };
        let costs = if kept.costs { size_of::<PixelCost>() } else { 0 };
        let per_pixel = (size_of::<[f32; 3]>() + statistics + costs) as u64;
        Bytes(pixel_count * per_pixel + grid.tile_count() as u64)
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

    /// What is known of each pixel's error, in the order of [`Film::pixels`]; none if it was not asked for.
    pub fn statistics(&self) -> Option<&[PixelStatistics]> {
        (!self.statistics.is_empty()).then_some(&self.statistics[..])
    }

    /// What each pixel took, in the order of [`Film::pixels`]; none if it was not asked for.
    pub fn costs(&self) -> Option<&[PixelCost]> {
        (!self.costs.is_empty()).then_some(&self.costs[..])
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
    /// when it is whole; a failure leaves an existing file as it was. A link stays, and what it names is replaced.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for an extension that names no format of this build, [`RenderError::Write`] if the
    /// file cannot be written, or is a pipe or a device.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), RenderError> {
        image::write(self, path.as_ref())
    }

    /// Takes over the pixels of a finished tile, given row by row.
    pub(crate) fn set_tile(&mut self, grid: &TileGrid, cell: u32, pixels: &[[f32; 3]]) {
        copy_tile(grid, cell, pixels, &mut self.pixels);
        self.finished[cell as usize] = true;
    }

    /// Takes over the statistics of a tile, given row by row, if the film keeps any.
    pub(crate) fn set_statistics(&mut self, grid: &TileGrid, cell: u32, statistics: &[PixelStatistics]) {
        if !self.statistics.is_empty() {
            copy_tile(grid, cell, statistics, &mut self.statistics);
        }
    }

    /// Takes over the costs of a tile, given row by row, if the film keeps any.
    pub(crate) fn set_costs(&mut self, grid: &TileGrid, cell: u32, costs: &[PixelCost]) {
        if !self.costs.is_empty() {
            copy_tile(grid, cell, costs, &mut self.costs);
        }
    }
}

fn copy_tile<T: Copy>(grid: &TileGrid, cell: u32, tile: &[T], all: &mut [T]) {
    let area = grid.area(cell);
    for (row, source) in tile.chunks_exact(area.width as usize).enumerate() {
        let start = (area.y as usize + row) * grid.width as usize + area.x as usize;
        all[start..][..source.len()].copy_from_slice(source);
    }
}
