//! Only blocks that a ray may meet are ever loaded and built, and each once while the slots suffice.

#[path = "support/compiling.rs"]
mod compiling;
#[path = "support/mod.rs"]
mod support;

use std::sync::{Arc, Mutex};

use compiling::{Mesh, compile};
use outcrop::compile::CompileOptions;
use outcrop::error::SourceError;
use outcrop::geom::{Aabb, Ray};
use outcrop::model::Model;
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::procedural::Terrain;
use outcrop::source::MemorySource;
use outcrop::trace::Occlusion;
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};
use support::may_meet;
use support::numbers::Random;

/// Notes which blocks are read.
struct Recording {
    source: MemorySource,
    reads: Mutex<Vec<u32>>,
}

impl Recording {
    /// A terrain in many small blocks.
    fn terrain() -> Arc<Recording> {
        let mesh = Mesh::of(&Terrain::new(100, 4).unwrap());
        let options = CompileOptions { block_bytes: 4 << 10, ..Default::default() };
        let (report, bytes) = compile(&mesh, &options, Bytes::mib(64));
        assert!(report.blocks > 100);
        Arc::new(Recording { source: MemorySource::new(bytes).unwrap(), reads: Mutex::new(Vec::new()) })
    }

    /// The blocks read since the last call, in order of number.
    fn take(&self) -> Vec<u32> {
        let mut reads = std::mem::take(&mut *self.reads.lock().unwrap());
        reads.sort_unstable();
        reads
    }
}

impl BlockSource for Recording {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        self.reads.lock().unwrap().push(block.0);
        self.source.read_block(block, into)
    }
}

fn open(source: &Arc<Recording>, slots_max: Option<u32>) -> LazyOctree {
    let source: Arc<dyn BlockSource> = Arc::clone(source) as _;
    let options = OctreeOptions { slots_max, ..Default::default() };
    LazyOctree::open(source, &MemoryBudget::new(Bytes::mib(256)), options).unwrap()
}

/// The blocks of which some ray may meet a sub-box.
fn reachable(model: &Model, rays: &[Ray]) -> Vec<u32> {
    let is_met = |index: &u32| {
        let entry = &model.blocks[*index as usize];
        let boxes: Vec<Aabb> = entry.sub_boxes().collect();
        let meets = |ray: &Ray, part: &Aabb| may_meet(ray, part, 1e-5);
        rays.iter().any(|ray| meets(ray, &entry.bounds) && boxes.iter().any(|part| meets(ray, part)))
    };
    (0..model.blocks.len() as u32).filter(is_met).collect()
}

/// Slanted rays from above onto the part of the terrain with x and y in -1 .. 0.
fn rays_onto_a_quarter(count: usize) -> Vec<Ray> {
    let mut random = Random(3);
    let ray = |_| {
        let target = [0.4 * random.signed() - 0.5, 0.4 * random.signed() - 0.5, 0.0];
        let slant = [0.3 * random.signed(), 0.3 * random.signed(), -1.0];
        Ray::new([0, 1, 2].map(|axis| target[axis] - slant[axis]), slant)
    };
    (0..count).map(ray).collect()
}

#[test]
fn only_blocks_that_a_ray_may_meet_are_loaded_and_each_once() {
    let source = Recording::terrain();
    let rays = rays_onto_a_quarter(400);
    let reachable = reachable(source.model(), &rays);
    let block_count = source.model().blocks.len();
    let octree = open(&source, None);
    assert_eq!(octree.cache().slot_count() as usize, block_count, "slots suffice");
    let mut tracer = octree.tracer().unwrap();
    assert_eq!(source.take(), [0; 0], "opening reads no block");

    let mut hits = vec![None; rays.len()];
    tracer.closest_hits(&rays, &mut hits).unwrap();
    let loaded = source.take();
    assert!(hits.iter().all(Option::is_some));
    assert!(loaded.is_sorted_by(|a, b| a < b), "each is loaded once");
    assert!(
        loaded.iter().all(|block| reachable.binary_search(block).is_ok()),
        "a block is loaded for nothing"
    );
    assert!(2 * loaded.len() < block_count, "{} of {block_count} are loaded", loaded.len());
    // At the least, the blocks of the hits.
    assert!(loaded.len() >= 20, "{} of {} within reach", loaded.len(), reachable.len());
    assert_eq!(octree.blocks_touched(), loaded.len() as u64);
    assert_eq!(tracer.counters().blocks_loaded, loaded.len() as u64);
    assert_eq!(octree.cache().stats().misses, loaded.len() as u64);

    tracer.closest_hits(&rays, &mut hits).unwrap();
    assert_eq!(source.take(), [0; 0], "what is resident is not loaded again");
    let mut occlusions = vec![Occlusion::Clear; rays.len()];
    tracer.occluded(&rays, None, &mut occlusions).unwrap();
    let more = source.take();
    assert!(more.iter().all(|block| reachable.binary_search(block).is_ok() && !loaded.contains(block)));
}

#[test]
fn a_ray_loads_no_block_behind_its_hit_or_its_end() {
    let source = Recording::terrain();
    for ray in rays_onto_a_quarter(60) {
        let octree = open(&source, None);
        let mut tracer = octree.tracer().unwrap();
        let hit = tracer.closest_hit(&ray).unwrap().unwrap();
        source.take();
        let octree = open(&source, None);
        let mut tracer = octree.tracer().unwrap();
        let ended = Ray { t_max: hit.t * (1.0 + 1e-12), ..ray };
        assert_eq!(tracer.closest_hit(&ended).unwrap().map(|hit| hit.triangle), Some(hit.triangle));
        let reachable = reachable(source.model(), &[ended]);
        assert!(source.take().iter().all(|block| reachable.binary_search(block).is_ok()));
    }
}

#[test]
fn rays_that_miss_the_model_load_nothing() {
    let source = Recording::terrain();
    let octree = open(&source, None);
    let mut tracer = octree.tracer().unwrap();
    let away =
        rays_onto_a_quarter(50).into_iter().map(|ray| Ray { direction: ray.direction.map(|x| -x), ..ray });
    let short = rays_onto_a_quarter(50).into_iter().map(|ray| Ray { t_max: 0.5, ..ray });
    let beside = [Ray::new([1.1, 0.0, 5.0], [0.0, 0.0, -1.0]), Ray::new([-5.0, 0.0, 0.6], [1.0, 0.0, 0.0])];
    let rays: Vec<Ray> = away.chain(short).chain(beside).collect();
    let mut hits = vec![None; rays.len()];
    tracer.closest_hits(&rays, &mut hits).unwrap();
    let mut occlusions = vec![Occlusion::Blocked; rays.len()];
    tracer.occluded(&rays, None, &mut occlusions).unwrap();
    assert!(hits.iter().all(Option::is_none));
    assert!(occlusions.iter().all(|occlusion| *occlusion == Occlusion::Clear));
    assert_eq!(source.take(), [0; 0]);
    assert_eq!(octree.blocks_touched(), 0);
}

#[test]
fn with_one_slot_blocks_are_loaded_again_but_never_others() {
    let source = Recording::terrain();
    let rays = rays_onto_a_quarter(100);
    let reachable = reachable(source.model(), &rays);
    let mut all = [vec![None; rays.len()], vec![None; rays.len()]];
    for (hits, slots_max) in all.iter_mut().zip([None, Some(1)]) {
        let octree = open(&source, slots_max);
        octree.tracer().unwrap().closest_hits(&rays, hits).unwrap();
        let mut loaded = source.take();
        let load_count = loaded.len();
        loaded.dedup();
        assert_eq!(octree.blocks_touched(), loaded.len() as u64);
        assert_eq!(load_count > loaded.len(), slots_max.is_some());
        assert!(loaded.iter().all(|block| reachable.binary_search(block).is_ok()));
    }
    assert_eq!(all[0], all[1]);
}
