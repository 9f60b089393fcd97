//! Puts octree, scene and settings together.

use std::sync::Arc;
use std::time::Instant;

use super::draft::Draft;
use super::film::{Film, Kept};
use super::geometry::{self, Geometry, Surfaces};
use super::layers::{Layers, layers};
use super::probe::Probe;
use super::query::{RayQuery, SceneTracer};
use super::report::{Outcome, RenderReport, WaitingReport};
use super::resample::{self, Resampled, SampledPixel};
use super::settings::{RenderSettings, WaitingRays};
use super::stage::Stage;
use super::tile_samples::FinishedTile;
use super::tiles::Area;
use super::waiting::{Extent, PoolQuery, WaitingPlan};
use super::workers::{self, ProgressFn, Thresholds, Totals};
use super::{Progress, paths};
use crate::attributes::AttributeCache;
use crate::budget::MemoryBudget;
use crate::cache::CacheStats;
use crate::compile::{Control, Threads};
use crate::error::{RenderError, TraceError};
use crate::instance::Instances;
use crate::model::Model;
use crate::octree::{LazyOctree, tracer_bytes_about};
use crate::scene::{Effect, EffectPlan, Scene};
use crate::texture::TextureCache;
use crate::trace::{BlockLoader, LoaderOptions};
use crate::units::Bytes;

/// A picture and what making it took.
#[derive(Debug)]
pub struct RenderedImage {
    /// The picture; after a cancel some tiles are black and marked as not finished.
    pub film: Film,
    /// What was done.
    pub report: RenderReport,
}

impl RenderedImage {
    /// The film if it is whole.
    ///
    /// # Errors
    /// [`RenderError::Cancelled`] if the render was cancelled before its end.
    pub fn into_complete(self) -> Result<Film, RenderError> {
        match self.report.outcome {
            Outcome::Complete => Ok(self.film),
            Outcome::Cancelled => Err(RenderError::Cancelled),
        }
    }
}

/// Renders pictures of one scene through one octree.
pub struct Renderer<'a> {
    geometry: Geometry<'a>,
    pub(super) stage: Stage,
    plan: EffectPlan,
    pub(super) budget: MemoryBudget,
    /// One for each model that has attributes; none at all if the picture needs none.
    attributes: Vec<Option<AttributeCache>>,
}

impl<'a> Renderer<'a> {
    /// A renderer for `scene` over the geometry of `octree`. Checks scene and settings and makes the
    /// [`EffectPlan`]. Memory is taken from `budget` only while [`Renderer::render`] runs, but for the cache of attributes, if the
    /// picture needs any: that is there from here on until the renderer is dropped.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a scene or settings that make no sense; [`RenderError::Budget`] and [`RenderError::Trace`] if
    /// attributes are needed and their cache does not fit, or the octree's source cannot give them.
    pub fn new(
        octree: &'a LazyOctree,
        scene: &Scene,
        settings: &RenderSettings,
        budget: &MemoryBudget,
    ) -> Result<Renderer<'a>, RenderError> {
        Renderer::of(Geometry::Model(octree), scene, settings, budget)
    }

    /// [`Renderer::new`] over instances. Materials of all models are told apart by name alone: a [`Finish`](crate::scene::Finish)
    /// holds for all of its name.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn over_instances(
        instances: &'a Instances,
        scene: &Scene,
        settings: &RenderSettings,
        budget: &MemoryBudget,
    ) -> Result<Renderer<'a>, RenderError> {
        Renderer::of(Geometry::Instances(instances), scene, settings, budget)
    }

    fn of(
        geometry: Geometry<'a>,
        scene: &Scene,
        settings: &RenderSettings,
        budget: &MemoryBudget,
    ) -> Result<Renderer<'a>, RenderError> {
        let (mut stage, plan) = set(scene, &geometry.surfaces(), settings)?;
        // Threads of a render have a tracer each.
        let readers = geometry.tracers_max();
        let [attribute_share, texture_share] = detail_shares(&stage, settings);
        let attributes = match stage.needs_attributes() {
            true => geometry.open_attributes(attribute_share, readers, budget)?,
            false => Vec::new(),
        };
        if let Some(textures) = stage.textures_to_open(scene) {
            let cache = TextureCache::open(textures, texture_share, readers, budget)?;
            stage.textures = Some(Arc::new(cache));
        }
        Ok(Renderer { geometry, stage, plan, budget: budget.clone(), attributes })
    }

    /// What a render on `threads` takes from the budget for film, ray trees and tables. An octree opened without
    /// a limit takes all that is left for its cache, so reserve this before, and drop that reservation after.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn bytes_needed(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
        threads: &Threads,
    ) -> Result<Bytes, RenderError> {
        bytes_needed(&Surfaces::from(model), scene, settings, threads, Some(model))
    }

    /// [`Renderer::bytes_needed`] for a picture of instances of all these models.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn bytes_needed_for(
        models: &[&Model],
        scene: &Scene,
        settings: &RenderSettings,
        threads: &Threads,
    ) -> Result<Bytes, RenderError> {
        bytes_needed(&Surfaces::from(models), scene, settings, threads, None)
    }

    /// Of [`Renderer::bytes_needed`], what the caches of attributes and textures take for so many threads.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub(crate) fn detail_bytes(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
        readers: u32,
    ) -> Result<Bytes, RenderError> {
        let surfaces = Surfaces::from(model);
        let (stage, _) = set(scene, &surfaces, settings)?;
        Ok(detail_bytes(&stage, scene, &surfaces, readers))
    }

    /// What the cache of attributes did (of several models, their caches together), if the picture needs one.
    pub fn attribute_stats(&self) -> Option<CacheStats> {
        let mut caches = self.attributes.iter().flatten().peekable();
        caches.peek()?;
        Some(geometry::sum_of(caches.map(AttributeCache::stats)))
    }

    /// What the cache of textures did, if the picture needs one.
    pub fn texture_stats(&self) -> Option<CacheStats> {
        self.stage.textures.as_deref().map(TextureCache::stats)
    }

    /// A query for one thread.
    ///
    /// # Errors
    /// [`RenderError::Trace`] if the octree gives no more tracers.
    pub(super) fn query(&self) -> Result<SceneTracer<'_>, TraceError> {
        self.geometry.query(&self.attributes)
    }

    /// The effects that will be simulated, and why.
    pub fn plan(&self) -> &EffectPlan {
        &self.plan
    }

    /// What lies behind each pixel, on the calling thread: one ray per pixel. `progress` is called after each row, which
    /// counts as a tile.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if the layers do not fit, [`RenderError::Trace`] if a block cannot be brought in,
    /// [`RenderError::Cancelled`] if `progress` said so.
    pub fn layers(&self, progress: &mut dyn FnMut(Progress) -> Control) -> Result<Layers, RenderError> {
        layers(&self.stage, &self.budget, self.query()?, progress)
    }

    /// Makes the picture on `threads`. `progress` is called after each batch of samples, by one thread at a time;
    /// answering [`Control::Cancel`] ends the render soon and gives the tiles finished so far. Each thread takes a tracer, so the octree
    /// must have been opened for as many ([`OctreeOptions::tracers_max`](crate::octree::OctreeOptions::tracers_max)).
    /// If the system gives fewer threads, fewer work.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if film and scratch do not fit, [`RenderError::Trace`] if a block cannot be brought
    /// in, or, before anything is drawn, if there are more threads than tracers ([`TraceError::TooManyTracers`]). There is no picture then.
    pub fn render(
        &self,
        threads: &Threads,
        progress: &mut (dyn FnMut(Progress) -> Control + Send),
    ) -> Result<RenderedImage, RenderError> {
        self.render_steered(threads, &|_| None, progress)
    }

    /// [`Renderer::render`] with an error threshold for each tile; where it is `None`, that of the settings holds. The function is
    /// asked once for each tile, when a thread takes it.
    pub(crate) fn render_steered(
        &self,
        threads: &Threads,
        thresholds: &Thresholds<'_>,
        progress: &mut (dyn FnMut(Progress) -> Control + Send),
    ) -> Result<RenderedImage, RenderError> {
        let (wanted, tracers_max) = (workers::worker_count(threads) as u32, self.geometry.tracers_max());
        if wanted > tracers_max {
            return Err(TraceError::TooManyTracers { wanted, tracers_max }.into());
        }
        let cache_before = self.geometry.cache_stats();
        let (picture, waiting) = match self.waiting(Extent::Picture, workers::worker_count(threads)) {
            Some((octree, plan)) => {
                let (picture, waiting) =
                    self.picture_waiting(octree, &plan, threads, thresholds, progress)?;
                (picture, Some(waiting))
            }
            None => {
                let query = || self.query();
                (picture(&self.stage, threads, &self.budget, &query, thresholds, progress)?, None)
            }
        };
        let Picture { film, totals, wall_seconds, memory } = picture;
        let settings = &self.stage.settings;
        let report = RenderReport {
            outcome: if totals.is_cancelled && !film.is_complete() {
                Outcome::Cancelled
            } else {
                Outcome::Complete
            },
            width: settings.width,
            height: settings.height,
            samples_per_pixel: settings.samples_per_pixel,
            threads: workers::worker_count(threads) as u32,
            tiles_total: self.stage.grid.tile_count() as u32,
            tiles_finished: totals.tiles,
            wall_seconds,
            seconds: totals.seconds,
            plan: self.plan.clone(),
            effects: totals.effects,
            trace: totals.trace,
            cache: since(&cache_before, &self.geometry.cache_stats()),
            blocks_touched: self.geometry.blocks_touched(),
            blocks_total: self.geometry.block_count(),
            memory,
            budget_peak: self.budget.peak(),
            waiting,
        };
        Ok(RenderedImage { film, report })
    }

    /// The octree whose blocks rays are to wait for, and how many, if any are.
    pub(super) fn waiting(&self, extent: Extent, workers: usize) -> Option<(&LazyOctree, WaitingPlan)> {
        let Geometry::Model(octree) = self.geometry else { return None };
        let (stage, model) = (&self.stage, octree.model());
        let mut plan = WaitingPlan::of(stage, extent, model, workers)?;
        if stage.settings.waiting != WaitingRays::Auto {
            return Some((octree, plan));
        }
        let cache = octree.cache();
        if cache.slot_count() >= model.expected_block_count() {
            return None;
        }
        let cache_bytes = cache.slot_bytes().0.saturating_mul(u64::from(cache.slot_count()));
        // What the threads' tracers take is not reserved yet either.
        let tracers = tracer_bytes_about(model).0.saturating_mul(workers as u64);
        let film = match extent {
            Extent::Picture => Film::bytes_needed(&stage.grid, Kept::by(&stage.settings)).0,
            Extent::Region => 0,
        };
        let available = self.budget.available().0.saturating_sub(film).saturating_sub(tracers);
        while waiting_bytes(stage, model, &plan, workers).0 > available.min(cache_bytes) {
            plan = plan.smaller(stage, workers)?;
        }
        Some((octree, plan))
    }

    /// A query whose rays wait in a pool of its own; `loader` loads for it, if there is one.
    pub(super) fn pool_query<'o>(
        &'o self,
        octree: &'o LazyOctree,
        plan: &WaitingPlan,
        loader: Option<&BlockLoader<'o>>,
    ) -> Result<PoolQuery<'o>, TraceError> {
        let options = plan.pool_options(&self.stage);
        let pool = match loader {
            Some(loader) => loader.ray_pool(options)?,
            None => octree.ray_pool(options)?,
        };
        Ok(Geometry::pool_query(pool, &self.attributes))
    }

    /// [`picture`] with rays that wait for blocks.
    fn picture_waiting<'o>(
        &'o self,
        octree: &'o LazyOctree,
        plan: &WaitingPlan,
        threads: &Threads,
        thresholds: &Thresholds<'_>,
        progress: &mut ProgressFn<'_>,
    ) -> Result<(Picture, WaitingReport), RenderError> {
        let stage = &self.stage;
        let workers = workers::worker_count(threads);
        // Pools and loaders make reservations of their own.
        let scratch = plan.bytes(stage).saturating_mul(workers as u64) + stage_bytes(stage);
        let film = Film::bytes_needed(&stage.grid, Kept::by(&stage.settings));
        let memory = Bytes(film.0 + waiting_bytes(stage, octree.model(), plan, workers).0);
        let mut loader_threads = stage.settings.loader_threads;
        let mut draw = |loader: Option<&BlockLoader<'o>>| {
            picture_by(stage, &self.budget, Bytes(scratch), memory, &mut |film, order| {
                let make_query = || self.pool_query(octree, plan, loader);
                workers::run_waiting(stage, plan, order, film, threads, &make_query, thresholds, progress)
            })
        };
        let picture = if loader_threads == 0 {
            draw(None)?
        } else {
            let options = loader_options(loader_threads);
            match octree.with_loader(loader_threads, options, |loader| draw(Some(loader))) {
                Ok(picture) => picture?,
                // Nothing was drawn.
                Err(TraceError::Budget(_)) if stage.settings.waiting == WaitingRays::Auto => {
                    loader_threads = 0;
                    draw(None)?
                }
                Err(error) => return Err(error.into()),
            }
        };
        let loads = picture.totals.loads;
        let waiting = WaitingReport {
            rays: plan.rays.saturating_mul(workers as u32),
            loader_threads,
            loading_seconds: loads.loading.as_secs_f64(),
            stall_seconds: loads.stall.as_secs_f64(),
            in_flight_peak: loads.in_flight_peak,
        };
        Ok((picture, waiting))
    }
}

impl Renderer<'_> {
    /// Looks at about `pixel_count` pixels all over the picture; `None` if `stop` said so. Takes a tracer while it lives.
    pub(crate) fn probe(
        &self,
        pixel_count: u32,
        samples_min: u32,
        stop: &mut dyn FnMut() -> Control,
    ) -> Result<Option<Probe<'_, SceneTracer<'_>>>, RenderError> {
        let query = self.query()?;
        Probe::new(&self.stage, query, pixel_count, samples_min, &self.budget, stop)
    }

    /// Keeps from now on what the samples of each pixel add up to: each picture goes on with the one before, on as many threads at
    /// most. The settings' sampling must be adaptive, and statistics kept.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if what is kept does not fit.
    pub(crate) fn keep_draft(&mut self, threads: &Threads) -> Result<(), RenderError> {
        let threads = workers::worker_count(threads);
        self.stage.draft = Some(Draft::new(&self.stage.settings, threads, &self.budget)?);
        Ok(())
    }

    /// What is kept, if it is.
    pub(crate) fn draft(&self) -> Option<&Draft> {
        self.stage.draft.as_ref()
    }

    /// Puts on the film of a render that was stopped what is kept of the tiles that it did not come to.
    pub(crate) fn fill_in(&self, film: &mut Film) {
        self.show_draft(film, |film, area| !film.is_finished(area.x, area.y));
    }

    /// Has the first samples of all pixels look at each other, and puts on the film of a whole picture what is known then.
    pub(crate) fn look_around(&self, film: &mut Film) {
        if let Some(draft) = &self.stage.draft {
            draft.look_around();
            self.show_draft(film, |_, _| true);
        }
    }

    fn show_draft(&self, film: &mut Film, is_asked: impl Fn(&Film, &Area) -> bool) {
        let Some(draft) = &self.stage.draft else { return };
        let mut kept = FinishedTile::default();
        let grid = &self.stage.grid;
        for cell in 0..grid.tile_count() as u32 {
            let area = grid.area(cell);
            if is_asked(film, &area) && draft.show(&self.stage, &area, &mut kept) {
                film.set_tile(grid, cell, &kept.pixels);
                film.set_statistics(grid, cell, &kept.statistics);
                film.set_costs(grid, cell, &kept.costs);
            }
        }
    }

    /// The samples that are asked for of `pixels`, on `threads`; `None` if `stop` said so.
    ///
    /// # Errors
    /// As for [`Renderer::render`].
    pub(crate) fn resample(
        &self,
        pixels: &[SampledPixel],
        threads: &Threads,
        stop: &mut (dyn FnMut() -> Control + Send),
    ) -> Result<Option<Resampled>, RenderError> {
        let scratch = paths::bytes_needed(&self.stage) * workers::worker_count(threads)
            + resample::bytes_needed(pixels.len());
        let _scratch = self.budget.reserve(Bytes(scratch as u64), "ray trees of a second look at pixels")?;
        resample::resample(&self.stage, pixels, threads, &|| self.query(), stop)
    }

    /// What [`Renderer::probe`] takes from the budget.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub(crate) fn probe_bytes(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
        pixel_count: u32,
    ) -> Result<Bytes, RenderError> {
        let (stage, _) = set(scene, &Surfaces::from(model), settings)?;
        Ok(Probe::<SceneTracer<'_>>::bytes_needed(&stage, pixel_count))
    }
}

/// A picture before it is reported on.
pub(super) struct Picture {
    pub film: Film,
    pub totals: Totals,
    pub wall_seconds: f64,
    pub memory: Bytes,
}

/// What a render of these surfaces takes; `model`: if they are those of one model.
fn bytes_needed(
    surfaces: &Surfaces<'_>,
    scene: &Scene,
    settings: &RenderSettings,
    threads: &Threads,
    model: Option<&Model>,
) -> Result<Bytes, RenderError> {
    let (stage, _) = set(scene, surfaces, settings)?;
    let workers = workers::worker_count(threads);
    let details = detail_bytes(&stage, scene, surfaces, workers as u32);
    let Memory { film, scratch } = memory(&stage, threads);
    // Whether rays wait is decided when it is known how many slots there are.
    let waiting = model.and_then(|model| {
        let plan = WaitingPlan::of(&stage, Extent::Picture, model, workers)?;
        Some(waiting_bytes(&stage, model, &plan, workers))
    });
    Ok(Bytes(film.0 + scratch.max(waiting.unwrap_or_default()).0 + details.0))
}

/// What the caches of attributes and textures take for so many threads.
fn detail_bytes(stage: &Stage, scene: &Scene, surfaces: &Surfaces<'_>, readers: u32) -> Bytes {
    let [attribute_share, texture_share] = detail_shares(stage, &stage.settings);
    let mut bytes = 0;
    if stage.needs_attributes() {
        bytes += surfaces.attribute_bytes(attribute_share, readers).0;
    }
    if let Some(textures) = stage.textures_to_open(scene) {
        bytes += TextureCache::bytes_needed(&textures, texture_share, readers).0;
    }
    Bytes(bytes)
}

/// Bytes for the caches of attributes and of textures: a quarter for those, if there are these.
fn detail_shares(stage: &Stage, settings: &RenderSettings) -> [Bytes; 2] {
    let all = settings.detail_bytes;
    let attributes = if stage.needs_textures() { all / 4 } else { all };
    [attributes, all - attributes].map(Bytes)
}

/// Checks scene and settings and brings them into the form that rendering wants.
pub(super) fn set(
    scene: &Scene,
    surfaces: &Surfaces<'_>,
    settings: &RenderSettings,
) -> Result<(Stage, EffectPlan), RenderError> {
    scene.validate()?;
    settings.validate()?;
    let materials = &surfaces.materials;
    scene.validate_finishes(materials)?;
    if surfaces.have_uvs() {
        scene.validate_textures(materials, settings.switched_off)?;
    }
    let plan = surfaces.plan(scene, &settings.effect_options());
    let mut stage = Stage::new(scene, materials, &plan, settings);
    stage.are_moving = surfaces.are_moving && plan.has(Effect::MotionBlur);
    Ok((stage, plan))
}

/// Renders `stage` through queries from `make_query`.
pub(super) fn picture<Q: RayQuery>(
    stage: &Stage,
    threads: &Threads,
    budget: &MemoryBudget,
    make_query: &(dyn Fn() -> Result<Q, TraceError> + Sync),
    thresholds: &Thresholds<'_>,
    progress: &mut ProgressFn<'_>,
) -> Result<Picture, RenderError> {
    let needed = memory(stage, threads);
    picture_by(stage, budget, needed.scratch, needed.total(), &mut |film, order| {
        workers::run(stage, order, film, threads, make_query, thresholds, progress)
    })
}

/// What makes the film, tile by tile in the order of these cells.
type Draw<'d> = dyn FnMut(&mut Film, &[u32]) -> Result<Totals, RenderError> + 'd;

/// Reserves `scratch`, and has `draw` make the film, tile by tile in the order that it is given. `memory`: what is reported as taken.
fn picture_by(
    stage: &Stage,
    budget: &MemoryBudget,
    scratch: Bytes,
    memory: Bytes,
    draw: &mut Draw<'_>,
) -> Result<Picture, RenderError> {
    let start = Instant::now();
    let _scratch = budget.reserve(scratch, "the renderer's ray trees and tiles")?;
    let mut film = Film::keeping(&stage.grid, Kept::by(&stage.settings), budget)?;
    let order = stage.grid.hilbert_order();
    let totals = draw(&mut film, &order)?;
    Ok(Picture { film, totals, wall_seconds: start.elapsed().as_secs_f64(), memory })
}

/// What a render takes from the budget.
struct Memory {
    film: Bytes,
    scratch: Bytes,
}

impl Memory {
    fn total(&self) -> Bytes {
        Bytes(self.film.0 + self.scratch.0)
    }
}

fn memory(stage: &Stage, threads: &Threads) -> Memory {
    let per_thread = paths::bytes_needed(stage) + workers::tile_bytes(stage);
    let scratch = per_thread as u64 * workers::worker_count(threads) as u64 + stage_bytes(stage);
    Memory { film: Film::bytes_needed(&stage.grid, Kept::by(&stage.settings)), scratch: Bytes(scratch) }
}

/// What all threads share, but for the film.
fn stage_bytes(stage: &Stage) -> u64 {
    stage.bytes() as u64 + stage.grid.order_bytes().0
}

/// What a render takes whose rays wait, but for the film and the threads' tracers.
pub(super) fn waiting_bytes(stage: &Stage, model: &Model, plan: &WaitingPlan, workers: usize) -> Bytes {
    let of_worker = plan.bytes_with_pool(stage, model.block_id_count() as usize);
    /// Requests and what comes of them: small beside a load's scratch.
    const QUEUES: u64 = 64 << 10;
    let of_loader = tracer_bytes_about(model).0 + QUEUES;
    // What is read ahead takes less than a load.
    let loads = match stage.settings.loader_threads {
        0 => 0,
        threads => u64::from(loads_at_once(threads)) + 1,
    };
    let loaders = of_loader * loads;
    Bytes(of_worker.saturating_mul(workers as u64).saturating_add(loaders).saturating_add(stage_bytes(stage)))
}

/// As many loads at a time as there are threads for them, and one of a pool that has nothing to trace; and as many again to choose
/// the next from.
pub(super) fn loader_options(threads: u32) -> LoaderOptions {
    let least = LoaderOptions::default();
    let loads_in_flight = least.loads_in_flight.max(2 * threads);
    LoaderOptions { loads_at_once: loads_at_once(threads), loads_in_flight }
}

/// Loads that run at the same time beside a picture.
fn loads_at_once(loader_threads: u32) -> u32 {
    loader_threads.saturating_add(1)
}

/// What happened between two looks at the same cache.
fn since(before: &CacheStats, after: &CacheStats) -> CacheStats {
    CacheStats {
        hits: after.hits - before.hits,
        misses: after.misses - before.misses,
        evictions: after.evictions - before.evictions,
        stalls: after.stalls - before.stalls,
        filled_bytes: after.filled_bytes - before.filled_bytes,
    }
}

impl std::fmt::Debug for Renderer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Renderer").field("plan", &self.plan).finish_non_exhaustive()
    }
}
