//! What the two levels say to each other, and what can be chosen.

use std::time::Duration;

use crate::error::ScheduleError;
use crate::schedule::grid::TileCells;

/// How a [`PartScheduler`](super::PartScheduler) and its sub-coordinators work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartOptions {
    /// How many sub-coordinators will come, as far as is known; at least 1. Each of the first so many gets an equal part at the start.
    pub expected: u32,
    /// How much of its equal part a sub-coordinator gets at the start, above 0 and at most 1. The rest is given to whoever asks, first to
    /// that one.
    pub first_share: f64,
    /// How long a sub-coordinator gathers results before it reports them. What it has gathered is lost with it. A tile of which
    /// everything is done is reported in one, so longer is less work for the top.
    pub gather: Duration,
    /// A sub-coordinator asks for more when what it has left would last its workers no longer than this.
    pub ask_before: Duration,
    /// Taking a part from another is not worth its messages if less time than this is gained.
    pub take_min: Duration,
}

impl PartOptions {
    /// The defaults for so many sub-coordinators.
    pub fn new(expected: u32) -> PartOptions {
        PartOptions {
            expected,
            first_share: 0.5,
            gather: Duration::from_millis(50),
            ask_before: Duration::from_millis(20),
            take_min: Duration::from_millis(2),
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for the first that makes no sense.
    pub fn validate(&self) -> Result<(), ScheduleError> {
        let check = |holds: bool, what, reason| {
            if holds { Ok(()) } else { Err(ScheduleError::Option { what, reason }) }
        };
        let count = (1..=SUBS_MAX).contains(&self.expected);
        check(count, "expected sub-coordinators", "there must be 1 to 2^16")?;
        let share = self.first_share > 0.0 && self.first_share <= 1.0;
        check(share, "first share", "it must be above 0 and at most 1")
    }
}

/// More sub-coordinators than anybody has.
const SUBS_MAX: u32 = 1 << 16;

/// What a sub-coordinator has left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PartRest {
    /// Cells that nobody has begun with.
    pub cells: u64,
    /// Cells that its workers have in hand.
    pub cells_leased: u64,
    /// Its workers.
    pub workers: u32,
    /// Expected work of the cells that nobody has begun with, in the unit of [`Spent::work`](crate::schedule::Spent::work); 0 if
    /// nothing is known.
    pub work: f64,
    /// Work per second of all its workers; 0 if nothing is known.
    pub speed: f64,
}

impl PartRest {
    /// Seconds that the rest will last; none if nothing is known.
    pub fn seconds(&self) -> Option<f64> {
        if self.cells == 0 {
            return Some(0.0);
        }
        let seconds = self.work / self.speed;
        (self.speed > 0.0 && seconds.is_finite()).then_some(seconds)
    }
}

/// Cells of a tile, and what they cost, or are expected to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PartCells {
    /// The cells.
    pub cells: TileCells,
    /// Of all of them together, in the unit of [`Spent::work`](crate::schedule::Spent::work); 0 if it is not known.
    pub work: f64,
}

/// From a sub-coordinator to the top.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PartReport {
    /// Cells that were done since the last report, tile by tile. Their pixels go with it.
    pub done: Vec<PartCells>,
    /// Cells that it was told to give up, and will not do; none if it was not told since the last report.
    pub given_up: Option<Vec<TileCells>>,
    /// Whether it asks for more.
    pub asks: bool,
    /// What is left.
    pub rest: PartRest,
}

/// From the top to a sub-coordinator.
#[derive(Clone, Debug, PartialEq)]
pub enum PartNotice {
    /// Do these cells, too.
    Grant(Vec<PartCells>),
    /// Give up about this share, 0 to 1, of what nobody has begun with, and report it at once.
    GiveUp {
        /// The share.
        share: f64,
    },
    /// Every cell of the image is done.
    Finished,
}

/// How far the image is, for the top.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PartProgress {
    /// Cells of the image.
    pub cells: u64,
    /// Cells that are done.
    pub cells_done: u64,
    /// Cells that belong to nobody.
    pub cells_free: u64,
    /// Cells that were reported although they were done.
    pub cells_repeated: u64,
    /// Parts that were given from what nobody had.
    pub parts_given: u64,
    /// Parts that one sub-coordinator gave up for another.
    pub parts_taken: u64,
    /// Sub-coordinators that take part.
    pub sub_coordinators: u32,
}
