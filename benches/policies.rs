//! Loads per touched block by replacement policy and cache size, on recorded accesses of three scenes, traced depth
//! first.
//!
//!     cargo bench --bench policies -- [--n WHEELS] [--size PIXELS]
//!
//! Small by default; `docs/results/policies.md` has the figures of large runs. Rays are recorded once per scene with one
//! tracer, then replayed without geometry, so the figures are exact and the same on every machine.

#[path = "support/paths.rs"]
mod paths;
#[path = "support/scenes.rs"]
mod scenes;

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;

use outcrop::LazyOctree;
use outcrop::access::{AccessTrace, MissRatioCurve, optimum_loads, replay};
use outcrop::cache::Policy;
use paths::Paths;
use scenes::Scene;

/// Cache sizes, as parts of all blocks.
const PERCENT: [u32; 5] = [3, 6, 10, 25, 50];
/// Pixels are taken tile by tile.
const TILE: u32 = 64;

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
    for scene in &Scene::three(n)? {
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
    let mut octree = scene.open(directory.path())?;
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
                hits += paths.trace(&mut tracer, [x, y], size)?;
            }
        }
    }
    Ok(hits)
}
