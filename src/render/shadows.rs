//! Shadow rays in batches: what stands between a point and a lamp, and what shines through.

use glam::DVec3;

use super::absorption::absorb;
use super::counters::EffectCounters;
use super::detail::query::SurfaceQuery;
use super::detail::transmission_at;
use super::query::RayQuery;
use super::stage::Stage;
use crate::error::TraceError;
use crate::geom::{Ray, RayFrame, Sense};
use crate::trace::{Hit, Occlusion};
use crate::units::TriangleId;

/// Light that reaches a sample unless something stands in its way.
#[derive(Clone, Copy, Debug)]
struct Claim {
    slot: u32,
    contribution: DVec3,
    /// What it lost for being too faint to be followed.
    lost: f64,
}

/// A claim that is answered after its batch.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpenClaim {
    pub slot: u32,
    pub contribution: DVec3,
    pub ray: Ray,
    /// See [`ShadowBatch::pass_straight_only`].
    pub straight_only: bool,
}

/// A shadow ray on its way through transparent surfaces.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walker {
    claim: u32,
    transmittance: DVec3,
    /// The hit that was seen last.
    pub last: Option<(f64, TriangleId)>,
    /// Where the surface was crossed that was crossed last, or where the ray begins.
    crossed_t: f64,
}

/// Claims of one batch of points. They are added to their samples in the order in which they came, so that neither
/// the batch nor a walk through glass shows in the sum (I2).
#[derive(Debug)]
pub(crate) struct ShadowBatch {
    capacity: usize,
    /// Whether light that a surface would bend counts as hidden: rays find it by themselves.
    straight_only: bool,
    rays: Vec<Ray>,
    claims: Vec<Claim>,
    occlusion: Vec<Occlusion>,
    walkers: Vec<Walker>,
    walk_rays: Vec<Ray>,
    walk_after: Vec<(f64, TriangleId)>,
    walk_hits: Vec<Option<Hit>>,
    /// Where claims go that are answered by somebody else.
    open: Option<Vec<OpenClaim>>,
}

impl ShadowBatch {
    pub fn new(capacity: usize, with_walks: bool) -> ShadowBatch {
        let walks = if with_walks { capacity } else { 0 };
        ShadowBatch {
            capacity,
            straight_only: false,
            rays: Vec::with_capacity(capacity),
            claims: Vec::with_capacity(capacity),
            occlusion: vec![Occlusion::Clear; capacity],
            walkers: Vec::with_capacity(walks),
            walk_rays: Vec::with_capacity(walks),
            walk_after: Vec::with_capacity(walks),
            walk_hits: vec![None; walks],
            open: None,
        }
    }

    /// From now on, claims are not answered here: [`ShadowBatch::resolve`] leaves them, at most `most` of them, to who calls
    /// [`ShadowBatch::take_open`].
    pub(super) fn leave_open(&mut self, most: usize) {
        self.open = Some(Vec::with_capacity(most));
    }

    /// The claims that were left open, in the order in which they came.
    pub(super) fn take_open(&mut self) -> impl Iterator<Item = OpenClaim> + '_ {
        self.open.iter_mut().flat_map(|open| open.drain(..))
    }

    /// What [`ShadowBatch::new`] allocates.
    pub fn bytes_needed(capacity: usize, with_walks: bool) -> usize {
        let claim = size_of::<Ray>() + size_of::<Claim>() + size_of::<Occlusion>();
        let walk = size_of::<Walker>()
            + size_of::<Ray>()
            + size_of::<(f64, TriangleId)>()
            + size_of::<Option<Hit>>();
        capacity * (claim + if with_walks { walk } else { 0 })
    }

    /// Gives up what was not answered.
    pub fn forget(&mut self) {
        self.rays.clear();
        self.claims.clear();
        self.walkers.clear();
        self.straight_only = false;
    }

    pub fn is_full(&self) -> bool {
        self.claims.len() == self.capacity
    }

    pub fn is_empty(&self) -> bool {
        self.claims.is_empty()
    }

    /// Whether the claims to come pass only surfaces that do not bend light. The batch must be empty.
    pub fn pass_straight_only(&mut self, straight_only: bool) {
        debug_assert!(self.is_empty());
        self.straight_only = straight_only;
    }

    /// Adds a claim of the sample in `slot`.
    ///
    /// # Panics
    /// If the batch is full, in builds with debug assertions.
    pub fn push(&mut self, slot: u32, contribution: DVec3, ray: Ray) {
        debug_assert!(!self.is_full());
        self.rays.push(ray);
        self.claims.push(Claim { slot, contribution, lost: 0.0 });
    }

    /// `times`: when each sample is taken, if instances move. Answers all claims, adds what reaches `radiance`, and is empty again.
    /// Light too weak to be followed through more surfaces is added to `lost`, which may be empty where no surface is transparent.
    pub fn resolve<Q: RayQuery>(
        &mut self,
        stage: &Stage,
        query: &mut SurfaceQuery<'_, Q>,
        times: &[f64],
        radiance: &mut [DVec3],
        lost: &mut [f64],
        counters: &mut EffectCounters,
    ) -> Result<(), TraceError> {
        let count = self.claims.len();
        if let Some(open) = &mut self.open {
            counters.shadow_rays += count as u64;
            let straight_only = self.straight_only;
            open.extend(self.claims.drain(..).zip(self.rays.drain(..)).map(|(claim, ray)| OpenClaim {
                slot: claim.slot,
                contribution: claim.contribution,
                ray,
                straight_only,
            }));
            return Ok(());
        }
        let occlusion = &mut self.occlusion[..count];
        let passed = if self.straight_only { &stage.straight } else { &stage.transparent };
        if !times.is_empty() {
            query.at_times(&mut self.claims.iter().map(|claim| times[claim.slot as usize]));
        }
        query.occluded(&self.rays, passed.as_ref(), occlusion)?;
        counters.shadow_rays += count as u64;
        if passed.is_none() || !occlusion.contains(&Occlusion::Filtered) {
            // Nothing shines through, so that the answers are all there is. Shadows that are traced only because they are forced
            // must not show.
            for (claim, answer) in self.claims.iter().zip(&*occlusion) {
                if *answer == Occlusion::Clear || !stage.shadows {
                    radiance[claim.slot as usize] += claim.contribution;
                }
            }
            self.rays.clear();
            self.claims.clear();
            return Ok(());
        }
        // Shadows that are traced only because they are forced must not show.
        if stage.shadows {
            for (index, answer) in occlusion.iter().enumerate() {
                match answer {
                    Occlusion::Clear => {}
                    Occlusion::Blocked => self.claims[index].contribution = DVec3::ZERO,
                    Occlusion::Filtered => {
                        self.walkers.push(Walker::new(index as u32, &self.rays[index]));
                    }
                }
            }
            self.walk(stage, query, times, counters)?;
        }
        for claim in &self.claims {
            radiance[claim.slot as usize] += claim.contribution;
        }
        // In the order of the claims, whichever batch they were in (I2).
        if !lost.is_empty() {
            for claim in &self.claims {
                lost[claim.slot as usize] += claim.lost;
            }
        }
        self.rays.clear();
        self.claims.clear();
        Ok(())
    }

    /// Takes every walker from surface to surface, in the order of (t, triangle id), until it is through or too weak.
    /// Light goes straight: refraction would bend it away from the lamp.
    fn walk<Q: RayQuery>(
        &mut self,
        stage: &Stage,
        query: &mut SurfaceQuery<'_, Q>,
        times: &[f64],
        counters: &mut EffectCounters,
    ) -> Result<(), TraceError> {
        let mut is_first = true;
        while !self.walkers.is_empty() {
            let count = self.walkers.len();
            self.walk_rays.clear();
            self.walk_after.clear();
            for walker in &self.walkers {
                self.walk_rays.push(self.rays[walker.claim as usize]);
                self.walk_after.extend(walker.last);
            }
            if !times.is_empty() {
                let slot_of = |walker: &Walker| self.claims[walker.claim as usize].slot as usize;
                query.at_times(&mut self.walkers.iter().map(|walker| times[slot_of(walker)]));
            }
            let hits = &mut self.walk_hits[..count];
            if is_first {
                query.closest_hits(&self.walk_rays, hits)?;
            } else {
                query.closest_hits_after(&self.walk_rays, &self.walk_after, hits)?;
            }
            is_first = false;
            counters.shadow_segments += count as u64;

            let mut left = 0;
            for index in 0..count {
                let mut walker = self.walkers[index];
                let (ray, hit) = (&self.walk_rays[index], self.walk_hits[index]);
                let Claim { contribution, lost, .. } = &mut self.claims[walker.claim as usize];
                if walker.meet(stage, query, ray, hit.as_ref(), contribution, lost, counters)? {
                    self.walkers[left] = walker;
                    left += 1;
                }
            }
            self.walkers.truncate(left);
        }
        Ok(())
    }
}

impl Walker {
    /// At the beginning of `ray`, which is that of a claim.
    pub fn new(claim: u32, ray: &Ray) -> Walker {
        Walker { claim, transmittance: DVec3::ONE, last: None, crossed_t: ray.t_min }
    }

    /// Takes it to what it meets next, if anything. False if it is through, or what is left of the `contribution` is too weak to be
    /// followed: it is lost then.
    ///
    /// # Errors
    /// Those of the query, where a picture says how much passes.
    #[expect(clippy::too_many_arguments, reason = "all belong to one claim")]
    pub fn meet<Q: RayQuery>(
        &mut self,
        stage: &Stage,
        query: &mut SurfaceQuery<'_, Q>,
        ray: &Ray,
        hit: Option<&Hit>,
        contribution: &mut DVec3,
        lost: &mut f64,
        counters: &mut EffectCounters,
    ) -> Result<bool, TraceError> {
        let Some(hit) = hit else {
            *contribution *= self.transmittance;
            return Ok(false);
        };
        self.pass(stage, query, ray, hit, counters)?;
        let left = (*contribution * self.transmittance).max_element();
        // Roulette has decided before whether it is worth asking.
        let goes_on = left > if stage.roulette { 0.0 } else { stage.settings.contribution_bound };
        if !goes_on {
            counters.contribution_cuts += u64::from(left > 0.0);
            *lost = left;
            *contribution = DVec3::ZERO;
        }
        Ok(goes_on)
    }

    /// Takes it through the surface at `hit` and through the inside that ends there.
    fn pass<Q: RayQuery>(
        &mut self,
        stage: &Stage,
        query: &mut SurfaceQuery<'_, Q>,
        ray: &Ray,
        hit: &Hit,
        counters: &mut EffectCounters,
    ) -> Result<(), TraceError> {
        self.last = Some((hit.t, hit.triangle));
        // At an edge or a vertex every triangle there is hit, and the surface is crossed once.
        let Some(sense) = RayFrame::new(ray).crossing(&hit.vertices) else { return Ok(()) };
        let shader = stage.shader(hit.material);
        let mut share = DVec3::splat(transmission_at(stage, query, hit)?);
        if sense == Sense::Exit && shader.absorption != DVec3::ZERO {
            counters.absorbed_segments += 1;
            let distance = (hit.t - self.crossed_t) * DVec3::from_array(ray.direction).length();
            // Two crossings at one point may come in either order.
            share *= absorb(shader.absorption, distance.max(0.0));
        }
        self.transmittance *= share;
        self.crossed_t = hit.t;
        Ok(())
    }
}
