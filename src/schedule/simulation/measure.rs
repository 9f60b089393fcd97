//! Costs and block accesses of an image, from counters of a real run.

use std::io::{self, Write};
use std::sync::Arc;

use parking_lot::Mutex;

use super::cost_image::{BlockSize, CostImage, CostModel};
use crate::access::AccessTrace;
use crate::error::{Error, TraceError};
use crate::octree::LazyOctree;
use crate::schedule::grid::{ImageGrid, TileCells};
use crate::stats::TraceCounters;
use crate::trace::Tracer;
use crate::units::TileId;

/// How much is kept of the blocks that a cell enters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AccessDetail {
    /// Each block once, in the order of the first entries: enough for caches that hold the blocks of some cells.
    Distinct,
    /// Every entry, but for those that follow one into the same block: what replays exactly.
    Sequence,
}

/// Traces the rays of one pixel, given as column and row.
pub type TracePixel<'f> = dyn FnMut(&mut Tracer<'_>, [u32; 2]) -> Result<(), TraceError> + 'f;

/// Tiles that are recorded together; bounds the memory of the recording.
const TILES_AT_ONCE: u32 = 64;

/// Traces the image of `grid` on the calling thread, cell by cell, and takes down what each costs. `trace` traces the rays of one pixel,
/// given as column and row. `progress` hears of each tile.
///
/// Costs are counters weighted by `model`, so they are exact, do not depend on the machine or on the cache, and leave loads out.
///
/// # Errors
/// What `trace` or the recording of block accesses gives.
pub fn measure(
    octree: &mut LazyOctree,
    grid: &ImageGrid,
    detail: AccessDetail,
    model: &CostModel,
    trace: &mut TracePixel<'_>,
    progress: &mut dyn FnMut(TileId),
) -> Result<CostImage, Error> {
    let entries = &octree.model().blocks;
    let blocks = entries
        .iter()
        .map(|entry| BlockSize { stored_bytes: entry.stored_bytes, triangles: entry.triangle_count })
        .collect();
    let mut image = CostImage::new(grid.clone(), blocks);
    for first in (0..grid.tile_count()).step_by(TILES_AT_ONCE as usize) {
        let tiles = first..grid.tile_count().min(first + TILES_AT_ONCE);
        let bytes = SharedBytes::default();
        let recorder = octree.record_accesses(Box::new(bytes.clone()))?;
        let mut cells = Vec::new();
        let mut tracer = octree.tracer()?;
        for tile in tiles.map(TileId) {
            for cell in 0..grid.cells_per_tile() {
                let before = tracer.counters();
                for (_, region) in grid.squares(TileCells { tile, cells: 1 << cell }, 1) {
                    for y in region.y..region.y + region.height {
                        for x in region.x..region.x + region.width {
                            trace(&mut tracer, [x, y])?;
                        }
                    }
                }
                cells.push(since(&before, &tracer.counters()));
            }
            progress(tile);
        }
        drop(tracer);
        recorder.finish()?;
        add(&mut image, &AccessTrace::from_bytes(bytes.take())?, &cells, detail, model);
    }
    Ok(image)
}

/// Adds cells whose queries stand one after the other in `accesses`.
fn add(
    image: &mut CostImage,
    accesses: &AccessTrace,
    cells: &[TraceCounters],
    detail: AccessDetail,
    model: &CostModel,
) {
    let mut cutter = Cutter {
        cells,
        at: 0,
        left: cells.first().map_or(0, |cell| cell.rays),
        entered: Vec::new(),
        last_cell: vec![usize::MAX; image.blocks().len()],
        image,
        detail,
        model,
    };
    cutter.end_cells();
    accesses.visit(|query| {
        let mut count = query.count;
        while count > 0 && cutter.left > 0 {
            let here = count.min(cutter.left);
            cutter.enter(query.blocks, here);
            count -= here;
            cutter.left -= here;
            cutter.end_cells();
        }
    });
}

/// Cuts a stream of queries into cells by how many rays each cell had.
struct Cutter<'a> {
    cells: &'a [TraceCounters],
    /// The cell that the next query belongs to.
    at: usize,
    /// Queries of that cell that are still to come.
    left: u64,
    /// The blocks that it has entered.
    entered: Vec<u32>,
    /// For each block, the cell that entered it last.
    last_cell: Vec<usize>,
    image: &'a mut CostImage,
    detail: AccessDetail,
    model: &'a CostModel,
}

impl Cutter<'_> {
    /// `count` queries entered the same blocks.
    fn enter(&mut self, blocks: &[u32], count: u64) {
        // A second time matters only where it goes round through several blocks.
        let goes_round = blocks.len() > 1 && self.detail == AccessDetail::Sequence;
        for _ in 0..if goes_round { count } else { 1 } {
            for block in blocks {
                let is_new = match self.detail {
                    AccessDetail::Distinct => {
                        std::mem::replace(&mut self.last_cell[*block as usize], self.at) != self.at
                    }
                    AccessDetail::Sequence => self.entered.last() != Some(block),
                };
                if is_new {
                    self.entered.push(*block);
                }
            }
        }
    }

    /// Adds the cells that are through.
    fn end_cells(&mut self) {
        while self.left == 0
            && let Some(cell) = self.cells.get(self.at)
        {
            self.image.push(self.model.seconds(cell), self.entered.drain(..));
            self.at += 1;
            self.left = self.cells.get(self.at).map_or(0, |cell| cell.rays);
        }
    }
}

fn since(before: &TraceCounters, after: &TraceCounters) -> TraceCounters {
    TraceCounters {
        rays: after.rays - before.rays,
        box_tests: after.box_tests - before.box_tests,
        ..TraceCounters::default()
    }
}

/// Bytes that are written in one place and read in another.
#[derive(Clone, Default)]
struct SharedBytes(Arc<Mutex<Vec<u8>>>);

impl SharedBytes {
    fn take(&self) -> Vec<u8> {
        std::mem::take(&mut self.0.lock())
    }
}

impl Write for SharedBytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.lock().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
