//! Light from all around: what points get of it, and what rays see that hit nothing.

use std::f64::consts::PI;
use std::time::Instant;

use glam::DVec3;

use super::paths::PathTracer;
use super::query::RayQuery;
use super::random::Dimension;
use super::response::Lobes;
use super::walk::Walk;
use crate::error::TraceError;
use crate::geom::Ray;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// The light of the surroundings that some lobes of every point answer to.
    pub(super) fn light_of_environment(
        &mut self,
        lobes: Lobes,
        mut start: Instant,
    ) -> Result<Instant, TraceError> {
        let stage = self.stage;
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
