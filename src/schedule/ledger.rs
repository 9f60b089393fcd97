//! The books: which cells are done, free, or on which lease.

use std::collections::{BTreeSet, HashMap};

use smallvec::SmallVec;

use super::grid::{ImageGrid, TileCells};
use crate::units::{LeaseId, TileId};

/// Nanoseconds since the start.
pub(super) type Nanos = u64;

/// Cells that one worker has promised to do.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lease {
    /// Index of the worker.
    pub slot: u32,
    /// What it still has to do.
    pub cells: TileCells,
    /// When its holder will begin with these cells, or began with them.
    pub start: Nanos,
    /// How long these cells will take; none if nothing is known.
    pub lasts: Option<Nanos>,
    /// When it runs out.
    pub deadline: Nanos,
    /// Whether some of its cells are on another lease, too.
    pub is_raced: bool,
}

impl Lease {
    /// When it will be through; far away if nothing is known.
    pub fn finish(&self) -> Nanos {
        self.start.saturating_add(self.lasts.unwrap_or(Nanos::MAX / 2))
    }
}

#[derive(Clone, Debug)]
struct Tile {
    /// The cells that the books are about: all of the image's, or those of a part of it.
    part: u64,
    done: u64,
    free: u64,
    holders: SmallVec<[LeaseId; 2]>,
}

/// The state of every cell. A cell is done, or free, or on one lease or more (more than one only when
/// raced), and never two of these. Where the books are about a part of the image only, other cells are none of them.
pub(super) struct Ledger {
    grid: ImageGrid,
    tiles: Vec<Tile>,
    leases: HashMap<LeaseId, Lease>,
    /// By the time at which they will be through.
    finishes: BTreeSet<(Nanos, LeaseId)>,
    /// By the time at which they run out.
    deadlines: BTreeSet<(Nanos, LeaseId)>,
    cells: u64,
    cells_done: u64,
    cells_free: u64,
}

impl Ledger {
    /// Books on which `done` (by tile) is done and all the rest is free.
    pub fn new(grid: ImageGrid, done: Option<&[u64]>) -> Ledger {
        let (mut cells, mut cells_done) = (0, 0);
        let tiles = (0..grid.tile_count())
            .map(|tile| {
                let exists = grid.cells_of(TileId(tile));
                let done = done.map_or(0, |done| done[tile as usize]) & exists;
                cells += u64::from(exists.count_ones());
                cells_done += u64::from(done.count_ones());
                Tile { part: exists, done, free: exists & !done, holders: SmallVec::new() }
            })
            .collect();
        Ledger {
            grid,
            tiles,
            leases: HashMap::new(),
            finishes: BTreeSet::new(),
            deadlines: BTreeSet::new(),
            cells,
            cells_done,
            cells_free: cells - cells_done,
        }
    }

    /// Books on no cell yet.
    pub fn empty(grid: ImageGrid) -> Ledger {
        let nothing = Tile { part: 0, done: 0, free: 0, holders: SmallVec::new() };
        let tiles = vec![nothing; grid.tile_count() as usize];
        let (leases, finishes, deadlines) = (HashMap::new(), BTreeSet::new(), BTreeSet::new());
        Ledger { grid, tiles, leases, finishes, deadlines, cells: 0, cells_done: 0, cells_free: 0 }
    }

    /// Takes cells into the books; those that were not there before are free, and are returned.
    pub fn add(&mut self, cells: TileCells) -> TileCells {
        let new = cells.cells & self.grid.cells_of(cells.tile);
        let tile = &mut self.tiles[cells.tile.0 as usize];
        let new = new & !tile.part;
        tile.part |= new;
        tile.free |= new;
        self.cells += u64::from(new.count_ones());
        self.cells_free += u64::from(new.count_ones());
        TileCells { tile: cells.tile, cells: new }
    }

    /// Takes free cells off the books.
    pub fn remove(&mut self, cells: TileCells) {
        let tile = &mut self.tiles[cells.tile.0 as usize];
        let gone = cells.cells & tile.free;
        tile.part &= !gone;
        tile.free &= !gone;
        self.cells -= u64::from(gone.count_ones());
        self.cells_free -= u64::from(gone.count_ones());
    }

    /// The cells of a tile that the books are about.
    pub fn part(&self, tile: TileId) -> u64 {
        self.tiles.get(tile.0 as usize).map_or(0, |tile| tile.part)
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

    pub fn cells_leased(&self) -> u64 {
        self.cells - self.cells_done - self.cells_free
    }

    /// Free cells of a tile; none if the tile does not exist.
    pub fn free(&self, tile: TileId) -> u64 {
        self.tiles.get(tile.0 as usize).map_or(0, |tile| tile.free)
    }

    pub fn done(&self, tile: TileId) -> u64 {
        self.tiles[tile.0 as usize].done
    }

    pub fn lease(&self, id: LeaseId) -> Option<&Lease> {
        self.leases.get(&id)
    }

    /// Leases, the one that will be through last first.
    pub fn latest(&self) -> impl Iterator<Item = (LeaseId, &Lease)> {
        self.finishes.iter().rev().filter_map(|(_, id)| Some((*id, self.leases.get(id)?)))
    }

    /// Leases, the one that will be, or should be, through first first.
    pub fn earliest(&self) -> impl Iterator<Item = (LeaseId, &Lease)> {
        self.finishes.iter().filter_map(|(_, id)| Some((*id, self.leases.get(id)?)))
    }

    /// When the next lease runs out, and which.
    pub fn next_deadline(&self) -> Option<(Nanos, LeaseId)> {
        self.deadlines.first().copied()
    }

    /// Enters a lease. Its cells are free, or, if it is raced, on another lease.
    pub fn open(&mut self, id: LeaseId, lease: Lease) {
        let TileCells { tile, cells } = lease.cells;
        let tile = &mut self.tiles[tile.0 as usize];
        self.cells_free -= u64::from((tile.free & cells).count_ones());
        tile.free &= !cells;
        tile.holders.push(id);
        self.finishes.insert((lease.finish(), id));
        self.deadlines.insert((lease.deadline, id));
        self.leases.insert(id, lease);
    }

    /// Changes times or cells of a lease. Cells that it loses must be done or go to another lease at once.
    pub fn change(&mut self, id: LeaseId, change: impl FnOnce(&mut Lease)) {
        let Some(lease) = self.leases.get_mut(&id) else { return };
        let before = (lease.finish(), lease.deadline);
        change(lease);
        let after = (lease.finish(), lease.deadline);
        if before.0 != after.0 {
            self.finishes.remove(&(before.0, id));
            self.finishes.insert((after.0, id));
        }
        if before.1 != after.1 {
            self.deadlines.remove(&(before.1, id));
            self.deadlines.insert((after.1, id));
        }
    }

    /// Takes a lease off the books; the cells that nobody does any more are free then, and are returned.
    pub fn close(&mut self, id: LeaseId) -> Option<(Lease, TileCells)> {
        let lease = self.leases.remove(&id)?;
        self.finishes.remove(&(lease.finish(), id));
        self.deadlines.remove(&(lease.deadline, id));
        let tile = &mut self.tiles[lease.cells.tile.0 as usize];
        tile.holders.retain(|holder| *holder != id);
        let held = tile.holders.iter().filter_map(|holder| self.leases.get(holder));
        let others = held.fold(0, |cells, lease| cells | lease.cells.cells);
        let freed = lease.cells.cells & !tile.done & !others;
        tile.free |= freed;
        self.cells_free += u64::from(freed.count_ones());
        Some((lease, TileCells { tile: lease.cells.tile, cells: freed }))
    }

    /// Enters cells as done: those that were not done before, and the leases that they were on, which may have nothing left now.
    pub fn finish(&mut self, cells: TileCells) -> (TileCells, SmallVec<[LeaseId; 2]>) {
        let tile = &mut self.tiles[cells.tile.0 as usize];
        let cells = TileCells { tile: cells.tile, cells: cells.cells & tile.part };
        let fresh = cells.cells & !tile.done;
        let were_free = cells.cells & tile.free;
        tile.done |= fresh;
        tile.free &= !cells.cells;
        self.cells_done += u64::from(fresh.count_ones());
        self.cells_free -= u64::from(were_free.count_ones());
        let mut holders = SmallVec::new();
        for id in &tile.holders {
            if let Some(lease) = self.leases.get_mut(id)
                && lease.cells.cells & cells.cells != 0
            {
                lease.cells.cells &= !cells.cells;
                holders.push(*id);
            }
        }
        (TileCells { tile: cells.tile, cells: fresh }, holders)
    }

    #[cfg(test)]
    pub fn lease_count(&self) -> usize {
        self.leases.len()
    }

    /// What must hold between calls; the complaint if it does not.
    #[cfg(test)]
    pub fn check(&self) -> Result<(), String> {
        let (mut done, mut free, mut holders) = (0, 0, 0);
        for (number, tile) in self.tiles.iter().enumerate() {
            let id = TileId(number as u32);
            let mut leased = 0;
            for holder in &tile.holders {
                let lease = self.leases.get(holder).ok_or("a holder that is no lease")?;
                if lease.cells.tile != id || lease.cells.cells == 0 {
                    return Err(format!("{holder:?} holds {:?}", lease.cells));
                }
                if leased & lease.cells.cells != 0 && !lease.is_raced {
                    return Err(format!("cells of {id:?} are held twice and not raced"));
                }
                leased |= lease.cells.cells;
            }
            let sets = [tile.done, tile.free, leased];
            let union = sets.iter().fold(0, |union, set| union | set);
            let sum: u32 = sets.iter().map(|set| set.count_ones()).sum();
            if union != tile.part || union & !self.grid.cells_of(id) != 0 || sum != union.count_ones() {
                return Err(format!("{id:?}: done {:x} free {:x} leased {:x}", sets[0], sets[1], sets[2]));
            }
            done += u64::from(tile.done.count_ones());
            free += u64::from(tile.free.count_ones());
            holders += tile.holders.len();
        }
        if (done, free) != (self.cells_done, self.cells_free) {
            return Err("the sums are wrong".to_string());
        }
        let lists = [self.leases.len(), self.finishes.len(), self.deadlines.len()];
        if lists.iter().any(|count| *count != holders) {
            return Err(format!("{holders} holders, but {lists:?} leases"));
        }
        let ordered = self.leases.iter().all(|(id, lease)| {
            self.finishes.contains(&(lease.finish(), *id)) && self.deadlines.contains(&(lease.deadline, *id))
        });
        if ordered { Ok(()) } else { Err("a lease is out of order".to_string()) }
    }
}
