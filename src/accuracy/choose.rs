//! The knobs of an error goal, from a probe of the picture.

use super::Metric;
use super::estimate::{max_quantile, sampling_room};
use super::job::{Job, ask};
use super::predict::Prediction;
use crate::error::RenderError;
use crate::render::probe::Probe;
use crate::render::{AdaptiveSampling, SceneTracer};

/// What is aimed at of an error goal.
const AIM: f64 = 0.95;

/// How an error goal is sampled.
#[derive(Clone, Copy, Debug)]
pub(super) enum Chosen {
    /// So many samples everywhere.
    Fixed(u32),
    /// Until a pixel's deviation is no more than this.
    Deviation(f64),
}

impl Job<'_, '_> {
    /// The contribution bound and the samples for an error goal.
    pub(super) fn choose(&mut self, metric: Metric, bound: f64) -> Result<(f64, Chosen), RenderError> {
        // High, and then down in steps: a probe of first samples costs little, and following rays that need not be followed much.
        let mut contribution_bound = match metric {
            Metric::Flip => 0.2 * bound,
            Metric::Rmse | Metric::Max => bound,
        };
        let most = cut_off_share(metric) * bound;
        let mut cut_before = f64::INFINITY;
        // Few pixels tell the size of what is cut off.
        for _ in 0..8 {
            let renderer = self.probe_renderer(contribution_bound)?;
            let probe = self.probe(&renderer, 4)?;
            let first = self.prediction(&probe);
            let cut = match metric {
                Metric::Flip => first.flip_cut_off(f64::INFINITY),
                _ => first.cut_off(metric, f64::INFINITY),
            };
            self.count(&probe);
            // What work budgets cut does not shrink.
            if cut <= most || cut > 0.95 * cut_before {
                break;
            }
            // FLIP grows with differences to the power of 0.7.
            let power = if metric == Metric::Flip { 1.0 / 0.7 } else { 1.0 };
            contribution_bound *= libm::pow(most / cut, power).clamp(1.0 / 64.0, 0.6);
            cut_before = cut;
        }
        let renderer = self.probe_renderer(contribution_bound)?;
        let mut probe = self.probe(&renderer, 1)?;
        let chosen = match self.few_samples(&probe, metric, bound) {
            Some(samples) => Ok(Chosen::Fixed(samples)),
            None => self.choose_deviation(&mut probe, metric, bound).map(Chosen::Deviation),
        };
        self.count(&probe);
        Ok((contribution_bound, chosen?))
    }

    /// [`Job::choose_deviation`] by a probe of its own.
    pub(super) fn choose_deviation_at(
        &mut self,
        contribution_bound: f64,
        metric: Metric,
        bound: f64,
    ) -> Result<f64, RenderError> {
        let renderer = self.probe_renderer(contribution_bound)?;
        let mut probe = self.probe(&renderer, 1)?;
        let deviation = self.choose_deviation(&mut probe, metric, bound);
        self.count(&probe);
        deviation
    }

    /// If the same few samples everywhere are enough, how many: nothing stops early then, so that no check is needed.
    fn few_samples(&self, probe: &Probe<'_, SceneTracer<'_>>, metric: Metric, bound: f64) -> Option<u32> {
        // The greatest error of many pixels is not known from two samples of each.
        if metric == Metric::Max {
            return None;
        }
        let prediction = self.prediction(probe);
        [2, AdaptiveSampling::SAMPLES_MIN].into_iter().find(|samples| {
            *samples <= self.options.samples_max
                && prediction.estimate_fixed(metric, *samples).whole <= AIM * bound
        })
    }

    /// The highest threshold that keeps the bound, by what the probe shows.
    fn choose_deviation(
        &mut self,
        probe: &mut Probe<'_, SceneTracer<'_>>,
        metric: Metric,
        bound: f64,
    ) -> Result<f64, RenderError> {
        let first = self.prediction(probe);
        if metric == Metric::Max {
            let room = sampling_room(metric, bound, first.cut_off(metric, f64::INFINITY));
            return Ok(AIM * room / max_quantile(self.pixels_total(), self.options.confidence));
        }
        let mut high = first.deviation_max();
        let keeps = |prediction: &Prediction<'_>, deviation: f64| {
            prediction.estimate(metric, deviation).whole <= AIM * bound
        };
        let samples_max = self.options.samples_max;
        // From the first samples alone to ever more, until the bound is kept; then back to the highest threshold that keeps it.
        let mut fails = None;
        loop {
            if !probe.refine(high, samples_max, &mut || ask(self.progress))? {
                return Err(RenderError::Cancelled);
            }
            let prediction = self.prediction(probe);
            if keeps(&prediction, high) {
                let mut fits = high;
                if let Some(mut fails) = fails {
                    for _ in 0..5 {
                        let middle = f64::sqrt(fits * fails);
                        if keeps(&prediction, middle) { fits = middle } else { fails = middle }
                    }
                }
                return Ok(fits);
            }
            if prediction.is_exhausted(high) {
                return Ok(high);
            }
            fails = Some(high);
            high *= 0.5;
        }
    }
}

/// The part of an error goal that cutting off may take. In RMSE it adds up with the rest in squares, and so half of it leaves 0.87 for
/// samples.
pub(super) fn cut_off_share(metric: Metric) -> f64 {
    match metric {
        Metric::Rmse => 0.5,
        Metric::Max | Metric::Flip => 0.25,
    }
}
