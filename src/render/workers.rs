//! Tiles over threads: each worker takes the next tile of the curve until none is left.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use glam::DVec3;
use parking_lot::Mutex;

use super::adaptive::SampleBlocks;
use super::counters::EffectCounters;
use super::film::{Film, PixelCost, PixelStatistics};
use super::paths::PathTracer;
use super::progress::Progress;
use super::query::RayQuery;
use super::report::WorkerSeconds;
use super::stage::Stage;
use super::tiles::{Area, morton_order};
use crate::compile::{Control, Threads};
use crate::error::{RenderError, TraceError};
use crate::geom::round_up_f32;
use crate::stats::TraceCounters;
use crate::units::TileId;

/// What the workers did together.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Totals {
    pub effects: EffectCounters,
    pub trace: TraceCounters,
    pub seconds: WorkerSeconds,
    pub tiles: u32,
    pub is_cancelled: bool,
}

/// The caller's callback.
pub(crate) type ProgressFn<'f> = dyn FnMut(Progress) -> Control + Send + 'f;

/// The error threshold of a tile, if it is not that of the settings. Asked once for each tile, when it is taken.
pub(crate) type Thresholds<'f> = dyn Fn(TileId) -> Option<f64> + Sync + 'f;

/// What the workers share.
struct Shared<'a> {
    stage: &'a Stage,
    /// Cells of the grid by [`TileId`].
    order: &'a [u32],
    thresholds: &'a Thresholds<'a>,
    next: AtomicU32,
    stop: AtomicBool,
    cancelled: AtomicBool,
    samples: AtomicU64,
    tiles: AtomicU32,
    film: Mutex<&'a mut Film>,
    progress: Mutex<&'a mut ProgressFn<'a>>,
    totals: Mutex<Totals>,
    /// The error of the lowest tile: with one thread always the same one.
    error: Mutex<Option<(TileId, RenderError)>>,
}

/// Renders every tile of `order` to `film`, each thread with a query of its own from `make_query`.
///
/// # Errors
/// The first by tile order among those that occurred before the workers stopped.
pub(crate) fn run<Q: RayQuery>(
    stage: &Stage,
    order: &[u32],
    film: &mut Film,
    threads: &Threads,
    make_query: &(dyn Fn() -> Result<Q, TraceError> + Sync),
    thresholds: &Thresholds<'_>,
    progress: &mut ProgressFn<'_>,
) -> Result<Totals, RenderError> {
    // A closure of its own ends the callback's lifetime with the shared state's.
    let mut progress = |state: Progress| progress(state);
    let shared = Shared {
        stage,
        order,
        thresholds,
        next: AtomicU32::new(0),
        stop: AtomicBool::new(false),
        cancelled: AtomicBool::new(false),
        samples: AtomicU64::new(0),
        tiles: AtomicU32::new(0),
        film: Mutex::new(film),
        progress: Mutex::new(&mut progress),
        totals: Mutex::new(Totals::default()),
        error: Mutex::new(None),
    };
    on_threads(threads, &|| shared.work(make_query));
    if let Some((_, error)) = shared.error.into_inner() {
        return Err(error);
    }
    let mut totals = shared.totals.into_inner();
    totals.tiles = shared.tiles.into_inner();
    totals.is_cancelled = shared.cancelled.into_inner();
    Ok(totals)
}

/// Runs `worker` once on each thread.
pub(super) fn on_threads(threads: &Threads, worker: &(dyn Fn() + Sync)) {
    match threads {
        Threads::One | Threads::Count(0 | 1) => worker(),
        Threads::Count(count) => std::thread::scope(|scope| {
            for _ in 1..*count {
                scope.spawn(worker);
            }
            worker();
        }),
        Threads::Pool(pool) => pool.scope(|scope| {
            for _ in 0..pool.current_num_threads() {
                scope.spawn(|_| worker());
            }
        }),
    }
}

impl Shared<'_> {
    fn work<Q: RayQuery>(&self, make_query: &(dyn Fn() -> Result<Q, TraceError> + Sync)) {
        // A panic in one worker unwinds to the caller; the others must not render on in vain.
        let _stop_on_panic = StopOnPanic(&self.stop);
        let mut tile = TileId(0);
        let result = make_query().map_err(RenderError::from).and_then(|query| {
            let mut worker = Worker::new(self, self.stage, query);
            let result = loop {
                tile = TileId(self.next.fetch_add(1, Ordering::Relaxed));
                let Some(cell) = self.order.get(tile.0 as usize) else { break Ok(()) };
                match worker.render_area_to(self.stage.grid.area(*cell), (self.thresholds)(tile)) {
                    Ok(true) => {
                        let mut film = self.film.lock();
                        film.set_tile(&self.stage.grid, *cell, worker.finished());
                        film.set_statistics(&self.stage.grid, *cell, worker.statistics());
                        film.set_costs(&self.stage.grid, *cell, worker.costs());
                        drop(film);
                        self.tiles.fetch_add(1, Ordering::Relaxed);
                        self.report();
                    }
                    Ok(false) => break Ok(()),
                    Err(error) => break Err(RenderError::from(error)),
                }
            };
            let mut totals = self.totals.lock();
            totals.effects.merge(&worker.effects());
            totals.trace.merge(&worker.trace());
            totals.seconds.merge(&worker.paths.seconds);
            result
        });
        if let Err(error) = result {
            self.stop.store(true, Ordering::Relaxed);
            let mut first = self.error.lock();
            if first.as_ref().is_none_or(|(earlier, _)| tile < *earlier) {
                *first = Some((tile, error));
            }
        }
    }

    /// Tells the caller how far the render is, unless another worker is just doing that.
    fn report(&self) {
        let Some(mut progress) = self.progress.try_lock() else { return };
        let state = Progress {
            samples: self.samples.load(Ordering::Relaxed),
            samples_total: samples_total(self.stage),
            tiles: self.tiles.load(Ordering::Relaxed),
            tiles_total: self.order.len() as u32,
        };
        if progress(state) == Control::Cancel {
            self.cancelled.store(true, Ordering::Relaxed);
            self.stop.store(true, Ordering::Relaxed);
        }
    }
}

/// Samples of the whole picture; the most there can be where sampling is adaptive.
fn samples_total(stage: &Stage) -> u64 {
    let settings = &stage.settings;
    u64::from(settings.width) * u64::from(settings.height) * u64::from(settings.samples_per_pixel)
}

/// The pixels of a tile while samples are added.
#[derive(Default)]
struct Tile {
    /// In the order in which they are traced, as offsets from the corner of the tile's surroundings.
    pixels: Vec<[u16; 2]>,
    /// Sum of samples per pixel, in that order.
    sums: Vec<DVec3>,
    /// The same in blocks, in that order; only if errors are asked for.
    blocks: Vec<SampleBlocks>,
    /// What their rays took, in that order; only if it is asked for.
    costs: Vec<PixelCost>,
    /// Contrast with the neighbours, in that order; only with adaptive sampling.
    contrasts: Vec<DVec3>,
    /// Index of each pixel, row by row; only with adaptive sampling.
    places: Vec<u32>,
    /// Pixels that get the next samples.
    active: Vec<u32>,
}

/// What a worker tells while it is inside a tile, and asks.
pub(crate) trait Watch {
    /// Whether the render is to end.
    fn is_stopped(&self) -> bool;

    /// So many samples more are done.
    fn add_samples(&self, count: u64);

    /// The tile goes on; a moment to tell others.
    fn report(&self);
}

impl Watch for &Shared<'_> {
    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    fn add_samples(&self, count: u64) {
        self.samples.fetch_add(count, Ordering::Relaxed);
    }

    fn report(&self) {
        Shared::report(self);
    }
}

/// One thread's part.
pub(crate) struct Worker<'s, W, Q> {
    pub watch: W,
    stage: &'s Stage,
    paths: PathTracer<'s, Q>,
    tile: Tile,
    /// The tile's pixels row by row.
    finished: Vec<[f32; 3]>,
    /// Beside them; only if they are kept.
    statistics: Vec<PixelStatistics>,
    costs: Vec<PixelCost>,
}

/// What must be known to trace samples of a tile.
#[derive(Clone, Copy)]
struct Place {
    /// The tile itself.
    area: Area,
    /// The tile and what is traced around it.
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

impl<'s, W: Watch, Q: RayQuery> Worker<'s, W, Q> {
    pub fn new(watch: W, stage: &'s Stage, query: Q) -> Worker<'s, W, Q> {
        Worker {
            watch,
            stage,
            paths: PathTracer::new(stage, query),
            tile: Tile::default(),
            finished: Vec::new(),
            statistics: Vec::new(),
            costs: Vec::new(),
        }
    }

    /// The pixels of the area that was rendered last, row by row.
    pub fn finished(&self) -> &[[f32; 3]] {
        &self.finished
    }

    /// What is known of their errors; empty if it was not asked for.
    pub fn statistics(&self) -> &[PixelStatistics] {
        &self.statistics
    }

    /// What they took; empty if it was not asked for.
    pub fn costs(&self) -> &[PixelCost] {
        &self.costs
    }

    /// Rays by effect so far.
    pub fn effects(&self) -> EffectCounters {
        self.paths.counters
    }

    /// Work of the queries so far.
    pub fn trace(&self) -> TraceCounters {
        self.paths.query.counters()
    }

    /// Renders an area of at most a tile's size, with an error threshold other than that of the settings if there is one; false if the
    /// render was stopped before its end.
    pub fn render_area_to(&mut self, area: Area, threshold: Option<f64>) -> Result<bool, TraceError> {
        let stage = self.stage;
        let settings = &stage.settings;
        let ground = if settings.adaptive.is_some() { stage.grid.surroundings(&area) } else { area };
        let place = Place { area, ground };
        let tile = &mut self.tile;
        morton_order(ground.width, ground.height, &mut tile.pixels);
        let count = tile.pixels.len();
        tile.sums.clear();
        tile.sums.resize(count, DVec3::ZERO);
        tile.blocks.clear();
        tile.blocks.resize(if keeps_blocks(stage) { count } else { 0 }, SampleBlocks::EMPTY);
        tile.costs.clear();
        tile.costs.resize(if settings.keep_costs { count } else { 0 }, PixelCost::default());
        tile.contrasts.clear();
        tile.active.clear();
        tile.active.extend(0..count as u32);
        let most = settings.samples_per_pixel;
        let mut samples = settings.adaptive.map_or(most, |adaptive| adaptive.samples_min);
        if !self.trace_samples(&place, 0, samples)? {
            return Ok(false);
        }
        if let Some(adaptive) = settings.adaptive {
            self.tile.look_around(&place);
            let deviation = threshold.unwrap_or(adaptive.error) / adaptive.quantile();
            loop {
                let Tile { active, blocks, contrasts, .. } = &mut self.tile;
                active
                    .retain(|&index| blocks[index as usize].deviation(contrasts[index as usize]) > deviation);
                if active.is_empty() || samples >= most {
                    break;
                }
                if !self.trace_samples(&place, samples, samples)? {
                    return Ok(false);
                }
                samples *= 2;
            }
        }
        self.finish(&place);
        Ok(true)
    }

    /// Traces samples `first .. first + count` of the active pixels; false if the render was stopped before the end.
    fn trace_samples(&mut self, place: &Place, first: u32, count: u32) -> Result<bool, TraceError> {
        let stage = self.stage;
        let Tile { pixels, sums, blocks, costs, active, .. } = &mut self.tile;
        let per_pixel = u64::from(count);
        let total = active.len() as u64 * per_pixel;
        let mut start = 0;
        while start < total {
            if self.watch.is_stopped() {
                return Ok(false);
            }
            let mut end = total.min(start + self.paths.batch_samples as u64);
            if stage.settings.keep_costs {
                // No further than the pixel.
                end = end.min((start / per_pixel + 1) * per_pixel);
            }
            let before = stage.settings.keep_costs.then(|| self.paths.query.counters());
            let rays = (start..end).map(|index| {
                let [x, y] = pixels[active[(index / per_pixel) as usize] as usize].map(u32::from);
                // Below `samples_per_pixel`, a u32.
                let sample = first + (index % per_pixel) as u32;
                stage.pixel_sample(place.ground.x + x, place.ground.y + y, sample)
            });
            self.paths.trace(rays)?;
            if let Some(before) = before {
                let pixel = active[(start / per_pixel) as usize] as usize;
                costs[pixel].add(&before, &self.paths.query.counters());
            }
            let mut own = 0;
            for (index, (radiance, lost)) in
                (start..end).zip(self.paths.radiance().iter().zip(self.paths.lost()))
            {
                let pixel = active[(index / per_pixel) as usize] as usize;
                sums[pixel] += *radiance;
                if let Some(blocks) = blocks.get_mut(pixel) {
                    blocks.add(*radiance, *lost);
                }
                own += u64::from(place.is_own(pixels[pixel]));
            }
            self.watch.add_samples(own);
            start = end;
            if start < total {
                self.watch.report();
            }
        }
        Ok(true)
    }

    /// Brings the tile's pixels into the order of the film.
    fn finish(&mut self, place: &Place) {
        let Tile { pixels, sums, blocks, costs, contrasts, .. } = &self.tile;
        let settings = &self.stage.settings;
        let area = &place.area;
        let count = area.width as usize * area.height as usize;
        self.finished.clear();
        self.finished.resize(count, [0.0; 3]);
        self.statistics.clear();
        self.statistics.resize(if settings.keep_statistics { count } else { 0 }, PixelStatistics::NONE);
        self.costs.clear();
        self.costs.resize(if settings.keep_costs { count } else { 0 }, PixelCost::default());
        let mut saved = 0;
        for (index, pixel) in pixels.iter().enumerate().filter(|(_, pixel)| place.is_own(**pixel)) {
            let [x, y] = pixel.map(u32::from);
            let (x, y) = (place.ground.x + x - area.x, place.ground.y + y - area.y);
            let to = y as usize * area.width as usize + x as usize;
            let samples = blocks.get(index).map_or(settings.samples_per_pixel, SampleBlocks::samples);
            saved += u64::from(settings.samples_per_pixel - samples);
            self.finished[to] = to_f32(sums[index] / f64::from(samples));
            if let Some(cost) = self.costs.get_mut(to) {
                *cost = costs[index];
            }
            if let Some(statistics) = self.statistics.get_mut(to) {
                let contrast = contrasts.get(index).copied().unwrap_or(DVec3::ZERO);
                *statistics = PixelStatistics {
                    samples,
                    deviation: blocks[index].deviation(contrast) as f32,
                    half_difference: to_f32(blocks[index].half_difference()),
                    lost: round_up_f32(blocks[index].lost()),
                };
            }
        }
        // Samples that need not be taken are as good as done.
        self.watch.add_samples(saved);
    }
}

impl Tile {
    /// After the first samples: measures contrasts, and leaves only the tile's own pixels active.
    fn look_around(&mut self, place: &Place) {
        let (width, height) = (place.ground.width as usize, place.ground.height as usize);
        self.places.clear();
        self.places.resize(width * height, 0);
        for (index, [x, y]) in self.pixels.iter().enumerate() {
            self.places[usize::from(*y) * width + usize::from(*x)] = index as u32;
        }
        let (blocks, places) = (&self.blocks, &self.places);
        let range = |x: usize, y: usize| blocks[places[y * width + x] as usize].range();
        self.contrasts.extend(self.pixels.iter().map(|pixel| {
            if !place.is_own(*pixel) {
                return DVec3::ZERO;
            }
            let [x, y] = pixel.map(usize::from);
            contrast([width, height], [x, y], range)
        }));
        let pixels = &self.pixels;
        self.active.retain(|&index| place.is_own(pixels[index as usize]));
    }
}

/// How far the samples of a pixel and its neighbours lie apart, per channel; `range` is the least and the greatest of each.
pub(super) fn contrast(
    [width, height]: [usize; 2],
    [x, y]: [usize; 2],
    range: impl Fn(usize, usize) -> [DVec3; 2],
) -> DVec3 {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for y in y.saturating_sub(1)..height.min(y + 2) {
        for x in x.saturating_sub(1)..width.min(x + 2) {
            let [least, greatest] = range(x, y);
            (low, high) = (low.min(least), high.max(greatest));
        }
    }
    high - low
}

/// Whether samples are kept in blocks.
fn keeps_blocks(stage: &Stage) -> bool {
    stage.settings.adaptive.is_some() || stage.settings.keep_statistics
}

fn to_f32(colour: DVec3) -> [f32; 3] {
    colour.to_array().map(|channel| channel as f32)
}

/// How many workers `threads` stands for.
pub(crate) fn worker_count(threads: &Threads) -> usize {
    match threads {
        Threads::One => 1,
        Threads::Count(count) => (*count).max(1),
        Threads::Pool(pool) => pool.current_num_threads(),
    }
}

/// What each worker's tile takes, in bytes.
pub(crate) fn tile_bytes(stage: &Stage) -> usize {
    let settings = &stage.settings;
    let is_adaptive = settings.adaptive.is_some();
    let border = if is_adaptive { 2 } else { 0 };
    let pixels = |border: u32| {
        let side = settings.tile_size + border;
        side.min(settings.width) as usize * side.min(settings.height) as usize
    };
    let blocks = if keeps_blocks(stage) { size_of::<SampleBlocks>() } else { 0 };
    let adaptive = if is_adaptive { size_of::<DVec3>() + size_of::<u32>() } else { 0 };
    let statistics = if settings.keep_statistics { size_of::<PixelStatistics>() } else { 0 };
    let costs = if settings.keep_costs { size_of::<PixelCost>() } else { 0 };
    pixels(border)
        * (size_of::<[u16; 2]>() + size_of::<DVec3>() + size_of::<u32>() + blocks + costs + adaptive)
        + pixels(0) * (size_of::<[f32; 3]>() + statistics + costs)
}

struct StopOnPanic<'s>(&'s AtomicBool);

impl Drop for StopOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}
