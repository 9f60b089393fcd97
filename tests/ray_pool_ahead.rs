//! What a ray that waits for a block has looked at behind it: what was there need not be there again, what is missing is loaded only if
//! nothing nearer is hit, and lists of missing blocks may be longer than there is room for.

#[path = "support/mod.rs"]
mod support;

use std::sync::Arc;

use outcrop::MemoryBudget;
use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LazyOctree, OctreeOptions};
use outcrop::source::MemorySource;
use outcrop::trace::{Answers, AnyRequest, ClosestRequest, Hit, Occlusion, OnMissing, PoolOptions, RayPool};
use outcrop::units::{Bytes, TriangleId};
use support::{Triangles, compile};

/// Triangles of a block, at one height.
const TRIANGLES: usize = 16;

/// Blocks one below the other, at the heights 0, -1, -2, ...: gates, whose boxes a ray down the middle meets but no triangle, and walls,
/// which it hits.
fn column(walls: &[bool]) -> Arc<MemorySource> {
    let mut triangles: Triangles = Vec::new();
    for (level, is_wall) in walls.iter().enumerate() {
        for index in 0..TRIANGLES {
            let at = |x: f64, y: f64| [x, y, -(level as f64)];
            triangles.push(match (is_wall, index % 2) {
                (true, 0) => [at(-1.0, -1.0), at(3.0, -1.0), at(-1.0, 3.0)],
                // In opposite corners by turns, so that each sub-box spans the middle.
                (_, 0) => [at(-1.0, -1.0), at(-0.9, -1.0), at(-1.0, -0.9)],
                _ => [at(1.0, 1.0), at(0.9, 1.0), at(1.0, 0.9)],
            });
        }
    }
    let exact = triangles.iter().map(|triangle| triangle.map(|corner| corner.map(|x| f64::from(x as f32))));
    compile(&exact.collect::<Triangles>(), Precision::Float32, TRIANGLES, |i| (i / TRIANGLES) as u64)
}

fn open(source: &Arc<MemorySource>, slots: u32) -> LazyOctree {
    let options = OctreeOptions { slots_max: Some(slots), tracers_max: 1, ..OctreeOptions::default() };
    LazyOctree::open(source.clone(), &MemoryBudget::new(Bytes::mib(64)), options).unwrap()
}

fn down() -> Ray {
    Ray::new([0.0, 0.0, 1.0], [0.0, 0.0, -1.0])
}

/// Up to the lowest level, and to no other.
fn up_to(level: usize) -> Ray {
    Ray { t_max: 0.75, ..Ray::new([0.0, 0.0, -(level as f64) - 0.5], [0.0, 0.0, 1.0]) }
}

fn ask(pool: &mut RayPool<'_>, ray: Ray, on_missing: OnMissing, answers: &mut Answers) {
    pool.closest_hits(&[ClosestRequest { ray, after: None, tag: 0 }], on_missing, answers).unwrap();
}

fn ask_any(pool: &mut RayPool<'_>, ray: Ray, on_missing: OnMissing, answers: &mut Answers) {
    pool.occluded(&[AnyRequest { ray, tag: 0 }], on_missing, answers).unwrap();
}

/// Runs what waits to its end; the one answer.
fn hit_at_the_end(pool: &mut RayPool<'_>, answers: &mut Answers) -> Option<Hit> {
    while pool.resume(answers).unwrap() {}
    hit_of(answers)
}

fn hit_of(answers: &mut Answers) -> Option<Hit> {
    assert_eq!(answers.hits.len(), 1);
    answers.hits.pop().unwrap().1
}

const WAIT: OnMissing = OnMissing::Wait { weight: 1 };

#[test]
fn what_was_there_need_not_be_there_again() {
    // Two gates, a wall, and two walls more that are there to take its slot.
    let source = column(&[false, false, true, true, true]);
    let octree = open(&source, 2);
    let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
    let mut answers = Answers::with_capacity(1);
    ask(&mut pool, up_to(2), OnMissing::Load, &mut answers);
    assert!(hit_of(&mut answers).is_some());
    ask(&mut pool, down(), WAIT, &mut answers);
    assert_eq!((pool.suspended_count(), pool.counters().blocks_loaded), (1, 1));
    for level in [3, 4] {
        ask(&mut pool, up_to(level), OnMissing::Load, &mut answers);
        assert!(hit_of(&mut answers).is_some());
    }
    assert_eq!(pool.counters().blocks_loaded, 3);
    let hit = hit_at_the_end(&mut pool, &mut answers).unwrap();
    assert_eq!((hit.t, hit.triangle), (3.0, TriangleId(2 * TRIANGLES as u64)));
    // The two gates, once each. Nothing behind the wall was waited for.
    assert_eq!(pool.counters().blocks_loaded, 5);
}

#[test]
fn what_lies_behind_a_hit_is_not_loaded() {
    let source = column(&[false, true, false, true, false]);
    let octree = open(&source, 5);
    let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
    let mut answers = Answers::with_capacity(1);
    ask(&mut pool, down(), WAIT, &mut answers);
    assert_eq!(hit_at_the_end(&mut pool, &mut answers).unwrap().t, 2.0);
    assert_eq!(pool.counters().blocks_loaded, 2);
}

/// More blocks in a row than a list has room for, several times over.
#[test]
fn lists_may_be_longer_than_their_room() {
    for gates in [19, 20, 21, 27, 28, 29, 60, 100] {
        for ends_with_wall in [false, true] {
            let mut levels = vec![false; gates];
            levels.push(ends_with_wall);
            let source = column(&levels);
            for slots in [2, gates as u32 + 1] {
                let octree = open(&source, slots);
                // In a pool with room for one ray, and depth first in one without.
                for suspended in [1, 0] {
                    let options = PoolOptions { suspended, ..PoolOptions::default() };
                    let mut pool = octree.ray_pool(options).unwrap();
                    let mut answers = Answers::with_capacity(1);
                    ask(&mut pool, down(), WAIT, &mut answers);
                    let hit = hit_at_the_end(&mut pool, &mut answers);
                    assert_eq!(hit.map(|hit| hit.t), ends_with_wall.then_some(gates as f64 + 1.0));
                    if suspended == 1 {
                        assert_eq!(pool.counters().blocks_loaded, gates as u64 + 1, "{gates}, {slots} slots");
                    }
                    ask_any(&mut pool, down(), WAIT, &mut answers);
                    while pool.resume(&mut answers).unwrap() {}
                    let expected = if ends_with_wall { Occlusion::Blocked } else { Occlusion::Clear };
                    assert_eq!(answers.occlusions.pop().map(|(_, found)| found), Some(expected));
                }
            }
        }
    }
}

/// A wall that comes before the place where the list was full makes what lies behind that place needless.
#[test]
fn a_hit_before_the_place_where_a_list_was_full_ends_the_ray() {
    for wall in [0, 7, 19, 20, 21, 35] {
        let mut levels = vec![false; 80];
        levels[wall] = true;
        let octree = open(&column(&levels), 3);
        let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
        let mut answers = Answers::with_capacity(1);
        // There when the ray comes, and gone later.
        ask(&mut pool, up_to(wall), OnMissing::Load, &mut answers);
        hit_of(&mut answers);
        ask(&mut pool, down(), WAIT, &mut answers);
        assert_eq!(hit_at_the_end(&mut pool, &mut answers).unwrap().t, wall as f64 + 1.0);
        let loads = pool.counters().blocks_loaded;
        assert!(loads <= wall as u64 + 2, "{loads} loads, wall {wall}");
    }
}

/// Two walls in one another's place: the one with the lower number is the answer, also where it is missing when the other is hit.
#[test]
fn a_missing_block_may_hold_the_same_hit_with_a_lower_number() {
    let wall = [[-1.0, -1.0, 0.0], [3.0, -1.0, 0.0], [-1.0, 3.0, 0.0]];
    // In the boxes of their blocks the ray comes to either at the same place.
    let triangles: Triangles = vec![wall; 2];
    for first in [0, 1] {
        let source = compile(&triangles, Precision::Float32, 1, |i| (i ^ first) as u64);
        let octree = open(&source, 2);
        for resident in [0, 1] {
            let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
            let mut answers = Answers::with_capacity(1);
            // Behind triangle 0 there is triangle 1 alone, which loads its block; and the other way about.
            let after = (resident == 1).then_some((1.0, TriangleId(0)));
            let request = ClosestRequest { ray: down(), after, tag: 0 };
            pool.closest_hits(&[request], OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
            assert_eq!(hit_at_the_end(&mut pool, &mut answers).unwrap().triangle, TriangleId(resident));
        }
        // One resident, whichever came last into a single slot.
        let octree = open(&source, 1);
        let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
        let mut answers = Answers::with_capacity(1);
        for _ in 0..3 {
            ask(&mut pool, down(), WAIT, &mut answers);
            let hit = hit_at_the_end(&mut pool, &mut answers).unwrap();
            assert_eq!((hit.t, hit.triangle), (1.0, TriangleId(0)));
            assert!(octree.cache().stats().misses >= 2);
        }
    }
}
