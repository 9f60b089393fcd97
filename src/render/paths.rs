//! Ray trees of a batch of samples: no recursion, no limit on depth, memory fixed in advance.
//!
//! Every sample of the batch walks its tree depth first, all samples in step: one ray per live sample goes into each
//! query. Where a ray splits, its work budget is divided, the child with the smaller part goes on and the other waits
//! on the sample's own stack; so `log2(work budget)` places are enough however deep the tree is. Each
//! sample adds up its light in the order of its own tree, so neither batch nor tile nor thread shows in the sum (I2).

use std::time::Instant;

use glam::DVec3;

use super::bounce::{Walk, bounce};
use super::counters::EffectCounters;
use super::detail::normals::on_side;
use super::detail::query::SurfaceQuery;
use super::detail::{Detail, Seen};
use super::glossy;
use super::hot::{Detailed, EffectsOfLoop, Matt, Sampled, Whitted};
use super::lamps::Scatter;
use super::media::{Borders, index_ratio};
use super::optics::{absorb, reflect, split};
use super::path_sizes::Sizes;
use super::query::RayQuery;
use super::random::Dimension;
use super::report::WorkerSeconds;
use super::shadows::ShadowBatch;
use super::stage::{Loop, PixelSample, Shader, Stage};
use crate::error::TraceError;
use crate::geom::{Ray, offset_origin};
use crate::trace::Hit;
use crate::units::MaterialId;

/// How a ray came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Transmission,
    Reflection,
    Bounce,
}

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

/// A ray that a hit spawns.
#[derive(Clone, Copy, Debug)]
struct Child {
    kind: Kind,
    direction: DVec3,
    throughput: DVec3,
    origin: [f64; 3],
    /// How its direction came about.
    course: Course,
}

/// What rays leave.
#[derive(Clone, Copy, Debug)]
struct Leaving {
    normal: DVec3,
    /// Roughness, and whether it splits light by Fresnel's equations, at this place.
    alpha: f64,
    is_glass: bool,
}

impl Leaving {
    fn new(shader: &Shader, normal: DVec3) -> Leaving {
        Leaving { normal, alpha: shader.alpha, is_glass: shader.is_glass() }
    }
}

#[derive(Clone, Copy, Debug)]
enum Course {
    /// As the ray came.
    Straight,
    /// By the law of reflection or refraction.
    Lawful,
    /// By luck, with this density over solid angle.
    Sampled(f64),
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
    borders: Borders,
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

    /// Adds background, emission and ambient light, lists the points to be lit, and spawns children.
    fn shade<E: EffectsOfLoop>(&mut self) -> Result<(), TraceError> {
        self.points.clear();
        self.scatters.clear();
        self.details.clear();
        self.next_heads.clear();
        self.next_rays.clear();
        self.next_walks.clear();
        let stage = self.stage;
        for index in 0..self.rays.len() {
            let mut head = self.head::<E>(index);
            let slot = head.slot as usize;
            let border = if E::SAMPLED && stage.nested { Some(self.borders.borders[index]) } else { None };
            let inside = border.and_then(|border| border.before);
            let Some(hit) = self.hits[index] else {
                if E::SAMPLED {
                    let (ray, walk) = (self.rays[index], self.walks[index]);
                    let medium = inside.map_or(DVec3::ZERO, |medium| stage.shader(medium).absorption);
                    let mut seen = self.gathered(&ray, &walk, f64::INFINITY, medium);
                    seen += self.seen_beyond(&ray, &walk) * absorb(medium, f64::INFINITY);
                    self.radiance[slot] += head.throughput * seen;
                } else {
                    self.radiance[slot] += head.throughput * stage.background;
                }
                self.advance_from_stack::<E>(head.slot);
                continue;
            };
            let shader = stage.shader(hit.material);
            let direction = DVec3::from_array(self.rays[index].direction);
            let (position, geometric) = (hit.position(), DVec3::from_array(hit.normal()));
            let is_behind = geometric.dot(direction) > 0.0;
            // The normal of a needle may vanish in rounding; then the surface is taken to face the ray.
            let normal = geometric.try_normalize().map_or(-direction, |n| if is_behind { -n } else { n });
            // The segment that ends here ran through the inside.
            let medium = match inside {
                Some(medium) => stage.shader(medium).absorption,
                None if border.is_none() && is_behind && shader.transmission_max > 0.0 => shader.absorption,
                None => DVec3::ZERO,
            };
            if E::SAMPLED && !stage.areas.is_empty() {
                let (ray, walk) = (self.rays[index], self.walks[index]);
                let gathered = self.gathered(&ray, &walk, hit.t, medium);
                self.radiance[slot] += head.throughput * gathered;
            }
            if E::SECONDARY && medium != DVec3::ZERO {
                self.counters.absorbed_segments += 1;
                head.throughput *= absorb(medium, hit.t);
            } else if E::SECONDARY && stage.force_absorption {
                head.throughput *= DVec3::ONE + absorb(DVec3::ONE, hit.t) * 0.0;
            }
            let error = border.map_or(hit.position_error(), |border| border.error.max(hit.position_error()));
            let origin_on =
                |side: DVec3| offset_origin(position, error, geometric.to_array(), side.to_array());
            if E::SAMPLED && border.is_some_and(|border| border.is_none()) {
                // Two bodies overlap, and this surface is inside the stronger one.
                self.counters.passed_surfaces += 1;
                let child = Child {
                    kind: Kind::Transmission,
                    direction,
                    throughput: head.throughput,
                    origin: origin_on(-normal),
                    course: Course::Straight,
                };
                self.follow::<E>(index, &head, &Leaving::new(shader, normal), [Some(child), None, None]);
                continue;
            }
            let mut point = Point {
                slot: head.slot,
                material: hit.material,
                throughput: head.throughput,
                position: DVec3::from_array(position),
                normal,
                origin: origin_on(normal),
                view: -direction,
            };
            let local;
            let mut shader = shader;
            let mut place = Scatter::OF_MATERIAL;
            if E::DETAILED {
                let width = self.walks[index].cone.width_at(hit.t);
                let seen = Seen { geometric: normal, is_behind, view: -direction, width };
                if stage.are_moving {
                    self.query.at_time(self.times[slot]);
                }
                let detail = Detail::at(stage, &mut self.query, &mut self.counters, &hit, shader, &seen)?;
                point.normal = detail.normal;
                if stage.forced_details.is_some() {
                    self.radiance[slot] += head.throughput * (detail.forced * 0.0);
                }
                if detail.lift != DVec3::ZERO {
                    // The offset keeps its side: the lift never leads to the other.
                    point.position += detail.lift;
                    point.origin = (DVec3::from_array(point.origin) + detail.lift).to_array();
                }
                if let Some(found) = detail.shader {
                    // As many as there are points, which are as many as there are samples.
                    place = self.details.len() as u32;
                    self.details.push(found);
                    local = found;
                    shader = &local;
                }
            }
            let glow =
                if E::DETAILED { shader.emission + shader.diffuse * stage.ambient } else { shader.glow };
            self.radiance[slot] += head.throughput * glow;
            if E::SECONDARY {
                self.counters.glowing_hits += u64::from(shader.glows);
                if stage.force_emission {
                    // Black, as the plan left it.
                    self.radiance[slot] += head.throughput * shader.emission;
                }
            }
            let is_lit = stage.direct || E::SAMPLED && stage.samples_lights();
            let eta =
                if E::SECONDARY { index_ratio(stage, shader, border.as_ref(), is_behind) } else { None };
            let is_forced =
                stage.force_shadows || E::SAMPLED && (stage.force_areas || stage.force_environment);
            if is_lit && (shader.is_lit || is_forced) {
                self.points.push(point);
                if E::SAMPLED {
                    let walk = self.walks[index];
                    let vertex = walk.vertex;
                    let far_origin = origin_on(-normal);
                    self.scatters.push(Scatter { walk, vertex, far_origin, eta, detail: place });
                }
            }
            if E::SECONDARY {
                self.spawn::<E>(index, &head, shader, &point, normal, eta, || origin_on(-normal));
            }
        }
        Ok(())
    }

    /// Decides which rays leave `point`, whose triangle has the normal `geometric`, and makes one the sample's next head.
    #[expect(clippy::too_many_arguments, reason = "all belong to one hit")]
    fn spawn<E: EffectsOfLoop>(
        &mut self,
        index: usize,
        head: &Head,
        shader: &Shader,
        point: &Point,
        geometric: DVec3,
        eta: Option<f64>,
        far_origin: impl Fn() -> [f64; 3],
    ) {
        let stage = self.stage;
        let direction = -point.view;
        let mut reflected = shader.mirror;
        let mut transmitted = shader.transmission;
        let mut onward = Some(direction);
        let mut away = None;
        // Whether the direction onward is that of the ray; and the densities of directions found by luck.
        let mut course = [if eta.is_some() { Course::Lawful } else { Course::Straight }, Course::Lawful];
        let mut facet = point.normal;
        let is_rough = E::SAMPLED && shader.alpha > 0.0;
        if is_rough {
            let walk = &self.walks[index];
            let uv = walk.key.pair(walk.vertex, Dimension::Microfacet);
            self.counters.random_numbers += 2;
            let of_lobe = match shader.is_glass() {
                true => &mut self.counters.frosted_numbers,
                false => &mut self.counters.glossy_numbers,
            };
            *of_lobe += 2;
            facet = glossy::sample_facet(point.normal, point.view, shader.alpha, uv);
        }
        if let Some(eta) = eta {
            let fresnel = split(direction, facet, eta);
            reflected += DVec3::splat(shader.transmission * fresnel.reflectance);
            transmitted = shader.transmission * (1.0 - fresnel.reflectance);
            onward = fresnel.refracted;
        }
        if is_rough {
            let (normal, view, alpha) = (point.normal, point.view, shader.alpha);
            let mirrored = reflect(direction, facet);
            let lobe = glossy::reflection(normal, view, alpha, mirrored, None);
            reflected *= lobe.map_or(0.0, |lobe| lobe.weight);
            (away, course[1]) = (Some(mirrored), Course::Sampled(lobe.map_or(0.0, |lobe| lobe.density)));
            if let (Some(eta), Some(refracted)) = (eta, onward) {
                let lobe = glossy::refraction(normal, view, alpha, refracted, eta);
                transmitted *= lobe.map_or(0.0, |lobe| lobe.weight);
                course[0] = Course::Sampled(lobe.map_or(0.0, |lobe| lobe.density));
            }
        }
        if E::DETAILED {
            // Where the two normals disagree, rays still go to the side that they are meant for.
            onward = onward.map(|onward| on_side(onward, -geometric));
            away = Some(on_side(away.unwrap_or_else(|| reflect(direction, point.normal)), geometric));
        }
        let mut candidates = [
            (Kind::Transmission, DVec3::splat(if onward.is_some() { transmitted } else { 0.0 })),
            (Kind::Reflection, if stage.reflection { reflected } else { DVec3::ZERO }),
            (Kind::Bounce, DVec3::ZERO),
        ];
        let mut bounced = None;
        if E::SAMPLED
            && (stage.interreflection && shader.diffuse != DVec3::ZERO || stage.force_interreflection)
        {
            let walk = &self.walks[index];
            bounced = bounce(point.normal, walk.key.pair(walk.vertex, Dimension::Bounce));
            if stage.interreflection && shader.diffuse != DVec3::ZERO {
                self.counters.random_numbers += 2;
                self.counters.bounce_numbers += 2;
                candidates[2].1 = if bounced.is_some() { shader.diffuse } else { DVec3::ZERO };
            }
        }
        let remaining = head.work - 1;
        let mut children: [Option<Child>; 3] = [None; 3];
        for (place, (kind, weight)) in candidates.into_iter().enumerate() {
            if !E::SAMPLED && kind == Kind::Bounce {
                break;
            }
            let throughput = head.throughput * weight;
            let make = |throughput: DVec3| match kind {
                Kind::Transmission => Child {
                    kind,
                    direction: onward.unwrap_or(direction),
                    throughput,
                    origin: far_origin(),
                    course: course[0],
                },
                Kind::Reflection => Child {
                    kind,
                    direction: away.unwrap_or_else(|| reflect(direction, point.normal)),
                    throughput,
                    origin: point.origin,
                    course: course[1],
                },
                Kind::Bounce => {
                    let (direction, density) = bounced.unwrap_or((point.normal, 0.0));
                    Child {
                        kind,
                        direction,
                        throughput,
                        origin: point.origin,
                        course: Course::Sampled(density),
                    }
                }
            };
            if stage.is_worth_following(throughput, remaining.max(1)) {
                children[place] = Some(make(throughput));
                continue;
            }
            let carries = throughput.max_element() > 0.0;
            if E::SAMPLED && stage.roulette && carries {
                let (walk, bound) = (&self.walks[index], stage.settings.contribution_bound);
                let most = stage.contribution_max(throughput, remaining.max(1));
                self.counters.random_numbers += 1;
                self.counters.roulette_numbers += 1;
                if walk.key.one(walk.vertex, Dimension::Roulette(place as u32)) * bound < most {
                    children[place] = Some(make(throughput * (bound / most)));
                    continue;
                }
                self.counters.roulette_ends += 1;
            } else if carries {
                self.counters.contribution_cuts += 1;
                self.lost[head.slot as usize] += throughput.max_element() * stage.radiance_max();
            }
            let forced = match kind {
                Kind::Transmission => stage.force_transmission,
                Kind::Reflection => stage.force_reflection,
                Kind::Bounce => stage.force_interreflection && !stage.interreflection,
            };
            if forced {
                let child = make(throughput);
                self.forced.push(Ray::new(child.origin, child.direction.to_array()));
            }
        }
        if E::SAMPLED {
            self.force_rough(index, shader, point, eta);
            if self.walks[index].has_bounced {
                self.choose(index, &mut children);
            }
        }
        self.follow::<E>(index, head, &Leaving::new(shader, point.normal), children);
    }

    /// Of several rays one goes on, by luck in proportion to what they carry, and carries for all: after a diffuse bounce a
    /// tree would cost more than it is worth.
    fn choose(&mut self, index: usize, children: &mut [Option<Child>; 3]) {
        let weights = children.map(|child| child.map_or(0.0, |child| child.throughput.max_element()));
        let total: f64 = weights.iter().sum();
        if children.iter().flatten().count() < 2 {
            return;
        }
        let walk = &self.walks[index];
        let mut rest = walk.key.one(walk.vertex, Dimension::Choice) * total;
        self.counters.random_numbers += 1;
        self.counters.bounce_numbers += 1;
        let mut chosen = None;
        for (child, weight) in children.iter().zip(weights) {
            if weight == 0.0 {
                continue;
            }
            chosen = child.map(|child| Child { throughput: child.throughput * (total / weight), ..child });
            if rest < weight {
                break;
            }
            rest -= weight;
        }
        *children = [chosen, None, None];
    }

    /// Traces the rays of rough surfaces for nothing where they are only forced.
    fn force_rough(&mut self, index: usize, shader: &Shader, point: &Point, eta: Option<f64>) {
        /// Any roughness will do.
        const ALPHA: f64 = 0.25;
        if !(self.stage.force_glossy || self.stage.force_frosted) || shader.alpha > 0.0 {
            return;
        }
        let walk = &self.walks[index];
        let uv = walk.key.pair(walk.vertex, Dimension::Microfacet);
        let facet = glossy::sample_facet(point.normal, point.view, ALPHA, uv);
        let directions = [
            (self.stage.force_glossy, Some(reflect(-point.view, facet))),
            (self.stage.force_frosted, split(-point.view, facet, eta.unwrap_or(1.0 / 1.5)).refracted),
        ];
        for (_, direction) in directions.into_iter().filter(|(forced, _)| *forced) {
            let direction = direction.unwrap_or(point.normal);
            self.forced.push(Ray::new(point.origin, direction.to_array()));
        }
    }

    /// Divides the work that is left among the children by the square root of their throughput: by throughput itself faint but
    /// long chains starve, in equal parts the main path through a stack of panes does. The child with least work becomes the
    /// sample's head and the others wait: so the head's work at least halves whenever a ray comes to wait, which bounds the
    /// stack.
    fn follow<E: EffectsOfLoop>(
        &mut self,
        index: usize,
        head: &Head,
        leaving: &Leaving,
        children: [Option<Child>; 3],
    ) {
        let (slot, work) = (head.slot, head.work - 1);
        let mut rays: smallvec::SmallVec<[(Child, u64); 3]> =
            children.into_iter().flatten().map(|child| (child, work)).collect();
        // Too little work for all: those that carry most have it.
        while rays.len() > 1 && (rays.len() as u64) > work {
            let carried = |ray: &(Child, u64)| ray.0.throughput.max_element();
            let least = (1..rays.len())
                .fold(0, |least, ray| if carried(&rays[ray]) <= carried(&rays[least]) { ray } else { least });
            let (cut, _) = rays.remove(least);
            self.cut_work(slot, &cut);
        }
        if rays.len() > 1 {
            let weights: smallvec::SmallVec<[f64; 3]> =
                rays.iter().map(|(child, _)| child.throughput.max_element().sqrt()).collect();
            let (total, count) = (weights.iter().sum::<f64>(), rays.len() as u64);
            let mut left = work;
            let last = rays.len() - 1;
            for (place, weight) in weights.iter().enumerate().take(last) {
                // At least one ray for each of the others.
                let others = count - 1 - place as u64;
                let share = ((work as f64 * (weight / total)) as u64).clamp(1, left - others);
                rays[place].1 = share;
                left -= share;
            }
            rays[last].1 = left;
            rays.sort_by_key(|(_, share)| *share);
        }
        let place = slot as usize * self.stack_depth;
        for (child, share) in rays.iter().skip(1).rev() {
            let ray = self.count_ray::<E>(leaving, child);
            let place = place + usize::from(self.waiting_counts[slot as usize]);
            self.waiting[place] = Some(Waiting { ray, work: *share, throughput: child.throughput });
            if E::SAMPLED {
                self.waiting_walks[place] = Some(self.walk_on(index, leaving, child));
            }
            self.waiting_counts[slot as usize] += 1;
        }
        match rays.first() {
            Some((child, share)) if *share > 0 => {
                let ray = self.count_ray::<E>(leaving, child);
                self.next_rays.push(ray);
                self.next_heads.push(Head { slot, work: *share, throughput: child.throughput });
                if E::SAMPLED {
                    let walk = self.walk_on(index, leaving, child);
                    self.next_walks.push(walk);
                }
            }
            cut => {
                if let Some((child, _)) = cut {
                    let child = *child;
                    self.cut_work(slot, &child);
                }
                self.advance_from_stack::<E>(slot);
            }
        }
    }

    /// Books a ray for which no work is left.
    fn cut_work(&mut self, slot: u32, child: &Child) {
        self.counters.work_cuts += 1;
        self.lost[slot as usize] += child.throughput.max_element() * self.stage.radiance_max();
    }

    fn count_ray<E: EffectsOfLoop>(&mut self, leaving: &Leaving, child: &Child) -> Ray {
        let counters = &mut self.counters;
        match (child.kind, child.course) {
            (Kind::Bounce, _) => counters.bounce_rays += 1,
            (_, Course::Sampled(_)) if E::SAMPLED => {
                *if leaving.is_glass { &mut counters.frosted_rays } else { &mut counters.glossy_rays } += 1;
            }
            (Kind::Reflection, _) => counters.reflection_rays += 1,
            (Kind::Transmission, _) => counters.transmission_rays += 1,
        }
        Ray::new(child.origin, child.direction.to_array())
    }

    /// The state of the path of `child`, which goes on where the ray of the head numbered `index` ends.
    fn walk_on(&self, index: usize, leaving: &Leaving, child: &Child) -> Walk {
        let before = &self.walks[index];
        let mut walk = Walk { vertex: before.vertex.child(child.kind as u32), ..*before };
        let goes_through = child.kind == Kind::Transmission;
        if goes_through && self.stage.nested {
            let border = &self.borders.borders[index];
            walk.media = if border.is_medium { border.media } else { walk.media };
        }
        match child.course {
            Course::Straight => {}
            Course::Lawful => walk.density = 0.0,
            Course::Sampled(density) => {
                walk.density = density;
                walk.from = DVec3::from_array(child.origin);
                walk.normal = leaving.normal;
            }
        }
        walk.has_bounced |= child.kind == Kind::Bounce;
        if self.stage.path_loop == Loop::Detailed
            && let Some(hit) = &self.hits[index]
        {
            // The hit that it leaves is still there.
            walk.cone = before.cone.on(hit.t, leaving.alpha, child.kind == Kind::Bounce);
        }
        walk
    }

    /// Makes the ray that waited last the sample's head; without one the sample is done.
    fn advance_from_stack<E: EffectsOfLoop>(&mut self, slot: u32) {
        if !E::SECONDARY {
            return;
        }
        let count = &mut self.waiting_counts[slot as usize];
        if *count == 0 {
            return;
        }
        *count -= 1;
        let place = slot as usize * self.stack_depth + usize::from(*count);
        if let Some(waiting) = self.waiting[place].take() {
            self.next_rays.push(waiting.ray);
            self.next_heads.push(Head { slot, work: waiting.work, throughput: waiting.throughput });
            if E::SAMPLED {
                self.next_walks.extend(self.waiting_walks[place].take());
            }
        }
    }
}

/// What [`PathTracer::new`] allocates for `stage`, in bytes.
pub(crate) fn bytes_needed(stage: &Stage) -> usize {
    Sizes::of(stage).bytes(stage)
}
