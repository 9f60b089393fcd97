//! How often blocks are loaded when the cache is smaller than the model, depth first and through a pool of suspended
//! rays, for three mixes of rays.
//!
//!     cargo bench --bench loads -- [MODEL] [--side N] [--pool N] [--weight N] [--percent N,...] [--mix N] [--only-pool] [--camera-loads]
//!         [--shadows-load]
//!
//! MODEL: `gearsN` (made here) or a model or compiled file. Answers of all runs are compared.

mod drive;
mod mixes;
#[path = "../support/rays.rs"]
mod rays;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use drive::{Order, Run, run};
use mixes::Mix;
use outcrop::compile::{CompileOptions, Control, compile_file, compile_shape};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::Gears;
use outcrop::source::{BlockSource, DiskSource, PageCache};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

struct Options {
    model: String,
    side: u32,
    pools: Vec<u32>,
    weight: u32,
    percents: Vec<f64>,
    mixes: Vec<Mix>,
    only_pool: bool,
    camera_loads: bool,
    shadows_load: bool,
}

impl Options {
    fn parse() -> Result<Options, lexopt::Error> {
        use lexopt::prelude::*;
        let mut options = Options {
            model: "gears2".to_string(),
            side: 256,
            pools: vec![1 << 14],
            weight: 4,
            percents: vec![25.0, 10.0, 6.0],
            mixes: Mix::ALL.to_vec(),
            only_pool: false,
            camera_loads: false,
            shadows_load: false,
        };
        let mut parser = lexopt::Parser::from_env();
        while let Some(argument) = parser.next()? {
            match argument {
                Value(model) => options.model = model.string()?,
                Long("side") => options.side = parser.value()?.parse()?,
                Long("pool") => options.pools = list(&parser.value()?.string()?)?,
                Long("weight") => options.weight = parser.value()?.parse()?,
                Long("percent") => options.percents = list(&parser.value()?.string()?)?,
                Long("mix") => options.mixes = vec![Mix::ALL[parser.value()?.parse::<usize>()?]],
                Long("only-pool") => options.only_pool = true,
                Long("camera-loads") => options.camera_loads = true,
                Long("shadows-load") => options.shadows_load = true,
                // `cargo bench` adds it.
                Long("bench") => {}
                // As for criterion's benches: once, small, only to see that it runs and that all answers are the same.
                Long("test") => {
                    (options.model, options.side) = ("gears1".to_string(), 32);
                    (options.pools, options.percents) = (vec![64], vec![25.0]);
                }
                other => return Err(other.unexpected()),
            }
        }
        Ok(options)
    }
}

fn list<T: std::str::FromStr>(text: &str) -> Result<Vec<T>, lexopt::Error> {
    text.split(',').map(|part| part.parse().map_err(|_| format!("{part}: not a number").into())).collect()
}

/// The compiled file of a model; in `folder` if it was made here.
fn compiled(model: &str, folder: &Path) -> PathBuf {
    let budget = MemoryBudget::new(Bytes::mib(512));
    let (options, go_on) = (CompileOptions::default(), &mut |_| Control::Continue);
    let path = folder.join("model.outcrop");
    if let Some(n) = model.strip_prefix("gears").and_then(|n| n.parse().ok()) {
        let gears = Gears::new(n).expect("a size that exists");
        compile_shape(&gears, &path, &options, &budget, go_on).expect("the gears compile");
        return path;
    }
    if model.ends_with(".outcrop") {
        return PathBuf::from(model);
    }
    compile_file(Path::new(model), &path, &options, &budget, go_on).expect("the model compiles");
    path
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let options = Options::parse()?;
    let folder = tempfile::tempdir()?;
    let path = compiled(&options.model, folder.path());
    println!("{}, {} x {} pixels", options.model, options.side, options.side);
    for mix in &options.mixes {
        let (whole, seconds) = measured(&path, *mix, options.side, 100.0, Order::DepthFirst);
        // What plain tracing in order touches, each once.
        let touched = whole.counters.blocks_loaded;
        println!(
            "{}: {} rays, {touched} blocks touched, {:.2} s with a slot for each",
            mix.name(),
            whole.counters.rays,
            seconds
        );
        let pools = options.pools.iter().map(|suspended| Order::Pool {
            suspended: *suspended,
            weight: options.weight,
            camera_loads: options.camera_loads,
            shadows_load: options.shadows_load,
        });
        let depth_first = (!options.only_pool).then_some(Order::DepthFirst);
        for order in depth_first.into_iter().chain(pools) {
            for percent in &options.percents {
                let (part, part_seconds) = measured(&path, *mix, options.side, *percent, order);
                assert_eq!(part.sum, whole.sum, "answers depend on the cache or the order");
                println!(
                    "  {percent:>4} % {order:?}: {:.3} loads per touched block, {:.2} of the time, peak {}",
                    part.counters.blocks_loaded as f64 / touched as f64,
                    part_seconds / seconds,
                    part.counters.suspended_peak,
                );
            }
        }
    }
    Ok(())
}

/// A run from a cold octree, past the page cache.
fn measured(path: &Path, mix: Mix, side: u32, percent: f64, order: Order) -> (Run, f64) {
    let source = Arc::new(DiskSource::open_with(path, PageCache::Bypass).expect("a compiled file"));
    let slots = (source.model().blocks.len() as f64 * percent / 100.0).ceil() as u32;
    let octree_options = OctreeOptions { slots_max: Some(slots), ..OctreeOptions::default() };
    let budget = MemoryBudget::new(Bytes(1 << 40));
    let octree = LazyOctree::open(source, &budget, octree_options).expect("the budget is ample");
    let start = Instant::now();
    let run = run(&octree, mix, side, order);
    (run, start.elapsed().as_secs_f64())
}
