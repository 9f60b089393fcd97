//! outcrop, with all blocks resident unless the budget says otherwise.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, CompileReport, Control, LazyModel, LazyOptions, compile_file};
use outcrop::octree::{LazyOctree, OctreeOptions, Tier};
use outcrop::source::{BlockSource, DiskSource};
use outcrop::stats::TraceCounters;
use outcrop::trace::{Hit, Occlusion, Tracer};
use outcrop::units::Bytes;

use crate::engine::{Engine, Found, Surface};
use crate::rays::{RAYS_PER_CALL, Rays};

/// Compiles in memory bounded by `budget`, on this thread.
pub fn compile(model: &Path, output: &Path, budget: Bytes) -> Result<CompileReport, String> {
    let budget = MemoryBudget::new(budget);
    compile_file(model, output, &CompileOptions::default(), &budget, &mut |_| Control::Continue)
        .map_err(|error| error.to_string())
}

/// Opens a compiled file for one tracer.
pub fn open(compiled: &Path, budget: Bytes, tier: Tier) -> Result<LazyOctree, String> {
    open_with(compiled, budget, OctreeOptions { tier, ..OctreeOptions::default() })
}

/// Opens a compiled file.
pub fn open_with(compiled: &Path, budget: Bytes, options: OctreeOptions) -> Result<LazyOctree, String> {
    let source: Arc<dyn BlockSource> =
        Arc::new(DiskSource::open(compiled).map_err(|error| error.to_string())?);
    LazyOctree::open(source, &MemoryBudget::new(budget), options).map_err(|error| error.to_string())
}

/// Opens a model file, or what an earlier run left of it beside `output`, for one tracer; it is compiled as rays reach it.
pub fn open_lazily(
    model: &Path,
    output: &Path,
    budget: Bytes,
    options: OctreeOptions,
) -> Result<LazyOctree, String> {
    let budget = MemoryBudget::new(budget);
    let lazy = LazyModel::open(model, output, &LazyOptions::default(), &budget, &mut |_| Control::Continue);
    let source: Arc<dyn BlockSource> = Arc::new(lazy.map_err(|error| error.to_string())?);
    LazyOctree::open(source, &budget, options).map_err(|error| error.to_string())
}

pub struct Outcrop<'o> {
    name: &'static str,
    tracer: Tracer<'o>,
    hits: Vec<Option<Hit>>,
    occlusions: Vec<Occlusion>,
    taken: TraceCounters,
}

impl<'o> Outcrop<'o> {
    pub fn new(name: &'static str, octree: &'o LazyOctree) -> Result<Outcrop<'o>, String> {
        let tracer = octree.tracer().map_err(|error| error.to_string())?;
        Ok(Outcrop {
            name,
            tracer,
            hits: vec![None; RAYS_PER_CALL],
            occlusions: vec![Occlusion::Clear; RAYS_PER_CALL],
            taken: TraceCounters::default(),
        })
    }

    fn trace(&mut self, rays: &Rays, range: Range<usize>) -> &[Option<Hit>] {
        let hits = &mut self.hits[..range.len()];
        // The file was compiled by this program; a failure ends the comparison.
        self.tracer.closest_hits(&rays.double[range], hits).unwrap_or_else(|error| panic!("{error}"));
        hits
    }
}

impl Engine for Outcrop<'_> {
    fn name(&self) -> &str {
        self.name
    }

    fn closest(&mut self, rays: &Rays, range: Range<usize>, found: &mut [Found]) {
        for (hit, to) in self.trace(rays, range).iter().zip(found) {
            *to = hit.as_ref().map_or(Found::NONE, |hit| Found { t: hit.t, triangle: hit.triangle.0 as u32 });
        }
    }

    fn occluded(&mut self, rays: &Rays, range: Range<usize>, blocked: &mut [bool]) {
        let occlusions = &mut self.occlusions[..range.len()];
        self.tracer.occluded(&rays.double[range], None, occlusions).unwrap_or_else(|error| panic!("{error}"));
        for (occlusion, to) in occlusions.iter().zip(blocked) {
            *to = *occlusion != Occlusion::Clear;
        }
    }

    fn surfaces(&mut self, rays: &Rays, range: Range<usize>, surfaces: &mut [Option<Surface>]) {
        for (hit, to) in self.trace(rays, range).iter().zip(surfaces) {
            *to = hit.as_ref().map(|hit| Surface { t: hit.t, normal: hit.normal() });
        }
    }

    fn take_counters(&mut self) -> Option<String> {
        let now = self.tracer.counters();
        let before = std::mem::replace(&mut self.taken, now);
        let rays = (now.rays - before.rays).max(1) as f64;
        let per_ray = |now: u64, before: u64| (now - before) as f64 / rays;
        let text = format!(
            "{} rays; per ray {:.2} box tests, {:.2} triangle tests, {:.3} decisions, {:.2} block visits; \
             {} exact fallbacks, {} blocks loaded",
            now.rays - before.rays,
            per_ray(now.box_tests, before.box_tests),
            per_ray(now.triangle_tests, before.triangle_tests),
            per_ray(now.decisions, before.decisions),
            per_ray(now.block_visits, before.block_visits),
            now.exact_fallbacks - before.exact_fallbacks,
            now.blocks_loaded - before.blocks_loaded,
        );
        Some(text)
    }
}
