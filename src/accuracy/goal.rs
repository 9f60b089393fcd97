//! What the caller wants of a picture.

use std::time::Duration;

use super::Metric;
use super::job::FIRST_SAMPLES;
use crate::error::RenderError;
use crate::render::Progress;

/// How good or how fast a picture is to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// As fast as can be with an error of at most `bound`, against the picture with infinitely many samples and nothing cut off.
    MaxError {
        /// How the error is measured.
        metric: Metric,
        /// The most it may be, in the metric's unit.
        bound: f64,
    },
    /// As good as can be in this time by the clock, the choice of the knobs included.
    MaxTime(Duration),
    /// Nothing is cut off, and every hit is certain: the picture that the settings' samples have, exactly. (With
    /// infinitely many samples there is no exact picture.)
    Exact,
}

/// A goal, and how sure to be of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GoalOptions {
    /// What is wanted.
    pub goal: Goal,
    /// Confidence of what is estimated, above 0.5 and not above 1 - 1e-9.
    pub confidence: f64,
    /// Most samples that a pixel may get; a power of two, at least 4. Not used by [`Goal::Exact`].
    pub samples_max: u32,
    /// Largest distance per axis between a vertex of the source and the compiled one, if the caller knows it
    /// ([`CompileReport::error_bound`](crate::compile::CompileReport::error_bound)); the file itself records only how positions are held.
    pub vertex_error: Option<f64>,
    /// Whether the certificate says something about the error in FLIP also where the goal is about another metric: that takes about two
    /// microseconds for each pixel, as long as a few rays.
    pub every_metric: bool,
}

/// Nearer to 1, what is left of 1 goes into quantiles with few digits, and leaves the range where they are divided among pixels.
const CONFIDENCE_MAX: f64 = 1.0 - 1e-9;

impl GoalOptions {
    /// `goal` at 95 % confidence with up to 4096 samples per pixel.
    pub fn new(goal: Goal) -> GoalOptions {
        GoalOptions { goal, confidence: 0.95, samples_max: 4096, vertex_error: None, every_metric: false }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for the first that makes no sense.
    pub fn validate(&self) -> Result<(), RenderError> {
        let check = |holds: bool, what: &'static str, reason: &str| {
            if holds { Ok(()) } else { Err(RenderError::Setting { what, reason: reason.to_string() }) }
        };
        match self.goal {
            Goal::MaxError { bound, .. } => {
                check(
                    bound > 0.0 && bound.is_finite(),
                    "error goal",
                    "the bound must be positive and finite",
                )?;
            }
            Goal::MaxTime(time) => check(!time.is_zero(), "time goal", "it must be above zero")?,
            Goal::Exact => {}
        }
        check(
            self.confidence > 0.5 && self.confidence <= CONFIDENCE_MAX,
            "confidence",
            "it must lie above 0.5 and not above 1 - 1e-9",
        )?;
        check(
            self.samples_max.is_power_of_two() && self.samples_max >= FIRST_SAMPLES,
            "most samples per pixel",
            "it must be a power of two, at least 4",
        )?;
        check(self.vertex_error.is_none_or(|error| error >= 0.0), "vertex error", "it must not be negative")
    }
}

/// How far a render to a goal is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GoalProgress {
    /// 0 while the knobs are chosen, then the number of the picture that is being made: 1, and more if too much was cut off of the first to
    /// keep the goal.
    pub attempt: u32,
    /// How far the step is that the picture is in; all zero while the knobs are chosen. A picture to an error goal takes several
    /// steps, each over all of it.
    pub progress: Progress,
}
