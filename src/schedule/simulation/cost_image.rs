//! What each cell of an image costs, and which blocks it needs.

use crate::error::ScheduleError;
use crate::schedule::grid::{ImageGrid, Region, TileCells};
use crate::stats::TraceCounters;
use crate::units::TileId;

/// Seconds for the work that counters stand for, on one machine.
///
/// The defaults are a least-squares fit to the CPU times of parts of two scenes at 2.5 GHz, one ray at a time; parts differ from
/// them by 17 % (root mean square; `docs/results/cluster-simulation.md`). Triangle tests go with box tests so closely that the fit
/// cannot tell them apart. What matters to a scheduler is how costs compare, not how large they are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CostModel {
    /// For each ray.
    pub ray_seconds: f64,
    /// For each box test, with the triangle tests that follow from it.
    pub box_test_seconds: f64,
}

impl Default for CostModel {
    fn default() -> CostModel {
        CostModel { ray_seconds: 150e-9, box_test_seconds: 50e-9 }
    }
}

impl CostModel {
    /// Seconds for work on blocks that are in memory.
    pub fn seconds(&self, counters: &TraceCounters) -> f64 {
        counters.rays as f64 * self.ray_seconds + counters.box_tests as f64 * self.box_test_seconds
    }
}

/// A block as far as loading it goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BlockSize {
    /// Bytes in the file.
    pub stored_bytes: u32,
    /// Triangles.
    pub triangles: u32,
}

/// The costs of an image, cell by cell along the curve.
#[derive(Clone, Debug, PartialEq)]
pub struct CostImage {
    grid: ImageGrid,
    /// Seconds with all blocks in memory, by `tile * cells_per_tile + cell`; 0 for cells that do not exist.
    seconds: Vec<f32>,
    /// Where each cell's accesses start.
    starts: Vec<u32>,
    accesses: Vec<u32>,
    blocks: Vec<BlockSize>,
}

impl CostImage {
    /// No cell has a cost yet; they are to be added in the order of their numbers.
    pub fn new(grid: ImageGrid, blocks: Vec<BlockSize>) -> CostImage {
        CostImage { grid, seconds: Vec::new(), starts: vec![0], accesses: Vec::new(), blocks }
    }

    /// Adds the next cell: what it costs with all blocks in memory, and the blocks that it enters, in order. Of a block entered
    /// again and again without another between, once is enough.
    pub fn push(&mut self, seconds: f64, accesses: impl IntoIterator<Item = u32>) {
        self.seconds.push(seconds as f32);
        let blocks = self.blocks.len() as u32;
        self.accesses.extend(accesses.into_iter().filter(|block| *block < blocks));
        self.starts.push(self.accesses.len() as u32);
    }

    /// The image's cells.
    pub fn grid(&self) -> &ImageGrid {
        &self.grid
    }

    /// The model's blocks.
    pub fn blocks(&self) -> &[BlockSize] {
        &self.blocks
    }

    /// Seconds of a cell with all blocks in memory; 0 for one that does not exist.
    pub fn seconds(&self, tile: TileId, cell: u32) -> f64 {
        self.seconds.get(self.index(tile, cell)).copied().unwrap_or(0.0).into()
    }

    /// Blocks that a cell enters, in order.
    pub fn accesses(&self, tile: TileId, cell: u32) -> &[u32] {
        let index = self.index(tile, cell);
        match (self.starts.get(index), self.starts.get(index + 1)) {
            (Some(start), Some(end)) => &self.accesses[*start as usize..*end as usize],
            _ => &[],
        }
    }

    fn index(&self, tile: TileId, cell: u32) -> usize {
        tile.0 as usize * self.grid.cells_per_tile() as usize + cell as usize
    }

    /// Seconds of the whole image with all blocks in memory.
    pub fn total_seconds(&self) -> f64 {
        self.seconds.iter().map(|seconds| f64::from(*seconds)).sum()
    }

    /// Seconds of the most expensive cell, and of the most expensive tile.
    pub fn longest_seconds(&self) -> (f64, f64) {
        let per_tile = self.grid.cells_per_tile() as usize;
        let longest = |parts: &mut dyn Iterator<Item = f64>| parts.fold(0.0, f64::max);
        let sum = |tile: &[f32]| tile.iter().map(|seconds| f64::from(*seconds)).sum();
        (
            longest(&mut self.seconds.iter().map(|seconds| f64::from(*seconds))),
            longest(&mut self.seconds.chunks(per_tile).map(sum)),
        )
    }

    /// The same image with every cost times `factor`: more samples per pixel, say.
    pub fn scaled(mut self, factor: f64) -> CostImage {
        for seconds in &mut self.seconds {
            *seconds = (f64::from(*seconds) * factor) as f32;
        }
        self
    }

    /// The same image in tiles and cells of other sides; a cell becomes the sum of those that it holds.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] if the sides make no grid, or a cell does not hold whole cells of this image.
    pub fn in_tiles(&self, tile_side: u32, cell_side: u32) -> Result<CostImage, ScheduleError> {
        let old_side = self.grid.cell_side();
        if !cell_side.is_multiple_of(old_side) {
            let reason = "the new cells must hold whole old ones";
            return Err(ScheduleError::Option { what: "cell side", reason });
        }
        let grid = ImageGrid::new(self.grid.width(), self.grid.height(), tile_side, cell_side)?;
        // The old cells by their places.
        let across = grid.width().div_ceil(old_side) as usize;
        let mut places = vec![None; across * grid.height().div_ceil(old_side) as usize];
        for (tile, cell, region) in cells(&self.grid) {
            if let Some(region) = region {
                places[(region.y / old_side) as usize * across + (region.x / old_side) as usize] =
                    Some((tile, cell));
            }
        }
        let mut image = CostImage::new(grid.clone(), self.blocks.clone());
        for (_, _, region) in cells(&grid) {
            let mut held = Vec::new();
            if let Some(Region { x, y, width, height }) = region {
                for row in y / old_side..(y + height).div_ceil(old_side) {
                    let columns = x / old_side..(x + width).div_ceil(old_side);
                    held.extend(columns.filter_map(|column| places[row as usize * across + column as usize]));
                }
            }
            held.sort_unstable();
            let seconds = held.iter().map(|(tile, cell)| self.seconds(*tile, *cell)).sum();
            image.push(
                seconds,
                held.iter().flat_map(|(tile, cell)| self.accesses(*tile, *cell).iter().copied()),
            );
        }
        Ok(image)
    }

    /// The same costs over an image of other tiles or cells: `grid` has as many cells in each tile, and as many tiles.
    /// So an image that was measured at half the size stands for one of full size, each of its pixels for four.
    ///
    /// None if the grids do not match.
    pub fn over(self, grid: ImageGrid) -> Option<CostImage> {
        let matches =
            self.grid.cells_per_tile() == grid.cells_per_tile() && self.grid.sides() == grid.sides();
        matches.then_some(CostImage { grid, ..self })
    }
}

/// Every cell of every tile, in order, with its pixels if it exists.
pub(super) fn cells(grid: &ImageGrid) -> impl Iterator<Item = (TileId, u32, Option<Region>)> {
    let tiles = (0..grid.tile_count()).map(TileId);
    tiles.flat_map(|tile| (0..grid.cells_per_tile()).map(move |cell| (tile, cell))).map(|(tile, cell)| {
        let squares = grid.squares(TileCells { tile, cells: 1 << cell }, 1);
        (tile, cell, squares.first().map(|(_, region)| *region))
    })
}
