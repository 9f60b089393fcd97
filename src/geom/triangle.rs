//! The scalar certified test: the meaning of "hit" for the whole library.

use super::Ray;

/// A certified hit of a ray on one triangle: canonical `t` and barycentrics from one fixed f64 operation order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// Ray parameter.
    pub t: f64,
    /// Weight of the second vertex.
    pub u: f64,
    /// Weight of the third vertex.
    pub v: f64,
}

/// TODO(geom)
pub fn intersect_certified(
    _ray: &Ray,
    _vertices: &[[f64; 3]; 3],
    _exact_fallbacks: &mut u64,
) -> Option<TriangleHit> {
    todo!()
}
