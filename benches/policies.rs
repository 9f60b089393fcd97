//! Loads per touched block by replacement policy and cache size, on recorded accesses of three scenes, traced depth
//! first.
//!
//!     cargo bench --bench policies -- [--n WHEELS] [--size PIXELS]
//!
//! Small by default; `docs/results/policies.md` has the figures of large runs. Rays are recorded once per scene with one
//! tracer, then replayed without geometry, so the figures are exact and the same on every machine.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::sync::Arc;

use outcrop::access::{AccessTrace, MissRatioCurve, optimum_loads, replay};
use outcrop::cache::Policy;
use outcrop::compile::{CompileOptions, Compiler, Control};
use outcrop::geom::{Ray, offset_origin};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Shape, TorusField};
use outcrop::source::DiskSource;
use outcrop::trace::{Hit, Occlusion, Tracer};
use outcrop::units::{Bytes, MaterialId};
use outcrop::{LazyOctree, MemoryBudget};

/// Cache sizes, as parts of all blocks.
const PERCENT: [u32; 5] = [3, 6, 10, 25, 50];
/// Pixels are taken tile by tile.
const TILE: u32 = 64;
/// The standard view and lights of the gears.
const EYE: [f64; 3] = [-1.1, -2.1, 2.6];
const LIGHTS: [[f64; 3]; 5] =
    [[2.0, 4.0, 4.0], [-2.0, 4.0, 3.0], [2.0, -2.5, 2.5], [-1.0, -4.0, 2.0], [-1.111, -2.121, 2.626]];

/// What happens at a hit, besides a shadow ray to each light.
#[derive(Clone, Copy)]
enum Paths {
    /// So many bounces, distributed as the cosine.
    Diffuse(u32),
    /// Glass of index 1.5 but for the floor: refraction or, as often as Fresnel's equations say, reflection, to so many rays
    /// in a row.
    Glass(u32),
}

struct Scene {
    name: &'static str,
    shape: Box<dyn Shape>,
    paths: Paths,
}

fn main() -> Result<(), Box<dyn Error>> {
    let (mut n, mut size) = (3, 256);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--bench" => {}
            // Only to see that it runs.
            "--test" => (n, size) = (1, 48),
            "--n" => n = arguments.next().ok_or("--n: a number is missing")?.parse()?,
            "--size" => size = arguments.next().ok_or("--size: a number is missing")?.parse()?,
            // A filter of another benchmark's names, as `cargo bench NAME` passes it to all.
            _ => return Ok(()),
        }
    }
    // About as many triangles as the gears.
    let tori = TorusField::new(4, 40 * n, 5 * n.pow(2), 1)?;
    let scenes = [
        Scene {
            name: "gears, opaque, three bounces",
            shape: Box::new(Gears::new(n)?),
            paths: Paths::Diffuse(3),
        },
        Scene { name: "gears, glass to depth 12", shape: Box::new(Gears::new(n)?), paths: Paths::Glass(12) },
        Scene { name: "tori, opaque, three bounces", shape: Box::new(tori), paths: Paths::Diffuse(3) },
    ];
    for scene in &scenes {
        let trace = record(scene, size)?;
        println!("\n{}: {} triangles, {size} x {size} pixels", scene.name, scene.shape.triangle_count());
        table(&trace);
    }
    Ok(())
}

/// Prints the loads per touched block of a stream of accesses, whoever ordered it.
fn table(trace: &AccessTrace) {
    let curve = MissRatioCurve::of(trace);
    let (blocks, totals) = (trace.block_count(), trace.totals());
    println!(
        "{blocks} blocks, {} touched; {} queries, {} entries into blocks",
        curve.touched(),
        totals.queries,
        totals.accesses
    );
    let names: Vec<&str> = Policy::ALL.iter().map(|policy| policy.name()).collect();
    println!("| cache | slots | {} | optimum | behind pins: {} |", names.join(" | "), names.join(" | "));
    println!("|---|---|{}", "---|".repeat(2 * names.len() + 1));
    for percent in PERCENT {
        let slots = (blocks * percent).div_ceil(100);
        // As a lone tracer keeps them.
        let pins = (slots / 4).clamp(1, 64);
        let row = |pins| Policy::ALL.map(|policy| replay(trace, policy, slots, pins));
        let (bare, pinned) = (row(0), row(pins));
        let optimum = optimum_loads(trace, slots);
        assert_eq!(bare[0].loads, curve.loads(slots), "two ways to LRU's loads");
        for counts in bare.iter().chain(&pinned) {
            assert_eq!((counts.accesses, counts.touched), (totals.accesses, curve.touched()));
            assert!(counts.loads >= optimum, "better than the best");
        }
        let cells = |counts: [outcrop::access::ReplayCounts; 3]| {
            counts.map(|counts| format!("{:.3}", counts.loads_per_touched_block())).join(" | ")
        };
        let optimum = optimum as f64 / curve.touched() as f64;
        println!("| {percent} % | {slots} | {} | {optimum:.3} | {} |", cells(bare), cells(pinned));
    }
    for loads in [1.0, 1.1, 2.0] {
        if let Some(need) = curve.memory_need(loads) {
            println!(
                "lru: {} ({} slots) for at most {loads} loads per touched block",
                need.bytes, need.slots
            );
        }
    }
}

/// Compiles the scene, traces it and reads the trace back.
fn record(scene: &Scene, size: u32) -> Result<AccessTrace, Box<dyn Error>> {
    let directory = tempfile::tempdir()?;
    let compiled = directory.path().join("scene.outcrop");
    let budget = MemoryBudget::new(Bytes::mib(2048));
    let mut progress = |_| Control::Continue;
    let mut compiler = Compiler::new(&compiled, CompileOptions::default(), &budget, &mut progress)?;
    scene.shape.emit(&mut compiler)?;
    compiler.finish()?;
    let mut octree =
        LazyOctree::open(Arc::new(DiskSource::open(&compiled)?), &budget, OctreeOptions::default())?;
    let accesses = directory.path().join("scene.accesses");
    let recorder = octree.record_accesses(Box::new(BufWriter::new(File::create(&accesses)?)))?;
    let hits = trace_all(&octree, scene.paths, size)?;
    assert!(hits > u64::from(size) * u64::from(size) / 4, "the model fills a good part of the picture");
    recorder.finish()?;
    let trace = AccessTrace::open(&accesses)?;
    assert_eq!(replay(&trace, Policy::Lru, u32::MAX, 0).loads, octree.blocks_touched());
    Ok(trace)
}

/// Follows the path of each pixel to its end before the next; how many hits there were.
fn trace_all(octree: &LazyOctree, paths: Paths, size: u32) -> Result<u64, Box<dyn Error>> {
    let mut tracer = octree.tracer()?;
    let mut hits = 0;
    for tile in 0..size.div_ceil(TILE).pow(2) {
        let tiles = size.div_ceil(TILE);
        let [left, top] = [tile % tiles * TILE, tile / tiles * TILE];
        for y in top..(top + TILE).min(size) {
            for x in left..(left + TILE).min(size) {
                // A generator for each pixel: paths do not depend on their order.
                let mut random = Random(u64::from(y * size + x));
                hits += follow(&mut tracer, camera_ray([x, y], size), paths, &mut random)?;
            }
        }
    }
    Ok(hits)
}

/// One path; its hits.
fn follow(
    tracer: &mut Tracer<'_>,
    mut ray: Ray,
    paths: Paths,
    random: &mut Random,
) -> Result<u64, Box<dyn Error>> {
    let rays = match paths {
        Paths::Diffuse(bounces) => bounces + 1,
        Paths::Glass(depth) => depth,
    };
    let mut occlusions = [Occlusion::Clear; LIGHTS.len()];
    for depth in 0..rays {
        let Some(hit) = tracer.closest_hit(&ray)? else { return Ok(depth.into()) };
        let normal = unit(hit.normal());
        // To the side from which the ray came.
        let normal = normal.map(|x| -x * dot(normal, ray.direction).signum());
        let from = |direction| offset_origin(hit.position(), hit.position_error(), normal, direction);
        let shadows = LIGHTS.map(|light| {
            let direction = sub(light, hit.position());
            Ray { t_max: 1.0, ..Ray::new(from(direction), direction) }
        });
        tracer.occluded(&shadows, None, &mut occlusions)?;
        let direction = match paths {
            Paths::Glass(_) if hit.material != MaterialId(0) => {
                through_glass(&hit, ray.direction, normal, random)
            }
            Paths::Glass(_) => return Ok(u64::from(depth) + 1),
            Paths::Diffuse(_) => cosine(normal, random),
        };
        ray = Ray::new(from(direction), direction);
    }
    Ok(rays.into())
}

/// Refracted, or reflected as often as Fresnel's equations for unpolarised light say. `normal` is on the ray's side.
fn through_glass(hit: &Hit, direction: [f64; 3], normal: [f64; 3], random: &mut Random) -> [f64; 3] {
    let direction = unit(direction);
    let enters = dot(hit.normal(), normal) > 0.0;
    let eta = if enters { 1.0 / 1.5 } else { 1.5 };
    let cos_in = -dot(direction, normal);
    let sin_out_squared = eta * eta * (1.0 - cos_in * cos_in);
    let reflected = [0, 1, 2].map(|k| direction[k] + 2.0 * cos_in * normal[k]);
    if sin_out_squared >= 1.0 {
        return reflected;
    }
    let cos_out = (1.0 - sin_out_squared).sqrt();
    let (parallel, across) = (
        (cos_in - eta * cos_out) / (cos_in + eta * cos_out),
        (eta * cos_in - cos_out) / (eta * cos_in + cos_out),
    );
    if random.unit() < 0.5 * (parallel * parallel + across * across) {
        return reflected;
    }
    [0, 1, 2].map(|k| eta * direction[k] + (eta * cos_in - cos_out) * normal[k])
}

/// A direction on the side of `normal`, distributed as the cosine: a point on the unit sphere that touches the surface.
fn cosine(normal: [f64; 3], random: &mut Random) -> [f64; 3] {
    loop {
        let any = [(); 3].map(|()| 2.0 * random.unit() - 1.0);
        let length = dot(any, any).sqrt();
        if (1e-3..1.0).contains(&length) {
            let direction = [0, 1, 2].map(|k| normal[k] + any[k] / length);
            if dot(direction, direction) > 1e-6 {
                return direction;
            }
        }
    }
}

fn camera_ray([x, y]: [u32; 2], size: u32) -> Ray {
    let forward = unit(EYE.map(|x| -x));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let half = 22.5f64.to_radians().tan();
    let place = |i: u32| half * (2.0 * (f64::from(i) + 0.5) / f64::from(size) - 1.0);
    Ray::new(EYE, [0, 1, 2].map(|k| forward[k] + place(x) * right[k] - place(y) * up[k]))
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|x| x / dot(a, a).sqrt())
}
