//! The pixels of a tile while samples are added to them: in rounds, where sampling is adaptive.
//!
//! A round is a list of samples, pixel by pixel; whoever traces them gives them back in that order, so that every pixel sums up its
//! samples in the same order whoever that is (I2).

use std::ops::Range;

use glam::DVec3;

use super::adaptive::SampleBlocks;
use super::around::{Around, look_around};
use super::draft::{PixelState, Wanted};
use super::film::{PixelCost, PixelStatistics, to_f32};
use super::stage::{PixelSample, Stage};
use super::tiles::{Area, morton_order};
use crate::stats::TraceCounters;

/// What must be known to trace samples of a tile.
#[derive(Clone, Copy, Default)]
struct Place {
    /// The tile itself.
    area: Area,
    /// The tile and what is traced around it; the tile alone unless sampling is adaptive.
    ground: Area,
}

impl Place {
    /// Whether a pixel of the ground belongs to the tile.
    fn is_own(&self, [x, y]: [u16; 2]) -> bool {
        let (x, y) = (self.ground.x + u32::from(x), self.ground.y + u32::from(y));
        (self.area.x..self.area.x + self.area.width).contains(&x)
            && (self.area.y..self.area.y + self.area.height).contains(&y)
    }
}

/// See the module's text.
#[derive(Default)]
pub(super) struct TileSamples {
    place: Place,
    /// In the order in which they are traced, as offsets from the corner of the tile's surroundings.
    pixels: Vec<[u16; 2]>,
    /// Sum of samples per pixel, in that order.
    sums: Vec<DVec3>,
    /// The same in blocks, in that order; only if errors are asked for.
    blocks: Vec<SampleBlocks>,
    /// What their rays took, in that order; only if it is asked for.
    costs: Vec<PixelCost>,
    /// What neighbours say of each, in that order; only with adaptive sampling.
    around: Vec<Around>,
    /// Deviations, in that order; only if the picture goes on.
    deviations: Vec<f64>,
    /// Index of each pixel, row by row; only with adaptive sampling.
    places: Vec<u32>,
    /// Pixels that get the samples of this round.
    active: Vec<u32>,
    /// The round gives each of them samples `first .. first + per_pixel`.
    first: u32,
    per_pixel: u32,
    /// Samples that its pixels had at the beginning, where the picture goes on.
    had: u64,
}

/// The pixels of a finished tile, row by row.
#[derive(Default)]
pub(super) struct FinishedTile {
    pub pixels: Vec<[f32; 3]>,
    /// Beside them; only if they are kept.
    pub statistics: Vec<PixelStatistics>,
    pub costs: Vec<PixelCost>,
}

impl TileSamples {
    /// Begins the first round of an area of at most a tile's size, with an error threshold if it is not that of the settings. Where a
    /// picture goes on, some pixel of the area must have to, at that threshold.
    pub fn begin(&mut self, stage: &Stage, area: Area, threshold: Option<f64>) {
        let settings = &stage.settings;
        let looks_around = settings.adaptive.is_some() && stage.draft.is_none();
        let ground = if looks_around { stage.grid.surroundings(&area) } else { area };
        // Most tiles have the shape of the one before.
        if [ground.width, ground.height] != [self.place.ground.width, self.place.ground.height] {
            morton_order(ground.width, ground.height, &mut self.pixels);
        }
        self.place = Place { area, ground };
        let count = self.pixels.len();
        self.sums.clear();
        self.sums.resize(count, DVec3::ZERO);
        self.blocks.clear();
        self.blocks.resize(if keeps_blocks(stage) { count } else { 0 }, SampleBlocks::EMPTY);
        self.costs.clear();
        self.costs.resize(if settings.keep_costs { count } else { 0 }, PixelCost::default());
        self.around.clear();
        self.active.clear();
        self.active.extend(0..count as u32);
        (self.first, self.had) = (0, 0);
        self.per_pixel =
            settings.adaptive.map_or(settings.samples_per_pixel, |adaptive| adaptive.samples_min);
        if let Some(draft) = &stage.draft {
            self.around.resize(count, Around::NOTHING);
            self.deviations.clear();
            self.deviations.resize(count, f64::INFINITY);
            self.places.clear();
            self.places.resize(count, 0);
            for (index, [x, y]) in (0u32..).zip(&self.pixels) {
                self.places[usize::from(*y) * area.width as usize + usize::from(*x)] = index;
            }
            draft.read(&area, |x, y, kept| {
                let index = self.places[(y * area.width + x) as usize] as usize;
                self.had += u64::from(kept.blocks.samples());
                self.sums[index] = kept.sum;
                self.blocks[index] = kept.blocks;
                self.around[index] = kept.around;
                self.deviations[index] = kept.deviation;
                if let Some(cost) = self.costs.get_mut(index) {
                    *cost = kept.cost;
                }
            });
            self.go_on(&Wanted::by(stage, draft.least(), threshold));
        }
    }

    /// Makes the pixels active that have the fewest samples of those that are to go on; false if none is.
    fn go_on(&mut self, wanted: &Wanted) -> bool {
        let TileSamples { active, blocks, deviations, .. } = self;
        active.clear();
        let mut least = u32::MAX;
        for (index, (blocks, deviation)) in (0u32..).zip(blocks.iter().zip(deviations.iter())) {
            let samples = blocks.samples();
            if samples <= least && wanted.is_open(samples, *deviation) {
                if samples < least {
                    active.clear();
                    least = samples;
                }
                active.push(index);
            }
        }
        if active.is_empty() {
            return false;
        }
        (self.first, self.per_pixel) = (least, wanted.step(least));
        true
    }

    /// Samples of this round.
    pub fn round_total(&self) -> u64 {
        self.active.len() as u64 * u64::from(self.per_pixel)
    }

    /// Samples of the same pixel lie this far apart at most, in a round.
    pub fn per_pixel(&self) -> u64 {
        u64::from(self.per_pixel)
    }

    /// Some samples of this round, in their order.
    #[inline]
    pub fn samples(&self, range: Range<u64>) -> impl Iterator<Item = PixelSample> + Clone {
        let [mut place, skipped] = self.place_of(range.start);
        let corner = [self.place.ground.x, self.place.ground.y];
        // Below `samples_per_pixel`, a u32.
        let (first, end) = (self.first, self.first + self.per_pixel);
        let mut next = first + skipped as u32;
        range.map(move |_| {
            if next == end {
                (place, next) = (place + 1, first);
            }
            let [x, y] = self.pixels[self.active[place] as usize].map(u32::from);
            let number = next;
            next += 1;
            PixelSample { x: corner[0] + x, y: corner[1] + y, number }
        })
    }

    /// A sample of this round.
    pub fn sample(&self, index: u64) -> PixelSample {
        let [place, skipped] = self.place_of(index);
        let [x, y] = self.pixels[self.active[place] as usize].map(u32::from);
        // Below `samples_per_pixel`, a u32.
        let number = self.first + skipped as u32;
        PixelSample { x: self.place.ground.x + x, y: self.place.ground.y + y, number }
    }

    /// Where among the active pixels that of a sample of this round is, and how many samples of that pixel come before it in the round.
    fn place_of(&self, index: u64) -> [usize; 2] {
        let per_pixel = u64::from(self.per_pixel);
        [(index / per_pixel) as usize, (index % per_pixel) as usize]
    }

    /// Takes in what became of the samples from number `start` of this round on; to be called in their order. How many of them
    /// belong to the tile's own pixels.
    pub fn add(&mut self, start: u64, radiance: &[DVec3], lost: &[f64]) -> u64 {
        let [place, skipped] = self.place_of(start);
        // The first may go on with a pixel.
        let begun = (self.per_pixel as usize - skipped).min(radiance.len());
        self.add_pixels(place, &radiance[..begun], &lost[..begun])
            + self.add_pixels(place + 1, &radiance[begun..], &lost[begun..])
    }

    /// [`TileSamples::add`] for whole pixels, or one, from this place among the active ones on.
    fn add_pixels(&mut self, place: usize, radiance: &[DVec3], lost: &[f64]) -> u64 {
        let per_pixel = self.per_pixel as usize;
        if self.blocks.is_empty() {
            // Not adaptive: every pixel is active, in its order, and the tile's own.
            if per_pixel == 1 {
                self.sums[place..].iter_mut().zip(radiance).for_each(|(sum, radiance)| *sum += *radiance);
                return radiance.len() as u64;
            }
            for (sum, radiance) in self.sums[place..].iter_mut().zip(radiance.chunks(per_pixel)) {
                for radiance in radiance {
                    *sum += *radiance;
                }
            }
            return radiance.len() as u64;
        }
        let mut own = 0;
        let samples = radiance.chunks(per_pixel).zip(lost.chunks(per_pixel));
        for (&pixel, (radiance, lost)) in self.active[place..].iter().zip(samples) {
            let pixel = pixel as usize;
            for (radiance, lost) in radiance.iter().zip(lost) {
                self.sums[pixel] += *radiance;
                self.blocks[pixel].add(*radiance, *lost);
            }
            if self.place.is_own(self.pixels[pixel]) {
                own += radiance.len() as u64;
            }
        }
        own
    }

    /// Books what was done between two looks at the counters for the pixel of a sample of this round.
    pub fn add_cost(&mut self, index: u64, before: &TraceCounters, after: &TraceCounters) {
        let pixel = self.active[(index / u64::from(self.per_pixel)) as usize] as usize;
        self.costs[pixel].add(before, after);
    }

    /// Begins another round for pixels whose error is above `threshold` (that of the settings if there is none); false if there are
    /// none, or they have all samples that they may have.
    pub fn next_round(&mut self, stage: &Stage, threshold: Option<f64>) -> bool {
        let Some(adaptive) = stage.settings.adaptive else { return false };
        if let Some(draft) = &stage.draft {
            for &index in &self.active {
                let index = index as usize;
                self.deviations[index] = self.blocks[index].deviation(self.around[index].contrast);
            }
            return self.go_on(&Wanted::by(stage, draft.least(), threshold));
        }
        if self.first == 0 {
            self.look_around();
        }
        let deviation = threshold.unwrap_or(adaptive.error) / adaptive.quantile();
        let TileSamples { active, blocks, around, .. } = self;
        active.retain(|&index| blocks[index as usize].deviation(around[index as usize].contrast) > deviation);
        let samples = self.first + self.per_pixel;
        if self.active.is_empty() || samples >= stage.settings.samples_per_pixel {
            return false;
        }
        // As many again as there were.
        (self.first, self.per_pixel) = (samples, samples);
        true
    }

    /// After the first samples: looks at neighbours, and leaves only the tile's own pixels active.
    fn look_around(&mut self) {
        let place = self.place;
        let (width, height) = (place.ground.width as usize, place.ground.height as usize);
        self.places.clear();
        self.places.resize(width * height, 0);
        for (index, [x, y]) in self.pixels.iter().enumerate() {
            self.places[usize::from(*y) * width + usize::from(*x)] = index as u32;
        }
        let (blocks, places) = (&self.blocks, &self.places);
        let first = |x: usize, y: usize| blocks[places[y * width + x] as usize].first_samples();
        self.around.extend(self.pixels.iter().map(|pixel| {
            if !place.is_own(*pixel) {
                return Around::NOTHING;
            }
            look_around([width, height], pixel.map(usize::from), first)
        }));
        let pixels = &self.pixels;
        self.active.retain(|&index| place.is_own(pixels[index as usize]));
    }

    /// Brings the tile's pixels into the order of the film. Returns how many samples were not needed, or were there before.
    pub fn finish(&self, stage: &Stage, finished: &mut FinishedTile) -> u64 {
        let TileSamples { place, pixels, sums, blocks, costs, around, deviations, .. } = self;
        let settings = &stage.settings;
        let area = &place.area;
        if let Some(draft) = &stage.draft {
            let mut saved = self.had;
            draft.write(area, |x, y, samples_before| {
                let index = self.places[(y * area.width + x) as usize] as usize;
                let samples = blocks[index].samples();
                saved += u64::from(settings.samples_per_pixel - samples);
                if samples == samples_before {
                    return None;
                }
                let cost = costs.get(index).copied().unwrap_or_default();
                let (sum, blocks, around) = (sums[index], blocks[index], around[index]);
                Some(PixelState { sum, blocks, around, deviation: deviations[index], cost })
            });
            draft.show(stage, area, finished);
            return saved;
        }
        let count = area.width as usize * area.height as usize;
        // Every one is set below.
        finished.pixels.resize(count, [0.0; 3]);
        finished.statistics.clear();
        finished.statistics.resize(if settings.keep_statistics { count } else { 0 }, PixelStatistics::NONE);
        finished.costs.clear();
        finished.costs.resize(if settings.keep_costs { count } else { 0 }, PixelCost::default());
        if blocks.is_empty() {
            // Not adaptive: every pixel is the tile's own, and has all its samples.
            let (width, samples) = (area.width as usize, f64::from(settings.samples_per_pixel));
            let to = |[x, y]: [u16; 2]| usize::from(y) * width + usize::from(x);
            for (pixel, sum) in pixels.iter().zip(sums) {
                finished.pixels[to(*pixel)] = to_f32(*sum / samples);
            }
            for (pixel, cost) in pixels.iter().zip(costs) {
                finished.costs[to(*pixel)] = *cost;
            }
            return 0;
        }
        let mut saved = 0;
        for (index, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| place.is_own(**pixel)) {
            let [x, y] = pixel.map(u32::from);
            let (x, y) = (place.ground.x + x - area.x, place.ground.y + y - area.y);
            let to = y as usize * area.width as usize + x as usize;
            let samples = blocks[index].samples();
            saved += u64::from(settings.samples_per_pixel - samples);
            finished.pixels[to] = to_f32(sums[index] / f64::from(samples));
            if let Some(cost) = finished.costs.get_mut(to) {
                *cost = costs[index];
            }
            if let Some(statistics) = finished.statistics.get_mut(to) {
                let (deviation, around) = match around.get(index) {
                    Some(around) => (blocks[index].deviation(around.contrast), around),
                    // Without neighbours a single sample says nothing.
                    None if samples == 1 => (f64::INFINITY, &Around::NOTHING),
                    None => (blocks[index].deviation(DVec3::ZERO), &Around::NOTHING),
                };
                *statistics = blocks[index].statistics(deviation, around);
            }
        }
        saved
    }

    /// What the lists of a tile take, in bytes, those of the finished tile apart.
    pub fn bytes_needed(stage: &Stage) -> usize {
        let settings = &stage.settings;
        let is_adaptive = settings.adaptive.is_some();
        let border = if is_adaptive { 2 } else { 0 };
        let blocks = if keeps_blocks(stage) { size_of::<SampleBlocks>() } else { 0 };
        let adaptive =
            if is_adaptive { size_of::<Around>() + size_of::<f64>() + size_of::<u32>() } else { 0 };
        let costs = if settings.keep_costs { size_of::<PixelCost>() } else { 0 };
        tile_pixels(stage, border)
            * (size_of::<[u16; 2]>() + size_of::<DVec3>() + size_of::<u32>() + blocks + costs + adaptive)
    }

    /// Most samples of a round, saturated.
    pub fn round_max(stage: &Stage) -> u32 {
        let settings = &stage.settings;
        let border = if settings.adaptive.is_some() { 2 } else { 0 };
        u32::try_from(tile_pixels(stage, border))
            .unwrap_or(u32::MAX)
            .saturating_mul(settings.samples_per_pixel)
    }
}

impl FinishedTile {
    /// What the lists take, in bytes.
    pub fn bytes_needed(stage: &Stage) -> usize {
        let settings = &stage.settings;
        let statistics = if settings.keep_statistics { size_of::<PixelStatistics>() } else { 0 };
        let costs = if settings.keep_costs { size_of::<PixelCost>() } else { 0 };
        tile_pixels(stage, 0) * (size_of::<[f32; 3]>() + statistics + costs)
    }
}

/// Pixels of a tile and of so much more of both sides.
fn tile_pixels(stage: &Stage, border: u32) -> usize {
    let settings = &stage.settings;
    let side = settings.tile_size + border;
    side.min(settings.width) as usize * side.min(settings.height) as usize
}

/// Whether samples are kept in blocks.
fn keeps_blocks(stage: &Stage) -> bool {
    stage.settings.adaptive.is_some() || stage.settings.keep_statistics
}
