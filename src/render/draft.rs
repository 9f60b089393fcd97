//! A picture that goes on: what the samples of each pixel have added up to is kept, so that more can be added to them and none is taken
//! again.
//!
//! Where a pixel stops is the first doubling at which its deviation is small enough. So a picture at a high threshold that goes on at a lower
//! one ends where one does that was made at the lower one at once: bit for bit, as each pixel adds up its samples in their order (I2).

use glam::DVec3;
use parking_lot::Mutex;

use super::adaptive::SampleBlocks;
use super::film::{PixelCost, PixelStatistics, to_f32};
use super::settings::RenderSettings;
use super::stage::Stage;
use super::tile_samples::{FinishedTile, contrast};
use super::tiles::Area;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::BudgetError;
use crate::units::Bytes;

/// What is kept of a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelState {
    /// In the order of its samples: what blocks add up to may differ in the last place.
    pub sum: DVec3,
    pub blocks: SampleBlocks,
    /// With its neighbours; zero until [`Draft::look_around`].
    pub contrast: DVec3,
    /// Of the mean, as its blocks and its contrast tell it.
    pub deviation: f64,
    pub cost: PixelCost,
}

impl PixelState {
    pub const EMPTY: PixelState = PixelState {
        sum: DVec3::ZERO,
        blocks: SampleBlocks::EMPTY,
        contrast: DVec3::ZERO,
        deviation: f64::INFINITY,
        cost: PixelCost { box_tests: 0, triangle_tests: 0 },
    };

    /// What a film shows of it.
    pub fn mean(&self) -> [f32; 3] {
        to_f32(self.sum / f64::from(self.blocks.samples()))
    }

    pub fn statistics(&self) -> PixelStatistics {
        self.blocks.statistics(self.deviation)
    }
}

/// What pixels are asked for: so many samples in any case, and more while their deviation is too large.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wanted {
    pub least: u32,
    pub deviation: f64,
    pub samples_max: u32,
}

impl Wanted {
    /// By a threshold of a tile, or that of the settings.
    pub fn by(stage: &Stage, least: u32, threshold: Option<f64>) -> Wanted {
        let settings = &stage.settings;
        let deviation = settings
            .adaptive
            .map_or(f64::INFINITY, |adaptive| threshold.unwrap_or(adaptive.error) / adaptive.quantile());
        Wanted { least, deviation, samples_max: settings.samples_per_pixel }
    }

    /// Whether a pixel is to go on.
    pub fn is_open(&self, samples: u32, deviation: f64) -> bool {
        samples < self.least || samples < self.samples_max && deviation > self.deviation
    }

    /// How many samples a pixel with so many gets next.
    pub fn step(&self, samples: u32) -> u32 {
        if samples < self.least { self.least - samples } else { samples }
    }
}

/// See the module's text.
#[derive(Debug)]
pub(crate) struct Draft {
    width: usize,
    kept: Mutex<Kept>,
    _reservation: Reservation,
}

#[derive(Debug)]
struct Kept {
    /// Row by row.
    pixels: Vec<PixelState>,
    least: u32,
}

impl Draft {
    /// Of a picture without samples, that so many threads work on.
    ///
    /// # Errors
    /// [`BudgetError`] if the budget cannot hold it.
    pub fn new(
        settings: &RenderSettings,
        threads: usize,
        budget: &MemoryBudget,
    ) -> Result<Draft, BudgetError> {
        let bytes = Draft::bytes_needed(settings, threads);
        let reservation = budget.reserve(bytes, "a picture that goes on")?;
        let count = settings.width as usize * settings.height as usize;
        Ok(Draft {
            width: settings.width as usize,
            kept: Mutex::new(Kept { pixels: vec![PixelState::EMPTY; count], least: 0 }),
            _reservation: reservation,
        })
    }

    /// What [`Draft::new`] takes from the budget: the pixels, their contrasts while they are measured, and for each thread a tile that needs no
    /// more samples.
    pub fn bytes_needed(settings: &RenderSettings, threads: usize) -> Bytes {
        let pixels = u64::from(settings.width) * u64::from(settings.height);
        let tile = u64::from(settings.tile_size.min(settings.width))
            * u64::from(settings.tile_size.min(settings.height));
        let kept = size_of::<PixelState>() + size_of::<DVec3>();
        let finished = size_of::<[f32; 3]>() + size_of::<PixelStatistics>() + size_of::<PixelCost>();
        Bytes(pixels * kept as u64 + threads as u64 * tile * finished as u64)
    }

    /// Asks every pixel to have so many samples in any case.
    pub fn set_least(&self, samples: u32) {
        self.kept.lock().least = samples;
    }

    /// Samples that every pixel is asked to have.
    pub fn least(&self) -> u32 {
        self.kept.lock().least
    }

    /// Measures the contrast of each pixel with its neighbours; to be called when all have the first samples of adaptive sampling, before any goes on alone.
    pub fn look_around(&self) {
        let mut kept = self.kept.lock();
        let (width, height) = (self.width, kept.pixels.len() / self.width);
        let contrasts: Vec<DVec3> = {
            let range = |x: usize, y: usize| kept.pixels[y * width + x].blocks.range();
            let at = |index: usize| [index % width, index / width];
            (0..kept.pixels.len()).map(|index| contrast([width, height], at(index), range)).collect()
        };
        for (pixel, contrast) in kept.pixels.iter_mut().zip(contrasts) {
            pixel.contrast = contrast;
            pixel.deviation = pixel.blocks.deviation(contrast);
        }
    }

    /// Gives the pixels of an area, row by row, to `take`.
    pub(super) fn read(&self, area: &Area, mut take: impl FnMut(u32, u32, &PixelState)) {
        let kept = self.kept.lock();
        for y in 0..area.height {
            let start = (area.y + y) as usize * self.width + area.x as usize;
            for (x, pixel) in (0..area.width).zip(&kept.pixels[start..]) {
                take(x, y, pixel);
            }
        }
    }

    /// Keeps what pixels of an area have now: each by its place in the area.
    pub(super) fn write(&self, area: &Area, pixels: impl Iterator<Item = ([u16; 2], PixelState)>) {
        let mut kept = self.kept.lock();
        for ([x, y], pixel) in pixels {
            let (x, y) = (area.x as usize + usize::from(x), area.y as usize + usize::from(y));
            kept.pixels[y * self.width + x] = pixel;
        }
    }

    /// Whether any pixel of an area is to go on. If none is, `finished` is what the film shows of them.
    pub(super) fn is_open(
        &self,
        stage: &Stage,
        area: &Area,
        threshold: Option<f64>,
        finished: &mut FinishedTile,
    ) -> bool {
        let wanted = Wanted::by(stage, self.least(), threshold);
        let mut is_open = false;
        self.read(area, |_, _, pixel| is_open |= wanted.is_open(pixel.blocks.samples(), pixel.deviation));
        if !is_open {
            self.show(stage, area, finished);
        }
        is_open
    }

    /// What a film shows of an area as it is: `false` if a pixel has no sample yet.
    pub(super) fn show(&self, stage: &Stage, area: &Area, finished: &mut FinishedTile) -> bool {
        let settings = &stage.settings;
        let count = area.width as usize * area.height as usize;
        finished.pixels.clear();
        finished.pixels.reserve_exact(count);
        finished.statistics.clear();
        finished.statistics.reserve_exact(if settings.keep_statistics { count } else { 0 });
        finished.costs.clear();
        finished.costs.reserve_exact(if settings.keep_costs { count } else { 0 });
        let mut is_whole = true;
        self.read(area, |_, _, pixel| {
            is_whole &= pixel.blocks.samples() > 0;
            finished.pixels.push(pixel.mean());
            if settings.keep_statistics {
                finished.statistics.push(pixel.statistics());
            }
            if settings.keep_costs {
                finished.costs.push(pixel.cost);
            }
        });
        is_whole
    }
}
