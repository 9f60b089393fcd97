//! Table 1: blocks from a slow disk or from readers' memories.

use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use outcrop::cluster::{Reader, RemoteOptions, RemoteSource, RoleOptions, run_reader};
use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::Gears;
use outcrop::source::testing::SlowSource;
use outcrop::source::{BlockSource, DiskSource};
use outcrop::transport::{LocalNetwork, Transport};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};

use crate::drive::{Order, run};
use crate::mixes::Mix;

const WORKERS: u32 = 4;

pub fn table_1(folder: &Path, n: u32, side: u32) -> Result<(), Box<dyn Error>> {
    let path = folder.join("small blocks.outcrop");
    let options = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
    let budget = MemoryBudget::new(Bytes::mib(512));
    compile_shape(&Gears::new(n)?, &path, &options, &budget, &mut |_| Control::Continue)?;
    println!(
        "\nTable 1 (measured, in one process): gears {n}, blocks of 4 KiB, {WORKERS} workers with 10 % of the blocks each, a quarter of the"
    );
    println!(
        "{side} x {side} pixels each, camera and shadow rays. Disk: each worker's own, 5 ms for each read and 40 MB/s. Readers: threads"
    );
    println!(
        "that hold the model in memory, over the in-process transport. The paper: disk 70, one reader 37 (of its unit).\n"
    );
    println!(
        "| blocks from | blocking loads, s | over the disk's | suspended rays, s | over the disk's, blocking |"
    );
    println!("|---|---|---|---|---|");
    let sources =
        |readers: usize, work: &dyn Fn(Vec<Arc<dyn BlockSource>>) -> f64| -> Result<f64, Box<dyn Error>> {
            if readers == 0 {
                let disk = || -> Result<Arc<dyn BlockSource>, Box<dyn Error>> {
                    let disk = DiskSource::open(&path)?;
                    Ok(Arc::new(SlowSource::new(disk, Duration::from_millis(5), Some(40_000_000))))
                };
                return Ok(work((0..WORKERS).map(|_| disk()).collect::<Result<_, _>>()?));
            }
            with_readers(&path, readers, work)
        };
    let mut disk = None;
    for (name, readers) in [("disk", 0), ("1 reader", 1), ("4 readers", 4)] {
        let [blocking, suspended] = [Order::DepthFirst, Order::pool(8, 16)]
            .map(|order| sources(readers, &|sources| workers(sources, side, order)));
        let (blocking, suspended) = (blocking?, suspended?);
        let of = *disk.get_or_insert(blocking);
        println!(
            "| {name} | {blocking:.2} | {:.2} | {suspended:.2} | {:.2} |",
            blocking / of,
            suspended / of
        );
    }
    Ok(())
}

/// Seconds until all workers are done, each with a quarter of the picture.
fn workers(sources: Vec<Arc<dyn BlockSource>>, side: u32, order: Order) -> f64 {
    let start = Instant::now();
    let quarter = side * side / WORKERS;
    std::thread::scope(|scope| {
        for (worker, source) in (0..WORKERS).zip(sources) {
            scope.spawn(move || {
                let slots = source.model().blocks.len().div_ceil(10) as u32;
                let options = OctreeOptions { slots_max: Some(slots), ..OctreeOptions::default() };
                let budget = MemoryBudget::new(Bytes(1 << 40));
                let octree = LazyOctree::open(source, &budget, options).expect("the budget is ample");
                run(&octree, Mix::Shadows, side, order, worker * quarter..(worker + 1) * quarter)
            });
        }
    });
    start.elapsed().as_secs_f64()
}

fn with_readers(
    path: &Path,
    count: usize,
    work: &dyn Fn(Vec<Arc<dyn BlockSource>>) -> f64,
) -> Result<f64, Box<dyn Error>> {
    let network = LocalNetwork::new();
    let coordinator = network.open("coordinator");
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let stops = Stops(&stop);
        let mut addresses = Vec::new();
        for i in 0..count {
            let transport = network.open(&format!("reader {i}"));
            let own = transport.address().ok_or("a transport without an address")?;
            let budget = MemoryBudget::new(Bytes::mib(512));
            let file = Arc::new(DiskSource::open(path)?);
            let reader = Reader::new(file, "reader", &own, Bytes::mib(256), &budget, RoleOptions::default())?;
            let coordinator = coordinator.address().ok_or("a transport without an address")?;
            addresses.push(own);
            let stop = stops.0;
            scope.spawn(move || {
                run_reader(&transport, reader, &coordinator, Duration::from_secs(3600), stop, &mut |_| {})
            });
        }
        let open = |worker: u32| -> Result<Arc<dyn BlockSource>, Box<dyn Error>> {
            let transport = Arc::new(network.open(&format!("worker {worker}")));
            Ok(Arc::new(RemoteSource::open(transport, addresses.clone(), RemoteOptions::default())?))
        };
        let sources = (0..WORKERS).map(open).collect::<Result<_, _>>()?;
        Ok(work(sources))
    })
}

/// Ends the readers, on an error too.
struct Stops<'s>(&'s AtomicBool);

impl Drop for Stops<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}
