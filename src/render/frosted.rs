//! Rough refraction: light that goes through rough glass. Directions as in [`super::ggx`].

use glam::DVec3;

use super::ggx::{Lobe, lambda, visible};
use super::paths::Point;
use super::refraction::split;
use super::ways::{Course, Ways};

/// How light is refracted along `direction`, on the other side of the surface.
pub(crate) fn refraction(normal: DVec3, view: DVec3, alpha: f64, direction: DVec3, eta: f64) -> Option<Lobe> {
    if normal.dot(direction) >= 0.0 {
        return None;
    }
    // Along the facet's normal by Snell's law; on the side of `view`.
    let half = (view * eta + direction).try_normalize()?;
    let facet = if half.dot(normal) < 0.0 { -half } else { half };
    let (along, across) = (facet.dot(view), facet.dot(direction));
    if along <= 0.0 || across >= 0.0 {
        return None;
    }
    let sum = eta * along + across;
    Some(Lobe {
        weight: 1.0 / (1.0 + lambda(alpha, -normal.dot(direction))),
        // The facet's density by the solid angle that it turns into (Walter, equation 17, with the index divided out).
        density: visible(normal, view, alpha, facet) * -across / (sum * sum),
        reflectance: split(-view, facet, eta).reflectance,
    })
}

impl Ways {
    /// What was refracted, if anything was, went by a facet of a rough surface.
    pub fn frost(&mut self, point: &Point, alpha: f64, eta: f64) {
        let way = &mut self.transmission;
        let Some(refracted) = way.direction else { return };
        let lobe = refraction(point.normal, point.view, alpha, refracted, eta);
        way.weight *= lobe.map_or(0.0, |lobe| lobe.weight);
        way.course = Course::Sampled(lobe.map_or(0.0, |lobe| lobe.density));
    }
}
