//! What a goal is worked on with: scene and settings, probes, and what all of it took.

use std::time::Instant;

use super::predict::Prediction;
use super::{Goal, GoalCounters, GoalOptions, GoalProgress, GoalSeconds, Knobs, Sampling, TileThreshold};
use crate::LazyOctree;
use crate::budget::MemoryBudget;
use crate::compile::{Control, Threads};
use crate::error::RenderError;
use crate::render::probe::Probe;
use crate::render::{AdaptiveSampling, Progress, RenderSettings, Renderer, SceneTracer};
use crate::scene::Scene;
use crate::units::TileId;

/// Pixels that a probe looks at, at most one in [`PROBE_SHARE`].
pub(super) const PROBE_PIXELS: u32 = 4096;
const PROBE_SHARE: u64 = 16;
/// Confidence of the intervals of pixels where the goal is about the whole picture. It only scales the threshold.
pub(super) const PIXEL_CONFIDENCE: f64 = 0.95;

/// Samples of every pixel before any goes on alone: what fewer have not met is not in their error.
pub(super) const FIRST_SAMPLES: u32 = 4;

pub(super) type GoalProgressFn<'f> = dyn FnMut(GoalProgress) -> Control + Send + 'f;

pub(super) struct Job<'a, 'p> {
    pub octree: &'a LazyOctree,
    pub scene: &'a Scene,
    pub settings: RenderSettings,
    pub options: GoalOptions,
    pub threads: &'a Threads,
    pub budget: &'a MemoryBudget,
    pub progress: &'p mut GoalProgressFn<'p>,
    pub counters: GoalCounters,
    /// Certificates that were made to find out whether an error goal is kept.
    pub looks: u32,
    pub seconds: GoalSeconds,
    pub start: Instant,
}

impl<'a, 'p> Job<'a, 'p> {
    pub fn new(
        octree: &'a LazyOctree,
        scene: &'a Scene,
        settings: &RenderSettings,
        options: &GoalOptions,
        threads: &'a Threads,
        budget: &'a MemoryBudget,
        progress: &'p mut GoalProgressFn<'p>,
    ) -> Job<'a, 'p> {
        Job {
            octree,
            scene,
            settings: *settings,
            options: *options,
            threads,
            budget,
            progress,
            counters: GoalCounters::default(),
            looks: 0,
            seconds: GoalSeconds::default(),
            start: Instant::now(),
        }
    }
}

impl Job<'_, '_> {
    pub fn pixels_total(&self) -> u64 {
        u64::from(self.settings.width) * u64::from(self.settings.height)
    }

    /// Confidence of what the next certificate estimates. The first one that says that an error goal is kept ends the search, so
    /// the chance of being wrong is shared among all that there may be: three quarters for the first, then an eighth, and half as
    /// much each time.
    pub fn confidence(&self) -> f64 {
        let is_search = matches!(self.options.goal, Goal::MaxError { .. });
        let share = match self.looks {
            _ if !is_search => 1.0,
            0 => 0.75,
            looks => libm::exp2(-2.0 - f64::from(looks)),
        };
        1.0 - (1.0 - self.options.confidence) * share
    }

    pub fn knobs(&self, sampling: Sampling) -> Knobs {
        Knobs {
            tier: self.octree.tier(),
            contribution_bound: self.settings.contribution_bound,
            work_budget: self.settings.work_budget,
            sampling,
            tile_size: self.settings.tile_size,
        }
    }

    pub fn adaptive(&self, samples_min: u32, confidence: f64, error: f64) -> Sampling {
        Sampling::Adaptive {
            samples_min,
            samples_max: self.options.samples_max,
            confidence,
            thresholds: vec![TileThreshold { first_tile: TileId(0), error }],
        }
    }

    /// Settings under which a pixel's samples are those that the picture will have.
    pub fn probe_settings(&self) -> RenderSettings {
        let adaptive =
            AdaptiveSampling { samples_min: FIRST_SAMPLES, error: 0.0, confidence: PIXEL_CONFIDENCE };
        RenderSettings {
            samples_per_pixel: self.options.samples_max,
            adaptive: Some(adaptive),
            ..self.settings
        }
    }

    /// A probe of the usual number of pixels.
    pub fn probe<'r>(
        &mut self,
        renderer: &'r Renderer<'_>,
    ) -> Result<Probe<'r, SceneTracer<'r>>, RenderError> {
        let usual = (self.pixels_total() / PROBE_SHARE).clamp(16, u64::from(PROBE_PIXELS)) as u32;
        let probe = renderer.probe(usual, FIRST_SAMPLES, &mut || ask(self.progress))?;
        probe.ok_or(RenderError::Cancelled)
    }

    pub fn prediction<'c>(&self, probe: &'c Probe<'_, SceneTracer<'_>>) -> Prediction<'c> {
        Prediction {
            cells: &probe.cells,
            columns: probe.columns,
            pixels_total: self.pixels_total(),
            samples_max: self.options.samples_max,
            confidence: self.options.confidence,
        }
    }

    pub fn count(&mut self, probe: &Probe<'_, SceneTracer<'_>>) {
        self.counters.effects.merge(&probe.effects());
        self.counters.trace.merge(&probe.queries());
    }
}

/// Asks the caller whether to go on while the knobs are chosen.
pub(super) fn ask(progress: &mut GoalProgressFn<'_>) -> Control {
    let nothing = Progress { samples: 0, samples_total: 0, tiles: 0, tiles_total: 0 };
    progress(GoalProgress { attempt: 0, progress: nothing })
}
