//! What a simulation gives.

use super::cost_image::CostImage;
use super::machine::{ClusterModel, sequential};
use super::worker::{Spending, Worker};
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
    /// Messages to and from the coordinator; with two levels, the top coordinator.
    pub messages: u64,
    /// Bytes of them.
    pub bytes: Bytes,
    /// Part of the time that the coordinator was busy with messages; with two levels, the top coordinator.
    pub coordinator_load: f64,
    /// Part of the time that the busiest sub-coordinator was busy with messages; 0 if there are none.
    pub sub_coordinator_load: f64,
    /// The scheduler's own account; with two levels, sums over all schedulers of sub-coordinators, but cells and repeated cells as
    /// the top counts them.
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

/// What a simulation has added up.
pub(super) struct Totals {
    /// When the last pixel arrived.
    pub nanos: u64,
    pub spending: Spending,
    pub counted_seconds: f64,
    pub messages: u64,
    pub bytes: u64,
    pub coordinator_busy: u64,
    /// Of the busiest one.
    pub sub_coordinator_busy: u64,
    pub schedule: ScheduleProgress,
}

impl Totals {
    pub fn report(&self, model: &ClusterModel, costs: &CostImage, workers: &[Worker]) -> SimulationReport {
        let count = workers.len() as u32;
        let alone = sequential(model, costs);
        let speeds: Vec<f64> = (0..count).map(|worker| model.speed(worker)).collect();
        let speed: f64 = speeds.iter().sum();
        let fastest = speeds.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let end = self.nanos;
        // Sum over the workers, in seconds.
        let idle =
            |nanos: &dyn Fn(&Worker) -> u64| workers.iter().map(|worker| nanos(worker) as f64 * 1e-9).sum();
        let part = |busy: u64| busy as f64 / end.max(1) as f64;
        SimulationReport {
            workers: count,
            seconds: end as f64 * 1e-9,
            sequential_seconds: alone.seconds,
            speed,
            bound_seconds: (alone.seconds / speed).max(costs.longest_seconds().0 / fastest),
            render_seconds: self.counted_seconds,
            load_seconds: self.spending.load_seconds,
            idle_at_start_seconds: idle(&|worker| worker.first.unwrap_or(end)),
            idle_at_end_seconds: idle(&|worker| end.saturating_sub(worker.last.min(end))),
            wasted_seconds: (self.spending.rendered_seconds - self.counted_seconds).max(0.0),
            loads: self.spending.loads,
            sequential_loads: alone.loads,
            messages: self.messages,
            bytes: Bytes(self.bytes),
            coordinator_load: part(self.coordinator_busy),
            sub_coordinator_load: part(self.sub_coordinator_busy),
            schedule: self.schedule,
        }
    }
}
