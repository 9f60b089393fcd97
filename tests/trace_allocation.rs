//! Queries allocate nothing, hits and misses of the cache alike, from the first on. In a binary of its own because it
//! replaces the global allocator.

#[path = "support/compiling.rs"]
mod compiling;
#[path = "support/counting_allocator.rs"]
mod counting_allocator;
#[path = "support/mod.rs"]
mod support;

use std::ops::ControlFlow;
use std::sync::Arc;

use compiling::{Mesh, Place, compile_with};
use counting_allocator::calls;
use outcrop::MemoryBudget;
use outcrop::block::Codec;
use outcrop::compile::{CompileOptions, Control, PrecisionChoice};
use outcrop::geom::Ray;
use outcrop::octree::{LazyOctree, LeafLayout, OctreeOptions};
use outcrop::procedural::Terrain;
use outcrop::source::DiskSource;
use outcrop::trace::{MaterialSet, Occlusion};
use outcrop::units::{Bytes, MaterialId};
use support::numbers::Random;

#[test]
fn queries_allocate_nothing_whether_blocks_are_resident_or_not() {
    let mut random = Random(5);
    let mut ray = |_| Ray::new([random.signed(), random.signed(), 1.0], [0.2 * random.signed(), 0.1, -1.0]);
    let rays: Vec<Ray> = (0..300).map(&mut ray).collect();
    let mut hits = vec![None; rays.len()];
    let mut occlusions = vec![Occlusion::Clear; rays.len()];
    let after = vec![(0.9, outcrop::units::TriangleId(0)); rays.len()];
    let ignore: MaterialSet = [MaterialId(0)].into_iter().collect();
    let mesh = Mesh::of(&Terrain::new(100, 4).unwrap());
    let place = Place::new();
    for (codec, precision) in [
        (Codec::Lz4, PrecisionChoice::Auto),
        (Codec::Lzo, PrecisionChoice::Lattice { exponent: -40 }),
        (Codec::Raw, PrecisionChoice::Float32),
    ] {
        let options = CompileOptions { block_bytes: 8 << 10, codec, precision, ..Default::default() };
        compile_with(&mesh, &options, Bytes::mib(64), &place.output(), &mut |_| Control::Continue).unwrap();
        for (slots_max, leaf_layout) in
            [(2, LeafLayout::Expanded), (3, LeafLayout::Indexed), (1000, LeafLayout::Auto)]
        {
            let source = Arc::new(DiskSource::open(place.output()).unwrap());
            let options = OctreeOptions { slots_max: Some(slots_max), leaf_layout, ..Default::default() };
            let budget = MemoryBudget::new(Bytes::mib(256));
            let octree = LazyOctree::open(source, &budget, options).unwrap();
            let mut tracer = octree.tracer().unwrap();
            // Start-up is over with the tracer's first load.
            tracer.closest_hits(&rays[..1], &mut hits[..1]).unwrap();
            let before = tracer.counters();
            let made = calls(|| {
                for _ in 0..2 {
                    tracer.closest_hits(&rays, &mut hits).unwrap();
                    tracer.closest_hits_after(&rays, &after, &mut hits).unwrap();
                    tracer.occluded(&rays, None, &mut occlusions).unwrap();
                    tracer.occluded(&rays, Some(&ignore), &mut occlusions).unwrap();
                    tracer.all_hits(&rays, |_, _| ControlFlow::Continue(())).unwrap();
                    tracer.crossings(&rays, |_, _| ControlFlow::Continue(())).unwrap();
                    tracer.release_pins();
                }
            });
            assert_eq!(made, 0, "{codec:?}, {slots_max} slots");
            let loads = tracer.counters().blocks_loaded - before.blocks_loaded;
            let blocks = octree.model().blocks.len() as u64;
            assert!(if slots_max < 4 { loads > 2 * blocks } else { loads <= blocks && loads > 10 });
            assert!(hits.iter().any(Option::is_some) && occlusions.contains(&Occlusion::Filtered));
        }
    }
}
