//! What the scheduler's methods are compared with.

use std::time::Duration;

use outcrop::schedule::{SchedulerOptions, TilePolicy};

/// A queue of whole tiles, row by row: no speeds learnt, nothing taken over, no bounds on what is handed out.
pub fn plain(workers: u32) -> SchedulerOptions {
    SchedulerOptions {
        policy: TilePolicy::Rows,
        tiles_per_worker: 0,
        share_of_rest: 0.0,
        critical_time: false,
        take_over: false,
        learn_speeds: false,
        hand_out_min: Duration::ZERO,
        ..SchedulerOptions::new(workers)
    }
}
