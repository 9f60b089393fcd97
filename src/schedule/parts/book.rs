//! The top's book: which cells are done, and whose the others are.

use std::collections::BTreeMap;

use smallvec::SmallVec;

use crate::schedule::grid::{ImageGrid, TileCells, ones};
use crate::schedule::policy::first_cells;
use crate::units::TileId;

#[derive(Clone, Debug, Default)]
struct Tile {
    done: u64,
    /// Cells that are not done, by the index of the sub-coordinator whose they are.
    owners: SmallVec<[(u32, u64); 2]>,
}

/// A cell of the image is done, or nobody's, or one sub-coordinator's, and never two of these.
pub(super) struct PartBook {
    grid: ImageGrid,
    tiles: Vec<Tile>,
    /// Nobody's cells.
    free: BTreeMap<TileId, u64>,
    cells: u64,
    cells_done: u64,
    cells_free: u64,
}

impl PartBook {
    /// A book in which `done` (by tile) is done and all the rest is nobody's.
    pub fn new(grid: ImageGrid, done: Option<&[u64]>) -> PartBook {
        let mut book = PartBook {
            tiles: vec![Tile::default(); grid.tile_count() as usize],
            free: BTreeMap::new(),
            cells: 0,
            cells_done: 0,
            cells_free: 0,
            grid,
        };
        for tile in (0..book.grid.tile_count()).map(TileId) {
            let exists = book.grid.cells_of(tile);
            let done = done.map_or(0, |done| done[tile.0 as usize]) & exists;
            book.tiles[tile.0 as usize].done = done;
            book.cells += u64::from(exists.count_ones());
            book.cells_done += u64::from(done.count_ones());
            book.release(TileCells { tile, cells: exists & !done });
        }
        book
    }

    pub fn grid(&self) -> &ImageGrid {
        &self.grid
    }

    pub fn cells(&self) -> u64 {
        self.cells
    }

    pub fn cells_done(&self) -> u64 {
        self.cells_done
    }

    pub fn cells_free(&self) -> u64 {
        self.cells_free
    }

    pub fn done(&self, tile: TileId) -> u64 {
        self.tiles[tile.0 as usize].done
    }

    /// Makes cells nobody's that nobody owns any more.
    fn release(&mut self, cells: TileCells) {
        if !cells.is_empty() {
            *self.free.entry(cells.tile).or_default() |= cells.cells;
            self.cells_free += u64::from(cells.count());
        }
    }

    /// Enters cells as done; those that were not done before, and how many of these each owner loses.
    pub fn finish(&mut self, cells: TileCells) -> (TileCells, SmallVec<[(u32, u32); 2]>) {
        let tile = &mut self.tiles[cells.tile.0 as usize];
        let fresh = cells.cells & !tile.done;
        tile.done |= fresh;
        self.cells_done += u64::from(fresh.count_ones());
        let mut losses = SmallVec::new();
        tile.owners.retain(|(owner, owned)| {
            let lost = *owned & fresh;
            if lost != 0 {
                losses.push((*owner, lost.count_ones()));
            }
            *owned &= !fresh;
            *owned != 0
        });
        if let Some(free) = self.free.get_mut(&cells.tile) {
            self.cells_free -= u64::from((*free & fresh).count_ones());
            *free &= !fresh;
            if *free == 0 {
                self.free.remove(&cells.tile);
            }
        }
        (TileCells { tile: cells.tile, cells: fresh }, losses)
    }

    /// Gives `count` of nobody's cells (at least one, if there is one) to `owner`, from the cell number `from` on along the curve,
    /// which goes round. Each tile comes once.
    pub fn give(&mut self, owner: u32, from: u64, count: u64) -> Vec<TileCells> {
        let per_tile = u64::from(self.grid.cells_per_tile());
        let start = TileId((from / per_tile).min(u64::from(self.grid.tile_count()) - 1) as u32);
        // Of the first tile, what lies before comes last.
        let before = ones(0, (from % per_tile) as u32);
        let mut left = count.max(1);
        let mut given: Vec<TileCells> = Vec::new();
        let after = self
            .free
            .range(start..)
            .map(|(tile, free)| (*tile, if *tile == start { *free & !before } else { *free }));
        let round = self.free.range(..start).map(|(tile, free)| (*tile, *free));
        let last = self.free.get(&start).map(|free| (start, *free & before));
        for (tile, free) in after.chain(round).chain(last) {
            if left == 0 {
                break;
            }
            let cells = first_cells(free, left.min(64) as u32, true);
            left -= u64::from(cells.count_ones());
            match given.first_mut().filter(|first| first.tile == tile) {
                Some(first) => first.cells |= cells,
                None if cells != 0 => given.push(TileCells { tile, cells }),
                None => {}
            }
        }
        for TileCells { tile, cells } in &given {
            if let Some(free) = self.free.get_mut(tile) {
                *free &= !cells;
                if *free == 0 {
                    self.free.remove(tile);
                }
            }
            self.cells_free -= u64::from(cells.count_ones());
            self.own(owner, TileCells { tile: *tile, cells: *cells });
        }
        given
    }

    fn own(&mut self, owner: u32, cells: TileCells) {
        let owners = &mut self.tiles[cells.tile.0 as usize].owners;
        match owners.iter_mut().find(|(other, _)| *other == owner) {
            Some((_, owned)) => *owned |= cells.cells,
            None => owners.push((owner, cells.cells)),
        }
    }

    /// Takes cells from their owner; they are the new owner's then, or nobody's. Cells that were not its own are left out.
    pub fn pass_on(&mut self, owner: u32, cells: TileCells, to: Option<u32>) -> TileCells {
        let mut passed = 0;
        self.tiles[cells.tile.0 as usize].owners.retain(|(other, owned)| {
            if *other == owner {
                passed = *owned & cells.cells;
                *owned &= !passed;
            }
            *owned != 0
        });
        let passed = TileCells { tile: cells.tile, cells: passed };
        match to {
            Some(to) if !passed.is_empty() => self.own(to, passed),
            _ => self.release(passed),
        }
        passed
    }

    /// What was an owner's is nobody's.
    pub fn abandon(&mut self, owner: u32) {
        for tile in (0..self.grid.tile_count()).map(TileId) {
            self.pass_on(owner, TileCells { tile, cells: !0 }, None);
        }
    }

    #[cfg(test)]
    pub fn owned(&self, owner: u32, tile: TileId) -> u64 {
        let owners = &self.tiles[tile.0 as usize].owners;
        owners.iter().find(|(other, _)| *other == owner).map_or(0, |(_, owned)| *owned)
    }

    /// What must hold between calls, with how many cells each owner has; the complaint if it does not.
    #[cfg(test)]
    pub fn check(&self) -> Result<BTreeMap<u32, u64>, String> {
        let mut owned: BTreeMap<u32, u64> = BTreeMap::new();
        let (mut done, mut free) = (0, 0);
        for (number, tile) in self.tiles.iter().enumerate() {
            let id = TileId(number as u32);
            let nobodys = self.free.get(&id).copied().unwrap_or(0);
            let sets = [tile.done, nobodys].into_iter().chain(tile.owners.iter().map(|(_, owned)| *owned));
            let (mut union, mut sum) = (0, 0);
            for set in sets {
                union |= set;
                sum += set.count_ones();
            }
            if union != self.grid.cells_of(id) || sum != union.count_ones() {
                return Err(format!("{id:?}: {tile:x?}, nobody's {nobodys:x}"));
            }
            if self.free.get(&id) == Some(&0) || tile.owners.iter().any(|(_, owned)| *owned == 0) {
                return Err(format!("{id:?} has an owner of nothing"));
            }
            for (owner, cells) in &tile.owners {
                *owned.entry(*owner).or_default() += u64::from(cells.count_ones());
            }
            done += u64::from(tile.done.count_ones());
            free += u64::from(nobodys.count_ones());
        }
        let sums = (self.cells, self.cells_done, self.cells_free);
        let is_sound = sums == (done + free + owned.values().sum::<u64>(), done, free);
        if is_sound {
            Ok(owned)
        } else {
            Err(format!("the sums are wrong: {sums:?}, {done} done, {free} free"))
        }
    }
}
