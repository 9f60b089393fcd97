//! What rough mirrors and rough glass are made of: microfacets of the GGX distribution, sampled by the normals that are visible.
//!
//! B. Walter et al., "Microfacet Models for Refraction through Rough Surfaces", EGSR 2007; E. Heitz, "Understanding the
//! Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 2014; J. Dupuy and A. Benyoub, "Sampling Visible GGX Normals
//! with Spherical Caps", HPG 2023. Light that meets more than one facet is lost: a rough surface sends on no more than a smooth
//! one, and less at high roughness.
//!
//! All directions point away from the surface, as unit vectors; `normal` is on the side of `view`.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::scene::frame_around;

/// A direction as the surface sends light along it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lobe {
    /// What a ray along a sampled direction is multiplied by, Fresnel's share apart: 0 ..= 1.
    pub weight: f64,
    /// Density over solid angle with which the direction is sampled, given its kind (reflected or refracted).
    pub density: f64,
    /// Fresnel's reflectance of the facet that sends light this way, for the index ratio given; 0 without one.
    pub reflectance: f64,
}

/// Keeps quotients of grazing directions numbers.
const COS_MIN: f64 = 1e-9;

/// Smith's auxiliary function of a direction at this cosine from the normal.
pub(super) fn lambda(alpha: f64, cos: f64) -> f64 {
    let cos = cos.max(COS_MIN);
    let tan_squared = (1.0 - cos * cos).max(0.0) / (cos * cos);
    0.5 * ((1.0 + alpha * alpha * tan_squared).sqrt() - 1.0)
}

/// Density of facet normals at this cosine from the normal.
fn distribution(alpha: f64, cos: f64) -> f64 {
    let squared = alpha * alpha;
    let base = cos * cos * (squared - 1.0) + 1.0;
    squared / (PI * base * base)
}

/// Density over solid angle of facet normals that are seen from `view`.
pub(super) fn visible(normal: DVec3, view: DVec3, alpha: f64, facet: DVec3) -> f64 {
    let cos = normal.dot(view).max(COS_MIN);
    let masking = 1.0 / (1.0 + lambda(alpha, cos));
    masking * facet.dot(view).max(0.0) * distribution(alpha, facet.dot(normal)) / cos
}

/// The facet normal that belongs to `point` in the unit square among those seen from `view`.
pub(crate) fn sample_facet(normal: DVec3, view: DVec3, alpha: f64, [u, v]: [f64; 2]) -> DVec3 {
    let [x, y] = frame_around(normal);
    let local =
        DVec3::new(view.dot(x) * alpha, view.dot(y) * alpha, view.dot(normal).max(COS_MIN)).normalize();
    let (sin, cos) = libm::sincos(TAU * u);
    let height = (1.0 - v) * (1.0 + local.z) - local.z;
    let radius = (1.0 - height * height).max(0.0).sqrt();
    let half = DVec3::new(radius * cos, radius * sin, height) + local;
    (x * (alpha * half.x) + y * (alpha * half.y) + normal * half.z.max(0.0)).try_normalize().unwrap_or(normal)
}
