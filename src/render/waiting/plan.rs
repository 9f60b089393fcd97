//! How many rays may wait, and what that takes.

use super::claims::Claims;
use super::samples::{Samples, Stacks};
use super::tiles::Tiles;
use crate::model::Model;
use crate::octree::{LazyOctree, LeafLayout};
use crate::render::path_sizes::Sizes;
use crate::render::settings::WaitingRays;
use crate::render::shadows::OpenClaim;
use crate::render::stage::{Loop, Stage};
use crate::render::tile_samples::TileSamples;
use crate::trace::{Answers, AnyRequest, ClosestRequest, PoolOptions, RayPool};

/// What samples are on their way at one time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::render) enum Extent {
    /// Those of several tiles of a picture.
    Picture,
    /// Those of one region, of at most a tile.
    Region,
}

/// Sizes of what one thread of a render has whose rays wait.
#[derive(Clone, Copy, Debug)]
pub(in crate::render) struct WaitingPlan {
    pub extent: Extent,
    /// So many rays shall wait before a block is loaded for them.
    pub rays: u32,
    /// Samples on their way.
    pub samples: u32,
    /// Most of them that are shaded together.
    pub batch: usize,
    /// Claims to light, and the most that come of one hit.
    pub claims: u32,
    pub claims_of_hit: u32,
    /// Rays that wait for a sibling, and how many places of those are kept for a sample that goes on alone.
    pub stacks: u32,
    pub stacks_kept: u32,
    /// Tiles, and samples of each on their way.
    pub tiles: usize,
    pub window: usize,
    pub sizes: Sizes,
}

/// Most rays that are given to a pool in one call.
pub(super) const ASKED_MAX: usize = 1024;

impl WaitingPlan {
    /// The largest number that [`WaitingRays::Auto`] lets wait, and the smallest that is worth it.
    const AUTO_MAX: u32 = 1 << 16;
    const AUTO_MIN: u32 = 1 << 10;
    /// [`WaitingRays::Auto`] takes at most this part of what the slots of all blocks would take.
    const AUTO_SHARE: u64 = 8;

    /// For `rays` that may wait in all `threads` together.
    pub fn new(stage: &Stage, extent: Extent, rays: u32, threads: usize) -> WaitingPlan {
        let settings = &stage.settings;
        let threads = threads.max(1) as u64;
        let rays = rays.div_ceil(u32::try_from(threads).unwrap_or(u32::MAX)).max(1);
        let round = TileSamples::round_max(stage).max(1);
        let all = match extent {
            Extent::Picture => {
                let pixels = u64::from(settings.width) * u64::from(settings.height);
                (pixels * u64::from(settings.samples_per_pixel)).div_ceil(threads)
            }
            Extent::Region => u64::from(round),
        };
        let samples = u32::try_from(all).unwrap_or(u32::MAX).min(rays).max(1);
        let batch = (samples as usize).min(ASKED_MAX);
        let mut sizes = Sizes::of_batch(stage, batch);
        let mut stacks_kept = 0;
        if sizes.stack_depth > 0 {
            stacks_kept = sizes.stack_depth as u32;
            // What a hit can do to its sample's stack: it takes the ray on top, or puts two above.
            sizes.stack_depth = 3;
        }
        let claims_of_hit = if sizes.shadows > 0 { claims_of_hit(stage) } else { 0 };
        let (window, tiles) = match extent {
            Extent::Picture => {
                let window = round.min((samples / 4).max(1024));
                let tiles_max = (stage.grid.tile_count() as u64).div_ceil(threads).max(1);
                (window, u64::from(2 * (samples / window) + 2).min(tiles_max))
            }
            // There is no other tile to go on with while a sample is late.
            Extent::Region => (round.min(samples.saturating_mul(2).max(1024)), 1),
        };
        WaitingPlan {
            extent,
            rays,
            samples,
            batch,
            claims: if claims_of_hit > 0 { rays.max(claims_of_hit) } else { 0 },
            claims_of_hit,
            stacks: if stacks_kept > 0 { samples.saturating_mul(2).saturating_add(stacks_kept) } else { 0 },
            stacks_kept,
            tiles: tiles as usize,
            window: window as usize,
            sizes,
        }
    }

    /// For a model, if rays are to wait at all. Under [`WaitingRays::Auto`] the most that are to wait.
    pub fn of(stage: &Stage, extent: Extent, model: &Model, threads: usize) -> Option<WaitingPlan> {
        // Who wants to know what each pixel cost wants rays of one pixel at a time.
        if stage.settings.keep_costs || stage.are_moving {
            return None;
        }
        match stage.settings.waiting {
            WaitingRays::Never => None,
            WaitingRays::Count(rays) => Some(WaitingPlan::new(stage, extent, rays, threads)),
            // Rays of mirrors and glass mostly follow each other through the same blocks (docs/results/suspension.md).
            WaitingRays::Auto if !stage.interreflection => None,
            WaitingRays::Auto => {
                let slot = LazyOctree::slot_bytes(model, LeafLayout::Indexed).0;
                let share = u64::from(model.block_id_count()).saturating_mul(slot) / WaitingPlan::AUTO_SHARE;
                let blocks = model.block_id_count() as usize;
                let first = WaitingPlan::new(stage, extent, WaitingPlan::AUTO_MAX, threads);
                let mut plans = std::iter::successors(Some(first), |plan| plan.smaller(stage, threads));
                plans.find(|plan| plan.bytes_with_pool(stage, blocks).saturating_mul(threads as u64) <= share)
            }
        }
    }

    /// For half as many rays, unless that is not worth it.
    pub fn smaller(&self, stage: &Stage, threads: usize) -> Option<WaitingPlan> {
        let rays = (self.rays / 2).saturating_mul(threads as u32);
        (rays >= WaitingPlan::AUTO_MIN).then(|| WaitingPlan::new(stage, self.extent, rays, threads))
    }

    pub fn pool_options(&self, stage: &Stage) -> PoolOptions {
        // The worker shades no more samples at once than have room for their rays.
        PoolOptions { suspended: self.rays, ignore: stage.transparent.clone(), children: 0 }
    }

    /// Most claims that come of the hits of a batch.
    pub fn claims_asked(&self) -> usize {
        (self.batch * self.claims_of_hit as usize).min(self.claims as usize)
    }

    /// What a thread takes beside its pool.
    pub fn bytes(&self, stage: &Stage) -> u64 {
        let with_walks = has_walks(stage);
        let claims_asked = self.claims_asked();
        let queues = (self.batch + 2 * RayPool::RESUMED_MAX + claims_asked) * size_of::<ClosestRequest>()
            + claims_asked * (size_of::<AnyRequest>() + size_of::<OpenClaim>());
        let bytes = self.sizes.bytes(stage)
            // Places, those that are ready and those that have ended.
            + self.samples as usize * (Samples::bytes_of_one(with_walks) + 2 * size_of::<u32>())
            + self.stacks as usize * Stacks::bytes_of_one(with_walks)
            + self.claims as usize * Claims::BYTES_OF_ONE
            + self.batch * size_of::<u32>()
            + queues
            + Answers::bytes_needed(ASKED_MAX)
            + Tiles::bytes_needed(stage, self.tiles, self.window);
        bytes as u64
    }

    /// What a thread takes with its pool, but for the pool's tracer.
    pub fn bytes_with_pool(&self, stage: &Stage, block_count: usize) -> u64 {
        let pool = RayPool::bytes_needed(&self.pool_options(stage), block_count);
        self.bytes(stage).saturating_add(pool.0)
    }
}

/// Whether samples carry a [`Walk`](crate::render::walk::Walk).
pub(super) fn has_walks(stage: &Stage) -> bool {
    matches!(stage.path_loop, Loop::Sampled | Loop::Detailed)
}

/// Most claims that a hit makes which are left open.
fn claims_of_hit(stage: &Stage) -> u32 {
    if !leaves_claims_open(stage) {
        return 0;
    }
    let sampled = stage.areas.len() + usize::from(stage.environment.is_some());
    // Those of rough surfaces are asked for twice.
    let parts = if stage.has_rough && !stage.interreflection { 2 } else { 1 };
    u32::try_from(stage.emitters.len() + parts * sampled).unwrap_or(u32::MAX)
}

/// Whether shadow rays wait: not where surfaces are cut out, which is looked up hit by hit.
pub(super) fn leaves_claims_open(stage: &Stage) -> bool {
    stage.cut_outs.is_none()
}
