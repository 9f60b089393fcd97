//! What cells will cost, from those that are done.

use std::cell::Cell;

use super::grid::{ImageGrid, TileCells};
use crate::units::TileId;

/// Costs of finished cells over the image, and the estimate for the others: the mean of all finished tiles, each weighted by
/// how much of it is done and by the inverse of its distance to the fourth power (the paper weights by inverse distance; the fourth power
/// keeps the many far ones from outvoting the few near).
///
/// Groups of tiles that are far for their size count as one (as in Barnes and Hut's method for gravity), so an estimate
/// looks at a few dozen sums, whatever the number of tiles.
pub(super) struct CostMap {
    /// Tiles across and down.
    sides: [u32; 2],
    /// Sums over squares of 1, 2, 4, ... tiles a side, row by row; the last is the whole image.
    levels: Vec<Level>,
    /// The estimate that was made last, if nothing was recorded since: one decision asks for the same one several times.
    last: Cell<Option<(TileId, f64)>>,
}

struct Level {
    columns: u32,
    sums: Vec<Sum>,
}

#[derive(Clone, Copy, Default)]
struct Sum {
    cells: f64,
    work: f64,
}

impl CostMap {
    pub fn new(grid: &ImageGrid) -> CostMap {
        let sides = grid.sides();
        let mut levels = Vec::new();
        let [mut columns, mut rows] = sides;
        loop {
            levels.push(Level { columns, sums: vec![Sum::default(); columns as usize * rows as usize] });
            if columns == 1 && rows == 1 {
                break;
            }
            (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
        }
        CostMap { sides, levels, last: Cell::new(None) }
    }

    /// `cells` cost `work` together.
    pub fn record(&mut self, grid: &ImageGrid, cells: TileCells, work: f64) {
        self.last.set(None);
        let [column, row] = grid.place(cells.tile);
        for (level, sums) in self.levels.iter_mut().enumerate() {
            let sum = &mut sums.sums[((row >> level) * sums.columns + (column >> level)) as usize];
            sum.cells += f64::from(cells.count());
            sum.work += work;
        }
    }

    /// Mean cost of a cell over the image; none if nothing is done.
    pub fn mean(&self) -> Option<f64> {
        let whole = self.levels.last()?.sums[0];
        (whole.cells > 0.0).then(|| whole.work / whole.cells)
    }

    /// What a cell of `tile` will cost; none if nothing is done.
    pub fn estimate(&self, grid: &ImageGrid, tile: TileId) -> Option<f64> {
        if let Some((_, known)) = self.last.get().filter(|(last, _)| *last == tile) {
            return Some(known);
        }
        let target = grid.place(tile);
        let mut weighted = Sum::default();
        self.gather(self.levels.len() - 1, [0, 0], target, &mut weighted);
        let estimate = (weighted.cells > 0.0).then(|| weighted.work / weighted.cells)?;
        self.last.set(Some((tile, estimate)));
        Some(estimate)
    }

    fn gather(&self, level: usize, [column, row]: [u32; 2], target: [u32; 2], into: &mut Sum) {
        let Level { columns, sums } = &self.levels[level];
        let sum = sums[(row * columns + column) as usize];
        if sum.cells == 0.0 {
            return;
        }
        let side = 1u32 << level;
        let distance2 = distance2([column, row], side, target);
        if level == 0 || distance2 > 4.0 * f64::from(side) * f64::from(side) {
            // A tile that is partly done speaks for the rest of itself from a third of its side away.
            let weight = 1.0 / distance2.max(0.1).powi(2);
            into.cells += sum.cells * weight;
            into.work += sum.work * weight;
            return;
        }
        for (x, y) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let child = [2 * column + x, 2 * row + y];
            let below = self.levels[level - 1].columns;
            let rows = self.sides[1].div_ceil(side / 2);
            if child[0] < below && child[1] < rows {
                self.gather(level - 1, child, target, into);
            }
        }
    }
}

/// Square of the distance, in tiles, from the middle of a square of `side` tiles to the middle of the tile `target`.
fn distance2(square: [u32; 2], side: u32, target: [u32; 2]) -> f64 {
    let side = f64::from(side);
    let [dx, dy] = [0, 1].map(|axis| (f64::from(square[axis]) + 0.5) * side - f64::from(target[axis]) - 0.5);
    dx * dx + dy * dy
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Within a few percent of the sum over all finished tiles.
    #[test]
    fn estimates_are_close_to_the_sum_over_all_tiles() {
        let grid = ImageGrid::new(640, 360, 8, 8).unwrap();
        let mut map = CostMap::new(&grid);
        let mut done: Vec<(TileId, f64)> = Vec::new();
        assert_eq!(map.estimate(&grid, TileId(3)), None);
        for step in 0u32..900 {
            let tile = TileId(step.wrapping_mul(2_654_435_761) % grid.tile_count());
            let [column, row] = grid.place(tile);
            // A hill on a plain.
            let work = 1.0 + 20.0 * (-distance2([column, row], 1, [20, 30]) / 100.0).exp();
            map.record(&grid, TileCells { tile, cells: 1 }, work);
            done.push((tile, work));
        }
        for tile in (0..grid.tile_count()).step_by(7).map(TileId) {
            let (mut weights, mut sum) = (0.0, 0.0);
            for (other, work) in &done {
                let weight = 1.0 / distance2(grid.place(*other), 1, grid.place(tile)).max(0.1).powi(2);
                weights += weight;
                sum += weight * work;
            }
            let (naive, fast) = (sum / weights, map.estimate(&grid, tile).unwrap());
            assert!((fast - naive).abs() < 0.1 * naive, "{tile:?}: {fast} for {naive}");
        }
        let mean = done.iter().map(|(_, work)| work).sum::<f64>() / done.len() as f64;
        assert!((map.mean().unwrap() - mean).abs() < 1e-9 * mean);
    }
}
