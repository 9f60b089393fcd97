//! How a lit point answers to light.

use std::f64::consts::PI;

use glam::DVec3;

use super::frosted;
use super::glossy;
use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::VertexId;
use super::stage::Shader;
use super::walk::{Walk, share};

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

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// The terms that hold at a point.
    pub(super) fn terms(&self, point: &Point, scatter: &Scatter) -> &Shader {
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
            && let Some(lobe) = frosted::refraction(point.normal, point.view, shader.alpha, toward, eta)
        {
            let strength = shader.transmission * (1.0 - lobe.reflectance);
            DVec3::splat(strength * lobe.weight * lobe.density * PI * against(lobe.density))
        } else {
            DVec3::ZERO
        }
    }
}

/// Blinn's highlight of that strength.
pub(super) fn highlight(shader: &Shader, strength: DVec3, point: &Point, toward: DVec3) -> DVec3 {
    let half = (toward + point.view).normalize_or_zero();
    let alignment = half.dot(point.normal).clamp(0.0, 1.0);
    strength * shader.exponent.of(alignment)
}
