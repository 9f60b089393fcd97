//! Lights with extent: what points get of them, and what rays gather that cross them.

use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;

use super::absorption::absorb;
use super::paths::PathTracer;
use super::query::RayQuery;
use super::random::Dimension;
use super::response::Lobes;
use super::walk::Walk;
use crate::error::TraceError;
use crate::geom::Ray;

/// A shadow ray to a light with extent ends just before the light: what coincides with it does not hide it.
const LIGHT_END: f64 = 1.0 - 1.0 / (1u64 << 38) as f64;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// The light of each of them that some lobes of every point answer to.
    pub(super) fn light_of_areas(&mut self, lobes: Lobes, mut start: Instant) -> Result<Instant, TraceError> {
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
        Ok(start)
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
}
