//! What a simulation gives.

use crate::schedule::scheduler::ScheduleProgress;
use crate::units::Bytes;

/// What a simulated render came to.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationReport {
    /// Workers at the start.
    pub workers: u32,
    /// From the start to the last pixel's arrival.
    pub seconds: f64,
    /// What one machine of speed 1 takes alone, loads included.
    pub sequential_seconds: f64,
    /// Sum of the workers' speeds.
    pub speed: f64,
    /// The least time possible: the sequential time over all workers' speeds, or the longest cell on the fastest one.
    pub bound_seconds: f64,
    /// Time of all workers on cells that counted.
    pub render_seconds: f64,
    /// Time of all workers on loads.
    pub load_seconds: f64,
    /// Time of all workers on cells that others had done, or that were not returned before the end.
    pub wasted_seconds: f64,
    /// Time of all workers until their first cell.
    pub idle_at_start_seconds: f64,
    /// Time of all workers from their last cell to the end.
    pub idle_at_end_seconds: f64,
    /// Blocks loaded by all workers.
    pub loads: u64,
    /// Blocks loaded by one machine alone.
    pub sequential_loads: u64,
    /// Messages to and from the coordinator.
    pub messages: u64,
    /// Bytes of them.
    pub bytes: Bytes,
    /// Part of the time that the coordinator was busy with messages.
    pub coordinator_load: f64,
    /// The scheduler's own account.
    pub schedule: ScheduleProgress,
}

impl SimulationReport {
    /// Sequential time over workers' speeds times parallel time; at most about 1, above only where many caches hold what one does not.
    pub fn efficiency(&self) -> f64 {
        self.sequential_seconds / (self.speed * self.seconds)
    }

    /// Part of the bound that was reached: at most about 1.
    pub fn of_bound(&self) -> f64 {
        self.bound_seconds / self.seconds
    }

    /// Loads of the cluster over loads of one machine.
    pub fn loads_ratio(&self) -> f64 {
        self.loads as f64 / self.sequential_loads.max(1) as f64
    }
}
