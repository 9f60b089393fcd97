//! What a coordinator says to a scheduler, and what it hears.

use std::time::Duration;

use super::checkpoint::ScheduleCheckpoint;
use super::grid::{ImageGrid, TileCells};
use crate::access::BlockSketch;
use crate::error::ScheduleError;
use crate::units::{LeaseId, WorkerId};

/// What a worker is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// To be sent back with the result.
    pub lease: LeaseId,
    /// The cells to render, in the order of their numbers: [`ImageGrid::squares`] gives their pixels in that order.
    pub cells: TileCells,
    /// The critical time: a worker that has spent so much time on the cells, from the first ray on, stops after the cell that it is
    /// at and returns what it has. [`Duration::MAX`] if there is none.
    pub stop_after: Duration,
}

/// The answer to a worker that asks for work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Render this.
    Assign(Assignment),
    /// Nothing to do now. A [`Notice::Wake`] follows when the worker should ask again.
    Wait,
    /// Every cell is done.
    Done,
}

/// What the scheduler has to say to a worker that did not ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Notice {
    /// Of this lease, do only these cells, or none; others do the rest. Cells that are rendered already may be returned all the
    /// same. A notice that arrives late, or never, costs work and no more.
    Shorten {
        /// Who holds the lease.
        worker: WorkerId,
        /// The lease.
        lease: LeaseId,
        /// What is left of it.
        keep: TileCells,
    },
    /// There may be work, or the image is finished: the coordinator calls [`TileScheduler::request`] for this worker, which
    /// was told to wait.
    Wake {
        /// Who waits.
        worker: WorkerId,
    },
}

/// What cells cost the worker that rendered them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spent {
    /// Seconds by the worker's clock, from the first ray of these cells to the last.
    pub seconds: f64,
    /// The same in a unit that does not depend on the machine, from counters; 0 if unknown. With it
    /// the scheduler learns how fast each worker is; without, it takes all to be alike.
    pub work: f64,
}

/// Cells that a worker has rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileResult {
    /// From the assignment.
    pub lease: LeaseId,
    /// Which cells were rendered: all of the assignment's, or fewer (a partial tile).
    pub cells: TileCells,
    /// Whether the worker is through with the lease. What it has not done is then given to others. If not, more results will
    /// follow under the same lease.
    pub is_last: bool,
    /// What these cells cost.
    pub spent: Spent,
    /// Which blocks they needed, roughly; empty if unknown. See [`PieceChoice::Held`](super::PieceChoice::Held).
    pub blocks: BlockSketch,
}

/// What became of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Receipt {
    /// The cells that were not done before. Only these count, and each counts once.
    pub fresh: TileCells,
    /// How many of the result's cells were done already.
    pub repeated: u32,
}

/// How far the image is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ScheduleProgress {
    /// Cells of the image.
    pub cells: u64,
    /// Cells that are done.
    pub cells_done: u64,
    /// Cells that are on lease.
    pub cells_leased: u64,
    /// Leases given so far.
    pub leases: u64,
    /// Leases that ran out or were lost with their workers.
    pub leases_lost: u64,
    /// Leases that were cut for an idle worker.
    pub leases_cut: u64,
    /// Overdue leases whose cells were given to another worker, too.
    pub leases_raced: u64,
    /// Cells that came back although they were done.
    pub cells_repeated: u64,
    /// Workers that take part.
    pub workers: u32,
}

/// Hands out the cells of one image. See the [room](super) for what every implementation keeps.
///
/// Time is counted from any start and never runs backward; a time before the greatest so far counts as that one.
pub trait TileScheduler: Send {
    /// The image's cells.
    fn grid(&self) -> &ImageGrid;

    /// A worker takes part from now on. Telling it twice does nothing.
    fn join(&mut self, worker: WorkerId, now: Duration);

    /// A worker is gone, or was given up. What it held is free again; results that it sent before still count when they
    /// arrive. Of a worker that never joined, this does nothing.
    fn leave(&mut self, worker: WorkerId, now: Duration);

    /// A worker asks for work. It may ask again before it has returned what it holds: one assignment in hand and one in advance hide the
    /// network.
    ///
    /// # Errors
    /// [`ScheduleError::UnknownWorker`] if it did not join.
    fn request(&mut self, worker: WorkerId, now: Duration) -> Result<Answer, ScheduleError>;

    /// A worker returns cells. Late, repeated and partial results are welcome, also of leases and workers that are given up, and
    /// of leases from before a restart.
    ///
    /// # Errors
    /// [`ScheduleError::NoSuchCells`] for a tile, or cells, that the image does not have; the result then does not count. No cells of a tile
    /// that exists are no error: so a lease ends of which nothing is left.
    fn complete(
        &mut self,
        worker: WorkerId,
        result: &TileResult,
        now: Duration,
    ) -> Result<Receipt, ScheduleError>;

    /// Takes back leases that lasted too long. To be called at the time that [`TileScheduler::next_tick`] gives, or a little later.
    fn tick(&mut self, now: Duration);

    /// When [`TileScheduler::tick`] is to be called next; none if nothing runs out.
    fn next_tick(&self) -> Option<Duration>;

    /// Takes the next message to a worker that did not ask. To be called until there is none, after every other call.
    fn notice(&mut self) -> Option<Notice>;

    /// Whether every cell is done.
    fn is_finished(&self) -> bool;

    /// How far the image is.
    fn progress(&self) -> ScheduleProgress;

    /// What a restarted coordinator needs to go on: which cells are done. The pixels are the coordinator's to keep, and
    /// must be safe before the checkpoint is.
    fn checkpoint(&self) -> ScheduleCheckpoint;
}
