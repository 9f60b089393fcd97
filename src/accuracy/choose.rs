//! The contribution bound of an error goal, from samples of a few pixels.

use super::Metric;
use super::estimate::{Sampled, cut_off, flip_cut_off, sampling_room};
use super::job::{Job, ask};
use crate::error::RenderError;
use crate::render::resample::SampledPixel;
use crate::render::{RenderSettings, Renderer, to_f32};

/// Pixels that are looked at for a contribution bound, at most one in [`LOOK_SHARE`].
const LOOK_PIXELS: u64 = 1024;
const LOOK_SHARE: u64 = 32;
/// Contribution bounds that are looked at.
const LOOKS_MAX: u32 = 10;

/// What a few pixels say about a contribution bound.
struct Look {
    /// What it adds to the error.
    cut: f64,
    /// Rays of a sample.
    rays: f64,
}

impl Job<'_, '_> {
    /// The contribution bound at which the least is expected to be left to do, from high down: what is cut off leaves less room for the
    /// error of sampling, and what is not takes rays.
    pub(super) fn choose_contribution_bound(
        &mut self,
        metric: Metric,
        bound: f64,
    ) -> Result<f64, RenderError> {
        let pixels = self.pixels_to_look_at(if metric == Metric::Flip { 4 } else { 1 });
        let mut candidate = match metric {
            Metric::Flip => 0.2 * bound,
            Metric::Rmse | Metric::Max => bound,
        };
        // FLIP grows with differences to the power of 0.7.
        let power = if metric == Metric::Flip { 1.0 / 0.7 } else { 1.0 };
        // For how much less error so many times as many samples are good: between `n^-3/4` of edges and `n^-1/2` of what is not
        // stratified; in FLIP, to the power of 0.7.
        let samples_power = if metric == Metric::Flip { -2.0 } else { -1.5 };
        let mut best = (f64::INFINITY, candidate);
        let mut cut_before = f64::INFINITY;
        for _ in 0..LOOKS_MAX {
            let look = self.look(metric, candidate, &pixels)?;
            // In FLIP noise hides what is cut off, and the other way round, nearly as in RMSE; what its filters make of single
            // pixels is too much anyway.
            let of = if metric == Metric::Flip { Metric::Rmse } else { metric };
            let room = sampling_room(of, bound, look.cut) / bound;
            let price = look.rays * libm::pow(room, samples_power);
            if price < best.0 || best.0.is_infinite() {
                best = (price, candidate);
            }
            // It gets dearer again, what work budgets cut does not shrink, or there is next to nothing left to gain.
            let gain = 1.0 - libm::pow(room, -samples_power);
            if price > best.0 || look.cut > 0.95 * cut_before || gain < 0.03 {
                break;
            }
            let wanted = 0.9 * bound / look.cut;
            candidate *= if wanted < 1.0 { libm::pow(wanted, power).clamp(1.0 / 64.0, 0.5) } else { 0.5 };
            cut_before = look.cut;
        }
        Ok(best.1)
    }

    fn look(
        &mut self,
        metric: Metric,
        contribution_bound: f64,
        pixels: &[SampledPixel],
    ) -> Result<Look, RenderError> {
        let settings = RenderSettings { contribution_bound, ..self.probe_settings() };
        let renderer = Renderer::new(self.octree, self.scene, &settings, self.budget)?;
        let told = &mut *self.progress;
        let found = renderer.resample(pixels, self.threads, &mut || ask(told))?;
        let found = found.ok_or(RenderError::Cancelled)?;
        self.counters.effects.merge(&found.effects);
        self.counters.trace.merge(&found.trace);
        let cut = match metric {
            Metric::Flip => {
                let seen = |(mean, lost): (&glam::DVec3, &f64)| Sampled {
                    mean: to_f32(*mean),
                    half_difference: [0.0; 3],
                    deviation: 0.0,
                    lost: *lost,
                };
                let seen: Vec<Sampled> = found.means.iter().zip(&found.lost).map(seen).collect();
                let width = pixels.iter().take_while(|pixel| pixel.y == pixels[0].y).count();
                flip_cut_off(&seen, width as u32)
            }
            Metric::Rmse | Metric::Max => cut_off(metric, found.lost.iter().copied()).unwrap_or(0.0),
        };
        Ok(Look { cut, rays: found.effects.rays() as f64 / pixels.len() as f64 })
    }

    /// Pixels in squares of `side`, in rows and columns over the picture, as a small picture: each with a sample before the one that is
    /// looked at.
    fn pixels_to_look_at(&self, side: u32) -> Vec<SampledPixel> {
        let wanted = (self.pixels_total() / LOOK_SHARE).clamp(256, LOOK_PIXELS).min(self.pixels_total());
        let sides = [self.settings.width, self.settings.height];
        let spacing = f64::from(side) * (self.pixels_total() as f64 / wanted as f64).sqrt();
        let [columns, rows] = sides.map(|length| {
            let count = (f64::from(length) / spacing).ceil().max(1.0) as u32;
            let step = f64::from(length) / f64::from(count);
            let start = |index: u32| {
                let middle = (f64::from(index) + 0.5) * step - 0.5 * f64::from(side);
                (middle.round().max(0.0) as u32).min(length.saturating_sub(side))
            };
            let mut places: Vec<u32> = (0..count)
                .flat_map(|index| (0..side.min(length)).map(move |offset| start(index) + offset))
                .collect();
            // Squares may overlap.
            places.sort_unstable();
            places.dedup();
            places
        });
        let row = |y: u32| columns.iter().map(move |&x| SampledPixel { x, y, first: 1, samples: 1 });
        rows.iter().flat_map(|&y| row(y)).collect()
    }
}

/// The part of an error goal that cutting off may take, if the picture is not to be made again for it. In RMSE it adds up with the rest in
/// squares.
pub(super) fn cut_off_share(metric: Metric) -> f64 {
    match metric {
        Metric::Rmse => 0.5,
        Metric::Max | Metric::Flip => 0.25,
    }
}
