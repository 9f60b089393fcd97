//! The top coordinator's scheduler.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::time::Duration;

use super::book::PartBook;
use super::messages::{PartCells, PartNotice, PartOptions, PartProgress, PartReport, PartRest};
use crate::error::ScheduleError;
use crate::schedule::checkpoint::ScheduleCheckpoint;
use crate::schedule::cost::CostMap;
use crate::schedule::estimates::nanos;
use crate::schedule::grid::{ImageGrid, TileCells};
use crate::schedule::ledger::Nanos;
use crate::units::{SubCoordinatorId, TileId};

/// Gives parts of the image to sub-coordinators. See the [module](super).
///
/// Time is counted from any start and never runs backward, as for a [`TileScheduler`](crate::TileScheduler).
pub struct PartScheduler {
    options: PartOptions,
    book: PartBook,
    costs: CostMap,
    slots: HashMap<SubCoordinatorId, u32>,
    subs: Vec<Option<Sub>>,
    vacant: Vec<u32>,
    /// How many have joined so far.
    joined: u32,
    /// Those that have something to give up and were not told to, by when they would be through.
    ends: BTreeSet<(Nanos, u32)>,
    /// Those that have asked and got nothing, the first one first.
    waiting: VecDeque<u32>,
    /// When those that wait may look at sub-coordinators that should be through.
    retry: Nanos,
    notices: VecDeque<(SubCoordinatorId, PartNotice)>,
    epoch: u32,
    now: Nanos,
    counts: PartProgress,
}

struct Sub {
    id: SubCoordinatorId,
    /// Where it gets its next cells, as a number along the curve.
    next: u64,
    /// Cells that are its and not done.
    owned: u64,
    rest: PartRest,
    /// When it will be through with its rest.
    end: Nanos,
    /// For whom it was told to give up a part, and has not answered.
    gives_to: Option<u32>,
    /// When it was last told to although it should be through.
    tried: Nanos,
}

/// How often those that wait look at sub-coordinators that should be through.
const RETRY: Nanos = 20_000_000;

/// So many sub-coordinators are looked at for one that has enough to give.
const LOOKED_AT: usize = 16;

/// An end that is not known: later than any that is.
const UNKNOWN: Nanos = Nanos::MAX / 2;

/// Cells that nobody has are given in portions of so many for each worker, at least.
const CELLS_PER_WORKER: u64 = 2;

impl PartScheduler {
    /// A scheduler for an image of which nothing is done.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for options that make no sense.
    pub fn new(grid: ImageGrid, options: PartOptions) -> Result<PartScheduler, ScheduleError> {
        options.validate()?;
        Ok(PartScheduler::start(PartBook::new(grid, None), options, 0))
    }

    /// Goes on from a checkpoint: what is done there is not given to anybody again.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for options that make no sense.
    pub fn restore(
        checkpoint: &ScheduleCheckpoint,
        options: PartOptions,
    ) -> Result<PartScheduler, ScheduleError> {
        options.validate()?;
        let book = PartBook::new(checkpoint.grid.clone(), Some(&checkpoint.done));
        Ok(PartScheduler::start(book, options, checkpoint.epoch.wrapping_add(1)))
    }

    fn start(book: PartBook, options: PartOptions, epoch: u32) -> PartScheduler {
        PartScheduler {
            options,
            costs: CostMap::new(book.grid()),
            book,
            slots: HashMap::new(),
            subs: Vec::new(),
            vacant: Vec::new(),
            joined: 0,
            ends: BTreeSet::new(),
            waiting: VecDeque::new(),
            retry: 0,
            notices: VecDeque::new(),
            epoch,
            now: 0,
            counts: PartProgress::default(),
        }
    }

    /// The image's cells.
    pub fn grid(&self) -> &ImageGrid {
        self.book.grid()
    }

    /// A sub-coordinator takes part from now on: it has no part yet, and so many workers. It need not ask for its first part.
    /// Telling it twice does nothing.
    pub fn join(&mut self, id: SubCoordinatorId, workers: u32, now: Duration) {
        self.advance(now);
        if self.slots.contains_key(&id) {
            return;
        }
        let slot = self.vacant.pop().unwrap_or_else(|| {
            self.subs.push(None);
            self.subs.len() as u32 - 1
        });
        let equal = |number: u32| {
            (u128::from(self.last_number()) * u128::from(number) / u128::from(self.options.expected)) as u64
        };
        let place = self.joined % self.options.expected;
        let (start, end) = (equal(place), equal(place + 1));
        let rest = PartRest { workers, ..PartRest::default() };
        let sub = Sub { id, next: start, owned: 0, rest, end: 0, gives_to: None, tried: 0 };
        self.subs[slot as usize] = Some(sub);
        self.slots.insert(id, slot);
        if self.joined < self.options.expected {
            let share = (end - start) as f64 * self.options.first_share;
            self.give(slot, share.ceil() as u64);
        }
        self.joined = self.joined.saturating_add(1);
        if self.is_finished() {
            self.notices.push_back((id, PartNotice::Finished));
        } else if self.sub(slot).is_some_and(|sub| sub.owned == 0) {
            self.waiting.push_back(slot);
            self.serve();
        }
    }

    /// A sub-coordinator is gone, or was given up. What it had not done is nobody's; reports that it sent before still count when
    /// they arrive.
    pub fn leave(&mut self, id: SubCoordinatorId, now: Duration) {
        self.advance(now);
        let Some(slot) = self.slots.remove(&id) else { return };
        let Some(gone) = self.subs[slot as usize].take() else { return };
        self.vacant.push(slot);
        self.ends.remove(&(gone.end, slot));
        self.waiting.retain(|waiting| *waiting != slot);
        for other in self.subs.iter_mut().flatten() {
            // What is given up for one that is gone is nobody's.
            other.gives_to = other.gives_to.map(|to| if to == slot { NOBODY } else { to });
        }
        self.book.abandon(slot);
        self.waiting.extend(gone.gives_to.filter(|to| *to != NOBODY));
        self.serve();
    }

    /// A sub-coordinator reports. The cells that were not done before, tile by tile: only these count, and each counts once. Of one that
    /// does not take part, or not any more, only these are looked at.
    ///
    /// # Errors
    /// [`ScheduleError::NoSuchCells`] for cells that the image does not have; nothing of the report then counts.
    pub fn report(
        &mut self,
        id: SubCoordinatorId,
        report: &PartReport,
        now: Duration,
    ) -> Result<Vec<TileCells>, ScheduleError> {
        self.advance(now);
        let done = report.done.iter().map(|part| part.cells);
        for TileCells { tile, cells } in done.chain(report.given_up.iter().flatten().copied()) {
            if cells & !self.grid().cells_of(tile) != 0 || tile.0 >= self.grid().tile_count() {
                let tile_count = self.grid().tile_count();
                return Err(ScheduleError::NoSuchCells { tile: tile.0, cells, tile_count });
            }
        }
        let mut all = Vec::new();
        for PartCells { cells, work } in report.done.iter().copied() {
            let (fresh, losses) = self.book.finish(cells);
            for (owner, lost) in losses {
                if let Some(sub) = self.subs[owner as usize].as_mut() {
                    sub.owned -= u64::from(lost);
                }
            }
            self.counts.cells_repeated += u64::from(cells.count() - fresh.count());
            if !fresh.is_empty() {
                let part = f64::from(fresh.count()) / f64::from(cells.count());
                if work.is_finite() && work > 0.0 {
                    self.costs.record(self.book.grid(), fresh, work * part);
                }
                all.push(fresh);
            }
        }
        if self.is_finished() {
            if !all.is_empty() {
                self.notices.clear();
                self.waiting.clear();
                let everybody = self.subs.iter().flatten();
                self.notices.extend(everybody.map(|sub| (sub.id, PartNotice::Finished)));
            }
            return Ok(all);
        }
        if let Some(slot) = self.slots.get(&id).copied() {
            self.set_rest(slot, report.rest);
            if let Some(cells) = &report.given_up {
                self.pass_on(slot, cells);
            }
            if report.asks && !self.waiting.contains(&slot) {
                self.waiting.push_back(slot);
            }
            self.serve();
        }
        Ok(all)
    }

    /// Lets those that wait look again. To be called at the time that [`PartScheduler::next_tick`] gives, or a little later.
    pub fn tick(&mut self, now: Duration) {
        self.advance(now);
        if self.now < self.retry || self.waiting.is_empty() {
            return;
        }
        self.retry = self.now.saturating_add(RETRY);
        self.serve();
        // Nobody has enough by what was reported. One that should have been through some time ago may have cells whose leases ran out.
        // Who waits may be the only one that has any.
        let Some((thief, victim)) = self.waiting.iter().find_map(|thief| Some((*thief, self.late(*thief)?)))
        else {
            return;
        };
        self.waiting.retain(|waiting| *waiting != thief);
        let now = self.now;
        if let Some(sub) = self.subs[victim as usize].as_mut() {
            sub.tried = now;
        }
        self.tell_to_give(victim, thief, 0.5);
    }

    /// Of those that should have been through some time ago, the one that was looked at the longest ago; not `thief` itself.
    fn late(&self, thief: u32) -> Option<u32> {
        let late = self.subs.iter().enumerate().filter_map(|(slot, sub)| Some((slot as u32, sub.as_ref()?)));
        let late = late.filter(|(slot, sub)| {
            let is_late = sub.end.saturating_add(RETRY) <= self.now;
            *slot != thief && sub.owned > 0 && sub.gives_to.is_none() && is_late
        });
        late.map(|(slot, sub)| (sub.tried, slot)).min().map(|(_, slot)| slot)
    }

    /// When [`PartScheduler::tick`] is to be called next; none if nobody waits.
    pub fn next_tick(&self) -> Option<Duration> {
        (!self.waiting.is_empty()).then_some(Duration::from_nanos(self.retry))
    }

    /// Takes the next message to a sub-coordinator. To be called until there is none, after every other call.
    pub fn notice(&mut self) -> Option<(SubCoordinatorId, PartNotice)> {
        self.notices.pop_front()
    }

    /// Whether every cell is done.
    pub fn is_finished(&self) -> bool {
        self.book.cells_done() == self.book.cells()
    }

    /// How far the image is.
    pub fn progress(&self) -> PartProgress {
        PartProgress {
            cells: self.book.cells(),
            cells_done: self.book.cells_done(),
            cells_free: self.book.cells_free(),
            sub_coordinators: self.slots.len() as u32,
            ..self.counts
        }
    }

    /// What a restarted top coordinator needs to go on: which cells are done. Sub-coordinators then join it anew, without any part.
    pub fn checkpoint(&self) -> ScheduleCheckpoint {
        let tiles = (0..self.grid().tile_count()).map(TileId);
        ScheduleCheckpoint {
            grid: self.grid().clone(),
            epoch: self.epoch,
            done: tiles.map(|tile| self.book.done(tile)).collect(),
        }
    }

    fn advance(&mut self, now: Duration) {
        self.now = self.now.max(nanos(now));
    }

    /// The number behind the curve's last cell.
    fn last_number(&self) -> u64 {
        u64::from(self.grid().tile_count()) * u64::from(self.grid().cells_per_tile())
    }

    fn sub(&self, slot: u32) -> Option<&Sub> {
        self.subs.get(slot as usize)?.as_ref()
    }

    /// Gives cells that nobody has.
    fn give(&mut self, slot: u32, count: u64) {
        let Some(sub) = self.subs[slot as usize].as_ref() else { return };
        let cells = self.book.give(slot, sub.next, count);
        self.counts.parts_given += u64::from(!cells.is_empty());
        self.grant(slot, &cells);
    }

    /// A sub-coordinator has more to do.
    fn grant(&mut self, slot: u32, cells: &[TileCells]) {
        let per_tile = u64::from(self.grid().cells_per_tile());
        let Some(last) = cells.last() else { return };
        let next = u64::from(last.tile.0) * per_tile + (64 - u64::from(last.cells.leading_zeros()));
        let parts = cells.iter().copied().map(|cells| {
            let cell = self.costs.estimate(self.grid(), cells.tile);
            PartCells { cells, work: cell.unwrap_or(0.0) * f64::from(cells.count()) }
        });
        let parts: Vec<PartCells> = parts.collect();
        let count: u64 = cells.iter().map(|cells| u64::from(cells.count())).sum();
        let work: f64 = parts.iter().map(|part| part.work).sum();
        let Some(sub) = self.subs[slot as usize].as_mut() else { return };
        let rest = PartRest { cells: sub.rest.cells + count, work: sub.rest.work + work, ..sub.rest };
        sub.next = next;
        sub.owned += count;
        self.notices.push_back((sub.id, PartNotice::Grant(parts)));
        self.set_rest(slot, rest);
    }

    /// Takes down what a sub-coordinator has left.
    fn set_rest(&mut self, slot: u32, rest: PartRest) {
        let now = self.now;
        let Some(sub) = self.subs[slot as usize].as_mut() else { return };
        self.ends.remove(&(sub.end, slot));
        sub.rest = rest;
        let lasts = rest.seconds().filter(|_| rest.workers > 0 || rest.cells == 0);
        sub.end = lasts.map_or(UNKNOWN, |seconds| now.saturating_add((seconds * 1e9) as Nanos).min(UNKNOWN));
        if rest.cells > 0 && sub.gives_to.is_none() {
            self.ends.insert((sub.end, slot));
        }
    }

    /// Finds something for those that wait.
    fn serve(&mut self) {
        // What is not enough for one is not enough for the next, unless it is that one's own.
        let mut at = 0;
        while let Some(slot) = self.waiting.get(at).copied().filter(|_| at < 2) {
            if self.book.cells_free() > 0 {
                self.waiting.remove(at);
                let workers = self.sub(slot).map_or(1, |sub| u64::from(sub.rest.workers.max(1)));
                let portion = self.book.cells_free() / (2 * self.slots.len().max(1) as u64);
                self.give(slot, portion.max(workers * CELLS_PER_WORKER));
            } else if let Some((victim, share)) = self.victim(slot) {
                self.waiting.remove(at);
                self.tell_to_give(victim, slot, share);
            } else {
                at += 1;
            }
        }
        self.retry = self.retry.max(self.now.saturating_add(1));
    }

    fn tell_to_give(&mut self, victim: u32, thief: u32, share: f64) {
        let Some(sub) = self.subs[victim as usize].as_mut() else { return };
        self.ends.remove(&(sub.end, victim));
        sub.gives_to = Some(thief);
        self.notices.push_back((sub.id, PartNotice::GiveUp { share }));
    }

    /// Who should give up something for `slot`, and what share of its rest: both are through at one time then.
    fn victim(&self, slot: u32) -> Option<(u32, f64)> {
        let own = self.sub(slot)?;
        let seconds_left = |sub: &Sub| sub.end.saturating_sub(self.now) as f64 * 1e-9;
        let own_left = if own.rest.cells == 0 { 0.0 } else { seconds_left(own) };
        let candidates = self.ends.iter().rev().take(LOOKED_AT).filter(|(_, other)| *other != slot);
        candidates.filter_map(|(_, other)| Some((*other, self.sub(*other)?))).find_map(|(number, other)| {
            let left = seconds_left(other);
            let speeds = if own.rest.speed > 0.0 && other.rest.speed > 0.0 {
                [own.rest.speed, other.rest.speed]
            } else {
                // Who asks has a worker, heard of or not.
                [own.rest.workers.max(1), other.rest.workers].map(f64::from)
            };
            let part = speeds[0] / (speeds[0] + speeds[1]).max(f64::MIN_POSITIVE);
            let share = part * (1.0 - own_left / left.max(f64::MIN_POSITIVE)).max(0.0);
            (share * left >= self.options.take_min.as_secs_f64() && share > 0.0).then_some((number, share))
        })
    }

    /// Cells that a sub-coordinator has given up go to whom they were meant for.
    fn pass_on(&mut self, slot: u32, cells: &[TileCells]) {
        let Some(sub) = self.subs[slot as usize].as_mut() else { return };
        let to = sub.gives_to.take();
        let to = to.filter(|to| *to != NOBODY);
        let mut passed = Vec::new();
        for cells in cells {
            let cells = self.book.pass_on(slot, *cells, to);
            if !cells.is_empty() {
                passed.push(cells);
            }
        }
        let count: u64 = passed.iter().map(|cells| u64::from(cells.count())).sum();
        if let Some(sub) = self.subs[slot as usize].as_mut() {
            sub.owned -= count;
            let rest = sub.rest;
            self.set_rest(slot, rest);
        }
        match to {
            Some(to) if passed.is_empty() => self.waiting.push_back(to),
            Some(to) => {
                self.counts.parts_taken += 1;
                self.grant(to, &passed);
            }
            None => {}
        }
    }

    #[cfg(test)]
    pub(in crate::schedule) fn check(&self) -> Result<(), String> {
        let owned = self.book.check()?;
        for (slot, sub) in self.subs.iter().enumerate() {
            let slot = slot as u32;
            let count = owned.get(&slot).copied().unwrap_or(0);
            if sub.as_ref().map_or(0, |sub| sub.owned) != count {
                return Err(format!("sub-coordinator {slot} has {count} cells"));
            }
        }
        let listed = |end, slot| self.sub(slot).is_some_and(|sub| sub.end == end && sub.gives_to.is_none());
        if !self.ends.iter().all(|(end, slot)| listed(*end, *slot)) {
            return Err("an end is out of order".to_string());
        }
        if !self.waiting.iter().all(|slot| self.sub(*slot).is_some()) {
            return Err("one waits that is gone".to_string());
        }
        Ok(())
    }

    /// The cells of a tile that are not done and belong to a sub-coordinator.
    #[cfg(test)]
    pub(in crate::schedule) fn owned(&self, id: SubCoordinatorId, tile: TileId) -> u64 {
        self.slots.get(&id).map_or(0, |slot| self.book.owned(*slot, tile))
    }
}

/// Stands for one that is gone.
const NOBODY: u32 = u32::MAX;

impl std::fmt::Debug for PartScheduler {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PartScheduler").field("progress", &self.progress()).finish_non_exhaustive()
    }
}
