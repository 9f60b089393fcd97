//! A simulated worker: what it holds, and how its time goes.

use std::collections::VecDeque;
use std::time::Duration;

use super::cost_image::CostImage;
use super::machine::{CellTime, ClusterModel, Machine};
use crate::access::BlockSketch;
use crate::schedule::grid::TileCells;
use crate::schedule::scheduler::{Assignment, Spent, TileResult};
use crate::units::{BlockId, LeaseId};

/// Bound for a coordinator.
#[derive(Clone, Copy, Debug)]
pub(super) enum Bound {
    Request,
    /// A result, and whether the worker asks for more with it.
    Result {
        result: TileResult,
        asks: bool,
    },
}

impl Bound {
    pub fn bytes(&self, model: &ClusterModel, costs: &CostImage) -> f64 {
        let (pixels, sketch_bytes) = match self {
            Bound::Result { result, .. } => (costs.grid().pixels(result.cells), SKETCH_BYTES),
            Bound::Request => (0, 0.0),
        };
        f64::from(model.message_bytes) + sketch_bytes + pixels as f64 * f64::from(model.pixel_bytes)
    }
}

/// Bytes of the blocks that a result tells of, at most.
const SKETCH_BYTES: f64 = 80.0;

/// Bound for a worker.
#[derive(Clone, Copy, Debug)]
pub(super) enum Told {
    Assign(Assignment),
    Shorten(LeaseId, u64),
}

/// What all workers have spent.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spending {
    pub rendered_seconds: f64,
    pub load_seconds: f64,
    pub loads: u64,
}

/// Cells that a worker was told to render.
struct Job {
    assignment: Assignment,
    /// What is still to be done.
    left: u64,
    done: u64,
    started: Option<u64>,
    /// Cost of what is done, in seconds at speed 1.
    work: f64,
    /// Blocks that it needed.
    blocks: BlockSketch,
}

pub(super) struct Worker {
    machine: Machine,
    jobs: VecDeque<Job>,
    /// The cell of the first job that is being rendered, and what it takes in all.
    cell: Option<u32>,
    cell_time: CellTime,
    has_asked: bool,
    pub is_lost: bool,
    /// When its first cell began and its last one ended.
    pub first: Option<u64>,
    pub last: u64,
}

impl Worker {
    pub fn new(machine: Machine) -> Worker {
        Worker {
            machine,
            jobs: VecDeque::new(),
            cell: None,
            cell_time: CellTime::default(),
            has_asked: false,
            is_lost: false,
            first: None,
            last: 0,
        }
    }

    /// Whether it wants more now; then it has asked.
    pub fn asks(&mut self, model: &ClusterModel) -> bool {
        let wanted = if model.ask_ahead { 2 } else { 1 };
        let asks = !self.is_lost && !self.has_asked && self.jobs.len() < wanted;
        self.has_asked |= asks;
        asks
    }

    pub fn tell(&mut self, told: Told) {
        match told {
            Told::Assign(assignment) => {
                self.has_asked = false;
                let left = assignment.cells.cells;
                let job = Job {
                    assignment,
                    left,
                    done: 0,
                    started: None,
                    work: 0.0,
                    blocks: BlockSketch::default(),
                };
                self.jobs.push_back(job);
            }
            Told::Shorten(lease, keep) => {
                let Some(at) = self.jobs.iter().position(|job| job.assignment.lease == lease) else {
                    return;
                };
                self.jobs[at].left &= keep;
                // One that has begun ends with the cell that it is at.
                if self.jobs[at].left == 0 && self.jobs[at].started.is_none() {
                    self.jobs.remove(at);
                }
            }
        }
    }

    /// Its coordinator is gone; it goes on with what it has begun, under another.
    pub fn change_coordinator(&mut self) {
        self.jobs.retain(|job| job.started.is_some());
        self.has_asked = false;
    }

    /// Begins with the next cell if it is idle and has one: when it will be through with it.
    pub fn begin(
        &mut self,
        now: u64,
        model: &ClusterModel,
        costs: &CostImage,
        spending: &mut Spending,
    ) -> Option<u64> {
        let job = self.jobs.front_mut().filter(|_| self.cell.is_none())?;
        job.started.get_or_insert(now);
        let cell = job.left.trailing_zeros();
        job.left &= job.left.wrapping_sub(1);
        let tile = job.assignment.cells.tile;
        let time = self.machine.render(model, costs, tile, cell);
        job.work += costs.seconds(tile, cell);
        let scale = BlockSketch::scale(costs.blocks().len() as u32);
        costs.accesses(tile, cell).iter().for_each(|block| job.blocks.add_scaled(BlockId(*block), scale));
        self.cell = Some(cell);
        self.cell_time = time;
        spending.rendered_seconds += time.render_seconds;
        spending.load_seconds += time.load_seconds;
        spending.loads += time.loads;
        let end = now + nanos(time.render_seconds + time.load_seconds);
        self.first.get_or_insert(now);
        self.last = end;
        Some(end)
    }

    /// It is through with a cell: what it returns, if it was the last one of a job.
    pub fn end_cell(&mut self, now: u64, model: &ClusterModel) -> Option<Bound> {
        let (Some(cell), Some(job)) = (self.cell.take(), self.jobs.front_mut()) else { return None };
        job.done |= 1 << cell;
        let spent = Duration::from_nanos(now - job.started.unwrap_or(now));
        if job.left != 0 && spent < job.assignment.stop_after {
            return None;
        }
        let result = TileResult {
            lease: job.assignment.lease,
            cells: TileCells { tile: job.assignment.cells.tile, cells: job.done },
            is_last: true,
            spent: Spent { seconds: spent.as_secs_f64(), work: job.work },
            blocks: job.blocks,
        };
        self.jobs.pop_front();
        Some(Bound::Result { result, asks: self.asks(model) })
    }

    /// Cells are booked whole when they begin; takes back what one under way at the end had still to do.
    pub fn stop_clock(&self, now: u64, spending: &mut Spending) {
        let whole = self.cell_time.render_seconds + self.cell_time.load_seconds;
        let rest = self.last.saturating_sub(now) as f64 * 1e-9;
        if self.cell.is_some() && rest > 0.0 {
            let part = (rest / whole).min(1.0);
            spending.rendered_seconds -= part * self.cell_time.render_seconds;
            spending.load_seconds -= part * self.cell_time.load_seconds;
        }
    }
}

pub(super) fn nanos(seconds: f64) -> u64 {
    // Saturates.
    (seconds * 1e9) as u64
}
