//! A rectangle of the picture by itself: what a worker of a cluster renders.

use std::sync::atomic::{AtomicBool, Ordering};

use super::counters::EffectCounters;
use super::film::Film;
use super::geometry::Surfaces;
use super::paths;
use super::query::SceneTracer;
use super::renderer::{Renderer, loader_options, set, waiting_bytes};
use super::settings::{RenderSettings, WaitingRays};
use super::stage::Stage;
use super::tiles::{Area, TileGrid};
use super::waiting::{Extent, OpenedTile, WaitingPlan, WaitingWorker};
use super::workers::{Watch, Worker, tile_bytes};
use crate::access::BlockSketch;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, RenderError, TraceError};
use crate::model::Model;
use crate::octree::LazyOctree;
use crate::scene::Scene;
use crate::stats::TraceCounters;
use crate::trace::{BlockLoader, LoadStats};
use crate::units::{Bytes, TileId};

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// Left-most column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Region {
    /// How many pixels it holds.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// Renders one region after the other, on one thread. Made by [`Renderer::regions`] and [`Regions::renderer`]. A pixel is the same, bit for
/// bit, whatever regions the picture is cut into and whoever renders them (I2).
pub struct RegionRenderer<'r> {
    lane: Lane<'r>,
    width: u32,
    height: u32,
    side_max: u32,
    _scratch: Reservation,
}

#[expect(clippy::large_enum_variant, reason = "there is one for each thread")]
enum Lane<'r> {
    InOrder(Worker<'r, Flag<'r>, SceneTracer<'r>>),
    Waiting(WaitingLane<'r>),
}

/// The caller's wish to stop.
struct Flag<'r>(&'r AtomicBool);

impl Watch for Flag<'_> {
    fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn add_samples(&self, _count: u64) {}

    fn report(&self) {}
}

/// What threads share that render regions beside each other. Made by [`Renderer::with_regions`].
pub struct Regions<'r> {
    renderer: &'r Renderer<'r>,
    waiting: Option<Waiting<'r>>,
}

/// How rays wait.
#[derive(Clone)]
struct Waiting<'r> {
    octree: &'r LazyOctree,
    plan: WaitingPlan,
    /// `None` if each thread loads for itself.
    loader: Option<BlockLoader<'r>>,
}

/// One thread whose rays wait.
struct WaitingLane<'r> {
    renderer: &'r Renderer<'r>,
    waiting: Waiting<'r>,
    stop: &'r AtomicBool,
    worker: Option<WaitingWorker<'r, 'r, Flag<'r>>>,
    /// What workers did that are no more.
    before: RegionCounters,
}

/// What a [`RegionRenderer`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RegionCounters {
    /// Rays by effect.
    pub effects: EffectCounters,
    /// Work of the queries.
    pub trace: TraceCounters,
    /// How loads went, if rays waited for them.
    pub loads: LoadStats,
}

impl RegionCounters {
    fn merge(&mut self, other: &RegionCounters) {
        self.effects.merge(&other.effects);
        self.trace.merge(&other.trace);
        self.loads.merge(&other.loads);
    }
}

impl Renderer<'_> {
    /// What [`Renderer::regions`] takes from the budget for each thread. An octree opened without a limit takes all that is left for
    /// its cache, so reserve this before, and drop that reservation after.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn region_bytes(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
    ) -> Result<Bytes, RenderError> {
        let settings = RenderSettings { waiting: WaitingRays::Never, ..*settings };
        Renderer::regions_bytes(scene, model, &settings, 1)
    }

    /// What [`Renderer::with_regions`] and so many renderers of regions take from the budget. To be set aside as in
    /// [`Renderer::region_bytes`].
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn regions_bytes(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
        threads: u32,
    ) -> Result<Bytes, RenderError> {
        let threads = threads.max(1);
        let (stage, _) = set(scene, &Surfaces::from(model), settings)?;
        let details = Renderer::detail_bytes(scene, model, settings, threads)?;
        let in_order = scratch_bytes(&stage).0.saturating_mul(u64::from(threads));
        // Whether rays wait is decided when it is known how many slots there are.
        let waiting = WaitingPlan::of(&stage, Extent::Region, model, threads as usize)
            .map(|plan| waiting_bytes(&stage, model, &plan, threads as usize).0);
        Ok(Bytes(in_order.max(waiting.unwrap_or(0)) + details.0))
    }

    /// A renderer of regions for the calling thread, whose rays do not wait. Regions may have at most the settings' `tile_size` pixels a
    /// side. While `stop` is set, rendering ends soon and gives nothing.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if its scratch does not fit, [`RenderError::Trace`] if the octree gives no more tracers.
    pub fn regions<'r>(&'r self, stop: &'r AtomicBool) -> Result<RegionRenderer<'r>, RenderError> {
        let scratch = self.budget.reserve(scratch_bytes(&self.stage), "a region's ray trees and pixels")?;
        let worker = Worker::new(Flag(stop), &self.stage, self.query()?);
        Ok(self.region_renderer(Lane::InOrder(worker), scratch))
    }

    fn region_renderer<'r>(&'r self, lane: Lane<'r>, scratch: Reservation) -> RegionRenderer<'r> {
        let RenderSettings { width, height, tile_size, .. } = self.stage.settings;
        RegionRenderer { lane, width, height, side_max: tile_size, _scratch: scratch }
    }

    /// Runs `run`, in which so many threads of the caller's may render regions, each with a [`Regions::renderer`] of its own. Rays wait for
    /// blocks as [`RenderSettings::waiting`] says, among the samples of a region; then so many threads beside them load as
    /// [`RenderSettings::loader_threads`] says, so that a source can be asked for as many blocks at one time. They end before this
    /// returns.
    ///
    /// # Errors
    /// [`RenderError::Trace`] if the budget has no room for what loads blocks; then `run` is not called.
    ///
    /// # Panics
    /// If `run` does.
    pub fn with_regions<'r, T>(
        &'r self,
        threads: u32,
        run: impl FnOnce(&Regions<'r>) -> T,
    ) -> Result<T, RenderError> {
        let settings = &self.stage.settings;
        let Some((octree, plan)) = self.waiting(Extent::Region, threads.max(1) as usize) else {
            return Ok(run(&Regions { renderer: self, waiting: None }));
        };
        let waiting = |loader| Regions { renderer: self, waiting: Some(Waiting { octree, plan, loader }) };
        let loader_threads = settings.loader_threads;
        if loader_threads == 0 {
            return Ok(run(&waiting(None)));
        }
        let options = loader_options(loader_threads);
        let mut run = Some(run);
        let mut take = |regions: &Regions<'r>| run.take().map(|run| run(regions));
        let result = match octree
            .with_loader(loader_threads, options, |loader| take(&waiting(Some(loader.clone()))))
        {
            Err(TraceError::Budget(_)) if settings.waiting == WaitingRays::Auto => take(&waiting(None)),
            other => other?,
        };
        // It is called once: a loader that finds no room has not called it.
        Ok(result.expect("regions are rendered once"))
    }
}

impl<'r> Regions<'r> {
    /// A renderer of regions for the calling thread. Regions may have at most the settings' `tile_size` pixels a side. While
    /// `stop` is set, rendering ends soon and gives nothing.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if its scratch does not fit, [`RenderError::Trace`] if the octree gives no more tracers.
    pub fn renderer(&self, stop: &'r AtomicBool) -> Result<RegionRenderer<'r>, RenderError> {
        let renderer = self.renderer;
        let Some(waiting) = self.waiting.clone() else { return renderer.regions(stop) };
        // Pools make reservations of their own.
        let bytes = Bytes(waiting.plan.bytes(&renderer.stage));
        let scratch = renderer.budget.reserve(bytes, "a region's ray trees and pixels")?;
        let mut lane =
            WaitingLane { renderer, waiting, stop, worker: None, before: RegionCounters::default() };
        lane.worker = Some(lane.new_worker()?);
        Ok(renderer.region_renderer(Lane::Waiting(lane), scratch))
    }

    /// Whether rays wait.
    pub fn rays_wait(&self) -> bool {
        self.waiting.is_some()
    }
}

impl<'r> WaitingLane<'r> {
    fn new_worker(&self) -> Result<WaitingWorker<'r, 'r, Flag<'r>>, TraceError> {
        let Waiting { octree, plan, loader } = &self.waiting;
        let query = self.renderer.pool_query(octree, plan, loader.as_ref())?;
        Ok(WaitingWorker::new(Flag(self.stop), &self.renderer.stage, plan, query))
    }

    fn counters(&self) -> RegionCounters {
        let mut counters = self.before;
        if let Some(worker) = &self.worker {
            let (effects, trace, loads) = (worker.effects(), worker.trace(), worker.loads());
            counters.merge(&RegionCounters { effects, trace, loads });
        }
        counters
    }

    fn render(&mut self, area: Area) -> Result<Option<&[[f32; 3]]>, TraceError> {
        let mut worker = match self.worker.take() {
            Some(worker) => worker,
            None => self.new_worker()?,
        };
        let mut tile = Some(OpenedTile { id: TileId(0), cell: 0, area, threshold: None });
        let result = worker.run(&mut || tile.take(), &|_, _| {});
        self.worker = Some(worker);
        if !matches!(result, Ok(true)) {
            // It has samples left on their way that nobody wants; the next region gets another.
            self.before = self.counters();
            self.worker = None;
        }
        result?;
        Ok(self.worker.as_ref().map(|worker| worker.finished().pixels.as_slice()))
    }
}

fn scratch_bytes(stage: &Stage) -> Bytes {
    Bytes((paths::bytes_needed(stage) + tile_bytes(stage)) as u64)
}

impl RegionRenderer<'_> {
    /// The pixels of `region`, row by row, in linear RGB; `None` if it was stopped.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a region that is empty, too large or not inside the picture; [`RenderError::Trace`] if a block cannot
    /// be brought in.
    pub fn render(&mut self, region: Region) -> Result<Option<&[[f32; 3]]>, RenderError> {
        let Region { x, y, width, height } = region;
        let is_inside =
            |start: u32, length: u32, end| start.checked_add(length).is_some_and(|sum| sum <= end);
        let sides = 1..=self.side_max;
        if !(is_inside(x, width, self.width)
            && is_inside(y, height, self.height)
            && sides.contains(&width)
            && sides.contains(&height))
        {
            return Err(RenderError::Setting {
                what: "region",
                reason: format!("{region:?} is empty, has a side of more than a tile, or leaves the picture"),
            });
        }
        let area = Area { x, y, width, height };
        Ok(match &mut self.lane {
            Lane::InOrder(worker) => {
                worker.render_area_to(area, None)?.then(|| worker.finished().pixels.as_slice())
            }
            Lane::Waiting(lane) => lane.render(area)?,
        })
    }

    /// Which blocks of the model rays entered since this was called last, roughly: nothing that shows may depend on it. Empty where
    /// there are several models.
    pub fn take_touched(&mut self) -> BlockSketch {
        match &mut self.lane {
            Lane::InOrder(worker) => worker.take_touched(),
            Lane::Waiting(lane) => lane.worker.as_mut().map(WaitingWorker::take_touched).unwrap_or_default(),
        }
    }

    /// What was done since this renderer was made.
    pub fn counters(&self) -> RegionCounters {
        match &self.lane {
            Lane::InOrder(worker) => RegionCounters {
                effects: worker.effects(),
                trace: worker.trace(),
                loads: LoadStats::default(),
            },
            Lane::Waiting(lane) => lane.counters(),
        }
    }
}

/// A picture that is put together from regions, in any order. Drawn from the memory budget until dropped.
pub(crate) struct Canvas {
    film: Film,
    /// One cell for each pixel, so that any region is some cells.
    grid: TileGrid,
}

impl Canvas {
    /// A black picture with no pixel finished.
    pub fn new(width: u32, height: u32, budget: &MemoryBudget) -> Result<Canvas, BudgetError> {
        let grid = TileGrid { width, height, tile_size: 1 };
        Ok(Canvas { film: Film::new(&grid, budget)?, grid })
    }

    /// Takes over the pixels of `region`, which must lie in the picture, row by row.
    pub fn set(&mut self, region: Region, pixels: &[[f32; 3]]) {
        for (row, pixels) in pixels.chunks_exact(region.width as usize).enumerate() {
            // A row of the region, which has fewer than 2^32 pixels.
            let start = (region.y + row as u32) * self.grid.width + region.x;
            for (cell, pixel) in (start..).zip(pixels) {
                self.film.set_tile(&self.grid, cell, std::slice::from_ref(pixel));
            }
        }
    }

    pub fn film(&self) -> &Film {
        &self.film
    }

    pub fn into_film(self) -> Film {
        self.film
    }
}

impl std::fmt::Debug for Regions<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Regions").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for RegionRenderer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RegionRenderer").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Bytes;

    #[test]
    fn a_canvas_is_finished_when_its_regions_are() {
        let budget = MemoryBudget::new(Bytes::mib(1));
        let mut canvas = Canvas::new(5, 3, &budget).unwrap();
        canvas.set(Region { x: 0, y: 0, width: 5, height: 2 }, &[[1.0; 3]; 10]);
        assert!(!canvas.film().is_complete() && canvas.film().is_finished(4, 1));
        assert!(!canvas.film().is_finished(0, 2));
        canvas.set(Region { x: 1, y: 2, width: 4, height: 1 }, &[[2.0; 3]; 4]);
        canvas.set(Region { x: 0, y: 2, width: 1, height: 1 }, &[[3.0; 3]; 1]);
        let film = canvas.into_film();
        assert!(film.is_complete());
        assert_eq!([film.pixel(0, 2), film.pixel(4, 2), film.pixel(4, 1)], [[3.0; 3], [2.0; 3], [1.0; 3]]);
    }
}
