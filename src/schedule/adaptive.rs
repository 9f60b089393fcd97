//! The scheduler: books, estimates and a policy put together.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::time::Duration;

use super::affinity::Affinity;
use super::checkpoint::ScheduleCheckpoint;
use super::cost::CostMap;
use super::crew::Crew;
use super::estimates::{Estimates, nanos};
use super::grid::{ImageGrid, TileCells};
use super::ledger::{Lease, Ledger, Nanos};
use super::options::{PieceChoice, SchedulerOptions, TilePolicy};
use super::parts::{PartCells, PartRest};
use super::policy::{CentralPolicy, CurvePolicy, Policy, RowsPolicy, View, first_cells};
use super::scheduler::{
    Answer, Assignment, Notice, Receipt, ScheduleProgress, Spent, TileResult, TileScheduler,
};
use crate::error::ScheduleError;
use crate::units::{LeaseId, TileId, WorkerId};

/// The library's [`TileScheduler`]; what it does is chosen by [`SchedulerOptions`].
///
/// A decision takes time logarithmic in tiles, workers and leases (`cargo bench --bench schedule`).
pub struct AdaptiveScheduler {
    options: SchedulerOptions,
    ledger: Ledger,
    /// Whether it is for parts of an image, and whether cells may still be granted.
    is_part: bool,
    is_open: bool,
    /// Of a scheduler for parts: expected work of what was free when it was last reckoned, and how many cells that were.
    free: (f64, u64),
    costs: CostMap,
    /// Who holds which blocks, if that is to matter.
    affinity: Option<Affinity>,
    crew: Crew,
    policy: Box<dyn Policy>,
    /// Workers that were told to wait, by index.
    waiting: BTreeSet<u32>,
    /// When those that wait may look again for a lease to take over.
    retry: Nanos,
    notices: VecDeque<Notice>,
    /// How often leases of a tile ran out.
    losses: HashMap<TileId, u32>,
    epoch: u32,
    now: Nanos,
    counts: ScheduleProgress,
}

/// How often, and how many of those that wait look for a lease to take over.
const RETRY: Nanos = 20_000_000;
const RETRY_COUNT: u32 = 8;

/// So many leases are looked at for one to take over, from either end of their order.
const LOOKED_AT: usize = 16;

impl AdaptiveScheduler {
    /// A scheduler for an image of `width` by `height` pixels of which nothing is done.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for sizes or options that make no sense.
    pub fn new(
        width: u32,
        height: u32,
        options: SchedulerOptions,
    ) -> Result<AdaptiveScheduler, ScheduleError> {
        options.validate()?;
        let grid = ImageGrid::new(width, height, options.tile_side, options.cell_side)?;
        Ok(AdaptiveScheduler::start(Ledger::new(grid, None), options, 0))
    }

    /// Goes on from a checkpoint: what is done there is not handed out again. Tile and cell sides are those of the checkpoint.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for options that make no sense.
    pub fn restore(
        checkpoint: &ScheduleCheckpoint,
        options: SchedulerOptions,
    ) -> Result<AdaptiveScheduler, ScheduleError> {
        let grid = checkpoint.grid.clone();
        let options =
            SchedulerOptions { tile_side: grid.tile_side(), cell_side: grid.cell_side(), ..options };
        options.validate()?;
        // Leases from before are never taken for new ones.
        let epoch = checkpoint.epoch.wrapping_add(1);
        Ok(AdaptiveScheduler::start(Ledger::new(grid, Some(&checkpoint.done)), options, epoch))
    }

    fn start(ledger: Ledger, options: SchedulerOptions, epoch: u32) -> AdaptiveScheduler {
        let central = |points, weight| CentralPolicy::new(&ledger, points, weight, options.expected_workers);
        let policy: Box<dyn Policy> = match options.policy {
            TilePolicy::Rows => Box::new(RowsPolicy::new(&ledger)),
            TilePolicy::Nearest(points) => Box::new(central(points, 0.0)),
            TilePolicy::TradeOff { points, weight } => Box::new(central(points, weight)),
            TilePolicy::Curve => Box::new(CurvePolicy::new(&ledger, options.expected_workers)),
        };
        AdaptiveScheduler {
            costs: CostMap::new(ledger.grid()),
            affinity: (options.piece_choice == PieceChoice::Held).then(|| Affinity::new(ledger.grid())),
            options,
            ledger,
            is_part: false,
            is_open: false,
            free: (0.0, 0),
            crew: Crew::default(),
            policy,
            waiting: BTreeSet::new(),
            retry: 0,
            notices: VecDeque::new(),
            losses: HashMap::new(),
            epoch,
            now: 0,
            counts: ScheduleProgress::default(),
        }
    }

    /// A scheduler for a part of an image, which is empty at first: it is [granted](AdaptiveScheduler::grant) cells and may be told
    /// to [give some up](AdaptiveScheduler::give_up). Until it is told of the [end](AdaptiveScheduler::end), a worker for whom there is
    /// nothing waits. Sizes in the options count for the part.
    ///
    /// # Errors
    /// As for [`AdaptiveScheduler::new`].
    pub fn for_parts(
        width: u32,
        height: u32,
        options: SchedulerOptions,
    ) -> Result<AdaptiveScheduler, ScheduleError> {
        options.validate()?;
        let grid = ImageGrid::new(width, height, options.tile_side, options.cell_side)?;
        let start = AdaptiveScheduler::start(Ledger::empty(grid), options, 0);
        Ok(AdaptiveScheduler { is_part: true, is_open: true, ..start })
    }

    /// Cells are to be done here from now on; cells that are the scheduler's already, or that the image does not have, are passed over.
    pub fn grant(&mut self, cells: &[PartCells], now: Duration) {
        self.advance(now);
        let tile_count = self.ledger.grid().tile_count();
        let exist = cells.iter().filter(|part| part.cells.tile.0 < tile_count);
        let mut new: Vec<TileCells> = exist.clone().map(|part| self.ledger.add(part.cells)).collect();
        for PartCells { cells, work } in exist.copied() {
            // It counts as much as one cell that was done there.
            let cell = work / f64::from(cells.count().max(1));
            if cell.is_finite() && cell > 0.0 {
                self.costs.record(self.ledger.grid(), TileCells { tile: cells.tile, cells: 1 }, cell);
            }
        }
        new.retain(|cells| !cells.is_empty());
        new.sort_by_key(|cells| cells.tile);
        // Of each tile once.
        new.dedup_by(|next, kept| {
            let is_same = next.tile == kept.tile;
            if is_same {
                kept.cells |= next.cells;
            }
            is_same
        });
        self.policy.granted(&new, self.crew.len() as u32);
        self.reckon_free(true);
        let count: u64 = new.iter().map(|cells| u64::from(cells.count())).sum();
        self.wake(u32::try_from(count).unwrap_or(u32::MAX));
    }

    /// Parts with cells that nobody has begun with: about this share, 0 to 1, of the work that is free, from the end of the curve. They are
    /// not to be done here any more. In the order of the curve; at least one cell if one is free and the share is not 0.
    pub fn give_up(&mut self, share: f64, now: Duration) -> Vec<TileCells> {
        self.advance(now);
        let mut left = share.clamp(0.0, 1.0) * self.free_work();
        let takes_all = share >= 1.0;
        let mut given = Vec::new();
        let mut from = 0;
        for tile in (0..self.ledger.grid().tile_count()).rev().map(TileId) {
            let free = self.ledger.free(tile);
            if free == 0 {
                continue;
            }
            let is_enough = !takes_all && left <= 0.0 && (share <= 0.0 || !given.is_empty());
            if self.ledger.cells_free() == 0 || is_enough {
                break;
            }
            let cell = self.estimates().cell_work(tile);
            // Cells that cost nothing go by the tile.
            let wanted = if takes_all || cell <= 0.0 { 64.0 } else { (left / cell).ceil().max(1.0) };
            let kept = free.count_ones().saturating_sub(wanted as u32);
            let cells = free & !first_cells(free, kept, true);
            left -= f64::from(cells.count_ones()) * cell;
            from = u64::from(tile.0) * u64::from(self.ledger.grid().cells_per_tile())
                + u64::from(cells.trailing_zeros());
            self.ledger.remove(TileCells { tile, cells });
            given.push(TileCells { tile, cells });
            // Behind cells that stay, nothing is taken.
            if kept > 0 {
                break;
            }
        }
        if !given.is_empty() {
            self.policy.withdrawn(from);
        }
        given.reverse();
        self.reckon_free(true);
        given
    }

    /// Every cell of the image is done, here or elsewhere: nobody needs to go on.
    pub fn end(&mut self, now: Duration) {
        self.advance(now);
        self.is_open = false;
        for tile in (0..self.ledger.grid().tile_count()).map(TileId) {
            let cells = self.ledger.part(tile) & !self.ledger.done(tile);
            let (_, holders) = self.ledger.finish(TileCells { tile, cells });
            holders.into_iter().for_each(|id| self.shorten(id));
        }
        self.wake(u32::MAX);
    }

    /// What is left to hand out.
    pub fn rest(&self) -> PartRest {
        let workers = self.crew.len() as u32;
        let cells = self.ledger.cells_free();
        let speed = self.estimates().mean_speed() * f64::from(workers);
        // Speeds that are not known cannot be set against costs that others have told.
        let is_known = self.ledger.cells_done() > 0 && self.costs.mean().is_some();
        let (work, speed) = if is_known { (self.free_work(), speed) } else { (0.0, 0.0) };
        PartRest { cells, cells_leased: self.ledger.cells_leased(), workers, work, speed }
    }

    /// Expected work of what is free, tile by tile, is reckoned anew where parts come and go (`changed`), and when an eighth of it is gone.
    fn reckon_free(&mut self, changed: bool) {
        let cells = self.ledger.cells_free();
        let (_, at) = self.free;
        if !self.is_part || !changed && cells.abs_diff(at) * 8 <= at {
            return;
        }
        let tiles = (0..self.ledger.grid().tile_count()).map(TileId);
        let free = tiles.map(|tile| (tile, self.ledger.free(tile))).filter(|(_, free)| *free != 0);
        let estimates = self.estimates();
        let work = free.map(|(tile, free)| f64::from(free.count_ones()) * estimates.cell_work(tile)).sum();
        self.free = (work, cells);
    }

    /// Expected work of what is free, of a scheduler for parts.
    fn free_work(&self) -> f64 {
        let (work, at) = self.free;
        work * self.ledger.cells_free() as f64 / at.max(1) as f64
    }

    /// What a cell of a tile is expected to cost; none if nothing is known.
    pub(super) fn cost(&self, tile: TileId) -> Option<f64> {
        self.costs.estimate(self.ledger.grid(), tile)
    }

    /// The cells of a tile that are to be done here, or were.
    pub(super) fn part(&self, tile: TileId) -> u64 {
        self.ledger.part(tile)
    }

    fn advance(&mut self, now: Duration) {
        self.now = self.now.max(nanos(now));
    }

    fn estimates(&self) -> Estimates<'_> {
        let free_work = self.is_part.then(|| self.free_work());
        let AdaptiveScheduler { options, ledger, costs, crew, .. } = self;
        Estimates { options, ledger, costs, crew, free_work }
    }

    /// When a worker's lease of some cells would begin, end, and run out.
    fn times(&self, slot: u32, cells: TileCells, start: Nanos) -> (Option<Nanos>, Nanos) {
        let losses = self.losses.get(&cells.tile).copied().unwrap_or(0);
        let lasts = self.estimates().lasts(slot, cells);
        (lasts, self.estimates().deadline(start, lasts, losses))
    }

    /// Enters a lease and makes the assignment.
    fn assign(&mut self, slot: u32, cells: TileCells, is_raced: bool) -> Answer {
        // It begins with these when it is through with what it has.
        let last = self.crew.get(slot).and_then(|worker| worker.leases.last());
        let last = last.and_then(|last| self.ledger.lease(*last));
        let start = last.filter(|last| last.lasts.is_some()).map_or(0, Lease::finish).max(self.now);
        let (lasts, deadline) = self.times(slot, cells, start);
        let id = LeaseId(u64::from(self.epoch) << 40 | self.counts.leases);
        self.counts.leases += 1;
        self.ledger.open(id, Lease { slot, cells, start, lasts, deadline, is_raced });
        if let Some(worker) = self.crew.get_mut(slot) {
            worker.leases.push(id);
        }
        let stop_after = self.estimates().critical_time(slot, cells.tile);
        Answer::Assign(Assignment { lease: id, cells, stop_after })
    }

    /// Takes a lease off the books. What is free then is the policy's again.
    fn close(&mut self, id: LeaseId) {
        let Some((lease, freed)) = self.ledger.close(id) else { return };
        if let Some(worker) = self.crew.get_mut(lease.slot) {
            worker.leases.retain(|held| *held != id);
        }
        if !freed.is_empty() {
            self.policy.freed(freed);
            self.wake(freed.count());
        }
    }

    /// Wakes some of those that wait.
    fn wake(&mut self, count: u32) {
        for _ in 0..count {
            let Some(slot) = self.waiting.pop_first() else { return };
            if let Some(worker) = self.crew.get(slot) {
                self.notices.push_back(Notice::Wake { worker: worker.id });
            }
        }
    }

    /// Tells a holder what is left of its lease; a lease with nothing left is closed.
    fn shorten(&mut self, id: LeaseId) {
        let Some(lease) = self.ledger.lease(id) else { return };
        let keep = lease.cells;
        if let Some(worker) = self.crew.get(lease.slot) {
            self.notices.push_back(Notice::Shorten { worker: worker.id, lease: id, keep });
        }
        if keep.is_empty() {
            self.close(id);
        }
    }

    /// Work for an idle worker when nothing is free: part of a lease that another holds, or all of one that is overdue.
    fn take_over(&mut self, slot: u32) -> Option<Answer> {
        let estimates = self.estimates();
        // The ones that will be through last, and the ones that should have been through first.
        let others = || {
            let ends = self.ledger.latest().take(LOOKED_AT).chain(self.ledger.earliest().take(LOOKED_AT));
            ends.filter(|(_, lease)| lease.slot != slot)
        };
        let cuts = others().filter_map(|(id, lease)| {
            let (cells, gain) = estimates.cut(slot, id, lease, self.now)?;
            Some((gain, id, cells))
        });
        if let Some((_, id, cells)) = cuts.max_by_key(|(gain, id, _)| (*gain, *id)) {
            self.ledger.change(id, |lease| {
                let before = lease.cells.count();
                lease.cells.cells &= !cells.cells;
                let part = f64::from(lease.cells.count()) / f64::from(before);
                // One that is overdue stays so.
                lease.lasts = lease.lasts.map(|lasts| (lasts as f64 * part) as Nanos);
            });
            self.counts.leases_cut += 1;
            let answer = self.assign(slot, cells, false);
            self.shorten(id);
            return Some(answer);
        }
        let patience = nanos(self.options.take_over_min);
        let is_late = |lease: &Lease| {
            let lasts = lease.lasts.unwrap_or(RETRY).max(patience);
            self.now > lease.start.saturating_add(lasts.saturating_mul(3))
        };
        let (id, cells) = others()
            .find(|(_, lease)| !lease.is_raced && is_late(lease))
            .map(|(id, lease)| (id, lease.cells))?;
        self.ledger.change(id, |lease| lease.is_raced = true);
        self.counts.leases_raced += 1;
        Some(self.assign(slot, cells, true))
    }

    /// The estimates for what a worker holds start anew: it begins with the first now.
    fn reckon(&mut self, slot: u32) {
        let leases = self.crew.get(slot).map(|worker| worker.leases.clone()).unwrap_or_default();
        let mut start = self.now;
        for id in leases {
            let Some(cells) = self.ledger.lease(id).map(|lease| lease.cells) else { continue };
            let (lasts, deadline) = self.times(slot, cells, start);
            self.ledger.change(id, |lease| {
                (lease.start, lease.lasts, lease.deadline) = (start, lasts, deadline);
            });
            start = start.saturating_add(lasts.unwrap_or(0));
        }
    }

    /// Takes down what cells cost, and how fast the worker was.
    fn learn(&mut self, slot: Option<u32>, all: TileCells, fresh: TileCells, spent: Spent) {
        let sound = |number: f64| if number.is_finite() && number > 0.0 { number } else { 0.0 };
        let (seconds, counted) = (sound(spent.seconds), sound(spent.work));
        let work = if counted > 0.0 { counted } else { seconds * self.crew.mean_speed().unwrap_or(1.0) };
        if !fresh.is_empty() {
            let part = f64::from(fresh.count()) / f64::from(all.count());
            self.costs.record(self.ledger.grid(), fresh, work * part);
        }
        if let Some(slot) = slot
            && counted > 0.0
        {
            self.crew.learn(slot, counted, seconds);
        }
    }
}

impl TileScheduler for AdaptiveScheduler {
    fn grid(&self) -> &ImageGrid {
        self.ledger.grid()
    }

    fn join(&mut self, worker: WorkerId, now: Duration) {
        self.advance(now);
        if let Some(slot) = self.crew.join(worker) {
            self.policy.join(slot, &self.ledger);
            if let Some(affinity) = &mut self.affinity {
                affinity.join(slot);
            }
        }
    }

    fn leave(&mut self, worker: WorkerId, now: Duration) {
        self.advance(now);
        let Some((slot, gone)) = self.crew.leave(worker) else { return };
        self.waiting.remove(&slot);
        self.policy.leave(slot);
        for id in gone.leases {
            self.counts.leases_lost += 1;
            self.close(id);
        }
    }

    fn request(&mut self, worker: WorkerId, now: Duration) -> Result<Answer, ScheduleError> {
        self.advance(now);
        let slot = self.crew.slot(worker).ok_or(ScheduleError::UnknownWorker { worker: worker.0 })?;
        self.waiting.remove(&slot);
        self.reckon_free(false);
        if self.is_finished() {
            return Ok(Answer::Done);
        }
        let holds = self.crew.get(slot).map_or(0, |worker| worker.leases.len());
        if holds < self.options.leases_in_hand_max as usize && self.ledger.cells_free() > 0 {
            let free_work = self.is_part.then(|| self.free_work());
            let AdaptiveScheduler { options, ledger, costs, affinity, crew, policy, .. } = self;
            let (ledger, costs) = (&*ledger, &*costs);
            let estimates = Estimates { options, ledger, costs, crew, free_work };
            let cells_max = |tile| estimates.cells_max(slot, tile);
            let affinity = affinity.as_ref();
            let view = View { ledger, costs, affinity, slot, cells_max: &cells_max };
            if let Some(cells) = policy.pick(&view) {
                return Ok(self.assign(slot, cells, false));
            }
        }
        // One that still has work is not idle.
        if self.options.take_over
            && holds == 0
            && let Some(answer) = self.take_over(slot)
        {
            return Ok(answer);
        }
        self.waiting.insert(slot);
        self.retry = self.now.saturating_add(RETRY);
        Ok(Answer::Wait)
    }

    fn complete(
        &mut self,
        worker: WorkerId,
        result: &TileResult,
        now: Duration,
    ) -> Result<Receipt, ScheduleError> {
        self.advance(now);
        let TileCells { tile, cells } = result.cells;
        let tile_count = self.ledger.grid().tile_count();
        // No cells at all are a lease's end, but only of a tile that exists.
        if tile.0 >= tile_count || cells & !self.ledger.grid().cells_of(tile) != 0 {
            return Err(ScheduleError::NoSuchCells { tile: tile.0, cells, tile_count });
        }
        let slot = self.crew.slot(worker);
        let (fresh, holders) = self.ledger.finish(result.cells);
        self.learn(slot, result.cells, fresh, result.spent);
        if let Some(affinity) = &mut self.affinity {
            affinity.record(slot, self.ledger.grid(), tile, &result.blocks);
        }
        // The lease is the worker's own, not one of the same number from elsewhere.
        let own = self.ledger.lease(result.lease).is_some_and(|lease| Some(lease.slot) == slot);
        for id in holders.into_iter().filter(|id| !own || *id != result.lease) {
            // What is left may be nothing; then its holder may stop.
            self.shorten(id);
        }
        if own
            && let Some(lease) = self.ledger.lease(result.lease)
            && (result.is_last || lease.cells.is_empty())
        {
            self.close(result.lease);
        }
        // The first result says what cells cost.
        self.reckon_free(self.ledger.cells_done() == u64::from(fresh.count()));
        if let Some(slot) = slot {
            self.reckon(slot);
            // It may have asked while it held all that it may.
            if self.waiting.remove(&slot) {
                self.notices.push_back(Notice::Wake { worker });
            }
        }
        if self.is_finished() {
            self.wake(u32::MAX);
        }
        let repeated = result.cells.count() - fresh.count();
        self.counts.cells_repeated += u64::from(repeated);
        Ok(Receipt { fresh, repeated })
    }

    fn tick(&mut self, now: Duration) {
        self.advance(now);
        while let Some((deadline, id)) = self.ledger.next_deadline() {
            if deadline > self.now {
                break;
            }
            if let Some(lease) = self.ledger.lease(id) {
                *self.losses.entry(lease.cells.tile).or_default() += 1;
            }
            self.counts.leases_lost += 1;
            self.close(id);
        }
        if self.options.take_over && self.now >= self.retry {
            self.wake(RETRY_COUNT);
            self.retry = self.now.saturating_add(RETRY);
        }
    }

    fn next_tick(&self) -> Option<Duration> {
        let (deadline, _) = self.ledger.next_deadline()?;
        let retries = self.options.take_over && !self.waiting.is_empty();
        let next = if retries { deadline.min(self.retry) } else { deadline };
        Some(Duration::from_nanos(next))
    }

    fn notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }

    fn is_finished(&self) -> bool {
        !self.is_open && self.ledger.cells_done() == self.ledger.cells()
    }

    fn progress(&self) -> ScheduleProgress {
        let (cells, cells_done) = (self.ledger.cells(), self.ledger.cells_done());
        ScheduleProgress {
            cells,
            cells_done,
            cells_leased: self.ledger.cells_leased(),
            workers: self.crew.len() as u32,
            ..self.counts
        }
    }

    fn checkpoint(&self) -> ScheduleCheckpoint {
        let tiles = 0..self.ledger.grid().tile_count();
        ScheduleCheckpoint {
            grid: self.ledger.grid().clone(),
            epoch: self.epoch,
            done: tiles.map(|tile| self.ledger.done(TileId(tile))).collect(),
        }
    }
}

#[cfg(test)]
impl AdaptiveScheduler {
    /// What must hold between calls; the complaint if it does not.
    pub(super) fn check(&self) -> Result<(), String> {
        self.ledger.check()?;
        let held: usize = self.crew.workers().map(|worker| worker.leases.len()).sum();
        if held != self.ledger.lease_count() {
            return Err(format!("{held} leases are held, {} are on the books", self.ledger.lease_count()));
        }
        Ok(())
    }
}

impl std::fmt::Debug for AdaptiveScheduler {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AdaptiveScheduler").finish_non_exhaustive()
    }
}
