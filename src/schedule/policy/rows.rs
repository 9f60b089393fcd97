//! Tiles row by row: a plain queue.

use std::collections::BTreeSet;

use super::{Policy, View, first_cells};
use crate::schedule::grid::{ImageGrid, TileCells};
use crate::schedule::ledger::Ledger;
use crate::units::TileId;

/// Tiles from the upper left, row by row.
pub(in crate::schedule) struct RowsPolicy {
    /// Tiles with free cells, as (row, column, tile).
    tiles: BTreeSet<(u32, u32, TileId)>,
    grid: ImageGrid,
}

impl RowsPolicy {
    pub fn new(ledger: &Ledger) -> RowsPolicy {
        let grid = ledger.grid().clone();
        let mut policy = RowsPolicy { tiles: BTreeSet::new(), grid };
        for tile in (0..ledger.grid().tile_count()).map(TileId) {
            policy.freed(TileCells { tile, cells: ledger.free(tile) });
        }
        policy
    }
}

impl Policy for RowsPolicy {
    fn join(&mut self, _: u32, _: &Ledger) {}

    fn leave(&mut self, _: u32) {}

    fn pick(&mut self, view: &View<'_>) -> Option<TileCells> {
        while let Some(&(row, column, tile)) = self.tiles.first() {
            let free = view.ledger.free(tile);
            let cells = if free == 0 { 0 } else { first_cells(free, (view.cells_max)(tile), false) };
            if cells == free {
                self.tiles.remove(&(row, column, tile));
            }
            if cells != 0 {
                return Some(TileCells { tile, cells });
            }
        }
        None
    }

    fn freed(&mut self, cells: TileCells) {
        if !cells.is_empty() {
            let [column, row] = self.grid.place(cells.tile);
            self.tiles.insert((row, column, cells.tile));
        }
    }
}
