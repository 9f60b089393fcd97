//! Tiles over threads: each worker takes the next tile of the curve until none is left.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use glam::DVec3;
use parking_lot::Mutex;

use super::counters::EffectCounters;
use super::film::Film;
use super::paths::PathTracer;
use super::progress::Progress;
use super::query::RayQuery;
use super::report::WorkerSeconds;
use super::sampling::pixel_offset;
use super::stage::Stage;
use super::tiles::{Area, morton_order};
use crate::compile::{Control, Threads};
use crate::error::{RenderError, TraceError};
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

/// What the workers share.
struct Shared<'a> {
    stage: &'a Stage,
    /// Cells of the grid by [`TileId`].
    order: &'a [u32],
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
    progress: &mut ProgressFn<'_>,
) -> Result<Totals, RenderError> {
    // A closure of its own ends the callback's lifetime with the shared state's.
    let mut progress = |state: Progress| progress(state);
    let shared = Shared {
        stage,
        order,
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
    let worker = || shared.work(make_query);
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
    if let Some((_, error)) = shared.error.into_inner() {
        return Err(error);
    }
    let mut totals = shared.totals.into_inner();
    totals.tiles = shared.tiles.into_inner();
    totals.is_cancelled = shared.cancelled.into_inner();
    Ok(totals)
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
                match worker.render_area(self.stage.grid.area(*cell)) {
                    Ok(true) => {
                        self.film.lock().set_tile(&self.stage.grid, *cell, worker.finished());
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

/// Samples of the whole picture.
fn samples_total(stage: &Stage) -> u64 {
    let settings = &stage.settings;
    u64::from(settings.width) * u64::from(settings.height) * u64::from(settings.samples_per_pixel)
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
    /// The tile's pixels in the order in which they are traced.
    pixels: Vec<[u16; 2]>,
    /// Sum of samples per pixel, in that order.
    sums: Vec<DVec3>,
    /// The tile's pixels row by row.
    finished: Vec<[f32; 3]>,
}

impl<'s, W: Watch, Q: RayQuery> Worker<'s, W, Q> {
    pub fn new(watch: W, stage: &'s Stage, query: Q) -> Worker<'s, W, Q> {
        Worker {
            watch,
            stage,
            paths: PathTracer::new(stage, query),
            pixels: Vec::new(),
            sums: Vec::new(),
            finished: Vec::new(),
        }
    }

    /// The pixels of the area that was rendered last, row by row.
    pub fn finished(&self) -> &[[f32; 3]] {
        &self.finished
    }

    /// Rays by effect so far.
    pub fn effects(&self) -> EffectCounters {
        self.paths.counters
    }

    /// Work of the queries so far.
    pub fn trace(&self) -> TraceCounters {
        self.paths.query.counters()
    }

    /// Renders an area of at most a tile's size; false if the render was stopped before its end.
    pub fn render_area(&mut self, area: Area) -> Result<bool, TraceError> {
        let stage = self.stage;
        let settings = &stage.settings;
        morton_order(area.width, area.height, &mut self.pixels);
        self.sums.clear();
        self.sums.resize(self.pixels.len(), DVec3::ZERO);
        let per_pixel = u64::from(settings.samples_per_pixel);
        let total = self.pixels.len() as u64 * per_pixel;
        let mut start = 0;
        while start < total {
            if self.watch.is_stopped() {
                return Ok(false);
            }
            let end = total.min(start + u64::from(settings.batch_samples));
            let pixels = &self.pixels;
            let rays = (start..end).map(|index| {
                let [x, y] = pixels[(index / per_pixel) as usize].map(u32::from);
                let (x, y) = (area.x + x, area.y + y);
                let pixel = u64::from(y) * u64::from(settings.width) + u64::from(x);
                // Below `samples_per_pixel`, a u32.
                let sample = (index % per_pixel) as u32;
                let offset =
                    pixel_offset(settings.seed, pixel, sample, settings.samples_per_pixel, settings.filter);
                stage.camera_sample(pixel, sample, f64::from(x) + offset[0], f64::from(y) + offset[1])
            });
            let radiance = self.paths.trace(rays)?;
            for (index, radiance) in (start..end).zip(radiance) {
                self.sums[(index / per_pixel) as usize] += *radiance;
            }
            self.watch.add_samples(end - start);
            start = end;
            if start < total {
                self.watch.report();
            }
        }
        self.finished.clear();
        self.finished.resize(self.pixels.len(), [0.0; 3]);
        for ([x, y], sum) in self.pixels.iter().zip(&self.sums) {
            let mean = *sum / per_pixel as f64;
            self.finished[usize::from(*y) * area.width as usize + usize::from(*x)] =
                mean.to_array().map(|channel| channel as f32);
        }
        Ok(true)
    }
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
    let pixels =
        settings.tile_size.min(settings.width) as usize * settings.tile_size.min(settings.height) as usize;
    pixels * (size_of::<[u16; 2]>() + size_of::<DVec3>() + size_of::<[f32; 3]>())
}

struct StopOnPanic<'s>(&'s AtomicBool);

impl Drop for StopOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}
