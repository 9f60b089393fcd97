//! Keeping to a time: thresholds that follow the clock, tile by tile.
//!
//! A probe says what each tile costs in rays at each threshold. When a thread takes a tile, the rays that fit into the time left, at
//! the rate seen so far, are spread over the tiles left: they all get the least threshold that fits. What was
//! chosen is recorded, and a picture made with the record needs no clock.

use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::TileThreshold;
use super::predict::Prediction;
use crate::render::{RenderSettings, TileGrid};
use crate::units::{Bytes, TileId};

/// Thresholds that are looked at, from one to the next by a factor of 1.2.
const STEPS: usize = 64;
const STEP: f64 = 1.2;
/// Tiles after which the rate seen counts as much as the rate of the probe.
const TRUST_AFTER_TILES: f64 = 3.0;

/// How much of the probe's rate is counted on at first: what is saved in the first tiles improves the last ones, but what is
/// overspent there is gone.
const CAUTION: f64 = 0.75;

/// Gives each tile its threshold.
pub(super) struct Steering {
    /// Threshold of each step, falling, as the half width of an interval.
    errors: Vec<f64>,
    /// Rays of all tiles from this one on, per step; one entry more than there are tiles.
    rays_from: Vec<[f32; STEPS]>,
    start: Instant,
    limit: Duration,
    threads: f64,
    /// Rays per second of all threads together, from the probe.
    rate: f64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    thresholds: Vec<TileThreshold>,
    /// Threshold of the tile taken last.
    last_step: Option<usize>,
    /// When the first tile was taken.
    begun: Option<Instant>,
    /// Rays that the tiles taken cost.
    rays_taken: f64,
    /// What the tile taken last costs.
    rays_last: f64,
}

/// What [`Steering::new`] allocates.
pub(super) fn bytes_needed(settings: &RenderSettings) -> Bytes {
    Bytes((settings.grid().tile_count() as u64 + 1) * (size_of::<[f32; STEPS]>() as u64 + 64))
}

impl Steering {
    /// `start` is when the time of `limit` began; `rate` is in rays per second of all threads together.
    pub fn new(
        prediction: &Prediction<'_>,
        settings: &RenderSettings,
        quantile: f64,
        start: Instant,
        limit: Duration,
        threads: usize,
        rate: f64,
    ) -> Steering {
        let highest = prediction.deviation_max().max(f64::MIN_POSITIVE);
        let deviations: Vec<f64> = (0..STEPS).map(|step| highest / libm::pow(STEP, step as f64)).collect();
        let rays = tile_rays(prediction, settings, &deviations);
        let mut rays_from = vec![[0.0f32; STEPS]; rays.len() + 1];
        for tile in (0..rays.len()).rev() {
            rays_from[tile] = std::array::from_fn(|step| rays_from[tile + 1][step] + rays[tile][step]);
        }
        Steering {
            errors: deviations.iter().map(|deviation| deviation * quantile).collect(),
            rays_from,
            start,
            limit,
            threads: threads as f64,
            rate: CAUTION * rate,
            state: Mutex::new(State::default()),
        }
    }

    /// Rays of the whole picture at the highest threshold: the least it can take.
    pub fn rays_min(&self) -> f64 {
        f64::from(self.rays_from[0][0])
    }

    /// The threshold of a tile that is taken now.
    pub fn threshold(&self, tile: TileId) -> f64 {
        let index = tile.0 as usize;
        let mut state = self.state.lock();
        let now = Instant::now();
        let begun = *state.begun.get_or_insert(now);
        let left = self.limit.saturating_sub(now - self.start).as_secs_f64();
        // Of the tiles that other threads are at, about half is still to do.
        let in_flight = 0.5 * (self.threads - 1.0) * state.rays_last;
        let done = (state.rays_taken - in_flight).max(0.0);
        let elapsed = (now - begun).as_secs_f64();
        let trust = done / (done + TRUST_AFTER_TILES * self.threads * state.rays_last.max(1.0));
        let rate = if elapsed > 0.0 { trust * done / elapsed + (1.0 - trust) * self.rate } else { self.rate };
        let room = left * rate - in_flight;
        let remaining = &self.rays_from[index];
        let fitting = remaining.iter().take_while(|rays| f64::from(**rays) <= room).count().saturating_sub(1);
        // Time left over near the end is no reason to spend it all on a few tiles.
        let step = state.last_step.map_or(fitting, |last| fitting.min(last + 1));
        state.last_step = Some(step);
        let rays = f64::from(remaining[step] - self.rays_from[index + 1][step]);
        state.rays_taken += rays;
        state.rays_last = rays;
        let error = self.errors[step];
        if state.thresholds.last().is_none_or(|last| last.error != error) {
            state.thresholds.push(TileThreshold { first_tile: tile, error });
        }
        error
    }

    /// What was chosen, in the order of tiles.
    pub fn into_thresholds(self) -> Vec<TileThreshold> {
        self.state.into_inner().thresholds
    }
}

/// Rays of each tile, in the order in which they are handed out, at each deviation.
fn tile_rays(
    prediction: &Prediction<'_>,
    settings: &RenderSettings,
    deviations: &[f64],
) -> Vec<[f32; STEPS]> {
    let grid: TileGrid = settings.grid();
    let columns = settings.width.div_ceil(settings.tile_size);
    let mut per_pixel = vec![([0.0f64; STEPS], 0u32); grid.tile_count()];
    let mut everywhere = [0.0f64; STEPS];
    // First samples that border tiles take again.
    let again = |area_pixels: f64, ground_pixels: f64| {
        f64::from(prediction.samples_min()) * (ground_pixels - area_pixels) / area_pixels
    };
    let whole = f64::from(settings.tile_size * settings.tile_size);
    let around = f64::from((settings.tile_size + 2) * (settings.tile_size + 2));
    let border = again(whole, around);
    for cell in prediction.cells {
        let rays: [f64; STEPS] = std::array::from_fn(|step| {
            prediction.rays_per_pixel(cell, deviations[step]) + border * prediction.rays_per_sample(cell)
        });
        let (x, y) = (cell.area.x + cell.area.width / 2, cell.area.y + cell.area.height / 2);
        let tile = y / settings.tile_size * columns + x / settings.tile_size;
        let (sum, count) = &mut per_pixel[tile as usize];
        *count += 1;
        for step in 0..STEPS {
            sum[step] += rays[step];
            everywhere[step] += rays[step] / prediction.cells.len() as f64;
        }
    }
    let order = grid.hilbert_order();
    let tile = |cell: &u32| {
        let area = grid.area(*cell);
        let pixels = f64::from(area.width * area.height);
        let (sum, count) = &per_pixel[*cell as usize];
        std::array::from_fn(|step| {
            let rays = if *count > 0 { sum[step] / f64::from(*count) } else { everywhere[step] };
            (pixels * rays) as f32
        })
    };
    order.iter().map(tile).collect()
}
