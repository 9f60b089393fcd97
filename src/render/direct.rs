//! Lights without extent: every point asks each of them.

use std::time::Instant;

use glam::DVec3;

use super::hot::EffectsOfLoop;
use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::Dimension;
use super::response::{Lobes, highlight};
use super::stage::Stage;
use crate::error::TraceError;
use crate::scene::Emitter;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Adds the light of every lamp at every point, lamp by lamp: rays to one lamp stay together, and each sample
    /// sums its lamps in the scene's order.
    pub(super) fn light<E: EffectsOfLoop>(&mut self) -> Result<(), TraceError> {
        // Apart from the rest, so that a point is read where it stands.
        let points = std::mem::take(&mut self.points);
        let result = self.light_points::<E>(&points);
        self.points = points;
        result
    }

    fn light_points<E: EffectsOfLoop>(&mut self, points: &[Point]) -> Result<(), TraceError> {
        let stage = self.stage;
        let with_rays = stage.shadows || stage.force_shadows;
        let mut start = Instant::now();
        for (light, emitter) in (0u32..).zip(&stage.emitters) {
            for (index, point) in points.iter().enumerate() {
                let mut contribution;
                let mut origin = point.origin;
                if E::SAMPLED {
                    let scatter = self.scatters[index];
                    let incidence = emitter.incidence(point.position);
                    if incidence.toward.dot(point.normal) < 0.0 {
                        origin = scatter.far_origin;
                    }
                    let response = self.response(point, &scatter, incidence.toward, None, Lobes::All);
                    let arriving = point.throughput * response * incidence.irradiance;
                    let dimension = Dimension::PointLightRoulette(light);
                    contribution = self.worth_asking(point.slot, &scatter, arriving, dimension);
                    if contribution == DVec3::ZERO && !stage.force_shadows {
                        continue;
                    }
                } else {
                    contribution = received::<E>(stage, emitter, point);
                    let bound = stage.settings.contribution_bound;
                    if !(contribution.x > bound || contribution.y > bound || contribution.z > bound) {
                        let largest = contribution.max_element();
                        if largest > 0.0 {
                            self.counters.contribution_cuts += 1;
                            self.lost[point.slot as usize] += largest;
                        }
                        if !stage.force_shadows {
                            continue;
                        }
                        contribution = DVec3::ZERO;
                    }
                }
                if !with_rays {
                    self.radiance[point.slot as usize] += contribution;
                    continue;
                }
                self.shadows.push(point.slot, contribution, emitter.shadow_ray(origin, point.normal));
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

/// What a point without luck sends back of a light, if nothing stands in its way.
#[inline(always)]
fn received<E: EffectsOfLoop>(stage: &Stage, emitter: &Emitter, point: &Point) -> DVec3 {
    let Some((cosine, incidence)) = emitter.incidence_facing(point.position, point.normal) else {
        return DVec3::ZERO;
    };
    let shader = stage.shader(point.material);
    let mut response = shader.diffuse * cosine;
    if shader.has_highlight {
        response += highlight(shader, shader.highlight, point, incidence.toward);
    }
    // Without rays that go on from hits, points carry everything.
    let throughput = if E::SECONDARY { point.throughput } else { DVec3::ONE };
    throughput * response * incidence.irradiance
}
