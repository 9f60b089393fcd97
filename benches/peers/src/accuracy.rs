//! What a tier costs: closest hits of the same rays in every tier, and with Embree's robust mode against its default.

use std::path::Path;

use outcrop::compile::PrecisionChoice;
use outcrop::import::VertexBatch;
use outcrop::octree::Tier;
use outcrop::procedural::{CUBOID_FACES, Shape, Terrain, cuboid_corners};
use outcrop::units::Bytes;

use crate::clock::{measure, median};
use crate::embree::{Embree, Mode};
use crate::engine::{Engine, Found};
use crate::leaks::compile;
use crate::mesh::Mesh;
use crate::outcrop_engine::{Outcrop, open};
use crate::rays::{Rays, primary, trace_closest};

/// Edge length of the images.
const SIZE: usize = 512;
/// Boxes of the CAD scene along x and y; one ray each.
const BOXES: u32 = 256;
/// `Exact` gets one of so many calls: tiles all over the image, whose width is no multiple of so many.
const EXACT_SHARE: usize = 17;

/// Prints one table.
pub fn run(model: &Path, repetitions: usize) -> Result<(), String> {
    let read = Mesh::read(model).map_err(|error| error.to_string())?;
    let mut terrain = Mesh::default();
    Terrain::new(1000, 1).and_then(|shape| shape.emit(&mut terrain)).map_err(|error| error.to_string())?;
    let name = model.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let scenes = [
        (name, read, primary(SIZE).0),
        ("terrain".to_string(), terrain, primary(SIZE).0),
        ("boxes from above, every ray ties".to_string(), boxes(), from_above()),
    ];
    println!("| scene | triangles | tracer | ns per ray | ratio to |");
    println!("|---|---|---|---|---|");
    for (name, mut mesh, rays) in scenes {
        Embree::pad(&mut mesh);
        scene(&name, &mesh, &rays, repetitions)?;
    }
    Ok(())
}

fn scene(name: &str, mesh: &Mesh, rays: &Rays, repetitions: usize) -> Result<(), String> {
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let path = folder.path().join("model.outcrop");
    compile(&path, PrecisionChoice::Float32, VertexBatch::Float32(&mesh.vertices), &mesh.triangles)
        .map_err(|error| error.to_string())?;
    let octrees: Vec<_> =
        Tier::ALL.into_iter().map(|tier| open(&path, Bytes(16 << 30), tier)).collect::<Result<_, _>>()?;
    let mut engines: Vec<Box<dyn Engine + '_>> = Vec::new();
    for (tier, octree) in Tier::ALL.into_iter().zip(&octrees) {
        engines.push(Box::new(Outcrop::new(tier.name(), octree)?));
    }
    for mode in [Mode::DEFAULT, Mode::ROBUST] {
        engines.push(Box::new(Embree::new(mesh, mode)?));
    }
    // Loads the blocks, and shows that all see much the same.
    let answers: Vec<Vec<Found>> =
        engines.iter_mut().map(|engine| trace_closest(engine.as_mut(), rays)).collect();
    let hits = answers[0].iter().filter(|found| found.is_hit()).count();
    for (engine, own) in engines.iter().zip(&answers) {
        let differ = own.iter().zip(&answers[3]).filter(|(a, b)| a.is_hit() != b.is_hit()).count();
        if 100 * differ > rays.len() || 4 * hits < rays.len() {
            return Err(format!("{name}: {} differs in {differ} of {} rays", engine.name(), rays.len()));
        }
    }
    let exact = Tier::ALL.len() - 1;
    let calls: Vec<_> = rays.calls().collect();
    let mut seconds = vec![Vec::new(); engines.len()];
    for repetition in 0..repetitions {
        for place in 0..engines.len() {
            let index = (place + repetition) % engines.len();
            let step = if index == exact { EXACT_SHARE } else { 1 };
            let mut found = vec![Found::NONE; rays.len()];
            let mut traced = 0;
            let time = measure(|| {
                for range in calls.iter().step_by(step) {
                    traced += range.len();
                    engines[index].closest(rays, range.clone(), &mut found[range.clone()]);
                }
            });
            for range in calls.iter().step_by(step) {
                assert!(found[range.clone()] == answers[index][range.clone()], "{}", engines[index].name());
            }
            seconds[index].push(1e9 * time / traced as f64);
        }
    }
    let fast = 0;
    let default = Tier::ALL.len();
    for (index, engine) in engines.iter().enumerate() {
        let base = if index < default { fast } else { default };
        // Of times in the same repetition, so that a slow moment of the machine hits both.
        let ratio = median(seconds[index].iter().zip(&seconds[base]).map(|(own, base)| own / base));
        println!(
            "| {name} | {} | {} | {:.0} | {ratio:.2} of {} |",
            mesh.triangles.len(),
            engine.name(),
            median(seconds[index].iter().copied()),
            engines[base].name()
        );
    }
    Ok(())
}

/// Boxes side by side, of different heights: a plain axis-aligned part.
fn boxes() -> Mesh {
    let mut mesh = Mesh::default();
    for x in 0..BOXES {
        for y in 0..BOXES {
            let first = mesh.vertices.len() as u32;
            let top = 1.0 + ((x * 7 + y * 13) % 16) as f32;
            let [low, high] = [[x, y], [x + 1, y + 1]].map(|corner| corner.map(|place| place as f32));
            mesh.vertices.extend(cuboid_corners([low[0], low[1], 0.0], [high[0], high[1], top]));
            mesh.triangles.extend(CUBOID_FACES.map(|face| face.map(|corner| first + corner)));
        }
    }
    mesh
}

/// Straight down on the middle of each box, which lies on the edge between the two triangles of its top.
fn from_above() -> Rays {
    let mut rays = Rays::default();
    for x in 0..BOXES {
        for y in 0..BOXES {
            rays.push([f64::from(x) + 0.5, f64::from(y) + 0.5, 64.0], [0.0, 0.0, -1.0], f64::INFINITY);
        }
    }
    rays
}
