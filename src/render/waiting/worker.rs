//! One thread of a render whose rays wait.

use std::collections::VecDeque;
use std::time::Instant;

use glam::DVec3;

use super::claims::Claims;
use super::places::NONE;
use super::plan::{ASKED_MAX, WaitingPlan, has_walks, leaves_claims_open};
use super::query::PoolQuery;
use super::samples::{Samples, Stacks};
use super::tiles::{NextTile, Tiles};
use crate::access::BlockSketch;
use crate::error::TraceError;
use crate::render::counters::EffectCounters;
use crate::render::hot::{EffectsOfLoop, Matt, Sampled, Whitted};
use crate::render::paths::{Head, PathTracer};
use crate::render::query::RayQuery;
use crate::render::report::WorkerSeconds;
use crate::render::shadows::Walker;
use crate::render::stage::{Loop, PixelSample, Stage};
use crate::render::tile_samples::FinishedTile;
use crate::render::workers::Watch;
use crate::stats::TraceCounters;
use crate::trace::{Answers, AnyRequest, ClosestRequest, Hit, LoadStats, Occlusion, OnMissing, RayPool};
use crate::units::TileId;

/// In a tag of a closest-hit query: that of a claim and not of a sample.
const CLAIM: u64 = 1 << 32;

/// What answers are worth to those that wait: the next hit of a path leads to more rays, a shadow ray ends.
const PATH: OnMissing = OnMissing::Wait { weight: 4 };
const SHADOW: OnMissing = OnMissing::Wait { weight: 1 };

/// See [the room](super).
pub(in crate::render) struct WaitingWorker<'s, 'o, W> {
    watch: W,
    stage: &'s Stage,
    plan: WaitingPlan,
    /// Shades batches of samples; its slots are theirs while it does.
    paths: PathTracer<'s, PoolQuery<'o>>,
    samples: Samples,
    stacks: Stacks,
    claims: Claims,
    tiles: Tiles,
    /// Samples whose answers have all come.
    ready: VecDeque<u32>,
    /// Samples that are done.
    ended: Vec<u32>,
    /// The sample that may use the places of stacks that are kept.
    alone: Option<u32>,
    /// The samples in the slots of `paths`.
    batch: Vec<u32>,
    /// What the pool is to be asked next: for heads, for claims on their way through surfaces, for claims.
    heads: Vec<ClosestRequest>,
    walks: Vec<ClosestRequest>,
    shadows: Vec<AnyRequest>,
    answers: Answers,
}

impl<'s, 'o, W: Watch> WaitingWorker<'s, 'o, W> {
    pub fn new(watch: W, stage: &'s Stage, plan: &WaitingPlan, query: PoolQuery<'o>) -> Self {
        let mut paths = PathTracer::of_sizes(stage, query, &plan.sizes);
        if leaves_claims_open(stage) {
            paths.shadows.leave_open(plan.claims_asked());
        }
        let with_walks = has_walks(stage);
        let claims = plan.claims_asked();
        WaitingWorker {
            watch,
            stage,
            plan: *plan,
            paths,
            samples: Samples::new(plan.samples, with_walks),
            stacks: Stacks::new(plan.stacks, with_walks),
            claims: Claims::new(plan.claims),
            tiles: Tiles::new(plan.tiles, plan.window),
            ready: VecDeque::with_capacity(plan.samples as usize),
            ended: Vec::with_capacity(plan.samples as usize),
            alone: None,
            batch: Vec::with_capacity(plan.batch),
            heads: Vec::with_capacity(plan.batch + RayPool::RESUMED_MAX),
            walks: Vec::with_capacity(claims + RayPool::RESUMED_MAX),
            shadows: Vec::with_capacity(claims),
            answers: Answers::with_capacity(ASKED_MAX),
        }
    }

    /// Rays by effect so far.
    pub fn effects(&self) -> EffectCounters {
        let mut counters = self.paths.counters;
        // Of claims that went on since a batch was shaded.
        counters.add_details(&self.paths.query.counters);
        counters
    }

    /// Work of the queries so far.
    pub fn trace(&self) -> TraceCounters {
        self.paths.query.counters()
    }

    /// Which blocks were entered since this was called last, roughly.
    pub fn take_touched(&mut self) -> BlockSketch {
        self.paths.query.take_touched()
    }

    /// How loads went so far.
    pub fn loads(&self) -> LoadStats {
        self.pool().load_stats()
    }

    pub fn seconds(&self) -> WorkerSeconds {
        self.paths.seconds
    }

    /// The tile that an error is told of.
    pub fn tile(&self) -> TileId {
        self.tiles.first_open().unwrap_or(TileId(0))
    }

    /// The tile that was finished last.
    pub fn finished(&self) -> &FinishedTile {
        self.tiles.finished()
    }

    fn pool(&self) -> &RayPool<'o> {
        &self.paths.query.geometry.pool
    }

    /// Renders all tiles that `next_tile` gives, and gives them, as they are finished, to `finish` with their cell. False if the render was
    /// stopped before the end; then, and after an error, there are samples left on their way, and this is not to be called again.
    pub fn run(
        &mut self,
        next_tile: &mut NextTile<'_>,
        finish: &dyn Fn(u32, &FinishedTile),
    ) -> Result<bool, TraceError> {
        loop {
            if self.watch.is_stopped() {
                return Ok(false);
            }
            let goes_on = self.shade_ready()?
                || self.begin_samples(next_tile)?
                || self.resume()?
                || self.shade_alone()?;
            self.deliver(finish);
            if !goes_on && self.samples.count() == 0 {
                return Ok(true);
            }
        }
    }

    /// How many samples can be shaded now, of so many.
    fn room(&self, count: usize) -> usize {
        let plan = &self.plan;
        let of_hit = plan.claims_of_hit as usize;
        let mut room = count.min(plan.batch);
        if let Some(of_claims) = (self.claims.room() as usize).checked_div(of_hit) {
            room = room.min(of_claims);
        }
        if plan.stacks > 0 {
            room = room.min((self.stacks.room().saturating_sub(plan.stacks_kept) / 2) as usize);
        }
        // Rays that find no room in the pool load for themselves; better that some of those that wait run before.
        let in_pool = self.pool().room() as usize / (1 + of_hit);
        let is_idle = self.pool().suspended_count() == 0;
        room.min(if is_idle { in_pool.max(1) } else { in_pool })
    }

    /// Begins samples, if too few rays wait; whether it did.
    fn begin_samples(&mut self, next_tile: &mut NextTile<'_>) -> Result<bool, TraceError> {
        if !self.pool().wants_rays() {
            return Ok(false);
        }
        let count = self.room(self.samples.room() as usize);
        self.batch.clear();
        while self.batch.len() < count {
            let Some((tile, index)) = self.tiles.next(self.stage, next_tile) else { break };
            // There is room for as many as were counted.
            self.batch.push(self.samples.begin(tile, index));
        }
        if self.batch.is_empty() {
            return Ok(false);
        }
        self.begin()?;
        self.watch.report();
        Ok(true)
    }

    /// Traces and shades the camera rays of the samples of the batch.
    fn begin(&mut self) -> Result<(), TraceError> {
        let WaitingWorker { paths, samples, tiles, batch, .. } = self;
        let start = Instant::now();
        paths.begin(pixel_samples(batch, samples, tiles));
        for (place, ray) in batch.iter().zip(&paths.rays) {
            samples.get_mut(*place).ray = *ray;
        }
        paths.waiting_counts[..batch.len()].fill(0);
        paths.query.closest_hits(&paths.rays, &mut paths.hits[..batch.len()])?;
        match paths.loop_of_samples() {
            Loop::Matt => self.enter::<Matt>(start),
            Loop::Whitted => self.enter::<Whitted>(start),
            Loop::Sampled | Loop::Detailed => self.enter::<Sampled>(start),
        }
    }

    /// Shades what the camera rays of the batch have hit.
    fn enter<E: EffectsOfLoop>(&mut self, start: Instant) -> Result<(), TraceError> {
        let WaitingWorker { paths, samples, tiles, batch, .. } = self;
        paths.enter::<E>(pixel_samples(batch, samples, tiles));
        self.shade::<E>(start)
    }

    /// Shades samples whose answers have come, as far as there is room for what follows; whether it did.
    fn shade_ready(&mut self) -> Result<bool, TraceError> {
        let count = self.room(self.ready.len());
        self.batch.clear();
        self.batch.extend(self.ready.drain(..count));
        self.shade_batch()
    }

    /// Goes on with one sample on the places that are kept for it, where no other can: always the same one until it is done. Whether there
    /// was any.
    fn shade_alone(&mut self) -> Result<bool, TraceError> {
        let Some(first) = self.ready.front().copied() else { return Ok(false) };
        let alone = *self.alone.get_or_insert(first);
        self.ready.retain(|ready| *ready != alone);
        self.batch.clear();
        self.batch.push(alone);
        self.shade_batch()
    }

    fn shade_batch(&mut self) -> Result<bool, TraceError> {
        if self.batch.is_empty() {
            return Ok(false);
        }
        self.bring_batch();
        let start = Instant::now();
        match self.stage.path_loop {
            Loop::Matt => self.shade::<Matt>(start)?,
            Loop::Whitted => self.shade::<Whitted>(start)?,
            Loop::Sampled | Loop::Detailed => self.shade::<Sampled>(start)?,
        }
        Ok(true)
    }

    /// Brings the samples of the batch into the slots of the path tracer.
    fn bring_batch(&mut self) {
        let WaitingWorker { stage, paths, samples, stacks, batch, .. } = self;
        paths.heads.clear();
        paths.rays.clear();
        paths.walks.clear();
        paths.radiance.clear();
        paths.lost.clear();
        paths.lost_by_shadows.clear();
        for (slot, place) in (0u32..).zip(batch.iter()) {
            let sample = samples.get(*place);
            // Only samples with a head become ready.
            let head = sample.head.unwrap_or(Head { slot, work: 1, throughput: DVec3::ZERO });
            paths.heads.push(Head { slot, ..head });
            paths.rays.push(sample.ray);
            paths.hits[slot as usize] = sample.hit;
            paths.walks.extend(samples.walk(*place));
            paths.radiance.push(sample.radiance);
            paths.lost.push(sample.lost);
            if stage.transparent.is_some() {
                paths.lost_by_shadows.push(sample.lost_by_shadows);
            }
            // Of its stack, only the top can be asked for.
            let (first, top) = (slot as usize * paths.stack_depth, stacks.top(sample.stack));
            paths.waiting_counts[slot as usize] = u8::from(top.is_some());
            if let Some((ray, walk)) = top {
                paths.waiting[first] = Some(ray);
                if let Some(of_ray) = paths.waiting_walks.get_mut(first) {
                    *of_ray = walk;
                }
            }
        }
    }

    /// Shades the hits of the batch and asks the pool for what follows.
    fn shade<E: EffectsOfLoop>(&mut self, start: Instant) -> Result<(), TraceError> {
        self.paths.go_on::<E>(start)?;
        let details = std::mem::take(&mut self.paths.query.counters);
        self.paths.counters.add_details(&details);
        let WaitingWorker { paths, samples, stacks, claims, batch, heads, shadows, .. } = self;
        for (slot, place) in batch.iter().enumerate() {
            let sample = samples.get_mut(*place);
            sample.radiance = paths.radiance[slot];
            sample.lost = paths.lost[slot];
            sample.lost_by_shadows = paths.lost_by_shadows.get(slot).copied().unwrap_or(0.0);
            sample.head = None;
            let (first, count) = (slot * paths.stack_depth, usize::from(paths.waiting_counts[slot]));
            let had_top = sample.stack != NONE;
            if had_top && count == 0 {
                stacks.pop(&mut sample.stack);
            }
            for above in first + usize::from(had_top)..first + count {
                let walk = paths.waiting_walks.get_mut(above).and_then(Option::take);
                if let Some(ray) = paths.waiting[above].take() {
                    stacks.push(&mut sample.stack, ray, walk);
                }
            }
        }
        for (index, head) in paths.next_heads.iter().enumerate() {
            let place = batch[head.slot as usize];
            let ray = paths.next_rays[index];
            let sample = samples.get_mut(place);
            sample.head = Some(*head);
            sample.ray = ray;
            sample.open += 1;
            if let Some(walk) = paths.next_walks.get(index) {
                samples.set_walk(place, *walk);
            }
            heads.push(ClosestRequest { ray, after: None, tag: place.into() });
        }
        for open in paths.shadows.take_open() {
            let place = batch[open.slot as usize];
            let ray = open.ray;
            let claim = claims.add(place, samples.get_mut(place), open);
            shadows.push(AnyRequest { ray, tag: claim.into() });
        }
        for index in 0..self.batch.len() {
            let place = self.batch[index];
            if self.samples.get(place).open == 0 {
                self.settle(place);
            }
        }
        self.ask()
    }

    /// Asks the pool for all that is to be asked, and for what follows from its answers.
    fn ask(&mut self) -> Result<(), TraceError> {
        let start = Instant::now();
        loop {
            let pool = &mut self.paths.query.geometry.pool;
            if !self.heads.is_empty() {
                let rest = self.heads.len().saturating_sub(ASKED_MAX);
                pool.closest_hits(&self.heads[rest..], PATH, &mut self.answers)?;
                self.heads.truncate(rest);
            } else if !self.walks.is_empty() {
                let rest = self.walks.len().saturating_sub(ASKED_MAX);
                pool.closest_hits(&self.walks[rest..], SHADOW, &mut self.answers)?;
                self.walks.truncate(rest);
            } else if !self.shadows.is_empty() {
                let rest = self.shadows.len().saturating_sub(ASKED_MAX);
                pool.occluded(&self.shadows[rest..], SHADOW, &mut self.answers)?;
                self.shadows.truncate(rest);
            } else {
                break;
            }
            self.take_answers()?;
        }
        self.paths.seconds.paths += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Has the pool load a block and run what waits for it; whether anything waited.
    fn resume(&mut self) -> Result<bool, TraceError> {
        let start = Instant::now();
        let ran = self.paths.query.geometry.pool.resume(&mut self.answers)?;
        self.take_answers()?;
        self.paths.seconds.paths += start.elapsed().as_secs_f64();
        self.ask()?;
        Ok(ran)
    }

    fn take_answers(&mut self) -> Result<(), TraceError> {
        let mut answers = std::mem::take(&mut self.answers);
        for (tag, hit) in answers.hits.drain(..) {
            // Tags are what was asked with: places, and claims with a bit above.
            let place = tag as u32;
            if tag & CLAIM == 0 {
                self.take_hit(place, hit)?;
            } else {
                self.paths.counters.shadow_segments += 1;
                self.walk_on(place, hit.as_ref())?;
            }
        }
        for (tag, occlusion) in answers.occlusions.drain(..) {
            self.take_occlusion(tag as u32, occlusion)?;
        }
        self.answers = answers;
        Ok(())
    }

    /// The hit of a sample's head.
    fn take_hit(&mut self, place: u32, hit: Option<Hit>) -> Result<(), TraceError> {
        if self.stage.cut_outs.is_some()
            && let Some(hit) = &hit
            && self.paths.query.is_cut_out(hit)?
        {
            self.paths.query.counters.cutout_rays += 1;
            let ray = self.samples.get(place).ray;
            self.heads.push(ClosestRequest { ray, after: Some((hit.t, hit.triangle)), tag: place.into() });
            return Ok(());
        }
        self.samples.get_mut(place).hit = hit;
        self.answered(place);
        Ok(())
    }

    /// What lies between a claim and its light.
    fn take_occlusion(&mut self, claim: u32, mut occlusion: Occlusion) -> Result<(), TraceError> {
        let stage = self.stage;
        let asked = self.claims.get_mut(claim);
        let (place, ray) = (asked.sample, asked.ray);
        // The pool knows one set of materials that may be passed; this claim passes fewer.
        if occlusion == Occlusion::Filtered && asked.straight_only && stage.shadows {
            self.paths.query.occluded(
                &[ray],
                stage.straight.as_ref(),
                std::slice::from_mut(&mut occlusion),
            )?;
        }
        let asked = self.claims.get_mut(claim);
        match occlusion {
            // Shadows that are traced only because they are forced must not show.
            _ if !stage.shadows => {}
            Occlusion::Clear => {}
            Occlusion::Blocked => asked.contribution = DVec3::ZERO,
            Occlusion::Filtered => {
                asked.walker = Walker::new(claim, &ray);
                self.walks.push(ClosestRequest { ray, after: None, tag: CLAIM | u64::from(claim) });
                return Ok(());
            }
        }
        self.answered(place);
        Ok(())
    }

    /// What a claim meets on its way through surfaces.
    fn walk_on(&mut self, claim: u32, hit: Option<&Hit>) -> Result<(), TraceError> {
        let asked = self.claims.get_mut(claim);
        let (place, ray) = (asked.sample, asked.ray);
        let PathTracer { query, counters, .. } = &mut self.paths;
        let (contribution, lost) = (&mut asked.contribution, &mut asked.lost);
        if asked.walker.meet(self.stage, query, &ray, hit, contribution, lost, counters)? {
            let after = asked.walker.last;
            self.walks.push(ClosestRequest { ray, after, tag: CLAIM | u64::from(claim) });
        } else {
            self.answered(place);
        }
        Ok(())
    }

    /// One answer less is to come.
    fn answered(&mut self, place: u32) {
        let sample = self.samples.get_mut(place);
        sample.open -= 1;
        if sample.open == 0 {
            self.settle(place);
        }
    }

    /// All answers to a sample have come.
    fn settle(&mut self, place: u32) {
        let sample = self.samples.get_mut(place);
        self.claims.settle(sample);
        if sample.head.is_some() {
            self.ready.push_back(place);
        } else {
            self.ended.push(place);
        }
    }

    /// Gives samples that are done to their tiles.
    fn deliver(&mut self, finish: &dyn Fn(u32, &FinishedTile)) {
        for place in self.ended.drain(..) {
            let sample = *self.samples.get(place);
            self.samples.end(place);
            if self.alone == Some(place) {
                self.alone = None;
            }
            let result = (sample.radiance, sample.lost + sample.lost_by_shadows);
            let delivered = self.tiles.deliver(self.stage, sample.tile, sample.index, result);
            self.watch.add_samples(delivered.samples);
            if let Some(cell) = delivered.finished_cell {
                finish(cell, self.tiles.finished());
            }
        }
    }
}

/// What the samples of a batch are of.
fn pixel_samples<'a>(
    batch: &'a [u32],
    samples: &'a Samples,
    tiles: &'a Tiles,
) -> impl Iterator<Item = PixelSample> {
    batch.iter().map(|place| {
        let sample = samples.get(*place);
        tiles.sample(sample.tile, sample.index)
    })
}
