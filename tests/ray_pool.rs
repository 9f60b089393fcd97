//! A pool of suspended rays answers what a tracer answers, whatever its size, the slots, the order and the threads.

#[path = "support/mod.rs"]
mod support;

use std::collections::BTreeMap;
use std::sync::Arc;

use outcrop::error::{LoadError, TraceError};
use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::source::MemorySource;
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::trace::{
    Answers, AnyRequest, ClosestRequest, Hit, MaterialSet, Occlusion, OnMissing, PoolOptions, RayPool, Tracer,
};
use outcrop::units::{Bytes, MaterialId, TriangleId};
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

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    #[test]
    fn answers_are_the_tracers(
        seed in any::<u64>(),
        slots in 1u32..40,
        suspended in prop::sample::select(vec![0u32, 1, 7, 60, 1000]),
    ) {
        let source = source_of(seed);
        let asked = asked(seed ^ 1, 200);
        let reference = open(source.clone(), 1000, 1);
        let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
        prop_assert!(expected.0.values().flatten().count() > 20);
        let octree = open(source, slots, 1);
        let options = PoolOptions { suspended, ignore: Some(ignored()) };
        let mut pool = octree.ray_pool(options).unwrap();
        for round in 0..2 {
            let found = by_pool(&mut pool, &asked, seed ^ round).unwrap();
            prop_assert!(found == expected);
        }
        let counters = pool.counters();
        prop_assert_eq!(counters.rays, 800);
        prop_assert!(counters.suspended_peak <= u64::from(suspended + suspended / 4 + 1));
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
                    let options = PoolOptions { suspended, ignore: Some(ignored()) };
                    let mut pool = octree.ray_pool(options).unwrap();
                    assert!(by_pool(&mut pool, asked, thread).unwrap() == *expected);
                });
            }
        });
    }
}

/// What waiting is for: far fewer loads than depth first.
#[test]
fn one_load_serves_all_rays_that_wait_for_it() {
    let source = source_of(9);
    let asked = asked(10, 2000);
    let loads = |suspended, on_missing| {
        let octree = open(source.clone(), 4, 1);
        let mut pool = octree.ray_pool(PoolOptions { suspended, ignore: None }).unwrap();
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

#[test]
fn a_failed_load_is_an_error_and_not_a_miss() {
    let asked = asked(4, 200);
    let reference = open(source_of(3), 1000, 1);
    let expected = by_tracer(&mut reference.tracer().unwrap(), &asked, &ignored());
    let run = |seed, bit_flips| {
        let source = MemorySource::new(Arc::clone(source_of(3).bytes())).unwrap();
        let rates = FaultRates { bit_flips, ..FaultRates::default() };
        let octree = open(Arc::new(FaultySource::new(source, seed, rates)), 6, 1);
        let mut pool = octree.ray_pool(PoolOptions { suspended: 100, ignore: Some(ignored()) }).unwrap();
        let found = by_pool(&mut pool, &asked, seed);
        (found, pool.counters().blocks_loaded)
    };
    let (whole, loads) = run(0, 0.0);
    assert!(whole.unwrap() == expected);
    // About as many runs fail as not.
    let rate = 0.7 / loads as f64;
    let mut failed = 0;
    for seed in 0..40 {
        match run(seed, rate).0 {
            Ok(found) => assert!(found == expected),
            Err(TraceError::Load(LoadError::Block(_))) => failed += 1,
            Err(error) => panic!("{error}"),
        }
    }
    assert!((5..36).contains(&failed), "{failed} of 40 failed");
}

#[test]
fn a_pool_is_drawn_from_the_budget_and_given_back() {
    let source = source_of(1);
    let options = PoolOptions { suspended: 1000, ignore: None };
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
