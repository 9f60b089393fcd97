//! Which blocks parts of the image need, and which workers are likely to hold them.

use super::grid::ImageGrid;
use crate::access::BlockSketch;
use crate::units::TileId;

/// Regions across the image at most; so the sketches of all take 1.4 MiB at most.
const REGIONS_ACROSS_MAX: u32 = 128;

/// Sketches are kept of squares of 1, 2, 4 and 8 regions a side. What larger ones need says nothing about a place.
const LEVELS: u32 = 4;

/// A worker's blocks are those of its last results: of so many at least, and of less than twice as many.
const RESULTS: u32 = 4;

/// What results told about blocks: a sketch for each region of the image, of all blocks that its finished cells needed, and one for
/// each worker, of the blocks that it touched last.
pub(super) struct Affinity {
    /// A region is a square of 2^shift tiles a side.
    shift: u32,
    levels: Vec<Level>,
    /// By index of the worker.
    workers: Vec<Held>,
}

struct Level {
    columns: u32,
    needed: Vec<BlockSketch>,
}

#[derive(Clone, Copy, Default)]
struct Held {
    now: BlockSketch,
    before: BlockSketch,
    results: u32,
}

impl Affinity {
    /// Nothing is known.
    pub fn new(grid: &ImageGrid) -> Affinity {
        let [columns, rows] = grid.sides();
        let mut shift = 0;
        while columns.max(rows).div_ceil(1 << shift) > REGIONS_ACROSS_MAX {
            shift += 1;
        }
        let levels = (shift..shift + LEVELS).map(|shift| {
            let [columns, rows] = [columns, rows].map(|side| side.div_ceil(1 << shift));
            Level { columns, needed: vec![BlockSketch::default(); columns as usize * rows as usize] }
        });
        Affinity { shift, levels: levels.collect(), workers: Vec::new() }
    }

    /// A worker came and holds nothing yet.
    pub fn join(&mut self, slot: u32) {
        let slot = slot as usize;
        if self.workers.len() <= slot {
            self.workers.resize(slot + 1, Held::default());
        }
        self.workers[slot] = Held::default();
    }

    /// Some cells of a tile needed these blocks; a worker, if it still takes part, has them now.
    pub fn record(&mut self, slot: Option<u32>, grid: &ImageGrid, tile: TileId, blocks: &BlockSketch) {
        if blocks.is_empty() {
            return;
        }
        let at = grid.place(tile);
        for level in 0..LEVELS {
            let index = self.index(level, at);
            self.levels[level as usize].needed[index].merge(blocks);
        }
        if let Some(held) = slot.and_then(|slot| self.workers.get_mut(slot as usize)) {
            held.now.merge(blocks);
            held.results += 1;
            if held.results >= RESULTS {
                *held = Held { now: BlockSketch::default(), before: held.now, results: 0 };
            }
        }
    }

    fn index(&self, level: u32, [column, row]: [u32; 2]) -> usize {
        let shift = self.shift + level;
        ((row >> shift) * self.levels[level as usize].columns + (column >> shift)) as usize
    }

    /// Which part of the blocks that a tile is likely to need the worker is likely to hold, 0 to 1; none if nothing is known about the
    /// neighbourhood, or about the worker.
    pub fn likelihood(&self, slot: u32, grid: &ImageGrid, tile: TileId) -> Option<f64> {
        let held = self.workers.get(slot as usize)?;
        let at = grid.place(tile);
        // The smallest square around it of which anything is done.
        let needed = (0..LEVELS).map(|level| &self.levels[level as usize].needed[self.index(level, at)]);
        let needed = needed.into_iter().find(|needed| !needed.is_empty())?;
        let mut all = held.now;
        all.merge(&held.before);
        Some(f64::from(needed.common(&all)) / f64::from(needed.count()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::BlockId;

    fn sketch(blocks: impl IntoIterator<Item = u32>) -> BlockSketch {
        let mut sketch = BlockSketch::default();
        blocks.into_iter().for_each(|block| sketch.add(BlockId(block), 512));
        sketch
    }

    #[test]
    fn a_worker_holds_what_it_touched_last() {
        // The second image has regions of several tiles.
        for (side, tile) in [(2048, 64), (4096, 8)] {
            let grid = ImageGrid::new(side, side, tile, 8).unwrap();
            let tiles = grid.tile_count();
            let mut affinity = Affinity::new(&grid);
            affinity.join(0);
            affinity.join(3);
            let (here, far) = (TileId(0), TileId(tiles - 1));
            assert_eq!(affinity.likelihood(0, &grid, here), None);
            affinity.record(Some(0), &grid, here, &sketch(0..8));
            affinity.record(Some(3), &grid, here, &sketch(4..16));
            // Of the sixteen that are needed here.
            assert_eq!(affinity.likelihood(0, &grid, here), Some(0.5));
            assert_eq!(affinity.likelihood(3, &grid, here), Some(0.75));
            assert_eq!(affinity.likelihood(3, &grid, TileId(1)), Some(0.75), "the neighbour is like it");
            assert_eq!(affinity.likelihood(3, &grid, far), None);
            // One that never came, and one that came anew.
            assert_eq!(affinity.likelihood(7, &grid, here), None);
            affinity.join(3);
            assert_eq!(affinity.likelihood(3, &grid, here), Some(0.0));
            // Results of nobody tell about the image only; results without blocks tell nothing.
            affinity.record(None, &grid, far, &sketch(4..5));
            affinity.record(Some(0), &grid, far, &sketch([]));
            assert_eq!(affinity.likelihood(0, &grid, far), Some(1.0));
            for _ in 0..2 * RESULTS {
                affinity.record(Some(0), &grid, far, &sketch(100..110));
            }
            assert_eq!(affinity.likelihood(0, &grid, here), Some(0.0), "it is long gone");
        }
    }
}
