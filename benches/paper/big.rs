//! Table 3 and Figure 4: a part of 114,800 triangles, copied without instancing.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use outcrop::compile::{CompileOptions, Control, PrecisionChoice, compile_shape};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Assembly, Shape, TorusField};
use outcrop::source::{BlockSource, DiskSource, PageCache};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

use crate::drive::{Order, run};
use crate::memory::MemoryLog;
use crate::mixes::Mix;

/// A part: eight rough tori, every second of glass.
const TORUS: [u32; 2] = [175, 41];

/// The big model, compiled.
pub struct Big {
    path: PathBuf,
    pub triangles: u64,
}

impl Big {
    /// `copies`^3 parts; 9 is the paper's number.
    pub fn compile(folder: &Path, copies: u32) -> Result<Big, Box<dyn Error>> {
        let path = folder.join("big.outcrop");
        let mut whole = Assembly::new();
        let size = 1.0 / f64::from(copies);
        let places = 0..copies;
        for cell in
            places.clone().flat_map(|z| places.clone().flat_map(move |y| (0..copies).map(move |x| [x, y, z])))
        {
            let translation = cell.map(|k| (2.0 * f64::from(k) + 1.0) * size - 1.0);
            let [around, across] = TORUS;
            whole = whole.with(TorusField::new(2, around, across, 1)?, size, translation);
        }
        let options = CompileOptions { precision: PrecisionChoice::Float32, ..CompileOptions::default() };
        let budget = MemoryBudget::new(Bytes::mib(256));
        let start = Instant::now();
        compile_shape(&whole, &path, &options, &budget, &mut |_| Control::Continue)?;
        println!(
            "\nThe big model: {copies}^3 parts, {} triangles, compiled in {:.1} s in 256 MB on one thread, the parts made on the way",
            whole.triangle_count(),
            start.elapsed().as_secs_f64()
        );
        println!("(the paper: three minutes for 83 M triangles).");
        Ok(Big { path, triangles: whole.triangle_count() })
    }

    /// What a path does, to so many rays in a row.
    pub fn mix(&self, depth: u32) -> Mix {
        let triangles = 2 * u64::from(TORUS[0]) * u64::from(TORUS[1]);
        Mix::Pieces { triangles, depth: depth - 1 }
    }

    /// With slots for so many percent of the blocks, read past the page cache.
    pub fn open(&self, percent: f64) -> Result<LazyOctree, Box<dyn Error>> {
        let source = Arc::new(DiskSource::open_with(&self.path, PageCache::Bypass)?);
        let slots = (source.model().blocks.len() as f64 * percent / 100.0).ceil() as u32;
        let options = OctreeOptions { slots_max: Some(slots), ..OctreeOptions::default() };
        Ok(LazyOctree::open(source, &MemoryBudget::new(Bytes(1 << 40)), options)?)
    }
}

/// Depth by depth, as the paper's: one ray after the other, LRU, loads on the way; and with suspended rays.
pub fn table_3(big: &Big, side: u32, memory: Option<PathBuf>) -> Result<(), Box<dyn Error>> {
    println!(
        "\nTable 3 (measured): the big model with 6 % of the blocks in memory, {side} x {side} pixels, five lights, one thread, page"
    );
    println!(
        "cache bypassed. RT: render time, LT: of that, time in which no ray was traced because of loads."
    );
    println!(
        "The paper, 83 M triangles: 24 loads per touched block at depth 1; RT / (RT - LT) 2.1 to 2.4 at depth 1 and 12.\n"
    );
    println!(
        "| depth | order | rays | block accesses | block loads | per touched block | RT s | LT s | RT / (RT - LT) |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let log = memory.map(MemoryLog::start);
    for depth in [1, 2, 12] {
        let orders = [
            ("depth first", Order::DepthFirst),
            ("suspended", Order::pool(0, 1)),
            ("suspended, 2 loaders", Order::pool(2, 8)),
        ];
        let (mut touched, mut sum) = (0, None);
        for (name, order) in orders {
            let octree = big.open(6.0)?;
            let start = Instant::now();
            let run = run(&octree, big.mix(depth), side, order, 0..side * side);
            let seconds = start.elapsed().as_secs_f64();
            // Those of the run in order.
            if touched == 0 {
                touched = octree.blocks_touched();
            }
            assert_eq!(*sum.get_or_insert(run.sum), run.sum, "answers depend on the order");
            let loading = run.stats.loading.as_secs_f64();
            println!(
                "| {depth} | {name} | {} | {} | {} | {:.2} | {seconds:.2} | {loading:.2} | {:.2} |",
                run.counters.rays,
                run.counters.block_visits,
                run.counters.blocks_loaded,
                run.counters.blocks_loaded as f64 / touched as f64,
                seconds / (seconds - loading),
            );
        }
    }
    if let Some(log) = log {
        log.finish()?;
    }
    Ok(())
}
