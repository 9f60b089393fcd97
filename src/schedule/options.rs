//! What can be chosen.

use std::time::Duration;

use crate::error::ScheduleError;

/// Where the workers' central points lie (the paper).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CentralPoints {
    /// In the middles of rectangles of equal area.
    #[default]
    Even,
    /// On the image's diagonals, which form an X.
    Diagonals,
}

/// How the next tile of a worker is chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TilePolicy {
    /// Row by row, from the upper left: what a queue of tiles does. For comparison.
    Rows,
    /// The free tile nearest to the worker's central point (the paper).
    Nearest(CentralPoints),
    /// The free tile for which `distance to the worker's point - weight * distance to the nearest other point` is
    /// least (the paper's trade-off: near one's own point, far from the others').
    TradeOff {
        /// Where the points lie.
        points: CentralPoints,
        /// What the distance to the others counts, 0 to 1.
        weight: f64,
    },
    /// Every worker has a piece of the curve through all cells and works along it. One whose piece is at an end takes over
    /// half of the piece that would take longest. The default.
    Curve,
}

/// Of which piece a worker of [`TilePolicy::Curve`] takes over half when its own is at an end, among those that would take nearly
/// the longest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PieceChoice {
    /// The one nearest along the curve to where the worker was.
    #[default]
    Near,
    /// The one whose blocks the worker most likely holds, by what results tell ([`TileResult::blocks`](super::TileResult::blocks)):
    /// the blocks that finished cells around there needed, against those that the worker touched last. Among equals, the nearest.
    Held,
}

/// How an [`AdaptiveScheduler`](super::AdaptiveScheduler) works. The defaults are the best known; the others are there so that each can be
/// compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SchedulerOptions {
    /// Side of a tile in pixels: the most that is handed out at once. 1, 2, 4 or 8 times `cell_side`.
    pub tile_side: u32,
    /// Side of a cell in pixels: the least that is handed out.
    pub cell_side: u32,
    /// How many workers will come, as far as is known; at least 1. The first so many get parts of equal size; others take parts over.
    pub expected_workers: u32,
    /// How a worker's next tile is chosen.
    pub policy: TilePolicy,
    /// Of which piece of the curve an idle worker takes over half.
    pub piece_choice: PieceChoice,
    /// At the start, no hand-out is greater than the image over the expected workers over this: at least five tiles each (the
    /// paper). 0 for no such bound.
    pub tiles_per_worker: u32,
    /// Late subdivision: a hand-out is at most this part of what is left per worker, but at least one cell. 0 hands out
    /// whole tiles to the end.
    pub share_of_rest: f64,
    /// No hand-out is expected to last less than this: each costs the coordinator some messages, and it has many workers to
    /// serve.
    pub hand_out_min: Duration,
    /// Whether a worker stops at a critical time: when, by the estimates, nothing would be left to do for the others.
    pub critical_time: bool,
    /// Whether an idle worker gets cells that another still has to do, when nothing is free: the back half of what is left of the
    /// lease that would end last. And when that cannot be cut, the last cells twice.
    pub take_over: bool,
    /// Whether speeds are learnt per worker.
    pub learn_speeds: bool,
    /// How many leases a worker may hold at once: one that asks for more has to wait. At least 1; 2 let it ask ahead.
    pub leases_in_hand_max: u32,
    /// A take-over of less than this is not worth its messages.
    pub take_over_min: Duration,
    /// A lease ends after this many times its expected time ...
    pub lease_factor: f64,
    /// ... but not before this. It is the lease of hand-outs whose time is not known yet, too.
    pub lease_min: Duration,
}

impl SchedulerOptions {
    /// The defaults for so many workers.
    pub fn new(expected_workers: u32) -> SchedulerOptions {
        SchedulerOptions {
            tile_side: 64,
            cell_side: 8,
            expected_workers,
            policy: TilePolicy::Curve,
            piece_choice: PieceChoice::Near,
            tiles_per_worker: 5,
            share_of_rest: 0.25,
            hand_out_min: Duration::from_micros(50 * u64::from(expected_workers)),
            critical_time: false,
            take_over: true,
            learn_speeds: true,
            leases_in_hand_max: 4,
            take_over_min: Duration::from_millis(2),
            lease_factor: 8.0,
            lease_min: Duration::from_secs(30),
        }
    }

    /// The defaults for the workers of one [sub-coordinator](super::SubScheduler): so many of its own. First hand-outs are smaller,
    /// since what is in hand cannot be given to other sub-coordinators when it turns out to be dear.
    pub fn for_sub_coordinator(expected_workers: u32) -> SchedulerOptions {
        SchedulerOptions { tiles_per_worker: 60, ..SchedulerOptions::new(expected_workers) }
    }

    /// Checks every field that does not depend on the image.
    ///
    /// # Errors
    /// [`ScheduleError::Option`] for the first that makes no sense.
    pub fn validate(&self) -> Result<(), ScheduleError> {
        let check = |holds: bool, what, reason| {
            if holds { Ok(()) } else { Err(ScheduleError::Option { what, reason }) }
        };
        check(
            (1..=WORKERS_MAX).contains(&self.expected_workers),
            "expected workers",
            "there must be 1 to 2^20",
        )?;
        check(self.leases_in_hand_max >= 1, "leases in hand", "a worker needs at least one")?;
        check((0.0..=1.0).contains(&self.share_of_rest), "share of the rest", "it must be 0 to 1")?;
        check(
            self.lease_factor.is_finite() && self.lease_factor >= 1.0,
            "lease factor",
            "a lease must last at least its expected time",
        )?;
        check(self.lease_min > Duration::ZERO, "shortest lease", "it must be longer than nothing")?;
        let weight = if let TilePolicy::TradeOff { weight, .. } = self.policy { weight } else { 0.0 };
        check((0.0..=1.0).contains(&weight), "trade-off", "its weight must be 0 to 1")
    }
}

/// More workers than anybody has.
const WORKERS_MAX: u32 = 1 << 20;
