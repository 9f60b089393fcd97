//! How often blocks are loaded when the cache is smaller than the model, depth first and through a pool of suspended
//! rays, for three mixes of rays.
//!
//!     cargo bench --bench loads -- [MODEL] [--side N] [--pool N] [--weight N] [--by-depth] [--percent N,...] [--mix N] [--only-pool]
//!         [--camera-loads] [--shadows-load] [--threads N] [--in-flight N] [--slow] [--quick] [--times N] [--policies]
//!
//! MODEL: `gearsN` or `toriN` (made here) or a model or compiled file. Answers of all runs are compared. Blocks are read past the
//! page cache.
//!
//! `--threads`: that many threads load for the pool, instead of the one that traces. `--slow`: each read takes 5 ms more, and all
//! share 40 MB/s. `--quick`: the trees of blocks are made in less time. `--times`: instead of counts, times with a slot for each
//! block and with each percentage, as many times in turn, and their medians. `--policies`: a table of loads by replacement policy,
//! and the fewest that any could have with the pool's own order of visits.

mod drive;
mod mixes;
#[path = "../support/rays.rs"]
mod rays;

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use drive::{Order, Run, run};
use mixes::Mix;
use outcrop::access::{AccessTrace, optimum_loads, replay};
use outcrop::cache::Policy;
use outcrop::compile::{CompileOptions, Control, compile_file, compile_shape};
use outcrop::octree::{OctreeOptions, TreeQuality};
use outcrop::procedural::{Gears, Shape, TorusField};
use outcrop::source::testing::SlowSource;
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
    by_depth: bool,
    threads: u32,
    in_flight: u32,
    slow: bool,
    quick: bool,
    times: usize,
    policies: bool,
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
            by_depth: false,
            threads: 0,
            in_flight: 8,
            slow: false,
            quick: false,
            times: 0,
            policies: false,
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
                Long("by-depth") => options.by_depth = true,
                Long("threads") => options.threads = parser.value()?.parse()?,
                Long("in-flight") => options.in_flight = parser.value()?.parse()?,
                Long("slow") => options.slow = true,
                Long("quick") => options.quick = true,
                Long("policies") => options.policies = true,
                Long("times") => options.times = parser.value()?.parse()?,
                // `cargo bench` adds it.
                Long("bench") => {}
                // As for criterion's benches: once, small, only to see that it runs and that all answers are the same.
                Long("test") => {
                    (options.model, options.side) = ("gears1".to_string(), 32);
                    (options.pools, options.percents, options.policies) = (vec![64], vec![25.0], false);
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
    let size = |prefix: &str| model.strip_prefix(prefix).and_then(|n| n.parse::<u32>().ok());
    let shape: Option<Box<dyn Shape>> = if let Some(n) = size("gears") {
        Some(Box::new(Gears::new(n).expect("a size that exists")))
    } else {
        // As many triangles as gears of that size.
        size("tori").map(|n| -> Box<dyn Shape> {
            Box::new(TorusField::new(4, 40 * n, 5 * n.pow(2), 1).expect("a size that exists"))
        })
    };
    if let Some(shape) = shape {
        compile_shape(&*shape, &path, &options, &budget, go_on).expect("the shape compiles");
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
    let block_count = DiskSource::open(&path)?.model().blocks.len();
    let quality = if options.quick { TreeQuality::Quick } else { TreeQuality::default() };
    let bench = Bench { path, block_count, side: options.side, slow: options.slow, quality };
    println!("{}, {} x {} pixels", options.model, options.side, options.side);
    for mix in &options.mixes {
        if options.times > 0 {
            times(&bench, *mix, &options);
        } else if options.policies {
            policies(&bench, *mix, &options, &folder.path().join("pool.accesses"));
        } else {
            counts(&bench, *mix, &options);
        }
    }
    Ok(())
}

impl Options {
    fn pools(&self) -> impl Iterator<Item = Order> + '_ {
        self.pools.iter().map(|suspended| Order::Pool {
            suspended: *suspended,
            weight: self.weight,
            by_depth: self.by_depth,
            camera_loads: self.camera_loads,
            shadows_load: self.shadows_load,
            threads: self.threads,
            in_flight: self.in_flight,
        })
    }
}

/// Loads per touched block.
fn counts(bench: &Bench, mix: Mix, options: &Options) {
    let whole = bench.measured(mix, 100.0, Order::DepthFirst);
    // What plain tracing in order touches, each once.
    let touched = whole.run.counters.blocks_loaded;
    println!(
        "{}: {} rays, {touched} blocks touched, {:.2} s with a slot for each",
        mix.name(),
        whole.run.counters.rays,
        whole.wall
    );
    let depth_first = (!options.only_pool).then_some(Order::DepthFirst);
    for order in depth_first.into_iter().chain(options.pools()) {
        for percent in &options.percents {
            let part = bench.measured(mix, *percent, order);
            assert_eq!(part.run.sum, whole.run.sum, "answers depend on the cache or the order");
            println!(
                "  {percent:>4} % {order:?}: {:.3} loads per touched block, {:.2} of the time, peak {}",
                part.run.counters.blocks_loaded as f64 / touched as f64,
                part.wall / whole.wall,
                part.run.counters.suspended_peak,
            );
        }
    }
}

/// Loads per touched block by replacement policy. `accesses`: where a file can be.
fn policies(bench: &Bench, mix: Mix, options: &Options, accesses: &Path) {
    let whole = bench.measured(mix, 100.0, Order::DepthFirst);
    let touched = whole.run.counters.blocks_loaded as f64;
    println!("{}: {} rays, {touched} blocks touched", mix.name(), whole.run.counters.rays);
    let names = Policy::ALL.map(Policy::name).join(" | ");
    for order in options.pools() {
        println!(
            "{order:?}\n| cache | slots | {names} | optimum |\n|---|---|{}---|",
            "---|".repeat(Policy::ALL.len())
        );
        for percent in &options.percents {
            let slots = bench.slots(*percent);
            let loads = Policy::ALL.map(|policy| {
                let run = bench.measured_by(mix, *percent, order, policy, None).run;
                assert_eq!(run.sum, whole.run.sum, "answers depend on the cache, the order or the policy");
                run.counters.blocks_loaded
            });
            let recorded = bench.measured_by(mix, *percent, order, Policy::Lru, Some(accesses)).run;
            assert_eq!(recorded.sum, whole.run.sum, "answers depend on whether accesses are written down");
            let trace = AccessTrace::open(accesses).expect("what was recorded");
            let optimum = optimum_loads(&trace, slots);
            let replayed = replay(&trace, Policy::Lru, slots, 0).loads;
            assert!(optimum <= replayed, "the fewest loads are more than those of lru");
            let cells: Vec<String> =
                loads.iter().map(|loads| format!("{:.3}", *loads as f64 / touched)).collect();
            println!("| {percent} % | {slots} | {} | {:.3} |", cells.join(" | "), optimum as f64 / touched);
        }
    }
}

/// Wall and processor time and stall, of runs in turn.
fn times(bench: &Bench, mix: Mix, options: &Options) {
    for order in options.pools() {
        println!("{}, {order:?}", mix.name());
        println!(
            "| slots | wall s | CPU s | stall | loads | MB read | in flight | wall / wall of 100 % | CPU / CPU |"
        );
        println!("|---|---|---|---|---|---|---|---|---|");
        let percents: Vec<f64> = [100.0].into_iter().chain(options.percents.iter().copied()).collect();
        let mut runs = vec![Vec::new(); percents.len()];
        for _ in 0..options.times {
            for (percent, runs) in percents.iter().zip(&mut runs) {
                runs.push(bench.measured(mix, *percent, order));
            }
        }
        let median = |runs: &[Measured], of: fn(&Measured) -> f64| {
            let mut values: Vec<f64> = runs.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        };
        let (wall, cpu) = (|run: &Measured| run.wall, |run: &Measured| run.cpu);
        for (percent, these) in percents.iter().zip(&runs) {
            assert!(these.iter().all(|run| run.run.sum == runs[0][0].run.sum), "answers depend on the cache");
            println!(
                "| {percent} % | {:.2} | {:.2} | {:.1} % | {:.0} | {:.0} | {:.0} | {:.2} | {:.2} |",
                median(these, wall),
                median(these, cpu),
                100.0 * median(these, |run| run.run.stats.stall.as_secs_f64() / run.wall),
                median(these, |run| run.run.counters.blocks_loaded as f64),
                median(these, |run| run.run.counters.bytes_read as f64 / 1e6),
                median(these, |run| f64::from(run.run.stats.in_flight_peak)),
                median(these, wall) / median(&runs[0], wall),
                median(these, cpu) / median(&runs[0], cpu),
            );
        }
    }
}

struct Bench {
    path: PathBuf,
    block_count: usize,
    side: u32,
    slow: bool,
    quality: TreeQuality,
}

#[derive(Clone, Copy)]
struct Measured {
    run: Run,
    /// In seconds.
    wall: f64,
    /// Processor time of all threads in seconds.
    cpu: f64,
}

impl Bench {
    /// Slots for that part of the blocks.
    fn slots(&self, percent: f64) -> u32 {
        (self.block_count as f64 * percent / 100.0).ceil() as u32
    }

    /// A run from a cold octree, past the page cache.
    fn measured(&self, mix: Mix, percent: f64, order: Order) -> Measured {
        self.measured_by(mix, percent, order, Policy::Lru, None)
    }

    /// The same with another policy; with `accesses`, which blocks are visited is written down there.
    fn measured_by(
        &self,
        mix: Mix,
        percent: f64,
        order: Order,
        policy: Policy,
        accesses: Option<&Path>,
    ) -> Measured {
        let disk = DiskSource::open_with(&self.path, PageCache::Bypass).expect("a compiled file");
        let source: Arc<dyn BlockSource> = if self.slow {
            Arc::new(SlowSource::new(disk, Duration::from_millis(5), Some(40_000_000)))
        } else {
            Arc::new(disk)
        };
        let octree_options = OctreeOptions {
            slots_max: Some(self.slots(percent)),
            policy,
            quality: self.quality,
            ..OctreeOptions::default()
        };
        let budget = MemoryBudget::new(Bytes(1 << 40));
        let mut octree = LazyOctree::open(source, &budget, octree_options).expect("the budget is ample");
        let recorder = accesses.map(|path| {
            let file = File::create(path).expect("room for a file");
            octree.record_accesses(Box::new(BufWriter::new(file))).expect("the file can be written")
        });
        let (start, cpu) = (Instant::now(), processor_time());
        let run = run(&octree, mix, self.side, order, 0..self.side * self.side);
        if let Some(recorder) = recorder {
            recorder.finish().expect("the file can be written");
        }
        Measured { run, wall: start.elapsed().as_secs_f64(), cpu: processor_time() - cpu }
    }
}

/// Of this process, in seconds; 0 where it cannot be asked.
fn processor_time() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
    }
    #[cfg(not(unix))]
    0.0
}
