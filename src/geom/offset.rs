//! Where a hit is, how wrong that position can be, and where a secondary ray may start.
//!
//! After M. Pharr, W. Jakob and G. Humphreys, "Physically Based Rendering", section 6.8 ("Managing Rounding Error"), with
//! `u = 2^-53` and without square roots.

use super::float::{U64, gamma};

/// The position with weights `u` of the second and `v` of the third vertex: `a + (u (b - a) + v (c - a))`, rounded.
#[inline]
pub fn hit_position(vertices: &[[f64; 3]; 3], u: f64, v: f64) -> [f64; 3] {
    let [a, b, c] = vertices;
    // Not by `map`, which is not always compiled into its caller.
    let at = |axis: usize| a[axis] + (u * (b[axis] - a[axis]) + v * (c[axis] - a[axis]));
    [at(0), at(1), at(2)]
}

/// A bound, the same for each axis, on the distance between [`hit_position`] and the point of the triangle's plane with exactly
/// the weights `u` and `v`.
///
/// It is about half a unit in the last place of the largest coordinate, plus three roundings of the triangle's size. The
/// weights' own error moves the point inside the plane only, so it does not count for offsets along the normal.
#[inline]
pub fn position_error(vertices: &[[f64; 3]; 3], u: f64, v: f64) -> f64 {
    // s = u (b-a) + v (c-a) has difference, product and sum: gamma(3) of its permanent; a + s is rounded once more: u64 |p|
    // of the computed p. gamma(4) and the factor 1 + 2^-41 cover the rounding of the bound itself.
    let [a, b, c] = vertices;
    let mut error = 0.0f64;
    for axis in 0..3 {
        let (along_b, along_c) = (u * (b[axis] - a[axis]), v * (c[axis] - a[axis]));
        let position = a[axis] + (along_b + along_c);
        let bound = const { gamma(4) } * (along_b.abs() + along_c.abs())
            + U64 * (1.0 + const { gamma(1 << 12) }) * position.abs();
        error = error.max(bound);
    }
    // Above the smallest normal number so that it can be multiplied; covers a product that underflowed.
    error + f64::MIN_POSITIVE
}

/// The unnormalised geometric normal `(b - a) x (c - a)`, rounded; by the right-hand rule over `a`, `b`, `c`.
#[inline]
pub fn triangle_normal(vertices: &[[f64; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = vertices;
    let minus = |p: &[f64; 3], q: &[f64; 3]| [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
    let (ab, ac) = (minus(b, a), minus(c, a));
    [ab[1] * ac[2] - ab[2] * ac[1], ab[2] * ac[0] - ab[0] * ac[2], ab[0] * ac[1] - ab[1] * ac[0]]
}

/// The origin of a secondary ray along `direction` from the surface at `position`, whose error per axis is at most `error`
/// ([`position_error`]) and whose unnormalised geometric normal is `geometric_normal` ([`triangle_normal`]).
///
/// The origin lies on the side of the surface to which `direction` points, at a distance of a few `error`: there is no fixed
/// epsilon.
///
/// # Guarantee
/// If the exact direction points to the side of the triangle's plane that the computed dot product says, and the normal has at
/// least one correct digit (the permanent of each component at most `2^46` times the largest component, which all but the
/// thinnest needles satisfy), then the origin is strictly on that side of the exact plane, so a ray from it along `direction` does not hit
/// that triangle again, nor any triangle of a convex body that it leaves outward: [`super::intersect_certified`] decides
/// exactly. This holds at any translation. It does not cover a direction within rounding of the plane itself, nor a
/// neighbour at a concave edge, which the ray may rightly hit.
///
/// For a zero or non-finite normal the position is returned unchanged.
pub fn offset_origin(
    position: [f64; 3],
    error: f64,
    geometric_normal: [f64; 3],
    direction: [f64; 3],
) -> [f64; 3] {
    let scaled = |a: [f64; 3]| {
        // Only the direction of the vector matters; scaling keeps squares away from overflow and underflow.
        let largest = a[0].abs().max(a[1].abs()).max(a[2].abs());
        [a[0] / largest, a[1] / largest, a[2] / largest]
    };
    let (n, d) = (scaled(geometric_normal), scaled(direction));
    let square = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
    let side = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
    if !(square.is_finite() && side.is_finite()) {
        return position;
    }
    // n . (position - surface) may be as low as -error |n|_1; this moves it by +2 error |n|_1 (docs/numerics.md, "Offset").
    let step = 2.0 * error * (n[0].abs() + n[1].abs() + n[2].abs()) / square;
    let step = if side < 0.0 { -step } else { step };
    let at = |axis: usize| {
        let moved = position[axis] + step * n[axis];
        // Away from the surface, so that rounding does not take back what the step gave.
        match step * n[axis] {
            s if s > 0.0 => moved.next_up(),
            s if s < 0.0 => moved.next_down(),
            _ => moved,
        }
    };
    [at(0), at(1), at(2)]
}
