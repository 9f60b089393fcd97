//! The tile of least score, found in a pyramid.

use crate::schedule::grid::ImageGrid;
use crate::units::TileId;

/// A set of tiles in which the one of least score is found fast. The score of a tile is its distance to a point, less what the
/// caller grants it; distances are between middles, in tiles.
pub(in crate::schedule) struct TileIndex {
    grid: ImageGrid,
    /// Over squares of 1, 2, 4, ... tiles a side, row by row: how many tiles of the set are in it.
    levels: Vec<Level>,
    /// The tile at each place, row by row.
    tiles: Vec<TileId>,
}

struct Level {
    columns: u32,
    rows: u32,
    counts: Vec<u32>,
    /// The most that any tile in the square, of the set or not, is granted.
    grants: Vec<f64>,
}

/// What a tile is granted, by its place row by row, for the worker that asks.
pub(in crate::schedule) type Grant<'a> = &'a dyn Fn(usize) -> f64;

impl TileIndex {
    /// An empty set.
    pub fn new(grid: &ImageGrid) -> TileIndex {
        let [mut columns, mut rows] = grid.sides();
        let mut tiles = vec![TileId(0); columns as usize * rows as usize];
        for tile in (0..grid.tile_count()).map(TileId) {
            let [column, row] = grid.place(tile);
            tiles[(row * columns + column) as usize] = tile;
        }
        let mut levels = Vec::new();
        loop {
            let squares = columns as usize * rows as usize;
            levels.push(Level { columns, rows, counts: vec![0; squares], grants: vec![0.0; squares] });
            if squares == 1 {
                break;
            }
            (columns, rows) = (columns.div_ceil(2), rows.div_ceil(2));
        }
        TileIndex { grid: grid.clone(), levels, tiles }
    }

    /// Puts a tile in or takes it out.
    pub fn set(&mut self, tile: TileId, is_in: bool) {
        let [column, row] = self.grid.place(tile);
        let at = |level: &Level, shift: usize| ((row >> shift) * level.columns + (column >> shift)) as usize;
        let before = self.levels[0].counts[at(&self.levels[0], 0)] != 0;
        if before == is_in {
            return;
        }
        for (shift, level) in self.levels.iter_mut().enumerate() {
            let place = at(level, shift);
            if is_in {
                level.counts[place] += 1;
            } else {
                level.counts[place] -= 1;
            }
        }
    }

    /// Sets the bounds on what each tile may be granted, by place.
    pub fn set_grants_max(&mut self, grant_max: Grant<'_>) {
        let tiles = self.levels[0].grants.len();
        self.levels[0].grants = (0..tiles).map(grant_max).collect();
        for at in 1..self.levels.len() {
            let (below, above) = self.levels.split_at_mut(at);
            let (below, above) = (&below[at - 1], &mut above[0]);
            above.grants.fill(f64::NEG_INFINITY);
            for row in 0..below.rows {
                for column in 0..below.columns {
                    let into = &mut above.grants[(row / 2 * above.columns + column / 2) as usize];
                    *into = into.max(below.grants[(row * below.columns + column) as usize]);
                }
            }
        }
    }

    /// The tile of the set with the least (score, number).
    pub fn least(&self, point: [f64; 2], grant: Grant<'_>) -> Option<TileId> {
        let mut best = (f64::INFINITY, TileId(u32::MAX));
        if self.levels.last()?.counts[0] == 0 {
            return None;
        }
        self.search(self.levels.len() - 1, [0, 0], point, grant, &mut best);
        best.0.is_finite().then_some(best.1)
    }

    fn search(
        &self,
        level: usize,
        [column, row]: [u32; 2],
        point: [f64; 2],
        grant: Grant<'_>,
        best: &mut (f64, TileId),
    ) {
        if level == 0 {
            let place = (row * self.levels[0].columns + column) as usize;
            let middle = [f64::from(column) + 0.5, f64::from(row) + 0.5];
            let found = (distance(point, middle) - grant(place), self.tiles[place]);
            if found < *best {
                *best = found;
            }
            return;
        }
        let below = &self.levels[level - 1];
        let side = f64::from(1u32 << (level - 1));
        let mut squares = [(f64::INFINITY, [0, 0]); 4];
        for (square, [x, y]) in squares.iter_mut().zip([[0, 0], [1, 0], [0, 1], [1, 1]]) {
            let [column, row] = [2 * column + x, 2 * row + y];
            if column >= below.columns || row >= below.rows {
                continue;
            }
            let place = (row * below.columns + column) as usize;
            if below.counts[place] > 0 {
                // Middles of its tiles lie half a tile inside of its border.
                let nearest = [(column, point[0]), (row, point[1])].map(|(at, to)| {
                    let start = f64::from(at) * side;
                    to.clamp(start + 0.5, start + side - 0.5)
                });
                *square = (distance(point, nearest) - below.grants[place], [column, row]);
            }
        }
        squares.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (bound, square) in squares {
            // At the same score the lower number wins, so an equal bound has to be looked into.
            if bound.is_finite() && bound <= best.0 {
                self.search(level - 1, square, point, grant, best);
            }
        }
    }
}

pub(in crate::schedule) fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
    (dx * dx + dy * dy).sqrt()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Against a look at every tile.
        #[test]
        fn the_least_score_is_found(
            size in (1u32..300, 1u32..200),
            changes in prop::collection::vec((any::<u32>(), any::<bool>()), 1..200),
            points in prop::collection::vec((-10.0..50.0f64, -10.0..50.0f64), 1..10),
            weight in prop_oneof![Just(0.0), 0.0..1.0f64],
        ) {
            let grid = ImageGrid::new(size.0, size.1, 8, 8).unwrap();
            let columns = grid.sides()[0] as usize;
            let mut index = TileIndex::new(&grid);
            // Something that varies and has equal values.
            let granted = |place: usize| weight * ((place * 7919 % 64) as f64);
            index.set_grants_max(&granted);
            let mut set = BTreeSet::new();
            for (tile, is_in) in changes {
                let tile = TileId(tile % grid.tile_count());
                index.set(tile, is_in);
                if is_in { set.insert(tile); } else { set.remove(&tile); }
                for (x, y) in &points {
                    let score = |tile: TileId| {
                        let [column, row] = grid.place(tile);
                        let middle = [f64::from(column) + 0.5, f64::from(row) + 0.5];
                        distance([*x, *y], middle) - granted(row as usize * columns + column as usize)
                    };
                    let naive = set.iter().map(|tile| (score(*tile), *tile)).min_by(|a, b| a.partial_cmp(b).unwrap());
                    prop_assert_eq!(index.least([*x, *y], &granted), naive.map(|(_, tile)| tile));
                }
            }
        }
    }
}
