//! How fast a worker is.

/// Work per second of one worker, learnt from its results; older ones count less.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Speed {
    work: f64,
    seconds: f64,
}

/// What a result's weight has sunk to after another of the same length.
const FADING: f64 = 0.8;

impl Speed {
    /// Some work took so long. Times of nothing say nothing.
    pub fn record(&mut self, work: f64, seconds: f64) {
        if work > 0.0 && seconds > 0.0 {
            self.work = self.work * FADING + work;
            self.seconds = self.seconds * FADING + seconds;
        }
    }

    /// Work per second; none before the first result.
    pub fn value(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.work / self.seconds)
    }
}
