//! Ray trees of a batch of samples: no recursion, no limit on depth, memory fixed in advance.
//!
//! Every sample of the batch walks its tree depth first, all samples in step: one ray per live sample goes into each
//! query. Where a ray splits, its work budget is divided, the child with the smaller part goes on and the other waits
//! on the sample's own stack; so `log2(work budget)` places are enough however deep the tree is. Each
//! sample adds up its light in the order of its own tree, so neither batch nor tile nor thread shows in the sum (I2).

use std::time::Instant;

use glam::DVec3;

use super::counters::EffectCounters;
use super::detail::query::SurfaceQuery;
use super::hot::{Detailed, EffectsOfLoop, Matt, Sampled, Whitted};
use super::media::Borders;
use super::path_sizes::Sizes;
use super::query::RayQuery;
use super::report::WorkerSeconds;
use super::response::Scatter;
use super::shadows::ShadowBatch;
use super::stage::{Loop, PixelSample, Shader, Stage};
use super::walk::Walk;
use crate::error::TraceError;
use crate::geom::Ray;
use crate::trace::Hit;
use crate::units::MaterialId;

/// The ray of a sample that is about to be traced; the ray itself stands beside it in a list of its own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    pub slot: u32,
    /// Rays that the tree below may hold, this one included.
    pub work: u64,
    pub throughput: DVec3,
}

/// A ray that waits for its sibling's tree to end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    pub ray: Ray,
    pub work: u64,
    pub throughput: DVec3,
}

/// A hit that is being shaded.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub slot: u32,
    pub material: MaterialId,
    pub throughput: DVec3,
    pub position: DVec3,
    /// Unit, on the side from which the ray came.
    pub normal: DVec3,
    /// Start of rays on that side.
    pub origin: [f64; 3],
    /// Unit, back along the ray.
    pub view: DVec3,
}

/// Traces batches of samples; one per thread.
pub(crate) struct PathTracer<'s, Q> {
    pub(super) stage: &'s Stage,
    /// Most rays of one call.
    pub batch_samples: usize,
    pub query: SurfaceQuery<'s, Q>,
    pub counters: EffectCounters,
    pub seconds: WorkerSeconds,
    pub(super) heads: Vec<Head>,
    pub(super) rays: Vec<Ray>,
    pub(super) next_heads: Vec<Head>,
    pub(super) next_rays: Vec<Ray>,
    pub(super) hits: Vec<Option<Hit>>,
    pub(super) points: Vec<Point>,
    /// `stack_depth` places per slot.
    pub(super) waiting: Vec<Option<Waiting>>,
    pub(super) waiting_counts: Vec<u8>,
    pub(super) stack_depth: usize,
    pub(super) radiance: Vec<DVec3>,
    /// Per slot: the most that any channel may lack because something was not followed.
    pub(super) lost: Vec<f64>,
    /// The same of shadow rays, until the sample is done; only if they can pass surfaces.
    pub(super) lost_by_shadows: Vec<f64>,
    pub(super) shadows: ShadowBatch,
    /// Rays of forced effects that cannot matter.
    pub(super) forced: Vec<Ray>,
    /// One beside each of `heads`, `next_heads`, `points` and `waiting`, in loops that sample effects; empty in others.
    pub(super) walks: Vec<Walk>,
    pub(super) next_walks: Vec<Walk>,
    pub(super) scatters: Vec<Scatter>,
    pub(super) waiting_walks: Vec<Option<Walk>>,
    /// When each sample is taken, by slot, and when each of `rays` is traced; only if instances move.
    pub(super) times: Vec<f64>,
    ray_times: Vec<f64>,
    /// Terms of points where they are not those of the material.
    pub(super) details: Vec<Shader>,
    /// Of nested media.
    pub(super) borders: Borders,
}

impl<'s, Q: RayQuery> PathTracer<'s, Q> {
    pub fn new(stage: &'s Stage, query: Q) -> PathTracer<'s, Q> {
        PathTracer::of_sizes(stage, query, &Sizes::of(stage))
    }

    pub(super) fn of_sizes(stage: &'s Stage, query: Q, sizes: &Sizes) -> PathTracer<'s, Q> {
        PathTracer {
            stage,
            batch_samples: sizes.batch,
            query: SurfaceQuery::new(stage, query),
            counters: EffectCounters::default(),
            seconds: WorkerSeconds::default(),
            heads: Vec::with_capacity(sizes.batch),
            rays: Vec::with_capacity(sizes.batch),
            next_heads: Vec::with_capacity(sizes.batch),
            next_rays: Vec::with_capacity(sizes.batch),
            hits: vec![None; sizes.batch],
            points: Vec::with_capacity(sizes.batch),
            waiting: vec![None; sizes.batch * sizes.stack_depth],
            waiting_counts: vec![0; sizes.batch],
            stack_depth: sizes.stack_depth,
            radiance: Vec::with_capacity(sizes.batch),
            lost: Vec::with_capacity(sizes.batch),
            lost_by_shadows: Vec::with_capacity(if stage.transparent.is_some() { sizes.batch } else { 0 }),
            shadows: ShadowBatch::new(sizes.shadows, stage.transparent.is_some()),
            forced: Vec::with_capacity(sizes.forced),
            walks: Vec::with_capacity(sizes.walks),
            next_walks: Vec::with_capacity(sizes.walks),
            scatters: Vec::with_capacity(sizes.walks),
            waiting_walks: vec![None; if sizes.walks > 0 { sizes.batch * sizes.stack_depth } else { 0 }],
            borders: Borders::new(sizes.borders),
            times: Vec::new(),
            ray_times: Vec::new(),
            details: Vec::new(),
        }
    }

    /// Computes the radiance of each sample, in their order. At most [`PathTracer::batch_samples`] samples.
    ///
    /// # Errors
    /// Those of the query; nothing that was computed is to be used then.
    pub fn trace(&mut self, samples: impl Iterator<Item = PixelSample> + Clone) -> Result<(), TraceError> {
        self.begin(samples.clone());
        let start = Instant::now();
        self.find_hits()?;
        // Decided once per batch; inside, what a loop does not know is not there (I6).
        match self.loop_of_samples() {
            Loop::Matt => self.trace_in::<Matt>(samples, start),
            Loop::Whitted => self.trace_in::<Whitted>(samples, start),
            Loop::Sampled | Loop::Detailed => self.trace_in::<Sampled>(samples, start),
        }
    }

    /// The loop for samples whose camera rays have found these hits: where rays go on from one, it must serve whatever they meet.
    pub(super) fn loop_of_samples(&self) -> Loop {
        match self.loop_of_hits() {
            Loop::Matt => Loop::Matt,
            _ => self.stage.path_loop,
        }
    }

    /// The loop for what the rays have hit.
    fn loop_of_hits(&self) -> Loop {
        self.stage
            .loop_of_hits(&self.hits[..self.rays.len()], |triangle| self.query.may_have_normals(triangle))
    }

    /// Traces samples to their end, whose camera rays were traced from `start` on.
    fn trace_in<E: EffectsOfLoop>(
        &mut self,
        samples: impl Iterator<Item = PixelSample>,
        mut start: Instant,
    ) -> Result<(), TraceError> {
        self.enter::<E>(samples);
        loop {
            self.go_on::<E>(start)?;
            std::mem::swap(&mut self.heads, &mut self.next_heads);
            std::mem::swap(&mut self.rays, &mut self.next_rays);
            if E::SAMPLED {
                std::mem::swap(&mut self.walks, &mut self.next_walks);
            }
            if self.rays.is_empty() {
                break;
            }
            start = Instant::now();
            self.find_hits()?;
        }
        self.counters.add_details(&std::mem::take(&mut self.query.counters));
        for (lost, by_shadows) in self.lost.iter_mut().zip(&self.lost_by_shadows) {
            *lost += by_shadows;
        }
        Ok(())
    }

    /// Radiance of each ray of the last [`PathTracer::trace`].
    pub fn radiance(&self) -> &[DVec3] {
        &self.radiance
    }

    /// For each ray of the last [`PathTracer::trace`], the most that any channel of its radiance lacks of what every tree of at most
    /// `work_budget` rays in which nothing was cut would give ([`Stage::radiance_max`] times throughput, summed over all cuts).
    pub fn lost(&self) -> &[f64] {
        &self.lost
    }

    /// Traces the head of every live sample; camera rays have none yet, and are those of their samples.
    fn find_hits(&mut self) -> Result<(), TraceError> {
        if self.stage.are_moving {
            self.ray_times.clear();
            if self.heads.is_empty() {
                self.ray_times.extend_from_slice(&self.times);
            } else {
                self.ray_times.extend(self.heads.iter().map(|head| self.times[head.slot as usize]));
            }
            self.query.at_times(&mut self.ray_times.iter().copied());
        }
        let hits = &mut self.hits[..self.rays.len()];
        self.query.closest_hits(&self.rays, hits)
    }

    /// Shades what the heads, which were traced from `start` on, hit, and finds the next ray of each sample's tree.
    pub(super) fn go_on<E: EffectsOfLoop>(&mut self, start: Instant) -> Result<(), TraceError> {
        if E::SAMPLED && (self.stage.nested || self.stage.force_nested) {
            self.find_borders()?;
        }
        // Only how hits are shaded differs, so that each step may decide for itself.
        if E::SAMPLED && self.loop_of_hits() == Loop::Detailed {
            self.go_on_shading::<Detailed>(start)
        } else {
            self.go_on_shading::<E>(start)
        }
    }

    /// [`PathTracer::go_on`] where the borders of media are known.
    fn go_on_shading<E: EffectsOfLoop>(&mut self, start: Instant) -> Result<(), TraceError> {
        let traced = Instant::now();
        self.seconds.paths += (traced - start).as_secs_f64();
        self.shade::<E>()?;
        self.seconds.shading += traced.elapsed().as_secs_f64();
        if self.stage.direct {
            self.light::<E>()?;
        }
        if E::SAMPLED {
            self.light_by_samples()?;
        }
        if !self.forced.is_empty() {
            let forced = &self.forced;
            self.hits.resize(self.hits.len().max(forced.len()), None);
            self.query.closest_hits(forced, &mut self.hits[..forced.len()])?;
            self.counters.forced_rays += forced.len() as u64;
            self.forced.clear();
        }
        Ok(())
    }

    /// Finds the borders of nested media at the hits; if they are only forced, for nothing.
    fn find_borders(&mut self) -> Result<(), TraceError> {
        let media = self.walks.iter().map(|walk| walk.media);
        let count = self.rays.len();
        let hits = &mut self.hits[..count];
        if self.stage.nested {
            return self.borders.find(
                self.stage,
                &mut self.query,
                (&self.rays, &self.ray_times),
                media,
                hits,
                &mut self.counters,
            );
        }
        let mut hits: Vec<_> = hits.to_vec();
        let mut counters = EffectCounters::default();
        let rays = (&self.rays[..], &self.ray_times[..]);
        self.borders.find(self.stage, &mut self.query, rays, media, &mut hits, &mut counters)?;
        self.counters.forced_rays += counters.medium_rays;
        Ok(())
    }
}

/// What [`PathTracer::new`] allocates for `stage`, in bytes.
pub(crate) fn bytes_needed(stage: &Stage) -> usize {
    Sizes::of(stage).bytes(stage)
}
