//! Tiles over threads: each worker takes the next tile of the curve until none is left.

use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};

use parking_lot::Mutex;

use super::counters::EffectCounters;
use super::draft::Draft;
use super::film::Film;
use super::paths::PathTracer;
use super::progress::Progress;
use super::query::RayQuery;
use super::report::WorkerSeconds;
use super::stage::Stage;
use super::tile_samples::{FinishedTile, TileSamples};
use super::tiles::Area;
use super::waiting::{OpenedTile, PoolQuery, WaitingPlan, WaitingWorker};
use crate::access::BlockSketch;
use crate::compile::{Control, Threads};
use crate::error::{RenderError, TraceError};
use crate::stats::TraceCounters;
use crate::trace::LoadStats;
use crate::units::TileId;

/// What the workers did together.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Totals {
    pub effects: EffectCounters,
    pub trace: TraceCounters,
    pub seconds: WorkerSeconds,
    /// How loads went where rays waited; of times, the sum over threads.
    pub loads: LoadStats,
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
    share(stage, order, film, threads, thresholds, progress, &|shared| shared.work(make_query))
}

/// [`run`] with rays that wait for blocks: each thread has a pool of its own from `make_query`.
///
/// # Errors
/// As for [`run`].
#[expect(clippy::too_many_arguments, reason = "as `run`, and the plan")]
pub(super) fn run_waiting<'o>(
    stage: &Stage,
    plan: &WaitingPlan,
    order: &[u32],
    film: &mut Film,
    threads: &Threads,
    make_query: &(dyn Fn() -> Result<PoolQuery<'o>, TraceError> + Sync),
    thresholds: &Thresholds<'_>,
    progress: &mut ProgressFn<'_>,
) -> Result<Totals, RenderError> {
    share(stage, order, film, threads, thresholds, progress, &|shared| shared.work_waiting(plan, make_query))
}

/// Has each thread `work` on the tiles of `order`.
fn share(
    stage: &Stage,
    order: &[u32],
    film: &mut Film,
    threads: &Threads,
    thresholds: &Thresholds<'_>,
    progress: &mut ProgressFn<'_>,
    work: &(dyn Fn(&Shared<'_>) + Sync),
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
    on_threads(threads, &|| work(&shared));
    if let Some((_, error)) = shared.error.into_inner() {
        return Err(error);
    }
    let mut totals = shared.totals.into_inner();
    totals.tiles = shared.tiles.into_inner();
    totals.is_cancelled = shared.cancelled.into_inner();
    Ok(totals)
}

/// Runs `worker` once on each thread; on fewer, but one at least, if the system gives fewer.
pub(super) fn on_threads(threads: &Threads, worker: &(dyn Fn() + Sync)) {
    match threads {
        Threads::One | Threads::Count(0 | 1) => worker(),
        Threads::Count(count) => std::thread::scope(|scope| {
            for _ in 1..*count {
                if std::thread::Builder::new().spawn_scoped(scope, worker).is_err() {
                    break;
                }
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
            let mut found = FinishedTile::default();
            let result = loop {
                let Some(opened) = self.next_tile(&mut found) else { break Ok(()) };
                tile = opened.id;
                match worker.render_area_to(opened.area, opened.threshold) {
                    Ok(true) => {
                        self.finish(opened.cell, worker.finished());
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
        self.end(tile, result);
    }

    /// [`Shared::work`] with rays that wait.
    fn work_waiting<'o>(
        &self,
        plan: &WaitingPlan,
        make_query: &(dyn Fn() -> Result<PoolQuery<'o>, TraceError> + Sync),
    ) {
        let _stop_on_panic = StopOnPanic(&self.stop);
        let mut tile = TileId(0);
        let result = make_query().and_then(|query| {
            let mut worker = WaitingWorker::new(self, self.stage, plan, query);
            let mut found = FinishedTile::default();
            let mut next_tile = || self.next_tile(&mut found);
            let result = worker.run(&mut next_tile, &|cell, finished| self.finish(cell, finished));
            tile = worker.tile();
            let mut totals = self.totals.lock();
            totals.effects.merge(&worker.effects());
            totals.trace.merge(&worker.trace());
            totals.seconds.merge(&worker.seconds());
            totals.loads.merge(&worker.loads());
            result.map(|_| ())
        });
        self.end(tile, result.map_err(RenderError::from));
    }

    /// The next tile; those that need no more samples, where a picture goes on, are finished on the way, in `found`.
    fn next_tile(&self, found: &mut FinishedTile) -> Option<OpenedTile> {
        loop {
            let id = TileId(self.next.fetch_add(1, Ordering::Relaxed));
            let cell = *self.order.get(id.0 as usize)?;
            let (area, threshold) = (self.stage.grid.area(cell), (self.thresholds)(id));
            let is_open = |draft: &Draft| {
                self.stop.load(Ordering::Relaxed) || draft.is_open(self.stage, &area, threshold, found)
            };
            if self.stage.draft.as_ref().is_none_or(is_open) {
                return Some(OpenedTile { id, cell, area, threshold });
            }
            // They have all that they are to have.
            let pixels = u64::from(area.width) * u64::from(area.height);
            self.samples
                .fetch_add(pixels * u64::from(self.stage.settings.samples_per_pixel), Ordering::Relaxed);
            self.finish(cell, found);
        }
    }

    /// How a worker ended; `tile` is the one that it was at.
    fn end(&self, tile: TileId, result: Result<(), RenderError>) {
        if let Err(error) = result {
            self.stop.store(true, Ordering::Relaxed);
            let mut first = self.error.lock();
            if first.as_ref().is_none_or(|(earlier, _)| tile < *earlier) {
                *first = Some((tile, error));
            }
        }
    }

    /// Puts a finished tile on the film.
    fn finish(&self, cell: u32, tile: &FinishedTile) {
        let mut film = self.film.lock();
        film.set_tile(&self.stage.grid, cell, &tile.pixels);
        film.set_statistics(&self.stage.grid, cell, &tile.statistics);
        film.set_costs(&self.stage.grid, cell, &tile.costs);
        drop(film);
        self.tiles.fetch_add(1, Ordering::Relaxed);
        self.report();
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
    tile: TileSamples,
    finished: FinishedTile,
}

impl<'s, W: Watch, Q: RayQuery> Worker<'s, W, Q> {
    pub fn new(watch: W, stage: &'s Stage, query: Q) -> Worker<'s, W, Q> {
        Worker {
            watch,
            stage,
            paths: PathTracer::new(stage, query),
            tile: TileSamples::default(),
            finished: FinishedTile::default(),
        }
    }

    /// The area that was rendered last.
    pub fn finished(&self) -> &FinishedTile {
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

    /// Which blocks were entered since this was called last, roughly.
    pub fn take_touched(&mut self) -> BlockSketch {
        self.paths.query.take_touched()
    }

    /// Renders an area of at most a tile's size, with an error threshold other than that of the settings if there is one; false if the
    /// render was stopped before its end.
    pub fn render_area_to(&mut self, area: Area, threshold: Option<f64>) -> Result<bool, TraceError> {
        self.tile.begin(self.stage, area, threshold);
        loop {
            if !self.trace_round()? {
                return Ok(false);
            }
            if !self.tile.next_round(self.stage, threshold) {
                break;
            }
        }
        // Samples that need not be taken are as good as done.
        self.watch.add_samples(self.tile.finish(self.stage, &mut self.finished));
        Ok(true)
    }

    /// Traces the samples of a round; false if the render was stopped before the end.
    fn trace_round(&mut self) -> Result<bool, TraceError> {
        let stage = self.stage;
        let tile = &mut self.tile;
        let total = tile.round_total();
        let mut start = 0;
        while start < total {
            if self.watch.is_stopped() {
                return Ok(false);
            }
            let mut end = total.min(start + self.paths.batch_samples as u64);
            if stage.settings.keep_costs {
                // No further than the pixel.
                end = end.min((start / tile.per_pixel() + 1) * tile.per_pixel());
            }
            let before = stage.settings.keep_costs.then(|| self.paths.query.counters());
            self.paths.trace(tile.samples(start..end))?;
            if let Some(before) = before {
                tile.add_cost(start, &before, &self.paths.query.counters());
            }
            self.watch.add_samples(tile.add(start, self.paths.radiance(), self.paths.lost()));
            start = end;
            if start < total {
                self.watch.report();
            }
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
    TileSamples::bytes_needed(stage) + FinishedTile::bytes_needed(stage)
}

struct StopOnPanic<'s>(&'s AtomicBool);

impl Drop for StopOnPanic<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.store(true, Ordering::Relaxed);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;
    use crate::without_threads::without_threads;

    #[test]
    fn fewer_threads_work_where_the_system_gives_fewer() {
        without_threads("render::workers::tests::fewer_threads_work_where_the_system_gives_fewer", || {
            let count = AtomicUsize::new(0);
            on_threads(&Threads::Count(3), &|| {
                count.fetch_add(1, Ordering::Relaxed);
            });
            assert_eq!(count.into_inner(), 1);
        });
    }
}
