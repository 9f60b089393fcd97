//! The facet of a rough surface that a path meets, whether it is mirrored there or refracted.

use glam::DVec3;

use super::ggx::sample_facet;
use super::mirror::reflect;
use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::Dimension;
use super::refraction::split;
use super::stage::Shader;
use crate::geom::Ray;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// The normal of one of the facets that are seen, by luck.
    pub(super) fn facet(&mut self, index: usize, shader: &Shader, point: &Point) -> DVec3 {
        let walk = &self.walks[index];
        let uv = walk.key.pair(walk.vertex, Dimension::Microfacet);
        self.counters.random_numbers += 2;
        let of_lobe = match shader.is_glass() {
            true => &mut self.counters.frosted_numbers,
            false => &mut self.counters.glossy_numbers,
        };
        *of_lobe += 2;
        sample_facet(point.normal, point.view, shader.alpha, uv)
    }

    /// Traces the rays of rough surfaces for nothing where they are only forced.
    pub(super) fn force_rough(&mut self, index: usize, shader: &Shader, point: &Point, eta: Option<f64>) {
        /// Any roughness will do.
        const ALPHA: f64 = 0.25;
        if !(self.stage.force_glossy || self.stage.force_frosted) || shader.alpha > 0.0 {
            return;
        }
        let walk = &self.walks[index];
        let uv = walk.key.pair(walk.vertex, Dimension::Microfacet);
        let facet = sample_facet(point.normal, point.view, ALPHA, uv);
        let directions = [
            (self.stage.force_glossy, Some(reflect(-point.view, facet))),
            (self.stage.force_frosted, split(-point.view, facet, eta.unwrap_or(1.0 / 1.5)).refracted),
        ];
        for (_, direction) in directions.into_iter().filter(|(forced, _)| *forced) {
            let direction = direction.unwrap_or(point.normal);
            self.forced.push(Ray::new(point.origin, direction.to_array()));
        }
    }
}
