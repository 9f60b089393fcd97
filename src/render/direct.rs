//! Lights without extent: every point asks each of them.

use std::time::Instant;

use glam::DVec3;

use super::hot::EffectsOfLoop;
use super::lamps::{Lobes, highlight};
use super::paths::PathTracer;
use super::query::RayQuery;
use super::random::Dimension;
use crate::error::TraceError;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Adds the light of every lamp at every point, lamp by lamp: rays to one lamp stay together, and each sample
    /// sums its lamps in the scene's order.
    pub(super) fn light<E: EffectsOfLoop>(&mut self) -> Result<(), TraceError> {
        let stage = self.stage;
        let with_rays = stage.shadows || stage.force_shadows;
        let mut start = Instant::now();
        for (light, emitter) in (0u32..).zip(&stage.emitters) {
            for index in 0..self.points.len() {
                let point = self.points[index];
                let incidence = emitter.incidence(point.position);
                let mut contribution = DVec3::ZERO;
                let mut origin = point.origin;
                if E::SAMPLED {
                    let scatter = self.scatters[index];
                    if incidence.toward.dot(point.normal) < 0.0 {
                        origin = scatter.far_origin;
                    }
                    let response = self.response(&point, &scatter, incidence.toward, None, Lobes::All);
                    let arriving = point.throughput * response * incidence.irradiance;
                    contribution = self.worth_asking(
                        point.slot,
                        &scatter,
                        arriving,
                        Dimension::PointLightRoulette(light),
                    );
                } else {
                    let shader = stage.shader(point.material);
                    let cosine = incidence.toward.dot(point.normal);
                    if cosine > 0.0 {
                        let mut response = shader.diffuse * cosine;
                        if shader.highlight != DVec3::ZERO {
                            response += highlight(shader, &point, incidence.toward);
                        }
                        contribution = point.throughput * response * incidence.irradiance;
                    }
                    let largest = contribution.max_element();
                    if largest <= stage.settings.contribution_bound {
                        self.counters.contribution_cuts += u64::from(largest > 0.0);
                        self.lost[point.slot as usize] += largest;
                        contribution = DVec3::ZERO;
                    }
                }
                if contribution == DVec3::ZERO && !stage.force_shadows {
                    continue;
                }
                if !with_rays {
                    self.radiance[point.slot as usize] += contribution;
                    continue;
                }
                let ray = emitter.shadow_ray(origin, point.normal);
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
    pub(super) fn resolve_shadows(&mut self, start: Instant) -> Result<Instant, TraceError> {
        let shaded = Instant::now();
        self.seconds.shading += (shaded - start).as_secs_f64();
        let lost = &mut self.lost_by_shadows;
        let (times, radiance) = (&self.times, &mut self.radiance);
        self.shadows.resolve(self.stage, &mut self.query, times, radiance, lost, &mut self.counters)?;
        let resolved = Instant::now();
        self.seconds.shadows += (resolved - shaded).as_secs_f64();
        Ok(resolved)
    }
}
