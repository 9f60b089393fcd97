//! A sub-coordinator's scheduler.

use std::collections::BTreeMap;
use std::time::Duration;

use super::messages::{PartCells, PartNotice, PartOptions, PartReport, PartRest};
use crate::error::ScheduleError;
use crate::schedule::adaptive::AdaptiveScheduler;
use crate::schedule::checkpoint::ScheduleCheckpoint;
use crate::schedule::grid::{ImageGrid, TileCells};
use crate::schedule::options::SchedulerOptions;
use crate::schedule::scheduler::{Answer, Notice, Receipt, ScheduleProgress, TileResult, TileScheduler};
use crate::units::{TileId, WorkerId};

/// Hands out a part of the image to the workers of one sub-coordinator, and keeps the top up to date. See the [module](super).
///
/// For its workers it is a [`TileScheduler`] like any other. After every call, [`SubScheduler::report_at`] says when
/// [`SubScheduler::take_report`] is to be called next.
#[derive(Debug)]
pub struct SubScheduler {
    scheduler: AdaptiveScheduler,
    options: PartOptions,
    /// Cells that were done and not reported, and what they cost.
    gathered: BTreeMap<TileId, PartCells>,
    /// When they are to be reported.
    due: Option<Duration>,
    given_up: Option<Vec<TileCells>>,
    /// It has asked for more and got nothing yet.
    has_asked: bool,
    /// A worker has asked since it did. Where none does, cells are of no use: two such would take the same ones from each other for ever.
    is_wanted: bool,
    is_closed: bool,
    /// Workers in the last report.
    workers_reported: Option<u32>,
    now: Duration,
}

impl SubScheduler {
    /// A scheduler with no part yet. `scheduler` are the options for its own workers, see
    /// [`SchedulerOptions::for_sub_coordinator`].
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for options that make no sense, for themselves or for the image.
    pub fn new(
        width: u32,
        height: u32,
        scheduler: SchedulerOptions,
        options: PartOptions,
    ) -> Result<SubScheduler, ScheduleError> {
        options.validate()?;
        Ok(SubScheduler {
            scheduler: AdaptiveScheduler::for_parts(width, height, scheduler)?,
            options,
            gathered: BTreeMap::new(),
            due: None,
            given_up: None,
            // To join is to ask.
            has_asked: true,
            is_wanted: false,
            is_closed: false,
            workers_reported: None,
            now: Duration::ZERO,
        })
    }

    /// The top has something to say.
    pub fn told(&mut self, notice: &PartNotice, now: Duration) {
        self.advance(now);
        match notice {
            PartNotice::Grant(cells) => {
                self.has_asked = false;
                self.scheduler.grant(cells, now);
                // Without workers it cannot keep it.
                self.workers_reported = self.workers_reported.filter(|workers| *workers > 0);
            }
            PartNotice::GiveUp { share } => {
                let cells = self.scheduler.give_up(*share, now);
                self.given_up.get_or_insert_default().extend(cells);
            }
            PartNotice::Finished => {
                self.is_closed = true;
                self.scheduler.end(now);
            }
        }
    }

    /// What is left to hand out.
    pub fn rest(&self) -> PartRest {
        self.scheduler.rest()
    }

    /// When [`SubScheduler::take_report`] is to be called; none if there is nothing to say.
    pub fn report_at(&self) -> Option<Duration> {
        if self.is_urgent(&self.rest()) { Some(self.now) } else { self.due }
    }

    /// What the top has to know now; none if it is not time yet.
    pub fn take_report(&mut self, now: Duration) -> Option<PartReport> {
        self.advance(now);
        let rest = self.rest();
        if !self.is_urgent(&rest) && self.due.is_none_or(|due| due > self.now) {
            return None;
        }
        let asks = self.asks(&rest);
        self.has_asked |= asks;
        self.is_wanted &= !asks;
        self.due = None;
        self.workers_reported = Some(rest.workers);
        let gathered = std::mem::take(&mut self.gathered);
        Some(PartReport {
            done: gathered.into_values().collect(),
            given_up: self.given_up.take(),
            asks,
            rest,
        })
    }

    fn advance(&mut self, now: Duration) {
        self.now = self.now.max(now);
    }

    /// Whether there is something to say that cannot wait.
    fn is_urgent(&self, rest: &PartRest) -> bool {
        let is_through = rest.cells + rest.cells_leased == 0 && !self.gathered.is_empty();
        let is_helpless = rest.workers == 0 && rest.cells > 0 && self.workers_reported != Some(0);
        self.given_up.is_some() || self.asks(rest) || is_through || is_helpless
    }

    fn asks(&self, rest: &PartRest) -> bool {
        let is_low = rest.seconds().is_some_and(|seconds| seconds <= self.options.ask_before.as_secs_f64());
        is_low && rest.workers > 0 && self.is_wanted && !self.has_asked && !self.is_closed
    }

    #[cfg(test)]
    pub(in crate::schedule) fn check(&self) -> Result<(), String> {
        self.scheduler.check()
    }

    /// The cells of a tile that are to be done here, or were.
    #[cfg(test)]
    pub(in crate::schedule) fn part(&self, tile: TileId) -> u64 {
        self.scheduler.part(tile)
    }
}

impl TileScheduler for SubScheduler {
    fn grid(&self) -> &ImageGrid {
        self.scheduler.grid()
    }

    fn join(&mut self, worker: WorkerId, now: Duration) {
        self.advance(now);
        self.scheduler.join(worker, now);
    }

    fn leave(&mut self, worker: WorkerId, now: Duration) {
        self.advance(now);
        self.scheduler.leave(worker, now);
    }

    fn request(&mut self, worker: WorkerId, now: Duration) -> Result<Answer, ScheduleError> {
        self.advance(now);
        let answer = self.scheduler.request(worker, now)?;
        self.is_wanted = true;
        Ok(answer)
    }

    /// Cells that are not of this part are welcome, too: the top knows whether they are new. Here only those of the part count.
    fn complete(
        &mut self,
        worker: WorkerId,
        result: &TileResult,
        now: Duration,
    ) -> Result<Receipt, ScheduleError> {
        self.advance(now);
        let receipt = self.scheduler.complete(worker, result, now)?;
        let TileCells { tile, cells } = result.cells;
        let passed = receipt.fresh.cells | cells & !self.scheduler.part(tile);
        if passed != 0 {
            let nothing = PartCells { cells: TileCells { tile, cells: 0 }, work: 0.0 };
            let gathered = self.gathered.entry(tile).or_insert(nothing);
            let new = (passed & !gathered.cells.cells).count_ones();
            gathered.cells.cells |= passed;
            gathered.work += f64::from(new) * self.scheduler.cost(tile).unwrap_or(0.0);
            self.due.get_or_insert(self.now.saturating_add(self.options.gather));
        }
        Ok(receipt)
    }

    fn tick(&mut self, now: Duration) {
        self.advance(now);
        self.scheduler.tick(now);
    }

    fn next_tick(&self) -> Option<Duration> {
        self.scheduler.next_tick()
    }

    fn notice(&mut self) -> Option<Notice> {
        self.scheduler.notice()
    }

    /// Whether every cell of the image is done: the top has said so.
    fn is_finished(&self) -> bool {
        self.scheduler.is_finished()
    }

    /// How far the part is.
    fn progress(&self) -> ScheduleProgress {
        self.scheduler.progress()
    }

    /// What is done here. The render's checkpoint is that of the top.
    fn checkpoint(&self) -> ScheduleCheckpoint {
        self.scheduler.checkpoint()
    }
}
