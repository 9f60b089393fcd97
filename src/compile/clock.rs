//! Where the time goes.

use std::time::Instant;

use super::options::Seconds;

/// Adds up the time of one part of the work over any number of spans.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Meter {
    cpu: f64,
    wall: f64,
}

/// A moment, by the wall and by the calling thread's processor time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    wall: Instant,
    cpu: Option<f64>,
}

impl Moment {
    pub(super) fn now() -> Moment {
        Moment { wall: Instant::now(), cpu: thread_cpu_seconds() }
    }
}

impl Meter {
    /// Adds the time since `start`, which must be of the same thread, and returns now.
    pub(super) fn add_since(&mut self, start: Moment) -> Moment {
        let now = Moment::now();
        let wall = now.wall.duration_since(start.wall).as_secs_f64();
        self.wall += wall;
        self.cpu += now.cpu.zip(start.cpu).map_or(wall, |(now, start)| now - start);
        now
    }

    /// Adds the spans of another meter.
    pub(super) fn merge(&mut self, other: &Meter) {
        self.wall += other.wall;
        self.cpu += other.cpu;
    }

    /// As a part of the report.
    pub(super) fn seconds(&self) -> Seconds {
        Seconds { wall: self.wall, cpu: self.cpu }
    }
}

/// Processor time of this thread so far, where the system has such a clock.
fn thread_cpu_seconds() -> Option<f64> {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        Some(time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9)
    }
    #[cfg(not(unix))]
    None
}
