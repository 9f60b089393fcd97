//! Ray trees of a batch of samples: no recursion, no limit on depth, memory fixed in advance.
//!
//! Every sample of the batch walks its tree depth first, all samples in step: one ray per live sample goes into each
//! query. Where a ray splits, its work budget is divided, the child with the smaller part goes on and the other waits
//! on the sample's own stack; so `log2(work budget)` places are enough however deep the tree is. Each
//! sample adds up its light in the order of its own tree, so neither batch nor tile nor thread shows in the sum (I2).

use std::time::Instant;

use glam::DVec3;

use super::counters::EffectCounters;
use super::optics::{absorb, reflect, split};
use super::query::RayQuery;
use super::report::WorkerSeconds;
use super::shadows::ShadowBatch;
use super::stage::{Shader, Stage};
use crate::error::TraceError;
use crate::geom::{Ray, offset_origin};
use crate::trace::Hit;
use crate::units::MaterialId;

/// How a ray came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Reflection,
    Transmission,
}

/// The ray of a sample that is about to be traced; the ray itself stands beside it in a list of its own.
#[derive(Clone, Copy, Debug)]
struct Head {
    slot: u32,
    /// Rays that the tree below may hold, this one included.
    work: u64,
    throughput: DVec3,
}

/// A ray that waits for its sibling's tree to end.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    ray: Ray,
    work: u64,
    throughput: DVec3,
}

/// A hit that is being shaded.
#[derive(Clone, Copy, Debug)]
struct Point {
    slot: u32,
    material: MaterialId,
    throughput: DVec3,
    position: DVec3,
    /// Unit, on the side from which the ray came.
    normal: DVec3,
    /// Start of rays on that side.
    origin: [f64; 3],
    /// Unit, back along the ray.
    view: DVec3,
}

/// A ray that a hit spawns.
#[derive(Clone, Copy, Debug)]
struct Child {
    kind: Kind,
    direction: DVec3,
    throughput: DVec3,
    origin: [f64; 3],
}

/// Traces batches of samples; one per thread.
pub(crate) struct PathTracer<'s, Q> {
    stage: &'s Stage,
    /// Most rays of one call.
    pub batch_samples: usize,
    pub query: Q,
    pub counters: EffectCounters,
    pub seconds: WorkerSeconds,
    heads: Vec<Head>,
    rays: Vec<Ray>,
    next_heads: Vec<Head>,
    next_rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    points: Vec<Point>,
    /// `stack_depth` places per slot.
    waiting: Vec<Option<Waiting>>,
    waiting_counts: Vec<u8>,
    stack_depth: usize,
    radiance: Vec<DVec3>,
    /// Per slot: the most that any channel may lack because something was not followed.
    lost: Vec<f64>,
    shadows: ShadowBatch,
    /// Rays of forced effects that cannot matter.
    forced: Vec<Ray>,
}

/// Sizes of the lists, all fixed by the settings.
#[derive(Clone, Copy, Debug)]
struct Sizes {
    batch: usize,
    stack_depth: usize,
    shadows: usize,
    forced: usize,
}

impl Sizes {
    fn of(stage: &Stage) -> Sizes {
        let batch = stage.settings.batch_samples.min(tile_samples_max(stage)) as usize;
        let lamps = stage.emitters.len().clamp(1, 4);
        Sizes {
            batch,
            // Only a surface that both passes and reflects can split a ray.
            stack_depth: if stage.transmission && stage.reflection {
                stage.settings.work_budget.ilog2() as usize + 1
            } else {
                0
            },
            shadows: if stage.shadows || stage.force_shadows { batch * lamps } else { 0 },
            forced: if stage.force_reflection || stage.force_transmission { 2 * batch } else { 0 },
        }
    }
}

impl<'s, Q: RayQuery> PathTracer<'s, Q> {
    pub fn new(stage: &'s Stage, query: Q) -> PathTracer<'s, Q> {
        let sizes = Sizes::of(stage);
        PathTracer {
            stage,
            batch_samples: sizes.batch,
            query,
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
            shadows: ShadowBatch::new(sizes.shadows, stage.transparent.is_some()),
            forced: Vec::with_capacity(sizes.forced),
        }
    }

    /// Computes the radiance of each camera ray, in their order. At most [`PathTracer::batch_samples`] rays.
    ///
    /// # Errors
    /// Those of the query; nothing that was computed is to be used then.
    pub fn trace(&mut self, camera_rays: impl Iterator<Item = Ray>) -> Result<(), TraceError> {
        self.heads.clear();
        self.rays.clear();
        self.radiance.clear();
        self.lost.clear();
        let work = self.stage.settings.work_budget;
        for (slot, ray) in camera_rays.enumerate() {
            self.rays.push(ray);
            self.heads.push(Head { slot: slot as u32, work, throughput: DVec3::ONE });
        }
        self.radiance.resize(self.heads.len(), DVec3::ZERO);
        self.lost.resize(self.heads.len(), 0.0);
        self.counters.samples += self.heads.len() as u64;
        self.counters.primary_rays += self.heads.len() as u64;
        while !self.heads.is_empty() {
            self.step()?;
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

    /// Traces the head of every live sample, shades what was hit and moves each sample to the next ray of its tree.
    fn step(&mut self) -> Result<(), TraceError> {
        let start = Instant::now();
        let hits = &mut self.hits[..self.rays.len()];
        self.query.closest_hits(&self.rays, hits)?;
        let traced = Instant::now();
        self.seconds.paths += (traced - start).as_secs_f64();
        self.shade();
        self.seconds.shading += traced.elapsed().as_secs_f64();
        if self.stage.direct {
            self.light()?;
        }
        if !self.forced.is_empty() {
            let forced = &self.forced;
            self.hits.resize(self.hits.len().max(forced.len()), None);
            self.query.closest_hits(forced, &mut self.hits[..forced.len()])?;
            self.counters.forced_rays += forced.len() as u64;
            self.forced.clear();
        }
        std::mem::swap(&mut self.heads, &mut self.next_heads);
        std::mem::swap(&mut self.rays, &mut self.next_rays);
        Ok(())
    }

    /// Adds background, emission and ambient light, lists the points to be lit, and spawns children.
    fn shade(&mut self) {
        self.points.clear();
        self.next_heads.clear();
        self.next_rays.clear();
        for index in 0..self.heads.len() {
            let mut head = self.heads[index];
            let slot = head.slot as usize;
            let Some(hit) = self.hits[index] else {
                self.radiance[slot] += head.throughput * self.stage.background;
                self.advance_from_stack(head.slot);
                continue;
            };
            let shader = self.stage.shader(hit.material);
            let direction = DVec3::from_array(self.rays[index].direction);
            let geometric = DVec3::from_array(hit.normal());
            let is_behind = geometric.dot(direction) > 0.0;
            // The normal of a needle may vanish in rounding; then the surface is taken to face the ray.
            let normal = geometric.try_normalize().map_or(-direction, |n| if is_behind { -n } else { n });
            if is_behind && shader.transmission > 0.0 {
                // The segment that ends here ran through the inside.
                head.throughput *= absorb(shader.absorption, hit.t);
            }
            self.radiance[slot] += head.throughput * (shader.emission + shader.diffuse * self.stage.ambient);
            let origin_on = |side: DVec3| {
                offset_origin(hit.position(), hit.position_error(), hit.normal(), side.to_array())
            };
            let point = Point {
                slot: head.slot,
                material: hit.material,
                throughput: head.throughput,
                position: DVec3::from_array(hit.position()),
                normal,
                origin: origin_on(normal),
                view: -direction,
            };
            if self.stage.direct && (shader.is_lit || self.stage.force_shadows) {
                self.points.push(point);
            }
            self.spawn(&head, shader, &point, is_behind, || origin_on(-normal));
        }
    }

    /// Decides which rays leave `point`, and makes one the sample's next head.
    fn spawn(
        &mut self,
        head: &Head,
        shader: &Shader,
        point: &Point,
        is_behind: bool,
        far_origin: impl Fn() -> [f64; 3],
    ) {
        let stage = self.stage;
        let direction = -point.view;
        let mut reflected = shader.mirror;
        let mut transmitted = shader.transmission;
        let mut onward = Some(direction);
        if shader.transmission > 0.0 && shader.refractive_index != 1.0 {
            let index = shader.refractive_index;
            let fresnel = split(direction, point.normal, if is_behind { index } else { 1.0 / index });
            reflected += DVec3::splat(shader.transmission * fresnel.reflectance);
            transmitted = shader.transmission * (1.0 - fresnel.reflectance);
            onward = fresnel.refracted;
        }
        let remaining = head.work - 1;
        let candidate = |kind: Kind, weight: DVec3| {
            let throughput = head.throughput * weight;
            let worth = stage.is_worth_following(throughput, remaining.max(1));
            (kind, throughput, throughput.max_element() > 0.0, worth)
        };
        let candidates = [
            candidate(Kind::Transmission, DVec3::splat(if onward.is_some() { transmitted } else { 0.0 })),
            candidate(Kind::Reflection, if stage.reflection { reflected } else { DVec3::ZERO }),
        ];
        let mut children: [Option<Child>; 2] = [None; 2];
        for (child, (kind, throughput, carries, worth)) in children.iter_mut().zip(candidates) {
            let make = || match kind {
                Kind::Transmission => {
                    Child { kind, direction: onward.unwrap_or(direction), throughput, origin: far_origin() }
                }
                Kind::Reflection => Child {
                    kind,
                    direction: reflect(direction, point.normal),
                    throughput,
                    origin: point.origin,
                },
            };
            if worth {
                *child = Some(make());
                continue;
            }
            if carries {
                self.counters.contribution_cuts += 1;
                self.lost[head.slot as usize] += throughput.max_element() * stage.radiance_max();
            }
            let forced =
                if kind == Kind::Transmission { stage.force_transmission } else { stage.force_reflection };
            if forced {
                let child = make();
                self.forced.push(Ray::new(child.origin, child.direction.to_array()));
            }
        }
        self.follow(head.slot, remaining, children);
    }

    /// Divides `work` among the children by the square root of their throughput: by throughput itself faint but long
    /// chains starve, in equal parts the main path through a stack of panes does. The child with less work becomes the sample's head and
    /// the other waits: so the head's work at least halves whenever a ray comes to wait, which bounds the stack.
    fn follow(&mut self, slot: u32, work: u64, children: [Option<Child>; 2]) {
        let [first, second] = match children {
            [Some(a), Some(b)] if work >= 2 => {
                let (a_weight, b_weight) =
                    (a.throughput.max_element().sqrt(), b.throughput.max_element().sqrt());
                let share = (work as f64 * (a_weight / (a_weight + b_weight))) as u64;
                let a_work = share.clamp(1, work - 1);
                let pair = [(a, a_work), (b, work - a_work)];
                if pair[0].1 <= pair[1].1 { pair.map(Some) } else { [Some(pair[1]), Some(pair[0])] }
            }
            // One ray is left: the child that carries more has it.
            [Some(a), Some(b)] => {
                let (heavier, lighter) =
                    if b.throughput.max_element() > a.throughput.max_element() { (b, a) } else { (a, b) };
                self.cut_work(slot, &lighter);
                [Some((heavier, work)), None]
            }
            [Some(only), None] | [None, Some(only)] => [Some((only, work)), None],
            [None, None] => [None, None],
        };
        if let Some((child, work)) = second {
            let place = slot as usize * self.stack_depth + usize::from(self.waiting_counts[slot as usize]);
            let ray = self.count_ray(&child);
            self.waiting[place] = Some(Waiting { ray, work, throughput: child.throughput });
            self.waiting_counts[slot as usize] += 1;
        }
        match first {
            Some((child, work)) if work > 0 => {
                let ray = self.count_ray(&child);
                self.next_rays.push(ray);
                self.next_heads.push(Head { slot, work, throughput: child.throughput });
            }
            cut => {
                if let Some((child, _)) = cut {
                    self.cut_work(slot, &child);
                }
                self.advance_from_stack(slot);
            }
        }
    }

    /// Books a ray for which no work is left.
    fn cut_work(&mut self, slot: u32, child: &Child) {
        self.counters.work_cuts += 1;
        self.lost[slot as usize] += child.throughput.max_element() * self.stage.radiance_max();
    }

    fn count_ray(&mut self, child: &Child) -> Ray {
        match child.kind {
            Kind::Reflection => self.counters.reflection_rays += 1,
            Kind::Transmission => self.counters.transmission_rays += 1,
        }
        Ray::new(child.origin, child.direction.to_array())
    }

    /// Makes the ray that waited last the sample's head; without one the sample is done.
    fn advance_from_stack(&mut self, slot: u32) {
        let count = &mut self.waiting_counts[slot as usize];
        if *count == 0 {
            return;
        }
        *count -= 1;
        let place = slot as usize * self.stack_depth + usize::from(*count);
        if let Some(waiting) = self.waiting[place].take() {
            self.next_rays.push(waiting.ray);
            self.next_heads.push(Head { slot, work: waiting.work, throughput: waiting.throughput });
        }
    }

    /// Adds the light of every lamp at every point, lamp by lamp: rays to one lamp stay together, and each sample
    /// sums its lamps in the scene's order.
    fn light(&mut self) -> Result<(), TraceError> {
        let stage = self.stage;
        let with_rays = stage.shadows || stage.force_shadows;
        let mut start = Instant::now();
        for emitter in &stage.emitters {
            for index in 0..self.points.len() {
                let point = &self.points[index];
                let shader = stage.shader(point.material);
                let incidence = emitter.incidence(point.position);
                let cosine = incidence.toward.dot(point.normal);
                let mut contribution = DVec3::ZERO;
                if cosine > 0.0 {
                    let mut response = shader.diffuse * cosine;
                    if shader.highlight != DVec3::ZERO {
                        let half = (incidence.toward + point.view).normalize_or_zero();
                        let alignment = half.dot(point.normal).clamp(0.0, 1.0);
                        response += shader.highlight * shader.exponent.of(alignment);
                    }
                    contribution = point.throughput * response * incidence.irradiance;
                }
                let largest = contribution.max_element();
                if largest <= stage.settings.contribution_bound {
                    self.counters.contribution_cuts += u64::from(largest > 0.0);
                    self.lost[point.slot as usize] += largest;
                    contribution = DVec3::ZERO;
                    if !stage.force_shadows {
                        continue;
                    }
                }
                if !with_rays {
                    self.radiance[point.slot as usize] += contribution;
                    continue;
                }
                let ray = emitter.shadow_ray(point.origin, point.normal);
                self.shadows.push(point.slot, contribution, ray);
                if self.shadows.is_full() {
                    start = self.resolve_shadows(start)?;
                }
            }
        }
        if !self.shadows.is_empty() {
            start = self.resolve_shadows(start)?;
        }
        self.seconds.shading += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Resolves the shadow batch; books the time since `start` as shading and the rest as shadows.
    fn resolve_shadows(&mut self, start: Instant) -> Result<Instant, TraceError> {
        let shaded = Instant::now();
        self.seconds.shading += (shaded - start).as_secs_f64();
        let lost = &mut self.lost;
        self.shadows.resolve(self.stage, &mut self.query, &mut self.radiance, lost, &mut self.counters)?;
        let resolved = Instant::now();
        self.seconds.shadows += (resolved - shaded).as_secs_f64();
        Ok(resolved)
    }
}

/// Most samples that a tile can hold, saturated: larger batches never come about.
fn tile_samples_max(stage: &Stage) -> u32 {
    let settings = &stage.settings;
    let pixels = settings.tile_size.min(settings.width) * settings.tile_size.min(settings.height);
    pixels.saturating_mul(settings.samples_per_pixel)
}

/// What [`PathTracer::new`] allocates for `stage`, in bytes.
pub(crate) fn bytes_needed(stage: &Stage) -> usize {
    let sizes = Sizes::of(stage);
    let per_sample = 2 * (size_of::<Head>() + size_of::<Ray>())
        + size_of::<Option<Hit>>()
        + size_of::<Point>()
        + sizes.stack_depth * size_of::<Option<Waiting>>()
        + size_of::<u8>()
        + size_of::<DVec3>()
        + size_of::<f64>();
    sizes.batch * per_sample
        + ShadowBatch::bytes_needed(sizes.shadows, stage.transparent.is_some())
        + sizes.forced * (size_of::<Ray>() + size_of::<Option<Hit>>())
}
