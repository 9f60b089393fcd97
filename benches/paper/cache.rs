//! The paper's two experiments with its cache: the size of blocks, and whether to pack them.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::octree::{LeafLayout, OctreeOptions};
use outcrop::procedural::Gears;
use outcrop::source::{BlockSource, DiskSource, PageCache};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

use crate::drive::{Order, Run, run};
use crate::mixes::Mix;

/// The disk of 2004.
const SEEK_SECONDS: f64 = 5e-3;
const BYTES_PER_SECOND: f64 = 40e6;

struct Measured {
    run: Run,
    blocks: usize,
    slots: u32,
    file_bytes: u64,
    /// Wall clock.
    seconds: f64,
}

pub fn experiments(folder: &Path, n: u32, side: u32) -> Result<(), Box<dyn Error>> {
    let path = folder.join("gears.outcrop");
    let gears = Gears::new(n)?;
    let mut cache_bytes = None;
    let mut measured = |options: &CompileOptions, order: Order| -> Result<Measured, Box<dyn Error>> {
        compile_shape(&gears, &path, options, &MemoryBudget::new(Bytes::mib(512)), &mut |_| {
            Control::Continue
        })?;
        let source = Arc::new(DiskSource::open_with(&path, PageCache::Bypass)?);
        let (blocks, file_bytes) = (source.model().blocks.len(), source.file_bytes()?);
        let slot = LazyOctree::slot_bytes(source.model(), LeafLayout::Expanded).0;
        // The same memory for all: a tenth of the slots of the first.
        let bytes = *cache_bytes.get_or_insert(slot * blocks as u64 / 10);
        let slots = ((bytes / slot) as u32).max(2);
        let options = OctreeOptions {
            slots_max: Some(slots),
            leaf_layout: LeafLayout::Expanded,
            ..OctreeOptions::default()
        };
        let octree = LazyOctree::open(source, &MemoryBudget::new(Bytes(1 << 40)), options)?;
        let start = Instant::now();
        let run = run(&octree, Mix::Shadows, side, order, 0..side * side);
        Ok(Measured { run, blocks, slots, file_bytes, seconds: start.elapsed().as_secs_f64() })
    };
    let then = |run: &Run| {
        let counters = &run.counters;
        counters.blocks_loaded as f64 * SEEK_SECONDS + counters.bytes_read as f64 / BYTES_PER_SECOND
    };
    println!(
        "\nBlock size (measured): gears {n}, camera and shadow rays, {side} x {side} pixels, one thread, page cache bypassed, the same cache memory for"
    );
    println!(
        "all: 10 % of the blocks of 64 KiB. LT: time that loads took. \"Disk of 2004\": computed from loads and bytes, 5 ms each and 40 MB/s."
    );
    println!("The paper's best: 64 KiB.\n");
    println!("| block KiB | order | blocks | slots | loads | MB read | time s | LT s | disk of 2004, s |");
    println!("|---|---|---|---|---|---|---|---|---|");
    // First the one that says what memory there is.
    let mut sum = None;
    for kib in [64, 4, 8, 16, 32, 128, 256] {
        let options = CompileOptions { block_bytes: kib << 10, ..CompileOptions::default() };
        for (name, order) in [("depth first", Order::DepthFirst), ("suspended", Order::pool(0, 1))] {
            let Measured { run, blocks, slots, seconds, .. } = measured(&options, order)?;
            assert_eq!(*sum.get_or_insert(run.sum), run.sum, "hits depend on the size of blocks");
            println!(
                "| {kib} | {name} | {blocks} | {slots} | {} | {:.1} | {seconds:.2} | {:.2} | {:.1} |",
                run.counters.blocks_loaded,
                run.counters.bytes_read as f64 / 1e6,
                run.stats.loading.as_secs_f64(),
                then(&run),
            );
        }
    }
    println!(
        "\nPacked or not (measured; blocks of 64 KiB, depth first, the rest as above). The paper packs with LZO.\n"
    );
    println!(
        "| codec | file MB | loads | MB read | LT s | us per load | disk of 2004, s | with its work, s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for codec in [Codec::Raw, Codec::Lzo, Codec::Lz4] {
        let options = CompileOptions { codec, ..CompileOptions::default() };
        let Measured { run, file_bytes, .. } = measured(&options, Order::DepthFirst)?;
        assert_eq!(sum, Some(run.sum), "hits depend on the codec");
        let (loading, stall) = (run.stats.loading.as_secs_f64(), run.stats.stall.as_secs_f64());
        println!(
            "| {codec:?} | {:.1} | {} | {:.1} | {loading:.2} | {:.0} | {:.1} | {:.1} |",
            file_bytes as f64 / 1e6,
            run.counters.blocks_loaded,
            run.counters.bytes_read as f64 / 1e6,
            1e6 * loading / run.counters.blocks_loaded as f64,
            then(&run),
            then(&run) + loading - stall,
        );
    }
    Ok(())
}
