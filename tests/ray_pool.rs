//! A pool of suspended rays answers what a tracer answers, whatever its size, the slots, the order, the threads and who
//! loads for it.

#[path = "support/mod.rs"]
mod support;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use outcrop::error::{LoadError, SourceError, TraceError};
use outcrop::geom::{Precision, Ray};
use outcrop::model::Model;
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::source::MemorySource;
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::trace::{
    Answers, AnyRequest, BlockLoader, ClosestRequest, Hit, LoaderOptions, MaterialSet, Occlusion, OnMissing,
    PoolOptions, RayPool, Tracer,
};
use outcrop::units::{BlockId, Bytes, MaterialId, TriangleId};
use outcrop::{BlockSource, MemoryBudget};
use proptest::prelude::*;
use support::numbers::Random;
use support::{Triangles, compile};

/// A cloud of small triangles on a grid of positions, so that hits coincide now and then.
fn cloud(seed: u64, count: usize) -> Triangles {
    let mut random = Random(seed);
    let mut grid = |scale: f64| random.vector(1.0).map(|x| (x * scale * 64.0).round() / 64.0);
    (0..count)
        .map(|_| {
            let corner = grid(1.0);
            let edges = [grid(0.4), grid(0.4)];
            [corner, edges[0], edges[1]].map(|edge| {
                if edge == corner { corner } else { [0, 1, 2].map(|axis| corner[axis] + edge[axis]) }
            })
        })
        .collect()
}

fn source_of(seed: u64) -> Arc<MemorySource> {
    let triangles = cloud(seed, 600);
    // Cells of a coarse grid keep blocks apart.
    let key = |i: usize| {
        let cell = triangles[i][0].map(|x| ((x + 1.0) * 2.0) as u64);
        cell[0] * 16 + cell[1] * 4 + cell[2]
    };
    compile(&triangles, Precision::Float32, 10, key)
}

fn open(source: Arc<dyn BlockSource>, slots: u32, tracers_max: u32) -> LazyOctree {
    let options = OctreeOptions { slots_max: Some(slots), tracers_max, ..OctreeOptions::default() };
    LazyOctree::open(source, &MemoryBudget::new(Bytes::mib(64)), options).unwrap()
}

fn ignored() -> MaterialSet {
    [MaterialId(0), MaterialId(2)].into_iter().collect()
}

/// Rays with tags: closest hits, some behind another hit, and any hits.
struct Asked {
    closest: Vec<ClosestRequest>,
    any: Vec<AnyRequest>,
}

fn asked(seed: u64, count: usize) -> Asked {
    let mut random = Random(seed);
    let mut closest = Vec::new();
    let mut any = Vec::new();
    for tag in 0..count as u64 {
        let origin = random.vector(1.0).map(|x| 2.0 * x);
        let mut target = random.vector(1.0).map(|x| 0.8 * x);
        if random.index(8) == 0 {
            target[random.index(2)] = origin[0];
        }
        let direction = [0, 1, 2].map(|axis| target[axis] - origin[axis]);
        let ray = Ray { t_max: 0.5 + 2.0 * random.signed().abs(), ..Ray::new(origin, direction) };
        let after = (random.index(3) == 0).then(|| (random.signed().abs(), TriangleId(random.bits() % 600)));
        closest.push(ClosestRequest { ray, after, tag });
        any.push(AnyRequest { ray, tag });
    }
    Asked { closest, any }
}

type Found = (BTreeMap<u64, Option<Hit>>, BTreeMap<u64, Occlusion>);

fn by_tracer(tracer: &mut Tracer<'_>, asked: &Asked, ignore: &MaterialSet) -> Found {
    let mut hits = BTreeMap::new();
    for request in &asked.closest {
        let mut hit = [None];
        match request.after {
            None => tracer.closest_hits(&[request.ray], &mut hit).unwrap(),
            Some(after) => tracer.closest_hits_after(&[request.ray], &[after], &mut hit).unwrap(),
        }
        hits.insert(request.tag, hit[0]);
    }
    let mut occlusions = BTreeMap::new();
    for request in &asked.any {
        let mut occlusion = [Occlusion::Clear];
        tracer.occluded(&[request.ray], Some(ignore), &mut occlusion).unwrap();
        occlusions.insert(request.tag, occlusion[0]);
    }
    (hits, occlusions)
}

/// Asks in pieces of random size, with resumptions in between.
fn by_pool(pool: &mut RayPool<'_>, asked: &Asked, seed: u64) -> Result<Found, TraceError> {
    let mut random = Random(seed);
    let mut answers = Answers::with_capacity(asked.closest.len() + asked.any.len());
    let (mut closest, mut any) = (&asked.closest[..], &asked.any[..]);
    let (mut hits, mut occlusions) = (BTreeMap::new(), BTreeMap::new());
    let mut goes_on = true;
    while goes_on || !closest.is_empty() || !any.is_empty() {
        let on_missing = match random.index(4) {
            0 => OnMissing::Load,
            weight => OnMissing::Wait { weight: weight as u32 },
        };
        match random.index(3) {
            0 => {
                let (now, later) = closest.split_at(closest.len().min(random.index(40)));
                pool.closest_hits(now, on_missing, &mut answers)?;
                closest = later;
            }
            1 => {
                let (now, later) = any.split_at(any.len().min(random.index(40)));
                pool.occluded(now, on_missing, &mut answers)?;
                any = later;
            }
            _ => goes_on = pool.resume(&mut answers)?,
        }
        for (tag, hit) in answers.hits.drain(..) {
            assert_eq!(hits.insert(tag, hit), None, "answered twice");
        }
        for (tag, occlusion) in answers.occlusions.drain(..) {
            assert_eq!(occlusions.insert(tag, occlusion), None, "answered twice");
        }
        goes_on |= pool.suspended_count() > 0;
    }
    assert!(!pool.resume(&mut answers)?);
    Ok((hits, occlusions))
}

/// Who loads for a pool.
#[derive(Clone, Copy, Debug)]
enum Loads {
    /// Its own thread.
    Own,
    /// So many threads of a loader.
    Threads(u32),
    /// A thread of the caller's, which it gives the loader for a while.
    Callers,
    /// A loader for which nobody works.
    Nobody,
}

const LOADS: [Loads; 5] = [Loads::Own, Loads::Threads(1), Loads::Threads(3), Loads::Callers, Loads::Nobody];

fn ahead(loads_in_flight: u32) -> LoaderOptions {
    LoaderOptions { loads_at_once: 1, loads_in_flight }
}

fn with_pool<R>(
    octree: &LazyOctree,
    options: PoolOptions,
    loads: Loads,
    loads_in_flight: u32,
    run: impl FnOnce(&mut RayPool<'_>) -> R,
) -> R {
    let loader_options = ahead(loads_in_flight);
    match loads {
        Loads::Own => run(&mut octree.ray_pool(options).unwrap()),
        Loads::Threads(threads) => {
            let run = |loader: &BlockLoader<'_>| run(&mut loader.ray_pool(options).unwrap());
            octree.with_loader(threads, loader_options, run).unwrap()
        }
        Loads::Nobody => {
            let loader = octree.block_loader(loader_options).unwrap();
            run(&mut loader.ray_pool(options).unwrap())
        }
        Loads::Callers => {
            let loader = octree.block_loader(loader_options).unwrap();
            std::thread::scope(|scope| {
                scope.spawn(|| {
                    // Some of its own accord, then until it is let go, which may be in the middle.
                    loader.load_next();
                    loader.work();
                });
                let closer = loader.clone();
                scope.spawn(move || {
                    std::thread::sleep(Duration::from_millis(3));
                    closer.close();
                });
                run(&mut loader.ray_pool(options).unwrap())
            })
        }
    }
}

/// Lets some reads take longer, so that loads end in another order than they began.
struct UnevenSource {
    source: Arc<MemorySource>,
    seed: u64,
    reads: AtomicU64,
}

impl BlockSource for UnevenSource {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        let read = self.reads.fetch_add(1, Ordering::Relaxed);
        if Random(self.seed ^ read << 20).index(8) == 0 {
            std::thread::sleep(Duration::from_micros(50));
        }
        self.source.read_block(block, into)
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn answers_are_the_tracers(
        seed in any::<u64>(),
        slots in 1u32..40,
        suspended in prop::sample::select(vec![0u32, 1, 7, 60, 1000]),
        loads in prop::sample::select(LOADS.to_vec()),
        loads_in_flight in 1u32..9,
    ) {
        let source = source_of(seed);
        let asked = asked(seed ^ 1, 200);
        let reference = open(source.clone(), 1000, 1);
        let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
        prop_assert!(expected.0.values().flatten().count() > 20);
        let octree = open(Arc::new(UnevenSource { source, seed, reads: AtomicU64::new(0) }), slots, 1);
        let options = PoolOptions { suspended, ignore: Some(ignored()), ..PoolOptions::default() };
        let (found, counters, stats) = with_pool(&octree, options, loads, loads_in_flight, |pool| {
            let found = [0, 1].map(|round| by_pool(pool, &asked, seed ^ round).unwrap());
            (found, pool.counters(), pool.load_stats())
        });
        prop_assert!(found.iter().all(|found| *found == expected));
        prop_assert_eq!(counters.rays, 800);
        let more = if suspended == 0 { 0 } else { (suspended / 4 + 1).max(PoolOptions::default().children) };
        prop_assert!(counters.suspended_peak <= u64::from(suspended + more));
        // A quarter of the slots at most.
        prop_assert!(stats.in_flight_peak <= loads_in_flight.min(slots / 4));
    }
}

#[test]
fn pools_on_two_threads_share_slots() {
    let source = source_of(5);
    let asked = asked(6, 300);
    let reference = open(source.clone(), 1000, 1);
    let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
    for (slots, suspended) in [(2, 5), (2, 300), (5, 1000), (20, 50)] {
        let octree = open(source.clone(), slots, 2);
        std::thread::scope(|scope| {
            for thread in 0..2 {
                let (octree, asked, expected) = (&octree, &asked, &expected);
                scope.spawn(move || {
                    let options =
                        PoolOptions { suspended, ignore: Some(ignored()), ..PoolOptions::default() };
                    let mut pool = octree.ray_pool(options).unwrap();
                    assert!(by_pool(&mut pool, asked, thread).unwrap() == *expected);
                });
            }
        });
    }
}

/// Two pools share a loader, and a tracer takes slots from both.
#[test]
fn pools_share_a_loader_and_its_slots() {
    let source = source_of(5);
    let asked = asked(6, 300);
    let reference = open(source.clone(), 1000, 1);
    let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
    for (slots, suspended, threads) in [(12, 300, 1), (13, 40, 2), (30, 1000, 3), (40, 5, 2), (13, 300, 0)] {
        let source = UnevenSource { source: source.clone(), seed: 1, reads: AtomicU64::new(0) };
        let octree = open(Arc::new(source), slots, 3);
        let peaks = octree.with_loader(threads, ahead(6), |loader| {
            std::thread::scope(|scope| {
                let (octree, asked, expected) = (&octree, &asked, &expected);
                scope.spawn(move || {
                    assert!(by_tracer(&mut octree.tracer().unwrap(), asked, &ignored()) == *expected);
                });
                let pools = [0, 1].map(|thread| {
                    scope.spawn(move || {
                        let options =
                            PoolOptions { suspended, ignore: Some(ignored()), ..PoolOptions::default() };
                        let mut pool = loader.ray_pool(options).unwrap();
                        assert!(by_pool(&mut pool, asked, thread).unwrap() == *expected);
                        pool.load_stats().in_flight_peak
                    })
                });
                pools.map(|pool| pool.join().unwrap())
            })
        });
        assert!(peaks.unwrap().iter().all(|peak| (1..=6.min(slots / 12)).contains(peak)));
    }
}

/// Reads wait until there are two of them.
struct MeetingSource {
    source: Arc<MemorySource>,
    reads: Mutex<(u32, bool)>,
    changed: Condvar,
}

impl BlockSource for MeetingSource {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        let mut reads = self.reads.lock().unwrap();
        reads.0 += 1;
        reads.1 |= reads.0 == 2;
        self.changed.notify_all();
        while !reads.1 {
            let (now, timeout) = self.changed.wait_timeout(reads, Duration::from_secs(20)).unwrap();
            reads = now;
            if timeout.timed_out() {
                break;
            }
        }
        reads.0 -= 1;
        drop(reads);
        self.source.read_block(block, into)
    }
}

#[test]
fn loads_run_at_the_same_time() {
    let source = source_of(7);
    let met = MeetingSource { source, reads: Mutex::new((0, false)), changed: Condvar::new() };
    let source = Arc::new(met);
    let octree = open(source.clone(), 1000, 1);
    let asked = asked(8, 300);
    octree
        .with_loader(2, ahead(4), |loader| {
            let options = PoolOptions { suspended: 1000, ..PoolOptions::default() };
            let mut pool = loader.ray_pool(options).unwrap();
            let mut answers = Answers::with_capacity(300);
            pool.closest_hits(&asked.closest, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
            assert!(pool.suspended_count() > 0);
            pool.resume(&mut answers).unwrap();
            assert!(source.reads.lock().unwrap().1, "no two reads met");
            while pool.resume(&mut answers).unwrap() {}
            assert_eq!(answers.hits.len(), 300);
            // Nothing but what was asked for, once, and all of it in the counters.
            let counters = pool.counters();
            assert_eq!(counters.blocks_loaded, octree.cache().stats().misses);
            assert_eq!(counters.blocks_loaded, octree.blocks_touched());
            assert!(pool.load_stats().stall > Duration::ZERO);
        })
        .unwrap();
}

/// Panics once, at a read of its choice.
struct PanickingSource {
    source: Arc<MemorySource>,
    reads: AtomicU64,
    at: u64,
}

impl BlockSource for PanickingSource {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        if self.reads.fetch_add(1, Ordering::Relaxed) == self.at {
            // Without the panic hook, which would print.
            std::panic::resume_unwind(Box::new("a source that panics"));
        }
        self.source.read_block(block, into)
    }
}

#[test]
fn a_load_that_panics_panics_in_its_pool_and_nothing_hangs() {
    let asked = asked(12, 100);
    let reference = open(source_of(11), 1000, 1);
    let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
    for (threads, at) in [(0, 0), (1, 0), (1, 9), (2, 3), (3, 20)] {
        let source = PanickingSource { source: source_of(11), reads: AtomicU64::new(0), at };
        let octree = open(Arc::new(source), 20, 1);
        let trace = |loader: &BlockLoader<'_>| {
            let options = PoolOptions { suspended: 1000, ignore: Some(ignored()), ..PoolOptions::default() };
            by_pool(&mut loader.ray_pool(options).unwrap(), &asked, 1).unwrap()
        };
        octree
            .with_loader(threads, ahead(5), |loader| {
                let panic = catch_unwind(AssertUnwindSafe(|| trace(loader))).unwrap_err();
                assert_eq!(*panic.downcast::<&str>().unwrap(), "a source that panics");
                // Threads, scratch and slots are all still there.
                assert!(trace(loader) == expected);
            })
            .unwrap();
    }
}

/// What waiting is for: far fewer loads than depth first.
#[test]
fn one_load_serves_all_rays_that_wait_for_it() {
    let source = source_of(9);
    let asked = asked(10, 2000);
    let loads = |suspended, on_missing| {
        let octree = open(source.clone(), 4, 1);
        let mut pool = octree.ray_pool(PoolOptions { suspended, ..PoolOptions::default() }).unwrap();
        let mut answers = Answers::with_capacity(2000);
        pool.closest_hits(&asked.closest, on_missing, &mut answers).unwrap();
        while pool.resume(&mut answers).unwrap() {}
        assert_eq!(answers.hits.len(), 2000);
        pool.counters().blocks_loaded
    };
    let depth_first = loads(4000, OnMissing::Load);
    let pooled = loads(4000, OnMissing::Wait { weight: 1 });
    let full = loads(0, OnMissing::Wait { weight: 1 });
    assert!(10 * pooled < depth_first, "{pooled} and {depth_first} loads");
    assert!(full <= depth_first + depth_first / 10);
}

/// Paths of which each hit leads to five shadow rays and one that goes on: with room kept for them the pool does not fill up, so that none
/// loads depth first.
#[test]
fn room_is_kept_for_the_children_of_answers() {
    const SUSPENDED: u32 = 400;
    let source = source_of(9);
    let run = |children| {
        let octree = open(source.clone(), 4, 1);
        let options = PoolOptions { suspended: SUSPENDED, children, ..PoolOptions::default() };
        let mut pool = octree.ray_pool(options).unwrap();
        let mut answers = Answers::with_capacity(6000);
        let mut first = asked(10, 2000).closest;
        let (mut found, mut blocked) = (BTreeMap::new(), BTreeMap::new());
        loop {
            if pool.wants_rays() && !first.is_empty() {
                let rest = first.split_off(first.len().min(2));
                pool.closest_hits(&first, OnMissing::Wait { weight: 4 }, &mut answers).unwrap();
                first = rest;
            } else if !pool.resume(&mut answers).unwrap() && first.is_empty() {
                break;
            }
            while !answers.hits.is_empty() {
                let (mut onward, mut shadows) = (Vec::new(), Vec::new());
                for (tag, hit) in answers.hits.drain(..) {
                    let (path, depth) = (tag % 2000, tag / 2000);
                    found.insert(tag, hit);
                    let Some(hit) = hit.filter(|_| depth < 6) else { continue };
                    let mut random = Random(tag + 1);
                    let mut ray = || Ray::new(hit.position(), random.vector(1.0));
                    shadows.extend((0..5).map(|lamp| AnyRequest { ray: ray(), tag: 8 * tag + lamp }));
                    let tag = 2000 * (depth + 1) + path;
                    onward.push(ClosestRequest { ray: ray(), after: None, tag });
                }
                pool.occluded(&shadows, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
                pool.closest_hits(&onward, OnMissing::Wait { weight: 4 }, &mut answers).unwrap();
            }
            blocked.extend(answers.occlusions.drain(..));
        }
        let counters = pool.counters();
        (found, blocked, counters.suspended_peak, counters.blocks_loaded)
    };
    // What is answered at once has children at once.
    let (found, blocked, peak, loads) = run(36);
    let (found_full, blocked_full, peak_full, loads_full) = run(0);
    assert!(found.len() > 4000 && found == found_full && blocked == blocked_full);
    let capacity = u64::from(SUSPENDED + SUSPENDED / 4 + 1);
    assert!(peak < capacity && peak_full == capacity, "{peak} and {peak_full} of {capacity}");
    assert!(loads < loads_full, "{loads} and {loads_full} loads");
}

#[test]
fn a_failed_load_is_an_error_and_not_a_miss() {
    let asked = asked(4, 200);
    let reference = open(source_of(3), 1000, 1);
    let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
    for loads in LOADS {
        let run = |seed, bit_flips| {
            let source = MemorySource::new(Arc::clone(source_of(3).bytes())).unwrap();
            let rates = FaultRates { bit_flips, ..FaultRates::default() };
            let octree = open(Arc::new(FaultySource::new(source, seed, rates)), 12, 1);
            let options = PoolOptions { suspended: 100, ignore: Some(ignored()), ..PoolOptions::default() };
            let run = |pool: &mut RayPool<'_>| (by_pool(pool, &asked, seed), pool.counters().blocks_loaded);
            with_pool(&octree, options, loads, 3, run)
        };
        let (whole, loads) = run(0, 0.0);
        assert!(whole.unwrap() == expected);
        // About as many runs fail as not.
        let rate = 0.7 / loads as f64;
        let mut failed = 0;
        for seed in 0..40 {
            match run(seed, rate).0 {
                Ok(found) => assert!(found == expected),
                Err(TraceError::Load(LoadError::Block(error))) => {
                    assert!((error.block.0 as usize) < reference.model().blocks.len());
                    failed += 1;
                }
                Err(error) => panic!("{error}"),
            }
        }
        assert!((5..36).contains(&failed), "{failed} of 40 failed");
    }
}

#[test]
fn a_pool_is_drawn_from_the_budget_and_given_back() {
    let source = source_of(1);
    let options = PoolOptions { suspended: 1000, ..PoolOptions::default() };
    let budget = MemoryBudget::new(Bytes::mib(64));
    let octree_options = OctreeOptions { slots_max: Some(2), ..OctreeOptions::default() };
    let octree = LazyOctree::open(source.clone(), &budget, octree_options).unwrap();
    let before = budget.used();
    let pool = octree.ray_pool(options.clone()).unwrap();
    let pool_bytes = RayPool::bytes_needed(&options, source.model().blocks.len());
    assert!(budget.used().0 - before.0 > pool_bytes.0 && pool_bytes.0 > 1000 * 200);
    drop(pool);
    assert_eq!(budget.used(), before);
    let rest = budget.reserve(Bytes(budget.available().0 - pool_bytes.0), "something else").unwrap();
    assert!(matches!(octree.ray_pool(options).map(|_| ()), Err(TraceError::Budget(_))));
    drop(rest);
    assert_eq!(budget.used(), before);
}

#[test]
fn a_loader_is_drawn_from_the_budget_and_given_back() {
    let source = source_of(1);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let octree_options = OctreeOptions { slots_max: Some(8), ..OctreeOptions::default() };
    let octree = LazyOctree::open(source.clone(), &budget, octree_options).unwrap();
    let before = budget.used();
    let options = LoaderOptions { loads_at_once: 3, loads_in_flight: 4 };
    let bytes = BlockLoader::bytes_needed(&options, &*source, 1);
    let loader = octree.block_loader(options).unwrap();
    assert_eq!(budget.used().0, before.0 + bytes.0);
    let pool = loader.ray_pool(PoolOptions::default()).unwrap();
    drop(loader);
    // The pool still has its handle.
    assert!(budget.used().0 > before.0 + bytes.0);
    drop(pool);
    assert_eq!(budget.used(), before);
    let rest = budget.reserve(Bytes(budget.available().0 - bytes.0 + 1), "something else").unwrap();
    assert!(matches!(octree.with_loader(1, options, |_| ()), Err(TraceError::Budget(_))));
    drop(rest);
    assert_eq!(octree.with_loader(1, options, |_| 7).unwrap(), 7);
    assert_eq!(budget.used(), before);
}

/// A pool that is dropped in the middle leaves nothing to another with the same loader.
#[test]
fn what_a_dropped_pool_asked_for_goes_nowhere() {
    let source = source_of(13);
    let asked = asked(14, 200);
    let expected = by_tracer(&mut open(source.clone(), 1000, 1).tracer().unwrap(), &asked, &ignored());
    let octree = open(source, 24, 1);
    let options = || PoolOptions { suspended: 1000, ignore: Some(ignored()), ..PoolOptions::default() };
    octree
        .with_loader(2, ahead(6), |loader| {
            for _ in 0..20 {
                let mut pool = loader.ray_pool(options()).unwrap();
                let mut answers = Answers::with_capacity(200);
                pool.closest_hits(&asked.closest, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
                pool.resume(&mut answers).unwrap();
                pool.resume(&mut answers).unwrap();
            }
            let mut pool = loader.ray_pool(options()).unwrap();
            assert!(by_pool(&mut pool, &asked, 2).unwrap() == expected);
        })
        .unwrap();
}
