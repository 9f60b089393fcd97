//! A model that is compiled lazily gives the hits, the images and in the end the file of one that is compiled at once; and what it keeps
//! between runs survives being broken off anywhere, or is found to be damaged.

#[path = "../support/compiling.rs"]
mod compiling;
mod conformance;
mod interrupted;
mod refusals;
#[path = "../support/mod.rs"]
mod support;

use std::path::Path;
use std::sync::Arc;

use compiling::{Mesh, Vertices};
use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Compiler, Control, LazyModel, LazyOptions};
use outcrop::error::{CompileError, TraceError};
use outcrop::geom::Ray;
use outcrop::model::SourceRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Soup, Tessellation};
use outcrop::source::MemorySource;
use outcrop::trace::{Hit, Occlusion};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use support::numbers::Random;

/// What the meshes of these tests are said to come from.
const SOURCE: SourceRecord = SourceRecord { file_bytes: 1, modified_ns: 2, fingerprint: 3 };

/// Toothed wheels in f32, with materials: 6 k triangles.
fn gears() -> Mesh {
    Mesh::of(&Gears::with_tessellation(2, Tessellation::new(3).unwrap()).unwrap())
}

/// Random triangles in f64, which become a lattice.
fn soup() -> Mesh {
    let mesh = Mesh::of(&Soup::new(3000, 0.1, 9).unwrap());
    let exact = (0..mesh.triangles.len() as u32 * 3).map(|i| {
        let vertex = mesh.vertex(mesh.triangles[i as usize / 3][i as usize % 3]);
        vertex.map(|x| x + 1.0 / 3.0)
    });
    let triangles = (0..mesh.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Mesh::new(Vertices::Float64(exact.collect()), triangles)
}

/// Many small cells of many small blocks.
fn small() -> LazyOptions {
    let compile = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
    LazyOptions { compile, cell_triangles: 256, ..LazyOptions::default() }
}

fn budget() -> MemoryBudget {
    MemoryBudget::new(Bytes::mib(64))
}

fn open(
    mesh: &Mesh,
    output: &Path,
    options: &LazyOptions,
    budget: &MemoryBudget,
) -> Result<Arc<LazyModel>, CompileError> {
    let emit = |compiler: &mut Compiler<'_>| mesh.emit(compiler);
    LazyModel::from_mesh(SOURCE, output, options, budget, &mut |_| Control::Continue, emit).map(Arc::new)
}

/// An octree over a model that is compiled at once.
fn eager(mesh: &Mesh, options: &CompileOptions) -> LazyOctree {
    let (_, bytes) = compiling::compile(mesh, options, Bytes::mib(64));
    let source = Arc::new(MemorySource::new(bytes).unwrap());
    LazyOctree::open(source, &budget(), OctreeOptions::default()).unwrap()
}

fn octree(model: &Arc<LazyModel>, budget: &MemoryBudget, tracers_max: u32) -> LazyOctree {
    let source = Arc::clone(model) as Arc<dyn BlockSource>;
    LazyOctree::open(source, budget, OctreeOptions { tracers_max, ..Default::default() }).unwrap()
}

/// Rays through the middle of the model from around it, and from within.
fn rays(octree: &LazyOctree, count: usize, seed: u64) -> Vec<Ray> {
    let bounds = octree.model().bounds;
    let (center, extent) = (bounds.center(), bounds.extent());
    let mut random = Random(seed);
    let mut at =
        |scale: f64| [0, 1, 2].map(|axis| center[axis] + scale * extent[axis] * (0.5 * random.signed()));
    (0..count)
        .map(|i| {
            let from = at(if i % 3 == 0 { 1.0 } else { 4.0 });
            let to = at(1.0);
            Ray::new(from, [0, 1, 2].map(|axis| to[axis] - from[axis]))
        })
        .collect()
}

type Answers = (Vec<Option<Hit>>, Vec<Occlusion>);

fn trace(octree: &LazyOctree, rays: &[Ray]) -> Result<Answers, TraceError> {
    let mut tracer = octree.tracer()?;
    let (mut hits, mut occlusions) = (vec![None; rays.len()], vec![Occlusion::Clear; rays.len()]);
    tracer.closest_hits(rays, &mut hits)?;
    tracer.occluded(rays, None, &mut occlusions)?;
    Ok((hits, occlusions))
}

/// Every option that changes blocks.
fn all_options() -> Vec<LazyOptions> {
    let mut all = vec![small(), LazyOptions::default()];
    let mut other = small();
    other.compile.codec = Codec::Raw;
    other.cell_triangles = 1;
    other.cells_at_once = 3;
    all.push(other);
    all
}
