//! Lights with extent and the environment: one sample each at every lit point (next-event estimation), weighted against
//! the rays that find the same light by themselves; and what rays gather from lights that they cross.

use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;

use super::bounce::{Walk, share};
use super::glossy;
use super::optics::absorb;
use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::{Dimension, VertexId};
use super::stage::{Shader, Stage};
use crate::error::TraceError;
use crate::geom::Ray;

/// What a lit point has beside [`Point`] where effects are sampled.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scatter {
    pub walk: Walk,
    /// The hit's vertex.
    pub vertex: VertexId,
    /// Start of rays on the far side.
    pub far_origin: [f64; 3],
    /// Refractive index on the near side over that on the far side; none if the surface does not refract.
    pub eta: Option<f64>,
    /// Which of the terms that hold at one place only; [`Scatter::OF_MATERIAL`] if they are those of the material.
    pub detail: u32,
}

impl Scatter {
    /// See [`Scatter::detail`].
    pub const OF_MATERIAL: u32 = u32::MAX;
}

/// Lobes of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lobes {
    /// The diffuse one and the highlight.
    Lamp,
    /// Those of rough mirrors and glass.
    Rough,
    All,
}

/// A shadow ray to a light with extent ends just before the light: what coincides with it does not hide it.
const LIGHT_END: f64 = 1.0 - 1.0 / (1u64 << 38) as f64;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Asks for the light of every light with extent and of the environment at every point, light by light.
    pub(super) fn light_by_samples(&mut self) -> Result<(), TraceError> {
        let stage = self.stage;
        if stage.areas.is_empty() && stage.environment.is_none() {
            return Ok(());
        }
        let mut start = Instant::now();
        // Rays of rough lobes find light through glass by themselves, and so do all rays with interreflection.
        let parts: &[(Lobes, bool)] = match (stage.interreflection, stage.has_rough) {
            (true, _) => &[(Lobes::All, true)],
            (false, true) => &[(Lobes::Lamp, false), (Lobes::Rough, true)],
            (false, false) => &[(Lobes::All, false)],
        };
        for (lobes, straight_only) in parts {
            self.shadows.pass_straight_only(*straight_only);
            start = self.light_lobes(*lobes, start)?;
            if !self.shadows.is_empty() {
                start = self.resolve_shadows(start)?;
            }
        }
        self.shadows.pass_straight_only(false);
        self.seconds.shading += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// The light that some lobes of every point answer to.
    fn light_lobes(&mut self, lobes: Lobes, mut start: Instant) -> Result<Instant, TraceError> {
        let stage = self.stage;
        for (light, emitter) in (0u32..).zip(&stage.areas) {
            for index in 0..self.points.len() {
                let (point, scatter) = (self.points[index], self.scatters[index]);
                if lobes == Lobes::Rough && self.terms(&point, &scatter).alpha == 0.0 {
                    continue;
                }
                let uv = scatter.walk.key.pair(scatter.vertex, Dimension::Light(light));
                self.counters.random_numbers += 2;
                self.counters.area_light_samples += 1;
                let Some(sample) = emitter.sample(point.position, uv) else { continue };
                let response = self.response(&point, &scatter, sample.toward, Some(sample.density), lobes);
                // Irradiance over pi, as for other lights.
                let contribution = point.throughput * response * emitter.radiance / (PI * sample.density);
                let origin =
                    if sample.toward.dot(point.normal) > 0.0 { point.origin } else { scatter.far_origin };
                let offset = sample.position - DVec3::from_array(origin);
                let ray = Ray { t_max: LIGHT_END, ..Ray::new(origin, offset.to_array()) };
                let luck = Dimension::LightRoulette(light);
                if offset != DVec3::ZERO {
                    start =
                        self.claim(&point, &scatter, contribution, ray, luck, stage.force_areas, start)?;
                }
            }
        }
        if let Some(environment) = &stage.environment {
            for index in 0..self.points.len() {
                let (point, scatter) = (self.points[index], self.scatters[index]);
                if lobes == Lobes::Rough && self.terms(&point, &scatter).alpha == 0.0 {
                    continue;
                }
                let uv = scatter.walk.key.pair(scatter.vertex, Dimension::Environment);
                self.counters.random_numbers += 2;
                self.counters.environment_samples += 1;
                let Some((toward, density)) = environment.sample(point.normal, uv) else { continue };
                let response = self.response(&point, &scatter, toward, Some(density), lobes);
                let contribution =
                    point.throughput * response * environment.radiance(toward) / (PI * density);
                let origin = if toward.dot(point.normal) > 0.0 { point.origin } else { scatter.far_origin };
                let ray = Ray::new(origin, toward.to_array());
                let luck = Dimension::EnvironmentRoulette;
                start =
                    self.claim(&point, &scatter, contribution, ray, luck, stage.force_environment, start)?;
            }
        }
        Ok(start)
    }

    /// Adds `contribution` to its sample unless something stands in the way of `ray`, or it is too faint.
    #[expect(clippy::too_many_arguments, reason = "all belong to one light sample")]
    fn claim(
        &mut self,
        point: &Point,
        scatter: &Scatter,
        mut contribution: DVec3,
        ray: Ray,
        luck: Dimension,
        is_forced: bool,
        start: Instant,
    ) -> Result<Instant, TraceError> {
        let stage = self.stage;
        contribution = self.worth_asking(point.slot, scatter, contribution, luck);
        if contribution == DVec3::ZERO && !(is_forced || stage.force_shadows) {
            return Ok(start);
        }
        if !(stage.shadows || stage.force_shadows || is_forced) {
            self.radiance[point.slot as usize] += contribution;
            return Ok(start);
        }
        self.shadows.push(point.slot, contribution, ray);
        if self.shadows.is_full() { self.resolve_shadows(start) } else { Ok(start) }
    }

    /// What is to be made of light that arrives if nothing hides it: zero if it is cut, more if luck lets it go on.
    pub(super) fn worth_asking(
        &mut self,
        slot: u32,
        scatter: &Scatter,
        contribution: DVec3,
        luck: Dimension,
    ) -> DVec3 {
        let bound = self.stage.settings.contribution_bound;
        let largest = contribution.max_element();
        if largest > bound || largest == 0.0 {
            return contribution;
        }
        if !self.stage.roulette {
            self.counters.contribution_cuts += 1;
            self.lost[slot as usize] += largest;
            return DVec3::ZERO;
        }
        self.counters.random_numbers += 1;
        self.counters.roulette_numbers += 1;
        if scatter.walk.key.one(scatter.vertex, luck) * bound < largest {
            return contribution * (bound / largest);
        }
        self.counters.roulette_ends += 1;
        DVec3::ZERO
    }

    /// The terms that hold at a point.
    fn terms(&self, point: &Point, scatter: &Scatter) -> &Shader {
        let local = self.details.get(scatter.detail as usize);
        local.unwrap_or_else(|| self.stage.shader(point.material))
    }

    /// The surface's answer to light from the unit vector `toward`, per irradiance at perpendicular incidence over pi: each
    /// lobe's by itself, with its share against rays sampled by that lobe. `light_density` is none for lights that no ray can
    /// meet.
    pub(super) fn response(
        &self,
        point: &Point,
        scatter: &Scatter,
        toward: DVec3,
        light_density: Option<f64>,
        lobes: Lobes,
    ) -> DVec3 {
        let stage = self.stage;
        let shader = self.terms(point, scatter);
        let cosine = toward.dot(point.normal);
        let against = |own: f64| light_density.map_or(1.0, |light| share(light, own));
        let is_rough = shader.alpha > 0.0 && lobes != Lobes::Lamp;
        if cosine > 0.0 {
            let mut response = DVec3::ZERO;
            if lobes != Lobes::Rough {
                response = shader.diffuse * cosine;
                if stage.interreflection {
                    response *= against(cosine / PI);
                }
            }
            let strength = if light_density.is_none() { shader.highlight } else { shader.area_highlight };
            if lobes != Lobes::Rough && strength != DVec3::ZERO {
                response += highlight(shader, strength, point, toward);
            }
            if is_rough
                && let Some(lobe) =
                    glossy::reflection(point.normal, point.view, shader.alpha, toward, scatter.eta)
            {
                let strength = shader.mirror + DVec3::splat(shader.transmission * lobe.reflectance);
                let strength = if stage.reflection { strength } else { DVec3::ZERO };
                response += strength * (lobe.weight * lobe.density * PI * against(lobe.density));
            }
            response
        } else if let Some(eta) = scatter.eta
            && is_rough
            && let Some(lobe) = glossy::refraction(point.normal, point.view, shader.alpha, toward, eta)
        {
            let strength = shader.transmission * (1.0 - lobe.reflectance);
            DVec3::splat(strength * lobe.weight * lobe.density * PI * against(lobe.density))
        } else {
            DVec3::ZERO
        }
    }

    /// What the ray of `walk` gathers from lights that it crosses up to `t_max`, in a medium with these coefficients.
    pub(super) fn gathered(&mut self, ray: &Ray, walk: &Walk, t_max: f64, coefficients: DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        let (origin, direction) = (DVec3::from_array(ray.origin), DVec3::from_array(ray.direction));
        // Lights in the plane of a surface are before it.
        let t_max = t_max * (1.0 + 1.0 / (1u64 << 38) as f64);
        for emitter in &self.stage.areas {
            let Some(crossing) = emitter.crossing(origin, direction, t_max) else { continue };
            if emitter.radiance == DVec3::ZERO {
                continue;
            }
            self.counters.light_crossings += 1;
            let share = if walk.density > 0.0 {
                let seen = emitter.crossing(walk.from, direction, f64::INFINITY);
                walk.share(seen.map_or(crossing.density, |seen| seen.density))
            } else {
                1.0
            };
            sum += emitter.radiance * absorb(coefficients, crossing.t) * share;
        }
        sum
    }

    /// What the ray of `walk` sees that hits nothing.
    pub(super) fn seen_beyond(&self, ray: &Ray, walk: &Walk) -> DVec3 {
        let stage = self.stage;
        let Some(surroundings) = &stage.surroundings else { return stage.background };
        let direction = DVec3::from_array(ray.direction);
        if !stage.lit_by_environment {
            return surroundings.radiance(direction);
        }
        let share =
            if walk.density > 0.0 { walk.share(surroundings.density(walk.normal, direction)) } else { 1.0 };
        surroundings.radiance(direction) * share
    }
}

/// Blinn's highlight of that strength.
pub(super) fn highlight(shader: &Shader, strength: DVec3, point: &Point, toward: DVec3) -> DVec3 {
    let half = (toward + point.view).normalize_or_zero();
    let alignment = half.dot(point.normal).clamp(0.0, 1.0);
    strength * shader.exponent.of(alignment)
}

impl Stage {
    /// Whether points keep a [`Scatter`] beside them, and lights with extent are asked for.
    pub fn samples_lights(&self) -> bool {
        !self.areas.is_empty() || self.environment.is_some()
    }
}
