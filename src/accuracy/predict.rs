//! From a probe to the whole picture: what adaptive sampling would cost and reach at any threshold.
//!
//! A threshold is given as a standard deviation here: the half width of the confidence interval over its quantile.

use super::estimate::{Estimate, MeanSquare, Pixels, Sampled, estimate, mean_square};
use super::unseen::{self, Unseen};
use super::{Metric, check};
use crate::render::probe::{Level, ProbedCell, ProbedPixel};

/// What a probe says.
pub(super) struct Prediction<'p> {
    pub cells: &'p [ProbedCell],
    /// Cells across.
    pub columns: usize,
    /// Of the whole picture.
    pub pixels_total: u64,
    pub samples_max: u32,
    pub confidence: f64,
}

impl Sampled {
    fn of(level: &Level) -> Sampled {
        let Level { mean, half_difference, deviation, lost, .. } = *level;
        Sampled { mean, half_difference, deviation, lost }
    }
}

impl Prediction<'_> {
    /// Where a pixel stops at a threshold, as far as it was probed.
    fn stop<'l>(&self, pixel: &'l ProbedPixel, deviation: f64) -> &'l Level {
        &pixel.levels[pixel.stop(deviation, self.samples_max)]
    }

    /// The estimate to be expected at a threshold not below that to which the probe was refined.
    pub fn estimate(&self, metric: Metric, deviation: f64) -> Estimate {
        let pixels = self.sampled(deviation);
        let samples = || self.rows().map(|pixel| self.stop(pixel, deviation).samples);
        let known = || samples().zip(pixels.iter().map(|pixel| pixel.deviation));
        let plan = check::Plan::new(known(), self.pixels_total);
        let chances = known().map(|(samples, deviation)| plan.chance(samples, deviation));
        let squares = self.rows().zip(&pixels).map(|(pixel, sampled)| {
            let stop = pixel.stop(deviation, self.samples_max);
            let (samples, next) = (pixel.levels[stop].samples, pixel.levels.get(stop + 1));
            // The half difference of twice the samples is half of the difference that a check would see.
            next.map_or(sampled.square(), |next| {
                check::own_part(sampled, samples) * 4.0 * mean_square(&next.half_difference)
            })
        });
        let probed: Vec<(f64, f64)> = squares.zip(chances).collect();
        let squares = MeanSquare::expected(&probed, self.pixels_total, self.confidence);
        // What pixels may have missed is known of the whole picture only.
        let unseen = Unseen::default();
        let pixels = Pixels::new(pixels, self.width() as u32);
        estimate(metric, &pixels, squares, &unseen, self.pixels_total, self.confidence)
    }

    /// All pixels as they are at a threshold.
    fn sampled(&self, deviation: f64) -> Vec<Sampled> {
        self.rows().map(|pixel| Sampled::of(self.stop(pixel, deviation))).collect()
    }

    /// How many pixels were probed.
    pub fn pixels(&self) -> usize {
        self.cells.iter().map(|cell| cell.pixels.len()).sum()
    }

    /// The largest deviation that any pixel has after its first samples.
    pub fn deviation_max(&self) -> f64 {
        self.rows().map(|pixel| pixel.levels[0].deviation).fold(0.0, f64::max)
    }

    /// Whether more samples would be taken at a lower threshold.
    pub fn is_exhausted(&self, deviation: f64) -> bool {
        self.rows().all(|pixel| {
            let level = self.stop(pixel, deviation);
            level.deviation == 0.0 || level.samples >= self.samples_max
        })
    }

    /// Rays per pixel of a cell at a threshold. Below the threshold of the probe deviations are taken to fall as at an edge, with
    /// `n^-3/4`.
    pub fn rays_per_pixel(&self, cell: &ProbedCell, deviation: f64) -> f64 {
        let samples: f64 = cell
            .pixels
            .iter()
            .map(|pixel| {
                let level = self.stop(pixel, deviation);
                let reached = f64::from(level.samples);
                if level.deviation <= deviation {
                    return reached;
                }
                let more = libm::pow(level.deviation / deviation.max(f64::MIN_POSITIVE), 4.0 / 3.0);
                (reached * more).min(f64::from(self.samples_max))
            })
            .sum();
        samples / cell.pixels.len() as f64 * self.rays_per_sample(cell)
    }

    /// Rays that it takes to look closer at what stands out, at most.
    pub fn rays_closer(&self) -> f64 {
        let around = self.rows().map(|pixel| [pixel.around.stands_out, pixel.around.surround]);
        let samples = unseen::samples_closer(around, self.samples_min());
        let cells = self.cells.len().max(1) as f64;
        let rays = self.cells.iter().map(|cell| self.rays_per_sample(cell)).sum::<f64>() / cells;
        samples * rays * self.pixels_total as f64 / self.pixels().max(1) as f64
    }

    pub fn rays_per_sample(&self, cell: &ProbedCell) -> f64 {
        cell.rays as f64 / cell.samples as f64
    }

    /// Samples of every pixel.
    pub fn samples_min(&self) -> u32 {
        self.cells[0].pixels[0].levels[0].samples
    }

    fn width(&self) -> usize {
        self.cells[..self.columns].iter().map(|cell| cell.area.width as usize).sum()
    }

    /// All pixels as a picture, cell beside cell, row by row.
    fn rows(&self) -> impl Iterator<Item = &ProbedPixel> {
        self.cells.chunks(self.columns).flat_map(|cells| {
            (0..cells[0].area.height as usize).flat_map(move |row| {
                cells.iter().flat_map(move |cell| {
                    let width = cell.area.width as usize;
                    &cell.pixels[row * width..][..width]
                })
            })
        })
    }
}
