//! Queries of the gears: camera rays, shadow rays and bounces over resident blocks, and what loading a block costs.

#[path = "../tests/support/compiled.rs"]
mod compiled;
#[path = "support/rays.rs"]
mod rays;

use std::hint::black_box;
use std::ops::ControlFlow;
use std::sync::Arc;

use compiled::compiled;
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use outcrop::compile::CompileOptions;
use outcrop::geom::Ray;
use outcrop::octree::{LeafLayout, OctreeOptions, Tier};
use outcrop::procedural::{Gears, Needles};
use outcrop::source::MemorySource;
use outcrop::trace::{Crossing, Hit, Occlusion, Tracer};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use rays::camera_ray;
use rays::numbers::{Random, dot, unit};

/// Rays per axis of the camera's square.
const SIDE: u32 = 256;
const LIGHT: [f64; 3] = [2.0, 4.0, 4.0];

/// The gears with eight wheels, 219,744 triangles.
fn gears() -> Arc<MemorySource> {
    let gears = Gears::new(2).expect("n is small");
    Arc::new(MemorySource::new(compiled(&gears, &CompileOptions::default())).expect("a whole file"))
}

fn open(source: &Arc<MemorySource>, options: OctreeOptions) -> LazyOctree {
    let source = Arc::clone(source);
    LazyOctree::open(source, &MemoryBudget::new(Bytes::mib(512)), options).expect("the budget is ample")
}

/// The standard view, row by row.
fn camera_rays() -> Vec<Ray> {
    (0..SIDE * SIDE).map(|i| camera_ray([i % SIDE, i / SIDE], SIDE)).collect()
}

/// From each hit to the light.
fn shadow_rays(hits: &[Hit]) -> Vec<Ray> {
    let ray = |hit: &Hit| {
        let origin = hit.position();
        let direction = [0, 1, 2].map(|axis| LIGHT[axis] - origin[axis]);
        Ray { t_min: 1e-6, t_max: 1.0, ..Ray::new(origin, direction) }
    };
    hits.iter().map(ray).collect()
}

/// From each hit to the camera's side of its surface, in a direction that has little to do with its neighbours'.
fn bounces(hits: &[Hit], rays: &[Ray]) -> Vec<Ray> {
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    let mut ray = |(hit, from): (&Hit, &Ray)| {
        let normal = unit(hit.normal());
        let side = -dot(normal, from.direction).signum();
        let any = loop {
            let any = [random(), random(), random()];
            if dot(any, any) < 1.0 {
                break any;
            }
        };
        let direction = [0, 1, 2].map(|axis| 1.01 * side * normal[axis] + any[axis]);
        Ray { t_min: 1e-6, ..Ray::new(hit.position(), direction) }
    };
    hits.iter().zip(rays).map(&mut ray).collect()
}

fn closest(tracer: &mut Tracer<'_>, rays: &[Ray], hits: &mut Vec<Option<Hit>>) {
    hits.resize(rays.len(), None);
    tracer.closest_hits(rays, hits).expect("the model is sound");
}

fn queries(criterion: &mut Criterion) {
    let source = gears();
    let camera = camera_rays();
    let certified = open(&source, OctreeOptions::default());
    let mut hits = Vec::new();
    closest(&mut certified.tracer().expect("the budget is ample"), &camera, &mut hits);
    let (met, meeting): (Vec<Hit>, Vec<Ray>) =
        hits.iter().zip(&camera).filter_map(|(hit, ray)| hit.map(|hit| (hit, *ray))).unzip();
    assert!(2 * met.len() > camera.len(), "the gears fill most of the picture");
    let (shadows, bounces) = (shadow_rays(&met), bounces(&met, &meeting));
    drop(certified);

    let kinds = [
        (Tier::Certified, LeafLayout::Expanded),
        (Tier::Certified, LeafLayout::Indexed),
        (Tier::Exact, LeafLayout::Expanded),
        (Tier::Fast, LeafLayout::Expanded),
        (Tier::Watertight, LeafLayout::Expanded),
        (Tier::Double, LeafLayout::Expanded),
    ];
    let octrees = kinds.map(|(tier, leaf_layout)| {
        open(&source, OctreeOptions { tier, leaf_layout, ..OctreeOptions::default() })
    });
    // All answers are compared before any is timed; this loads the blocks, too.
    let mut occlusions = vec![Occlusion::Clear; shadows.len()];
    let counts = octrees.each_ref().map(|octree| {
        let mut tracer = octree.tracer().expect("the budget is ample");
        let closest_counts = [&camera, &bounces].map(|rays| {
            closest(&mut tracer, rays, &mut hits);
            hits.iter().flatten().count()
        });
        tracer.occluded(&shadows, None, &mut occlusions).expect("the model is sound");
        let blocked = occlusions.iter().filter(|occlusion| **occlusion == Occlusion::Blocked).count();
        [closest_counts[0], closest_counts[1], blocked]
    });
    assert_eq!(counts[0], counts[1], "certified answers do not depend on the layout");
    assert_eq!(counts[0], counts[2], "exact answers are the certified ones");
    for others in &counts[3..] {
        for (certified, other) in counts[0].iter().zip(others) {
            assert!(certified.abs_diff(*other) < 1 + camera.len() / 100, "{certified} and {other} hits");
        }
    }

    for ((tier, layout), octree) in kinds.iter().zip(&octrees) {
        let mut tracer = octree.tracer().expect("the budget is ample");
        let mut group = criterion.benchmark_group(format!("trace/{tier:?}/{layout:?}"));
        for (name, rays) in [("closest camera", &camera), ("closest bounce", &bounces)] {
            group.throughput(Throughput::Elements(rays.len() as u64));
            group.bench_function(name, |bencher| {
                bencher.iter(|| closest(&mut tracer, black_box(rays), &mut hits));
            });
        }
        group.throughput(Throughput::Elements(shadows.len() as u64));
        group.bench_function("any shadow", |bencher| {
            bencher.iter(|| tracer.occluded(black_box(&shadows), None, &mut occlusions));
        });
        assert_eq!(tracer.counters().blocks_loaded, 0, "all blocks stay resident");
    }
}

/// Needles across each other, whose boxes tell little: nearly all of the work of a ray is testing triangles, of which
/// each ray hits few. Per triangle tested.
fn triangles(criterion: &mut Criterion) {
    let needles = Needles::new(4000, 1e-4, 1).expect("the numbers make sense");
    let source =
        Arc::new(MemorySource::new(compiled(&needles, &CompileOptions::default())).expect("a whole file"));
    let bounds = source.model().bounds;
    let [center, reach] = [bounds.center(), bounds.extent()];
    let mut random = Random(2);
    let mut place = |size: f64| {
        let place = random.vector(size);
        [0, 1, 2].map(|axis| center[axis] + reach[axis] * place[axis])
    };
    let rays: Vec<Ray> = (0..4096)
        .map(|_| {
            let (origin, target) = (place(2.0), place(0.2));
            Ray::new(origin, [0, 1, 2].map(|axis| target[axis] - origin[axis]))
        })
        .collect();
    let mut group = criterion.benchmark_group("trace/per triangle");
    let mut counts = Vec::new();
    for tier in Tier::ALL {
        let octree = open(&source, OctreeOptions { tier, ..OctreeOptions::default() });
        let mut tracer = octree.tracer().expect("the budget is ample");
        let mut hits = Vec::new();
        closest(&mut tracer, &rays, &mut hits);
        let before = tracer.counters();
        closest(&mut tracer, &rays, &mut hits);
        let tested = tracer.counters().triangle_tests - before.triangle_tests;
        assert!(tested > 100 * rays.len() as u64, "triangles are what takes the time: {tested}");
        counts.push(hits.iter().flatten().count());
        group.throughput(Throughput::Elements(tested));
        group.bench_function(tier.name(), |bencher| {
            bencher.iter(|| closest(&mut tracer, black_box(&rays), &mut hits));
        });
    }
    let [.., certified, exact] = counts[..] else { unreachable!("five tiers") };
    assert!(certified == exact && certified > 0, "{counts:?} hits");
}

/// Reading, decoding and building: the first ray into a block of an octree with one slot.
fn loads(criterion: &mut Criterion) {
    let source = gears();
    let mut group = criterion.benchmark_group("trace/load");
    for layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
        let options = OctreeOptions { leaf_layout: layout, slots_max: Some(1), ..OctreeOptions::default() };
        let octree = open(&source, options);
        let mut tracer = octree.tracer().expect("the budget is ample");
        // Two rays that need different blocks evict each other's.
        let away = [[-0.5, -0.5], [0.5, 0.5]];
        let rays = away.map(|[x, y]| Ray::new([x, y, 3.0], [1e-3, 1e-3, -1.0]));
        let mut hits = [None; 2];
        tracer.closest_hits(&rays, &mut hits).expect("the model is sound");
        let before = tracer.counters();
        tracer.closest_hits(&rays, &mut hits).expect("the model is sound");
        let after = tracer.counters();
        let blocks = after.blocks_loaded - before.blocks_loaded;
        assert!(blocks >= 2 && hits[0].is_some() && hits[1].is_some(), "every batch loads");
        println!(
            "{layout:?}: {blocks} blocks of {} triangles together for each batch",
            after.triangles_decoded - before.triangles_decoded
        );
        group.throughput(Throughput::Elements(blocks));
        group.bench_function(format!("{layout:?}"), |bencher| {
            bencher.iter(|| tracer.closest_hits(black_box(&rays), &mut hits));
        });
    }
}

/// All hits of camera rays: one query after the other for the next hit, in one traversal, and without the doubles at edges.
fn all_hits(criterion: &mut Criterion) {
    let source = gears();
    let camera = camera_rays();
    let rays: Vec<Ray> = camera.iter().step_by(4).copied().collect();
    let octree = open(&source, OctreeOptions::default());
    let mut tracer = octree.tracer().expect("the budget is ample");
    // The answers are compared before they are timed; this loads the blocks, too.
    let walked = walk(&mut tracer, &rays);
    let before = tracer.counters();
    let again = walk(&mut tracer, &rays);
    let between = tracer.counters();
    let gathered = gather(&mut tracer, &rays);
    let after = tracer.counters();
    assert!(
        walked == gathered && walked == again && walked.0 > rays.len() as u64,
        "{walked:?}, {gathered:?}"
    );
    println!(
        "{} hits of {} rays; block visits: {} one after the other, {} together",
        gathered.0,
        rays.len(),
        between.block_visits - before.block_visits,
        after.block_visits - between.block_visits
    );
    for (unit, count) in [("ray", rays.len() as u64), ("hit", gathered.0)] {
        let mut group = criterion.benchmark_group(format!("trace/all hits by {unit}"));
        group.throughput(Throughput::Elements(count));
        group.bench_function("closest_hits_after", |bencher| {
            bencher.iter(|| walk(&mut tracer, black_box(&rays)))
        });
        group.bench_function("all_hits", |bencher| bencher.iter(|| gather(&mut tracer, black_box(&rays))));
        group.bench_function("crossings", |bencher| {
            bencher.iter(|| {
                let mut count = 0;
                let visit = |_: usize, _: &Crossing| {
                    count += 1;
                    ControlFlow::Continue(())
                };
                tracer.crossings(black_box(&rays), visit).expect("the model is sound");
                count
            });
        });
    }
}

/// How many hits, and a sum over which and where they are.
type Digest = (u64, u64);

fn digest(into: &mut Digest, hit: &Hit) {
    into.0 += 1;
    into.1 = into.1.rotate_left(5).wrapping_add(hit.t.to_bits() ^ hit.triangle.0);
}

/// The naive way.
fn walk(tracer: &mut Tracer<'_>, rays: &[Ray]) -> Digest {
    let mut all = (0, 0);
    for ray in rays {
        let mut hit = tracer.closest_hit(ray).expect("the model is sound");
        while let Some(found) = hit {
            digest(&mut all, &found);
            let mut next = [None];
            tracer
                .closest_hits_after(&[*ray], &[(found.t, found.triangle)], &mut next)
                .expect("the model is sound");
            hit = next[0];
        }
    }
    all
}

fn gather(tracer: &mut Tracer<'_>, rays: &[Ray]) -> Digest {
    let mut all = (0, 0);
    let visit = |_: usize, hit: &Hit| {
        digest(&mut all, hit);
        ControlFlow::Continue(())
    };
    tracer.all_hits(rays, visit).expect("the model is sound");
    all
}

criterion_group! { name = benches; config = Criterion::default().sample_size(10); targets = queries, triangles, all_hits, loads }
criterion_main!(benches);
