//! Which free cells a worker gets next.

mod central;
mod curve;
mod nearest;
mod points;
mod rows;

pub(in crate::schedule) use central::CentralPolicy;
pub(in crate::schedule) use curve::CurvePolicy;
pub(in crate::schedule) use rows::RowsPolicy;

use crate::schedule::affinity::Affinity;
use crate::schedule::cost::CostMap;
use crate::schedule::grid::{ImageGrid, TileCells};
use crate::schedule::ledger::Ledger;
use crate::units::TileId;

/// What a policy may look at.
pub(in crate::schedule) struct View<'a> {
    pub ledger: &'a Ledger,
    pub costs: &'a CostMap,
    /// Who holds which blocks, if that is to matter.
    pub affinity: Option<&'a Affinity>,
    /// Index of the worker that asks.
    pub slot: u32,
    /// Most cells that it may get of any tile.
    pub cells_max: &'a dyn Fn(TileId) -> u32,
}

impl View<'_> {
    pub fn grid(&self) -> &ImageGrid {
        self.ledger.grid()
    }
}

/// Chooses among free cells. Workers are named by index; an index is used again when its worker has left.
///
/// The books are kept elsewhere: a policy only has to find free cells when there are any.
pub(in crate::schedule) trait Policy: Send {
    /// A worker came.
    fn join(&mut self, slot: u32, ledger: &Ledger);

    /// A worker is gone.
    fn leave(&mut self, slot: u32);

    /// Free cells of one tile, at least one and at most as many as allowed; none only if no cell is free at all. They are taken.
    fn pick(&mut self, view: &View<'_>) -> Option<TileCells>;

    /// Cells that were taken are free again.
    fn freed(&mut self, cells: TileCells);

    /// Cells have come to the image's part, each tile once, in the order of the curve; they are free. So many workers take part.
    fn granted(&mut self, cells: &[TileCells], workers: u32) {
        let _ = workers;
        cells.iter().for_each(|cells| self.freed(*cells));
    }

    /// Of the cells from this number on (`tile * cells_per_tile + cell`), none is free any more: others do them.
    fn withdrawn(&mut self, from: u64) {
        let _ = from;
    }
}

/// The first squares of `free` that come to no more than `cells_max` cells, or the first cells if `anywhere`.
pub(in crate::schedule) fn first_cells(free: u64, cells_max: u32, anywhere: bool) -> u64 {
    if anywhere {
        let mut left = free;
        for _ in 0..cells_max {
            left &= left.wrapping_sub(1);
        }
        return free & !left;
    }
    // One square: the largest that starts at the first free cell. Missing cells at the border do not matter to the worker, but
    // free cells end where a square has a cell that is not free.
    let first = free.trailing_zeros();
    let mut count = 64;
    loop {
        let block = crate::schedule::grid::ones(first, count);
        if count <= cells_max.max(1) && first.is_multiple_of(count) && free & block == block {
            return block;
        }
        if count == 1 {
            return free & block;
        }
        count /= 4;
    }
}
