//! A picture's rays, depth first through a tracer or through a pool. Shared with the bench of the paper's tables.
#![allow(dead_code)]

use std::ops::Range;

use outcrop::LazyOctree;
use outcrop::error::TraceError;
use outcrop::geom::Ray;
use outcrop::procedural::Gears;
use outcrop::stats::TraceCounters;
use outcrop::trace::{
    Answers, AnyRequest, ClosestRequest, Hit, LoadStats, LoaderOptions, Occlusion, OnMissing, PoolOptions,
    RayPool, Tracer,
};

use crate::mixes::{Mix, shadow_ray};
use crate::rays::camera_ray;
use crate::rays::numbers::mix;

/// How rays are run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Each pixel's rays one after the other; a missing block is loaded at once.
    DepthFirst,
    /// Through a pool.
    Pool {
        /// See `PoolOptions::suspended`.
        suspended: u32,
        /// Of a ray that spawns others; shadow rays have 1.
        weight: u32,
        /// Whether that is for each ray that may still follow, rather than for any.
        by_depth: bool,
        /// Whether camera rays load what they miss.
        camera_loads: bool,
        /// Whether the shadow rays of camera rays do.
        shadows_load: bool,
        /// Threads that load; with 0 the one that traces does.
        threads: u32,
        /// See `LoaderOptions::loads_in_flight`.
        in_flight: u32,
    },
}

impl Order {
    /// A pool of the usual size, every ray of which waits, with so many threads that load.
    pub fn pool(threads: u32, in_flight: u32) -> Order {
        Order::Pool {
            suspended: 1 << 14,
            weight: 4,
            by_depth: true,
            camera_loads: false,
            shadows_load: false,
            threads,
            in_flight,
        }
    }
}

/// What a run did; the sum is over all answers, in no order.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    pub sum: u64,
    pub counters: TraceCounters,
    pub stats: LoadStats,
}

/// The pixel at a place of the Z curve through a square picture.
fn pixel(index: u32) -> (u32, u32) {
    let every_other_bit = |mut bits: u32| {
        bits &= 0x5555_5555;
        for (shift, mask) in [(1, 0x3333_3333), (2, 0x0f0f_0f0f), (4, 0x00ff_00ff), (8, 0xffff)] {
            bits = (bits | bits >> shift) & mask;
        }
        bits
    };
    (every_other_bit(index), every_other_bit(index >> 1))
}

/// A tag: pixel, depth, and 7 for the path's own ray or the lamp.
fn tag(index: u32, depth: u32, what: u32) -> u64 {
    u64::from(index) << 8 | u64::from(depth << 3 | what)
}

fn hit_sum(tag: u64, hit: &Option<Hit>) -> u64 {
    mix(tag ^ hit.as_ref().map_or(!0, |hit| hit.triangle.0 << 20 ^ hit.t.to_bits()))
}

fn occlusion_sum(tag: u64, occlusion: Occlusion) -> u64 {
    mix(tag ^ (occlusion as u64) << 60)
}

/// Traces those pixels of a picture of `side` x `side`, a power of two, that have these places on the Z curve.
pub fn run(octree: &LazyOctree, mix: Mix, side: u32, order: Order, pixels: Range<u32>) -> Run {
    match order {
        Order::DepthFirst => depth_first(octree, mix, side, pixels),
        Order::Pool { suspended, weight, by_depth, camera_loads, shadows_load, threads, in_flight } => {
            let ample = "the budget is ample";
            let options = PoolOptions { suspended, ..PoolOptions::default() };
            let shadow = OnMissing::Wait { weight: 1 };
            let on_missing = OnMissingBy {
                camera_loads,
                weight,
                by_depth,
                first_shadow: if shadows_load { OnMissing::Load } else { shadow },
                shadow,
            };
            if threads == 0 {
                return Driver::new(octree.ray_pool(options).expect(ample), mix, side, on_missing)
                    .run(pixels);
            }
            let loader_options = LoaderOptions { loads_at_once: threads, loads_in_flight: in_flight };
            let run = octree.with_loader(threads, loader_options, |loader| {
                let pool = loader.ray_pool(options).expect(ample);
                Driver::new(pool, mix, side, on_missing).run(pixels)
            });
            run.expect(ample)
        }
    }
}

fn depth_first(octree: &LazyOctree, mix: Mix, side: u32, pixels: Range<u32>) -> Run {
    let mut tracer = octree.tracer().expect("the budget is ample");
    let mut sum = 0u64;
    for index in pixels {
        let (x, y) = pixel(index);
        let one = path(&mut tracer, mix, camera_ray([x, y], side), index).expect("the model is sound");
        sum = sum.wrapping_add(one);
    }
    Run { sum, counters: tracer.counters(), stats: tracer.load_stats() }
}

/// All rays of one pixel; the sum over their answers.
pub fn path(tracer: &mut Tracer<'_>, mix: Mix, mut ray: Ray, index: u32) -> Result<u64, TraceError> {
    let mut occlusions = [Occlusion::Clear; Gears::LAMPS.len()];
    let (mut sum, mut depth) = (0u64, 0);
    loop {
        let hit = tracer.closest_hit(&ray)?;
        sum = sum.wrapping_add(hit_sum(tag(index, depth, 7), &hit));
        let Some(hit) = hit else { return Ok(sum) };
        let shadows = Gears::LAMPS.map(|lamp| shadow_ray(&hit, lamp, 0).ray);
        tracer.occluded(&shadows, None, &mut occlusions)?;
        for (lamp, occlusion) in (0..).zip(occlusions) {
            sum = sum.wrapping_add(occlusion_sum(tag(index, depth, lamp), occlusion));
        }
        let Some(next) = mix.onward(&hit, ray.direction, index, depth) else { return Ok(sum) };
        (ray, depth) = (next, depth + 1);
    }
}

/// Pixels started together.
const BATCH: u32 = 256;

/// What rays do about missing blocks.
struct OnMissingBy {
    camera_loads: bool,
    weight: u32,
    by_depth: bool,
    first_shadow: OnMissing,
    shadow: OnMissing,
}

impl OnMissingBy {
    /// What a path's ray does after so many others, at most `last`.
    fn path(&self, depth: u32, last: u32) -> OnMissing {
        if depth == 0 && self.camera_loads {
            OnMissing::Load
        } else if self.by_depth {
            OnMissing::Wait { weight: self.weight * (last + 1 - depth) }
        } else {
            OnMissing::Wait { weight: self.weight }
        }
    }
}

struct Driver<'o> {
    pool: RayPool<'o>,
    mix: Mix,
    side: u32,
    on_missing: OnMissingBy,
    answers: Answers,
    /// Direction of each path's ray, which the pool does not give back.
    directions: Vec<[f64; 3]>,
    /// By depth.
    onward: Vec<Vec<ClosestRequest>>,
    /// Shadow rays of camera rays, and of others.
    shadows: [Vec<AnyRequest>; 2],
    sum: u64,
}

impl<'o> Driver<'o> {
    fn new(pool: RayPool<'o>, mix: Mix, side: u32, on_missing: OnMissingBy) -> Driver<'o> {
        Driver {
            pool,
            mix,
            side,
            on_missing,
            answers: Answers::with_capacity(Gears::LAMPS.len() * RayPool::RESUMED_MAX),
            directions: vec![[0.0; 3]; (side * side) as usize],
            onward: vec![Vec::new(); mix.depth() as usize + 1],
            shadows: [Vec::new(), Vec::new()],
            sum: 0,
        }
    }

    fn run(mut self, pixels: Range<u32>) -> Run {
        let mut next = pixels.start;
        let sound = "the model is sound";
        loop {
            if next < pixels.end && self.pool.wants_rays() {
                let end = (next + BATCH).min(pixels.end);
                for index in next..end {
                    let (x, y) = pixel(index);
                    let ray = camera_ray([x, y], self.side);
                    self.directions[index as usize] = ray.direction;
                    self.onward[0].push(ClosestRequest { ray, after: None, tag: tag(index, 0, 7) });
                }
                next = end;
                self.ask();
            } else if !self.pool.resume(&mut self.answers).expect(sound) && next == pixels.end {
                return Run { sum: self.sum, counters: self.pool.counters(), stats: self.pool.load_stats() };
            }
            while !self.answers.hits.is_empty() || !self.answers.occlusions.is_empty() {
                self.shade();
                let on_missing = [self.on_missing.first_shadow, self.on_missing.shadow];
                for (shadows, on_missing) in self.shadows.iter_mut().zip(on_missing) {
                    self.pool.occluded(shadows, on_missing, &mut self.answers).expect(sound);
                    shadows.clear();
                }
                self.ask();
            }
        }
    }

    /// Asks the pool for the first hits of the rays listed.
    fn ask(&mut self) {
        for (rays, depth) in self.onward.iter_mut().zip(0..) {
            let on_missing = self.on_missing.path(depth, self.mix.depth());
            self.pool.closest_hits(rays, on_missing, &mut self.answers).expect("the model is sound");
            rays.clear();
        }
    }

    /// Sums up the answers and lists the rays that they lead to: shadow rays lamp by lamp.
    fn shade(&mut self) {
        for (tag, occlusion) in self.answers.occlusions.drain(..) {
            self.sum = self.sum.wrapping_add(occlusion_sum(tag, occlusion));
        }
        for (lamp, position) in (0..).zip(Gears::LAMPS) {
            for (hit_tag, hit) in &self.answers.hits {
                let (index, depth) = ((hit_tag >> 8) as u32, (*hit_tag as u32 & 0xff) >> 3);
                if let Some(hit) = hit {
                    let list = &mut self.shadows[usize::from(depth > 0)];
                    list.push(shadow_ray(hit, position, tag(index, depth, lamp)));
                }
            }
        }
        for (hit_tag, hit) in self.answers.hits.drain(..) {
            self.sum = self.sum.wrapping_add(hit_sum(hit_tag, &hit));
            let (index, depth) = ((hit_tag >> 8) as u32, (hit_tag as u32 & 0xff) >> 3);
            let direction = &mut self.directions[index as usize];
            let Some(ray) = hit.and_then(|hit| self.mix.onward(&hit, *direction, index, depth)) else {
                continue;
            };
            *direction = ray.direction;
            let next = ClosestRequest { ray, after: None, tag: tag(index, depth + 1, 7) };
            self.onward[depth as usize + 1].push(next);
        }
    }
}
