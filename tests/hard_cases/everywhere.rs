//! A case through the whole library: every way of storing, caching and tracing it gives the hits of brute force, bit
//! for bit, and brute force is right by exact integers.

use std::collections::HashMap;
use std::sync::Arc;

use outcrop::compile::{CompileOptions, PrecisionChoice};
use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LazyOctree, LeafLayout, OctreeOptions, Tier};
use outcrop::simd::SimdLevel;
use outcrop::source::MemorySource;
use outcrop::trace::{Hit, Occlusion};
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

use crate::cases::{Case, Random};
use crate::compiling::{self, Mesh, Vertices};
use crate::support;
use crate::truth::{Triangle, Truth, Verdict};

/// How far the certified `t` may be off.
pub const TOLERANCE: f64 = 1.0 / (1u64 << 40) as f64;

/// The instruction sets; one that the CPU lacks counts as portable.
pub const LEVELS: [SimdLevel; 2] = [SimdLevel::Portable, SimdLevel::Avx2];

/// The case compiled as files are.
pub fn source(case: &Case, block_bytes: u32) -> Arc<dyn BlockSource> {
    Arc::new(MemorySource::new(compiled_bytes(case, block_bytes)).unwrap())
}

/// The compiled file of a case.
pub fn compiled_bytes(case: &Case, block_bytes: u32) -> Vec<u8> {
    let mut places: HashMap<[u64; 3], u32> = HashMap::new();
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    let mut index = |p: [f64; 3]| {
        *places.entry(p.map(f64::to_bits)).or_insert_with(|| {
            vertices.push(p);
            vertices.len() as u32 - 1
        })
    };
    let triangles = case.triangles.iter().map(|triangle| triangle.map(&mut index)).collect();
    let (vertices, precision) = match case.precision {
        Precision::Float32 => (
            Vertices::Float32(vertices.iter().map(|p| p.map(|x| x as f32)).collect()),
            PrecisionChoice::Float32,
        ),
        Precision::Lattice(lattice) => {
            (Vertices::Float64(vertices), PrecisionChoice::Lattice { exponent: lattice.exponent })
        }
    };
    let options = CompileOptions { block_bytes, precision, ..Default::default() };
    compiling::compile(&Mesh::new(vertices, triangles), &options, Bytes::mib(64)).1
}

pub fn open(source: &Arc<dyn BlockSource>, options: OctreeOptions) -> LazyOctree {
    LazyOctree::open(Arc::clone(source), &MemoryBudget::new(Bytes::mib(128)), options).unwrap()
}

/// Closest hits, traced by as many tracers as the octree allows, each with its share of the rays.
pub fn closest(octree: &LazyOctree, rays: &[Ray]) -> Vec<Option<Hit>> {
    let mut hits = vec![None; rays.len()];
    let share = rays.len().div_ceil(octree.tracers_max() as usize).max(1);
    std::thread::scope(|scope| {
        for (rays, hits) in rays.chunks(share).zip(hits.chunks_mut(share)) {
            scope.spawn(|| octree.tracer().unwrap().closest_hits(rays, hits).unwrap());
        }
    });
    hits
}

pub fn occluded(octree: &LazyOctree, rays: &[Ray]) -> Vec<bool> {
    let mut occlusions = vec![Occlusion::Clear; rays.len()];
    octree.tracer().unwrap().occluded(rays, None, &mut occlusions).unwrap();
    occlusions.into_iter().map(|occlusion| occlusion == Occlusion::Blocked).collect()
}

/// What was found: `t`, triangle and weights.
type Found = Option<(f64, u64, f64, f64)>;

fn found(hits: &[Option<Hit>]) -> Vec<Found> {
    hits.iter().map(|hit| hit.map(|hit| (hit.t, hit.triangle.0, hit.u, hit.v))).collect()
}

/// The least hit of each ray by brute force with the scalar test, asserted to be right by exact integers.
pub fn expected(case: &Case) -> Vec<Option<(f64, u64)>> {
    let mut hit_count = 0;
    let expected = case.rays.iter().map(|ray| {
        let least = support::all_hits(&case.triangles, ray).first().map(|(t, id)| (*t, id.0));
        let truth = Truth::of(ray, &case.triangles);
        let found = least.map(|(t, id)| (t, id as usize));
        let verdict = truth.judge(found, &case.triangles, TOLERANCE);
        assert_eq!(verdict, Verdict::Right, "{}: {ray:?}: {found:?}", case.name);
        hit_count += usize::from(least.is_some());
        least
    });
    let expected: Vec<_> = expected.collect();
    assert!(hit_count > 0, "{}: nothing is hit, so nothing is tested", case.name);
    println!("{}: {} triangles, {} rays, {hit_count} hits", case.name, case.triangles.len(), case.rays.len());
    expected
}

/// Asserts that the case's hits are right and the same for blocks of any size down to single triangles, both layouts,
/// all instruction sets, caches down to one slot, several tracers, `Certified` and `Exact`; and that a shuffled source
/// gives the same `t`.
pub fn check(case: &Case) {
    let expected = expected(case);
    let scattered = |i: usize| (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32;
    let by_x = |i: usize| case.triangles[i][0][0].to_bits() >> 40;
    let compiled: Arc<dyn BlockSource> = support::compile(&case.triangles, case.precision, 40, by_x);
    // A block of its own for each triangle of small models.
    let tiny = case.triangles.len().div_ceil(250);
    let shattered: Arc<dyn BlockSource> = support::compile(&case.triangles, case.precision, tiny, scattered);
    let as_file = source(case, 4 << 10);
    let [portable, avx2] = LEVELS;
    let ways = [
        (&as_file, LeafLayout::Expanded, avx2, None, 1, Tier::Certified),
        (&as_file, LeafLayout::Indexed, portable, None, 3, Tier::Certified),
        (&compiled, LeafLayout::Indexed, avx2, Some(3), 3, Tier::Certified),
        (&compiled, LeafLayout::Expanded, portable, Some(1), 1, Tier::Certified),
        (&shattered, LeafLayout::Expanded, avx2, None, 2, Tier::Certified),
        (&shattered, LeafLayout::Indexed, portable, None, 1, Tier::Certified),
        (&compiled, LeafLayout::Expanded, avx2, None, 1, Tier::Exact),
    ];
    let mut first: Option<Vec<Found>> = None;
    for (source, leaf_layout, level, slots_max, tracers_max, tier) in ways {
        let options = OctreeOptions {
            leaf_layout,
            simd: Some(level),
            slots_max,
            tracers_max,
            tier,
            ..Default::default()
        };
        let octree = open(source, options);
        // With one slot each ray loads its blocks: a few are enough.
        let rays = if slots_max.is_some() { &case.rays[..case.rays.len().min(300)] } else { &case.rays };
        let hits = found(&closest(&octree, rays));
        for (index, (hit, expected)) in hits.iter().zip(&expected).enumerate() {
            let hit = hit.map(|(t, id, ..)| (t, id));
            assert_eq!(hit, *expected, "{}: ray {index} {:?}, {options:?}", case.name, rays[index]);
        }
        let first = first.get_or_insert_with(|| hits.clone());
        assert_eq!(hits[..], first[..rays.len()], "{}: weights, {options:?}", case.name);
        for (index, (blocked, expected)) in occluded(&octree, rays).into_iter().zip(&expected).enumerate() {
            assert_eq!(blocked, expected.is_some(), "{}: shadow ray {index}, {options:?}", case.name);
        }
    }
    check_shuffled(case, &expected);
}

/// The same triangles in another order: other numbers, and the same `t`. (`t` of one triangle does not depend on its
/// number, so the least one does not either.)
fn check_shuffled(case: &Case, expected: &[Option<(f64, u64)>]) {
    let mut random = Random(99);
    let mut order: Vec<usize> = (0..case.triangles.len()).collect();
    for i in (1..order.len()).rev() {
        order.swap(i, random.index(i + 1));
    }
    let triangles: Vec<Triangle> = order.iter().map(|i| case.triangles[*i]).collect();
    let shuffled = Case { name: case.name, precision: case.precision, triangles, rays: Vec::new() };
    let octree = open(&source(&shuffled, 4 << 10), OctreeOptions::default());
    for (hit, expected) in closest(&octree, &case.rays).iter().zip(expected) {
        assert_eq!(hit.map(|hit| hit.t), expected.map(|(t, _)| t), "{}: shuffled", case.name);
    }
}
