//! What is expected: how long cells take, how many a worker should get, where a lease is best cut.

use std::time::Duration;

use super::cost::CostMap;
use super::crew::Crew;
use super::grid::TileCells;
use super::ledger::{Lease, Ledger, Nanos};
use super::options::SchedulerOptions;
use super::policy::first_cells;
use crate::units::{LeaseId, TileId};

/// Estimates from what was done so far. Before the first result every cell counts one unit of work.
pub(super) struct Estimates<'a> {
    pub options: &'a SchedulerOptions,
    pub ledger: &'a Ledger,
    pub costs: &'a CostMap,
    pub crew: &'a Crew,
    /// Work that nobody has begun with, where it is known better than by the mean.
    pub free_work: Option<f64>,
}

impl Estimates<'_> {
    pub fn mean_speed(&self) -> f64 {
        self.crew.mean_speed().unwrap_or(1.0)
    }

    /// Work per second of a worker: its own, or as the others.
    pub fn speed(&self, slot: u32) -> f64 {
        let own = self.crew.speed(slot).filter(|_| self.options.learn_speeds);
        own.unwrap_or_else(|| self.mean_speed())
    }

    /// Work per second of all together.
    fn total_speed(&self) -> f64 {
        self.mean_speed() * self.crew.len().max(1) as f64
    }

    pub fn cell_work(&self, tile: TileId) -> f64 {
        self.costs.estimate(self.ledger.grid(), tile).unwrap_or(1.0)
    }

    /// Work that is not done yet, by the mean of what is.
    fn work_left(&self) -> f64 {
        let mean = self.costs.mean().unwrap_or(1.0);
        match self.free_work {
            Some(free) => free + self.ledger.cells_leased() as f64 * mean,
            None => (self.ledger.cells() - self.ledger.cells_done()) as f64 * mean,
        }
    }

    /// Most cells of `tile` that a worker may get now.
    pub fn cells_max(&self, slot: u32, tile: TileId) -> u32 {
        let options = self.options;
        let per_tile = self.ledger.grid().cells_per_tile();
        let mut most = f64::from(per_tile);
        if options.tiles_per_worker > 0 {
            let workers = self.crew.len().max(options.expected_workers as usize) as f64;
            most = most.min(self.ledger.cells() as f64 / workers / f64::from(options.tiles_per_worker));
        }
        // Cells that cost nothing are handed out by the tile.
        if let Some(cell) = Some(self.cell_work(tile)).filter(|cell| *cell > 0.0) {
            if options.share_of_rest > 0.0 {
                let share = self.work_left() * self.speed(slot) / self.total_speed() * options.share_of_rest;
                most = most.min(share / cell);
            }
            if self.costs.mean().is_some() {
                most = most.max(options.hand_out_min.as_secs_f64() * self.speed(slot) / cell);
            }
        }
        (most as u32).clamp(1, per_tile)
    }

    /// Expected time of cells for a worker; none if nothing is known.
    pub fn lasts(&self, slot: u32, cells: TileCells) -> Option<Nanos> {
        let cell = self.costs.estimate(self.ledger.grid(), cells.tile)?;
        Some(nanos_of_seconds(f64::from(cells.count()) * cell / self.speed(slot)))
    }

    /// When a lease runs out that starts at `start`, if leases of its tile ran out so many times before: each time lasts twice as long.
    pub fn deadline(&self, start: Nanos, lasts: Option<Nanos>, losses: u32) -> Nanos {
        let expected = lasts.unwrap_or(0) as f64 * self.options.lease_factor;
        let lasts = nanos(self.options.lease_min).max(expected as Nanos);
        start.saturating_add(lasts.saturating_mul(1 << losses.min(20)))
    }

    /// When, by the estimates, the others have nothing left to do; at least the time of one cell.
    pub fn critical_time(&self, slot: u32, tile: TileId) -> Duration {
        if !self.options.critical_time || self.costs.mean().is_none() {
            return Duration::MAX;
        }
        let cell = self.cell_work(tile) / self.speed(slot);
        Duration::from_nanos(nanos_of_seconds((self.work_left() / self.total_speed()).max(cell)))
    }

    /// When a lease's holder begins, or began, with it. One that stands behind another lease of its holder does not begin before that is
    /// through; and if that should be through already, it takes half as long again as it has.
    fn begins(&self, id: LeaseId, lease: &Lease, now: Nanos) -> Nanos {
        let first = self.crew.get(lease.slot).and_then(|worker| worker.leases.first().copied());
        match first.filter(|first| *first != id).and_then(|first| self.ledger.lease(first)) {
            None => lease.start,
            Some(first) if first.finish() > now => lease.start.max(first.finish()),
            Some(first) => now.saturating_add(now.saturating_sub(first.start) / 2).max(now + 1),
        }
    }

    /// The back of a lease, such that its holder and the worker `slot` end at the same time, and how long the worker will have to
    /// do with it. None if that is not worth while.
    pub fn cut(&self, slot: u32, id: LeaseId, lease: &Lease, now: Nanos) -> Option<(TileCells, Nanos)> {
        if lease.is_raced {
            return None;
        }
        let count = f64::from(lease.cells.count());
        let [holder, own] = [lease.slot, slot].map(|slot| self.speed(slot));
        let start = self.begins(id, lease, now);
        let spent = now.saturating_sub(start) as f64;
        let (keep, own_cell) = match lease.lasts {
            Some(lasts) if start.saturating_add(lasts) > now => {
                let cell = (lasts as f64 / count).max(1.0);
                let own_cell = cell * holder / own;
                let wait = start.saturating_sub(now) as f64;
                // wait + keep * cell - spent = (count - keep) * own_cell
                let equal = ((count * own_cell + spent - wait) / (cell + own_cell)).ceil();
                // The cell that the holder is at stays with it.
                let at = if wait > 0.0 { 0.0 } else { (spent / cell).floor() + 1.0 };
                (equal.max(at), own_cell)
            }
            // It should be through, or nothing is known: it may be anywhere. What has lasted long will last long; and if the holder
            // is beyond the middle already, it is through as soon as it hears, and little is done twice.
            _ => ((count * holder / (holder + own)).ceil(), spent / count * holder / own),
        };
        let keep = keep.clamp(0.0, count);
        let gain = (count - keep) * own_cell;
        if keep == count || gain < nanos(self.options.take_over_min) as f64 {
            return None;
        }
        let kept = first_cells(lease.cells.cells, keep as u32, true);
        let cells = TileCells { tile: lease.cells.tile, cells: lease.cells.cells & !kept };
        Some((cells, gain as Nanos))
    }
}

pub(super) fn nanos(time: Duration) -> Nanos {
    Nanos::try_from(time.as_nanos()).unwrap_or(Nanos::MAX)
}

fn nanos_of_seconds(seconds: f64) -> Nanos {
    // Saturates.
    (seconds * 1e9) as Nanos
}
