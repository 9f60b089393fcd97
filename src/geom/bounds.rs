//! How wrong a hit can be: bounds on `t`, the weights and the position, on request.

use super::double::{self, Double};
use super::float::{U64, gamma};
use super::frame::RayFrame;
use super::{TriangleHit, hit_position, triangle_exact};

/// Proven bounds on the errors of a hit, absolute, against the point where the exact ray meets the triangle's exact
/// plane: see `docs/numerics.md`, "Error bounds of a hit". Infinite where the ray is parallel to the plane or
/// a number is out of the domain of [`RayFrame`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HitErrorBounds {
    /// Of the ray parameter.
    pub t: f64,
    /// Of the weight of the second vertex.
    pub u: f64,
    /// Of the weight of the third vertex.
    pub v: f64,
    /// Of the position that the weights give ([`hit_position`]), per axis.
    pub position: [f64; 3],
}

impl HitErrorBounds {
    const UNKNOWN: HitErrorBounds =
        HitErrorBounds { t: f64::INFINITY, u: f64::INFINITY, v: f64::INFINITY, position: [f64::INFINITY; 3] };
}

/// Of a determinant in double-length numbers relative to its permanent: 5 operations of `7 u^2`, taken as `64 u^2`, which
/// also covers that permanents are computed at most 10 factors low.
const DOUBLE_ERROR: f64 = 64.0 * U64 * U64;
/// Errors of the ratios in double length beyond which exact arithmetic takes over: far above `u`, they would show.
const DOUBLE_ERROR_MAX: f64 = U64 / 16.0;
/// Roundings of the bounds themselves.
const SLACK: f64 = 1.0 + gamma(32);

/// A ratio of two determinants, and how far off it is.
#[derive(Clone, Copy)]
struct Ratio {
    value: f64,
    error: f64,
}

/// What a hit is compared with: `t` in the scaled direction, `u` and `v`.
struct Reference([Ratio; 3]);

fn permanents(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        (a[1] * b[2]).abs() + (a[2] * b[1]).abs(),
        (a[2] * b[0]).abs() + (a[0] * b[2]).abs(),
        (a[0] * b[1]).abs() + (a[1] * b[0]).abs(),
    ]
}

fn dot_of_magnitudes(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0].abs() * b[0].abs() + a[1].abs() * b[1].abs() + a[2].abs() * b[2].abs()
}

impl Reference {
    /// From double-length numbers, if they are good enough.
    fn in_double(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> Option<Reference> {
        let [a, b, c] = *vertices;
        let direction = frame.direction.map(Double::from);
        let (to_a, ab, ac) =
            (double::difference(a, frame.origin), double::difference(b, a), double::difference(c, a));
        let moment = double::cross(&direction, &to_a);
        let normal = double::cross(&ab, &ac);
        let values = |vector: &double::Vector| [vector[0].value(), vector[1].value(), vector[2].value()];
        let (near, first, second) = (values(&to_a), values(&ab), values(&ac));
        let (of_normal, of_moment) = (permanents(first, second), permanents(frame.direction, near));

        let determinant = double::dot(&normal, &direction).value();
        let determinant_error =
            DOUBLE_ERROR * dot_of_magnitudes(of_normal, frame.direction) / determinant.abs();
        let ratio = |numerator: Double, permanent: f64| {
            let value = numerator.value() / determinant;
            // Numerator and determinant as above; both values and the quotient round once, and the sum of the errors
            // has terms of second order.
            let relative = determinant_error + 4.0 * U64;
            let error = DOUBLE_ERROR * permanent / determinant.abs() + value.abs() * relative;
            // Written so that NaN fails.
            let is_good =
                error <= DOUBLE_ERROR_MAX + 5.0 * U64 * value.abs() && determinant_error <= DOUBLE_ERROR_MAX;
            is_good.then_some(Ratio { value, error })
        };
        let t = ratio(double::dot(&normal, &to_a), dot_of_magnitudes(of_normal, near))?;
        let u = ratio(-double::dot(&ac, &moment), dot_of_magnitudes(of_moment, second))?;
        let v = ratio(double::dot(&ab, &moment), dot_of_magnitudes(of_moment, first))?;
        // `t` has no natural size, so its error counts relative to itself.
        (t.error <= (DOUBLE_ERROR_MAX + 5.0 * U64) * t.value.abs()).then_some(Reference([t, u, v]))
    }

    /// From exact determinants, each rounded to nearest.
    fn exactly(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> Option<Reference> {
        let exact = triangle_exact::determinants(frame, vertices)?;
        let ratio = |numerator: f64| {
            let value = numerator / exact.determinant;
            Ratio { value, error: 6.0 * U64 * value.abs() }
        };
        Some(Reference([exact.numerator, exact.v, exact.w].map(ratio)))
    }
}

impl RayFrame {
    /// Bounds on the errors of `hit`, which may come from any test of this ray on the triangle `vertices`, whatever its
    /// precision: the exact values are enclosed anew, in double-length numbers or, where those are not enough, in
    /// exact ones, and the hit is held against them. Costs about as much as ten tests.
    pub fn error_bounds(&self, vertices: &[[f64; 3]; 3], hit: &TriangleHit) -> HitErrorBounds {
        let reference = Reference::in_double(self, vertices).or_else(|| Reference::exactly(self, vertices));
        let Some(Reference([t, u, v])) = reference else { return HitErrorBounds::UNKNOWN };
        let bound = |found: f64, ratio: Ratio| {
            let bound = SLACK * ((found - ratio.value).abs() + ratio.error);
            if bound.is_nan() { f64::INFINITY } else { bound }
        };
        let scale = self.scale();
        // The scale is a power of two: it rounds only at the ends of the range.
        let scaled = Ratio { value: t.value * scale, error: t.error * scale + f64::from_bits(2) };
        let (u, v) = (bound(hit.u, u), bound(hit.v, v));
        let [a, b, c] = *vertices;
        let position = hit_position(vertices, hit.u, hit.v);
        let position = [0, 1, 2].map(|axis| {
            let (ab, ac) = ((b[axis] - a[axis]).abs(), (c[axis] - a[axis]).abs());
            // As in `position_error`, for this axis alone: difference, product and sum of each term, and the last sum.
            let rounding = gamma(3) * (hit.u.abs() * ab + hit.v.abs() * ac) + U64 * position[axis].abs();
            let bound = SLACK * (rounding + u * ab + v * ac) + f64::MIN_POSITIVE;
            if bound.is_nan() { f64::INFINITY } else { bound }
        });
        HitErrorBounds { t: bound(hit.t, scaled), u, v, position }
    }

    /// [`RayFrame::intersect`] decided by exact arithmetic alone, one to two orders of magnitude slower: what the faster
    /// stages are checked against. The numbers of a hit are the canonical ones, and they tell whether it is in the ray's interval.
    pub fn intersect_exactly(&self, vertices: &[[f64; 3]; 3]) -> Option<TriangleHit> {
        let mut line = *self;
        (line.t_min, line.t_max) = (f64::NEG_INFINITY, f64::INFINITY);
        let exact = triangle_exact::intersect(&line, vertices)?;
        let hit = line.intersect(vertices, &mut 0).unwrap_or(exact);
        if hit.t == f64::MAX {
            // It may lie beyond the range of f64, and then beyond every finite end.
            return self.intersect(vertices, &mut 0);
        }
        (hit.t >= self.t_min && hit.t <= self.t_max).then_some(hit)
    }
}
