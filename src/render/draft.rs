//! A picture that goes on: what the samples of each pixel have added up to is kept, so that more can be added to them and none is taken
//! again.
//!
//! Where a pixel stops is the first doubling at which its deviation is small enough. So a picture at a high threshold that goes on
//! at a lower one ends where one does that was made at the lower one at once: bit for bit, as each pixel adds up its samples in
//! their order (I2).

use std::sync::atomic::{AtomicU32, Ordering};

use glam::DVec3;
use parking_lot::Mutex;

use super::adaptive::SampleBlocks;
use super::around::{Around, FirstSamples, look_around};
use super::film::{PixelCost, PixelStatistics, to_f32};
use super::settings::RenderSettings;
use super::stage::Stage;
use super::tile_samples::FinishedTile;
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
    /// What neighbours say; nothing until [`Draft::look_around`].
    pub around: Around,
    /// Of the mean, as its blocks and its contrast tell it.
    pub deviation: f64,
    pub cost: PixelCost,
}

impl PixelState {
    pub const EMPTY: PixelState = PixelState {
        sum: DVec3::ZERO,
        blocks: SampleBlocks::EMPTY,
        around: Around::NOTHING,
        deviation: f64::INFINITY,
        cost: PixelCost { box_tests: 0, triangle_tests: 0 },
    };

    fn shown(&self) -> Shown {
        Shown {
            mean: to_f32(self.sum / f64::from(self.blocks.samples())),
            statistics: self.blocks.statistics(self.deviation, &self.around),
            deviation: self.deviation,
        }
    }
}

/// What a film shows of a pixel, and its deviation as it is: apart from the rest, as most pixels of most steps need no more than a look.
#[derive(Clone, Copy, Debug)]
struct Shown {
    mean: [f32; 3],
    statistics: PixelStatistics,
    deviation: f64,
}

impl Shown {
    const NOTHING: Shown =
        Shown { mean: [0.0; 3], statistics: PixelStatistics::NONE, deviation: f64::INFINITY };
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
    /// From the top. Each for itself, so that threads at different tiles seldom wait for each other.
    rows: Vec<Mutex<Row>>,
    least: AtomicU32,
    _reservation: Reservation,
}

#[derive(Debug)]
struct Row {
    pixels: Vec<PixelState>,
    shown: Vec<Shown>,
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
        let width = settings.width as usize;
        let row = || Row { pixels: vec![PixelState::EMPTY; width], shown: vec![Shown::NOTHING; width] };
        Ok(Draft {
            rows: (0..settings.height).map(|_| Mutex::new(row())).collect(),
            least: AtomicU32::new(0),
            _reservation: reservation,
        })
    }

    /// What [`Draft::new`] takes from the budget: the pixels, three rows of first samples while neighbours are looked at, and for each thread
    /// a tile that needs no more samples.
    pub fn bytes_needed(settings: &RenderSettings, threads: usize) -> Bytes {
        let (width, height) = (u64::from(settings.width), u64::from(settings.height));
        let tile = u64::from(settings.tile_size.min(settings.width))
            * u64::from(settings.tile_size.min(settings.height));
        let row =
            width * (size_of::<PixelState>() + size_of::<Shown>()) as u64 + size_of::<Mutex<Row>>() as u64;
        let first = 3 * width * size_of::<FirstSamples>() as u64;
        let finished = size_of::<[f32; 3]>() + size_of::<PixelStatistics>() + size_of::<PixelCost>();
        Bytes(height * row + first + threads as u64 * tile * finished as u64)
    }

    /// Asks every pixel to have so many samples in any case.
    pub fn set_least(&self, samples: u32) {
        self.least.store(samples, Ordering::Relaxed);
    }

    /// Samples that every pixel is asked to have.
    pub fn least(&self) -> u32 {
        self.least.load(Ordering::Relaxed)
    }

    /// Has each pixel look at its neighbours ([`look_around`]); to be called when all have the first samples of adaptive sampling, before
    /// any goes on alone.
    pub fn look_around(&self) {
        let height = self.rows.len();
        let first = |y: usize, into: &mut Vec<FirstSamples>| {
            into.clear();
            into.extend(self.rows[y].lock().pixels.iter().map(|pixel| pixel.blocks.first_samples()));
        };
        let [mut above, mut here, mut below] = [(); 3].map(|()| Vec::new());
        if height > 0 {
            first(0, &mut below);
        }
        for (y, row) in self.rows.iter().enumerate() {
            (above, here, below) = (here, below, above);
            if y + 1 < height {
                first(y + 1, &mut below);
            }
            let lines = [&above, &here, &below];
            let lines = &lines[usize::from(y == 0)..if y + 1 < height { 3 } else { 2 }];
            let Row { pixels, shown } = &mut *row.lock();
            let size = [pixels.len(), lines.len()];
            for (x, (pixel, shown)) in pixels.iter_mut().zip(shown).enumerate() {
                pixel.around = look_around(size, [x, usize::from(y > 0)], |x, y| lines[y][x]);
                pixel.deviation = pixel.blocks.deviation(pixel.around.contrast);
                *shown = pixel.shown();
            }
        }
    }

    /// Gives the pixels of an area, row by row, to `take`.
    pub(super) fn read(&self, area: &Area, mut take: impl FnMut(u32, u32, &PixelState)) {
        for y in 0..area.height {
            let row = self.rows[(area.y + y) as usize].lock();
            for (x, pixel) in (0..area.width).zip(&row.pixels[area.x as usize..]) {
                take(x, y, pixel);
            }
        }
    }

    /// Keeps what pixels of an area have now. `pixel` is asked for that of each place, row by row, and told how many samples it
    /// had; it gives nothing for one that has no more.
    pub(super) fn write(&self, area: &Area, mut pixel: impl FnMut(u32, u32, u32) -> Option<PixelState>) {
        for y in 0..area.height {
            let mut row = self.rows[(area.y + y) as usize].lock();
            for x in 0..area.width {
                let at = (area.x + x) as usize;
                if let Some(pixel) = pixel(x, y, row.shown[at].statistics.samples) {
                    row.shown[at] = pixel.shown();
                    row.pixels[at] = pixel;
                }
            }
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
        let is_open = (area.y..area.y + area.height).any(|y| {
            let shown = &self.rows[y as usize].lock().shown[area.x as usize..][..area.width as usize];
            shown.iter().any(|pixel| wanted.is_open(pixel.statistics.samples, pixel.deviation))
        });
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
        for y in area.y..area.y + area.height {
            let row = self.rows[y as usize].lock();
            let columns = area.x as usize..(area.x + area.width) as usize;
            let shown = &row.shown[columns.clone()];
            is_whole &= shown.iter().all(|pixel| pixel.statistics.samples > 0);
            finished.pixels.extend(shown.iter().map(|pixel| pixel.mean));
            if settings.keep_statistics {
                finished.statistics.extend(shown.iter().map(|pixel| pixel.statistics));
            }
            if settings.keep_costs {
                finished.costs.extend(row.pixels[columns].iter().map(|pixel| pixel.cost));
            }
        }
        is_whole
    }
}
