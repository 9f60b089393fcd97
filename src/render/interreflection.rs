//! Diffuse interreflection: bounces off what surfaces scatter evenly.

use glam::DVec3;

use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::Dimension;
use super::stage::Shader;
use super::ways::{Course, Ways};
use crate::scene::{cosine_direction, to_frame};

/// The direction of a diffuse bounce at a surface with this normal, and its density over solid angle, which the diffuse
/// reflectance over pi times the cosine cancels. `None` for a direction in the surface.
pub(crate) fn bounce(normal: DVec3, point: [f64; 2]) -> Option<(DVec3, f64)> {
    let direction = to_frame(normal, cosine_direction(point));
    let density = direction.dot(normal) / std::f64::consts::PI;
    (density > 0.0).then_some((direction, density))
}

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Adds the way of a diffuse bounce, if there is one or it is forced.
    pub(super) fn interreflect(&mut self, ways: &mut Ways, index: usize, shader: &Shader, point: &Point) {
        let stage = self.stage;
        let is_diffuse = stage.interreflection && shader.diffuse != DVec3::ZERO;
        if !(is_diffuse || stage.force_interreflection) {
            return;
        }
        let walk = &self.walks[index];
        let bounced = bounce(point.normal, walk.key.pair(walk.vertex, Dimension::Bounce));
        if is_diffuse {
            self.counters.random_numbers += 2;
            self.counters.bounce_numbers += 2;
        }
        if let Some((direction, density)) = bounced {
            let way = &mut ways.bounce;
            (way.direction, way.course) = (Some(direction), Course::Sampled(density));
            if is_diffuse {
                way.weight = shader.diffuse;
            }
        }
    }
}
