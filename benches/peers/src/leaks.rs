//! Rays from inside a closed surface at its vertices and edges: each must hit something.

use std::path::Path;

use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Compiler, Control, PrecisionChoice};
use outcrop::error::CompileError;
use outcrop::import::{MeshBuffer, MeshSink, VertexBatch};
use outcrop::octree::Tier;
use outcrop::procedural::{Icosphere, Shape};
use outcrop::units::{Bytes, MaterialId};

use crate::embree::{Embree, Mode};
use crate::engine::Engine;
use crate::mesh::Mesh;
use crate::numbers::Random;
use crate::obvhs_engine::Obvhs;
use crate::outcrop_engine::{Outcrop, open};
use crate::rays::{Rays, trace_closest};

/// The sphere keeps some detail in f32 at the farthest translation, where neighbouring floats are 1 apart.
const RADIUS: f64 = 100.0;
const SUBDIVISIONS: u32 = 5;
const TRANSLATIONS: [f64; 4] = [0.0, 1e4, 1e6, 1e7];
/// f64 vertices are multiples of this power of two, so that outcrop holds them as they are.
const LATTICE_EXPONENT: i32 = -20;

/// Counts and prints leaks of `count` rays of each kind. An error if outcrop has any.
pub fn run(count: usize) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    println!(
        "closed icosphere, radius {RADIUS}, {} triangles; {count} rays from inside at vertices, {count} at edges; \
         rays that hit nothing (vertices + edges)\n",
        20 << (2 * SUBDIVISIONS)
    );
    print!("| translation |");
    for translation in TRANSLATIONS {
        print!(" {translation:e} |");
    }
    println!("\n|---|---|---|---|---|");
    let mut table: Vec<(String, Vec<[usize; 2]>)> = Vec::new();
    for translation in TRANSLATIONS {
        for (name, leaks) in at(translation, count, folder.path())? {
            match table.iter_mut().find(|row| row.0 == name) {
                Some(row) => row.1.push(leaks),
                None => table.push((name, vec![leaks])),
            }
        }
    }
    for (name, row) in &table {
        print!("| {name} |");
        for [vertices, edges] in row {
            print!(" {vertices} + {edges} |");
        }
        println!();
    }
    let leaky = |(name, row): &(String, Vec<[usize; 2]>)| {
        name.starts_with("outcrop") && row.iter().flatten().any(|leaks| *leaks > 0)
    };
    if table.iter().any(leaky) { Err("outcrop leaks".to_string()) } else { Ok(()) }
}

/// Leaks of each tracer with the sphere at `translation` on all axes.
fn at(translation: f64, count: usize, folder: &Path) -> Result<Vec<(String, [usize; 2])>, String> {
    let center = [translation; 3];
    let text = |error: CompileError| error.to_string();
    let mut double = MeshBuffer::new();
    Icosphere::new(RADIUS, center, SUBDIVISIONS).and_then(|shape| shape.emit(&mut double)).map_err(text)?;
    let step = f64::from(LATTICE_EXPONENT).exp2();
    for position in double.vertices.iter_mut().flatten() {
        *position = (*position / step).round() * step;
    }
    let mut single = Mesh { triangles: double.triangles.clone(), ..Mesh::default() };
    single.vertices = double.vertices.iter().map(|position| position.map(|x| x as f32)).collect();
    Embree::pad(&mut single);

    // Everyone gets the f32 mesh and f32 rays at its vertices and edges.
    let single_vertices: Vec<[f64; 3]> =
        single.vertices.iter().map(|position| position.map(f64::from)).collect();
    let single_rays = rays(&single_vertices, &single.triangles, center, count, |x| f64::from(x as f32));
    let mut results = Vec::new();
    let mut record = |name: &str, engine: &mut dyn Engine, rays: &[Rays; 2]| {
        let leaks = [0, 1].map(|kind: usize| {
            trace_closest(engine, &rays[kind]).iter().filter(|found| !found.is_hit()).count()
        });
        results.push((name.to_string(), leaks));
    };
    for mode in [Mode::DEFAULT, Mode::ROBUST] {
        record(mode.name, &mut Embree::new(&single, mode)?, &single_rays);
    }
    record("obvhs", &mut Obvhs::new(&single), &single_rays);

    let path = folder.join("sphere.outcrop");
    compile(&path, PrecisionChoice::Float32, VertexBatch::Float32(&single.vertices), &single.triangles)
        .map_err(text)?;
    let octree = open(&path, Bytes::mib(256), Tier::Certified)?;
    record("outcrop, the same f32 input", &mut Outcrop::new("outcrop", &octree)?, &single_rays);

    // And outcrop the f64 mesh with f64 rays, which the others cannot take.
    let lattice = PrecisionChoice::Lattice { exponent: LATTICE_EXPONENT };
    compile(&path, lattice, VertexBatch::Float64(&double.vertices), &double.triangles).map_err(text)?;
    let double_rays = rays(&double.vertices, &double.triangles, center, count, |x| x);
    let octree = open(&path, Bytes::mib(256), Tier::Certified)?;
    record("outcrop, f64 input", &mut Outcrop::new("outcrop", &octree)?, &double_rays);
    Ok(results)
}

/// Rays at random vertices, and at random points of random edges, from random points well inside; every number as
/// `round` makes it.
fn rays(
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
    center: [f64; 3],
    count: usize,
    round: impl Fn(f64) -> f64,
) -> [Rays; 2] {
    let mut random = Random(7);
    let below = |random: &mut Random, count: usize| (random.unit() * count as f64) as usize;
    let mut at_targets = |edges: bool| {
        let mut rays = Rays::default();
        for _ in 0..count {
            let origin = center.map(|x| round(x + 0.3 * RADIUS * (2.0 * random.unit() - 1.0)));
            let triangle = triangles[below(&mut random, triangles.len())];
            let corner = below(&mut random, 3);
            let [a, b] = [corner, (corner + 1) % 3].map(|corner| vertices[triangle[corner] as usize]);
            let along = if edges { random.unit() } else { 0.0 };
            let direction = [0, 1, 2].map(|axis| round(a[axis] + along * (b[axis] - a[axis]) - origin[axis]));
            rays.push_unrounded(origin, direction);
        }
        rays
    };
    [at_targets(false), at_targets(true)]
}

/// Compiles a mesh that is in memory.
pub fn compile(
    path: &Path,
    precision: PrecisionChoice,
    vertices: VertexBatch<'_>,
    triangles: &[[u32; 3]],
) -> Result<(), CompileError> {
    let budget = MemoryBudget::new(Bytes::mib(256));
    let options = CompileOptions { precision, ..CompileOptions::default() };
    let mut progress = |_| Control::Continue;
    let mut compiler = Compiler::new(path, options, &budget, &mut progress)?;
    compiler.vertices(vertices)?;
    compiler.vertices_complete()?;
    compiler.triangles(triangles, MaterialId(0))?;
    compiler.finish()?;
    Ok(())
}
