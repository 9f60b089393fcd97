//! Glossy reflection: rough mirrors, and the part of light that rough glass mirrors. Directions as in [`super::ggx`].

use glam::DVec3;

use super::ggx::{Lobe, lambda, visible};
use super::mirror::reflect;
use super::paths::Point;
use super::refraction::split;
use super::ways::{Course, Ways};

/// How light is reflected along `direction`. `eta` is the refractive index on the side of `view` over that on the other, if
/// the surface refracts at all.
pub(crate) fn reflection(
    normal: DVec3,
    view: DVec3,
    alpha: f64,
    direction: DVec3,
    eta: Option<f64>,
) -> Option<Lobe> {
    let (cos_view, cos) = (normal.dot(view), normal.dot(direction));
    if cos <= 0.0 {
        return None;
    }
    let facet = (view + direction).try_normalize()?;
    let along = facet.dot(view);
    if along <= 0.0 {
        return None;
    }
    let (a, b) = (lambda(alpha, cos_view), lambda(alpha, cos));
    Some(Lobe {
        weight: (1.0 + a) / (1.0 + a + b),
        density: visible(normal, view, alpha, facet) / (4.0 * along),
        reflectance: eta.map_or(0.0, |eta| split(-view, facet, eta).reflectance),
    })
}

impl Ways {
    /// What is mirrored goes by this `facet` of a rough surface.
    pub fn gloss(&mut self, point: &Point, alpha: f64, facet: DVec3) {
        let mirrored = reflect(-point.view, facet);
        let lobe = reflection(point.normal, point.view, alpha, mirrored, None);
        let way = &mut self.reflection;
        way.weight *= lobe.map_or(0.0, |lobe| lobe.weight);
        way.direction = Some(mirrored);
        way.course = Course::Sampled(lobe.map_or(0.0, |lobe| lobe.density));
    }
}
