//! A ray made ready for exact triangle tests, and the f64 stage of the test.

use super::float::{U64, gamma};
use super::grid::{self, Grid};
use super::{Ray, TriangleHit, double, triangle_exact};

/// Coordinates are exact multiples of this, `2^-252`, or are taken as such; every f64 from `2^-200` up is one.
pub(super) const COORDINATE_UNIT: f64 = f64::from_bits((1023 - 252) << 52);
/// Largest coordinate, `2^252`.
pub(super) const COORDINATE_MAX: f64 = f64::from_bits((1023 + 252) << 52);
/// Components of a scaled direction are multiples of this, `2^-570`; every f64 from `2^-518` up is one.
const DIRECTION_UNIT: f64 = f64::from_bits((1023 - 570) << 52);

/// Error of an edge function relative to the bound on the permanents: 9 roundings on the longest path, one for those in the
/// bound (`docs/numerics.md`, "Edge functions").
const EDGE_ERROR: f64 = 2.0 * gamma(10);
/// Error of numerator and denominator of `t` relative to their computed permanents (`docs/numerics.md`, "Ray parameter").
pub(super) const PLANE_ERROR: f64 = gamma(9);
/// `t` stands if (permanent / value) of numerator and denominator add up to at most this: `900 gamma(9) < 0.989 * 2^-40`.
const T_CONDITION_MAX: f64 = 900.0;
/// The same for double-length numbers: `64 u^2 * 2^59 = 2^-41`.
const T_CONDITION_MAX_DOUBLE: f64 = (1u64 << 59) as f64;
/// Error of the edge functions in double-length numbers relative to that in f64: `50 u^2 / gamma(9) < 8 u` (`docs/numerics.md`,
/// "Double length").
const DOUBLE_ERROR: f64 = 8.0 * U64;
/// Error of the numerator of `t` in double-length numbers relative to its permanent (`docs/numerics.md`, "Double length").
const NUMERATOR_ERROR_DOUBLE: f64 = 64.0 * U64 * U64;
/// `u` and `v` stand if the edge functions' error is at most this part of the determinant.
const WEIGHT_ERROR_MAX: f64 = 1.0 / (1u64 << 25) as f64;

/// A [`Ray`] made ready for many triangle tests: 96 bytes, made once per ray.
///
/// It holds the ray's origin; its direction multiplied by a power of two so that the largest component is in `[1, 2)` (in
/// `[2^-52, 4)` for the shortest and longest directions that f64 can hold), which is exact; that power; the interval of `t`;
/// and the error factor of the edge functions for this direction.
///
/// # What is proven
/// [`RayFrame::intersect`] decides exactly, whatever the magnitudes, for
/// - origins and vertices whose coordinates are 0 or between `2^-200` and `2^252` in magnitude (more generally: multiples of
///   `2^-252` up to `2^252`), which holds all f32 numbers, subnormal ones too, and every [`Lattice`](super::Lattice);
/// - directions whose components are 0 or at least `2^-518` of the largest one.
///
/// Outside of that: a finer component of origin or direction is rounded, once, to a multiple of `2^-252` (origin) or of
/// `2^-570` of the largest (direction), so the hits are those of a neighbouring ray, on every triangle the same one: still no
/// leak. A ray with an origin beyond `2^252`, or one that [`Ray::validate`] refuses because of its origin or direction,
/// hits nothing. A triangle with a coordinate that is not finite is not hit; with one beyond `2^252` or finer than `2^-252` it
/// may be decided wrongly. Nothing panics and no result is NaN.
#[derive(Clone, Copy, Debug)]
pub struct RayFrame {
    pub(super) origin: [f64; 3],
    pub(super) direction: [f64; 3],
    /// The scaled direction divided by the ray's; also what turns a scaled parameter into `t`.
    scale: f64,
    /// Least `t` of a hit, that value included.
    pub t_min: f64,
    /// Largest `t` of a hit, that value included. May be lowered between tests: the `t` of a hit does not depend on it.
    pub t_max: f64,
    /// [`EDGE_ERROR`] times the sum of the direction's magnitudes.
    edge_error: f64,
}

/// What the f64 stage found, and what it knows about its own errors.
struct Plain {
    /// Edge functions.
    u: f64,
    v: f64,
    w: f64,
    determinant: f64,
    /// Numerator of `t`.
    numerator: f64,
    /// Of each edge function.
    error: f64,
    /// Permanent of the numerator of `t`.
    numerator_permanent: f64,
    /// Permanent of the determinant.
    permanent: f64,
}

/// `x` rounded to a multiple of `unit`, a power of two; unchanged (and exact) from `2^52 unit` up.
fn snap(x: f64, unit: f64) -> f64 {
    const SHIFT: f64 = 1.5 * (1u64 << 52) as f64;
    if x.abs() < unit * (1u64 << 52) as f64 { (x + SHIFT * unit) - SHIFT * unit } else { x }
}

fn max(a: f64, b: f64) -> f64 {
    // One instruction, unlike `f64::max`, which orders NaN; a NaN here ends in the exact stage either way.
    if a > b { a } else { b }
}

fn min(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

fn max_abs(a: [f64; 3]) -> f64 {
    max(max(a[0].abs(), a[1].abs()), a[2].abs())
}

/// Whether a line with these exact edge functions meets the closed triangle.
fn meets(edges: [f64; 3]) -> bool {
    let [u, v, w] = edges;
    let (least, most) = (min(min(u, v), w), max(max(u, v), w));
    // One sign, and not all zero.
    (least >= 0.0 && most > 0.0) || (most <= 0.0 && least < 0.0)
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// The edge functions `U`, `V`, `W` in f64, and a bound on the error of each (`docs/numerics.md`, "Edge functions"). A
/// vertex that is not finite makes the bound infinite or NaN.
#[inline]
pub(super) fn edge_functions(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> ([f64; 3], f64) {
    let [a, b, c] = *vertices;
    let to_a = minus(a, frame.origin);
    let (ab, ac) = (minus(b, a), minus(c, a));
    let moment = cross(frame.direction, to_a);
    let w = dot(ab, moment);
    let v = -dot(ac, moment);
    let u = (dot(cross(ab, ac), frame.direction) - v) - w;
    let edge = max(max_abs(ab), max_abs(ac));
    ([u, v, w], frame.edge_error * edge * (2.0 * max_abs(to_a) + edge))
}

impl RayFrame {
    /// Prepares `ray`.
    #[inline]
    pub fn new(ray: &Ray) -> RayFrame {
        let longest = max_abs(ray.direction);
        // The exponent of the longest component, kept where both 2^exponent and 2^-exponent are normal numbers.
        let exponent = ((longest.to_bits() >> 52) as i64 - 1023).clamp(-1022, 1022);
        let scale = f64::from_bits(((1023 - exponent) as u64) << 52);
        let mut origin = ray.origin.map(|x| snap(x, COORDINATE_UNIT));
        let mut direction = ray.direction.map(|x| snap(x * scale, DIRECTION_UNIT));
        // Written so that NaN fails. A zero direction makes every determinant zero: no hit.
        let valid =
            origin.iter().all(|x| x.abs() <= COORDINATE_MAX) && direction.iter().all(|x| x.abs() < 4.0);
        if !valid {
            (origin, direction) = ([0.0; 3], [0.0; 3]);
        }
        let length = direction[0].abs() + direction[1].abs() + direction[2].abs();
        RayFrame {
            origin,
            direction,
            scale,
            t_min: ray.t_min,
            t_max: ray.t_max,
            edge_error: EDGE_ERROR * length,
        }
    }

    /// [`RayFrame::new`] for a ray whose origin is finite and below 2^252, and whose direction has components that are
    /// normal numbers not below `2^-500` of the largest one, which is between `2^-1000` and `2^1000`: then nothing of the
    /// direction is rounded, and nothing has to be looked at.
    #[inline(always)]
    pub(crate) fn of_plain(ray: &Ray) -> RayFrame {
        let [x, y, z] = ray.direction;
        let exponent = (max_abs(ray.direction).to_bits() >> 52) as i64 - 1023;
        let scale = f64::from_bits(((1023 - exponent) as u64) << 52);
        let direction = [x * scale, y * scale, z * scale];
        let length = direction[0].abs() + direction[1].abs() + direction[2].abs();
        let [x, y, z] = ray.origin;
        RayFrame {
            origin: [snap(x, COORDINATE_UNIT), snap(y, COORDINATE_UNIT), snap(z, COORDINATE_UNIT)],
            direction,
            scale,
            t_min: ray.t_min,
            t_max: ray.t_max,
            edge_error: EDGE_ERROR * length,
        }
    }

    /// Where the ray's `t` is 0.
    pub fn origin(&self) -> [f64; 3] {
        self.origin
    }

    /// The scaled direction: the ray's times [`RayFrame::scale`].
    pub fn direction(&self) -> [f64; 3] {
        self.direction
    }

    /// The power of two by which the direction was multiplied. `t = scale * s` if `s` is measured in the scaled direction.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Decides exactly whether the ray meets the triangle `vertices`, and where.
    ///
    /// With the edge functions `U = d . (b-o) x (c-o)`, `V = d . (c-o) x (a-o)`, `W = d . (a-o) x (b-o)` as real numbers, the
    /// ray's line meets the triangle iff all three are at least 0 or all three are at most 0, and their sum is not 0: the
    /// triangle is closed, both its sides count, and a triangle of zero area or parallel to the ray is never hit. An edge's function
    /// depends on the edge alone and changes sign with its sense, so of two triangles at a shared edge at least one is hit
    /// by a ray that passes from one to the other: no leak (I3). The hit counts if its canonical `t` satisfies
    /// `t_min <= t <= t_max`.
    ///
    /// `t`, `u` and `v` are pure functions of the ray and of the vertices in their order (I2): one operation order, plain
    /// multiplications and additions, no SIMD, no fused operation that could change a bit. `t` is off by a factor within
    /// `1 +- 2^-40` of the real one, unless it leaves the normal range of f64: then it saturates at `f64::MAX`, or is off by at
    /// most `2^-1074`. `u` and `v` are off by at most `2^-24` and satisfy `0 <= u`, `0 <= v`, `u + v <= 1` in f64. In the
    /// triangle's plane the point they give is off by about `gamma(10)` of the distance to the origin over the cosine of incidence.
    ///
    /// `exact_fallbacks` grows by one if f64 with its error bounds left the answer open: then it was found out whether rounding
    /// happened at all, and, if so, double-length or exact arithmetic gave the answer.
    #[inline]
    pub fn intersect(&self, vertices: &[[f64; 3]; 3], exact_fallbacks: &mut u64) -> Option<TriangleHit> {
        self.intersect_inlined(vertices, exact_fallbacks)
    }

    /// [`RayFrame::intersect`] for callers whose instructions are others than the target's.
    #[inline(always)]
    pub(crate) fn intersect_inlined(
        &self,
        vertices: &[[f64; 3]; 3],
        exact_fallbacks: &mut u64,
    ) -> Option<TriangleHit> {
        let [a, b, c] = *vertices;
        let to_a = minus(a, self.origin);
        let (ab, ac) = (minus(b, a), minus(c, a));
        let moment = cross(self.direction, to_a);
        let w = dot(ab, moment);
        let v = -dot(ac, moment);
        let normal = cross(ab, ac);
        let determinant = dot(normal, self.direction);
        let u = (determinant - v) - w;

        let edge = max(max_abs(ab), max_abs(ac));
        let error = self.edge_error * edge * (2.0 * max_abs(to_a) + edge);
        let (least, most) = (min(min(u, v), w), max(max(u, v), w));
        if least < -error && most > error {
            // Two functions of certain and opposite sign.
            return None;
        }
        // NaN and infinite bounds fail every comparison below that would accept, and so reach the exact stage.
        let inside = least > error || most < -error;

        let inverse = 1.0 / determinant;
        let numerator = dot(normal, to_a);
        let t = numerator * inverse;
        let normal_permanent = [
            (ab[1] * ac[2]).abs() + (ab[2] * ac[1]).abs(),
            (ab[2] * ac[0]).abs() + (ab[0] * ac[2]).abs(),
            (ab[0] * ac[1]).abs() + (ab[1] * ac[0]).abs(),
        ];
        let numerator_permanent = dot(normal_permanent, to_a.map(f64::abs));
        let permanent = dot(normal_permanent, self.direction.map(f64::abs));
        let t_stands = numerator_permanent + permanent * t.abs() <= T_CONDITION_MAX * numerator.abs();
        if inside && t_stands && error <= WEIGHT_ERROR_MAX * determinant.abs() {
            return self.accept(t, v * inverse, w * inverse);
        }
        // A secondary ray that leaves the surface it starts on: t is certainly negative, however inexact.
        if numerator.abs() > PLANE_ERROR * numerator_permanent
            && determinant.abs() > PLANE_ERROR * permanent
            && (numerator < 0.0) != (determinant < 0.0)
            && self.t_min >= 0.0
        {
            return None;
        }
        *exact_fallbacks += 1;
        let plain = Plain { u, v, w, determinant, numerator, error, numerator_permanent, permanent };
        self.intersect_further(vertices, &plain)
    }

    /// What the f64 stage left open. Ties, as a rule, between short numbers: then f64, or double-length numbers, rounded nothing.
    #[cold]
    #[inline(never)]
    fn intersect_further(&self, vertices: &[[f64; 3]; 3], plain: &Plain) -> Option<TriangleHit> {
        let grid = Grid::of(self.direction, &[self.origin, vertices[0], vertices[1], vertices[2]]);
        // At least the sum of the permanents of the edge functions, up to roundings.
        let permanent = plain.error / gamma(10);
        if grid.holds_edge_functions(permanent, grid::F64_BITS) {
            let Plain { u, v, w, determinant, numerator, .. } = *plain;
            if !meets([u, v, w]) {
                return None;
            }
            if grid.holds_numerator(plain.numerator_permanent, grid::F64_BITS) {
                return self.accept(numerator / determinant, v / determinant, w / determinant);
            }
        }
        self.intersect_double(vertices, plain, &grid, permanent)
    }

    /// The same determinants in double-length numbers: settles needles, grazing rays, near misses of an edge, and ties of
    /// numbers of middling length, at about a tenth of the price of exact arithmetic, which is left with the ties of long
    /// numbers and worse.
    #[inline(never)]
    fn intersect_double(
        &self,
        vertices: &[[f64; 3]; 3],
        plain: &Plain,
        grid: &Grid,
        edge_permanent: f64,
    ) -> Option<TriangleHit> {
        let [a, b, c] = *vertices;
        let direction = self.direction.map(double::Double::from);
        let to_a = double::difference(a, self.origin);
        let (ab, ac) = (double::difference(b, a), double::difference(c, a));
        let moment = double::cross(&direction, &to_a);
        let (w, v) = (double::dot(&ab, &moment), -double::dot(&ac, &moment));
        let normal = double::cross(&ab, &ac);
        let determinant = double::dot(&normal, &direction);
        let u = determinant.minus(v).minus(w);
        let [u, v, w, determinant] = [u, v, w, determinant].map(double::Double::value);
        let numerator = double::dot(&normal, &to_a);

        if grid.holds_edge_functions(edge_permanent, grid::DOUBLE_BITS) {
            if !meets([u, v, w]) {
                return None;
            }
            let error = if grid.holds_numerator(plain.numerator_permanent, grid::DOUBLE_BITS) {
                0.0
            } else {
                NUMERATOR_ERROR_DOUBLE * plain.numerator_permanent
            };
            if let Some(numerator) = numerator.certainly_rounded(error) {
                return self.accept(numerator / determinant, v / determinant, w / determinant);
            }
            return triangle_exact::intersect(self, vertices);
        }
        let error = DOUBLE_ERROR * plain.error;
        let (least, most) = (min(min(u, v), w), max(max(u, v), w));
        if least < -error && most > error {
            return None;
        }
        let inverse = 1.0 / determinant;
        let numerator = numerator.value();
        let t = numerator * inverse;
        let t_stands =
            plain.numerator_permanent + plain.permanent * t.abs() <= T_CONDITION_MAX_DOUBLE * numerator.abs();
        if (least > error || most < -error) && t_stands && error <= WEIGHT_ERROR_MAX * determinant.abs() {
            return self.accept(t, v * inverse, w * inverse);
        }
        triangle_exact::intersect(self, vertices)
    }

    /// The hit at the scaled parameter `t` if it is in the interval.
    #[inline]
    pub(super) fn accept(&self, t: f64, u: f64, v: f64) -> Option<TriangleHit> {
        // Adding zero turns -0 into 0.
        let t = t * self.scale + 0.0;
        // Written so that NaN fails. An overflow to infinity is beyond every finite t_max and inside an infinite one.
        if !(t >= self.t_min && t <= self.t_max) {
            return None;
        }
        let u = min(max(u, 0.0), 1.0);
        let v = max(v, 0.0);
        // u + (1 - u) rounds to 1, and 1 - u - (1 - u) is 0: no weight is ever negative.
        Some(TriangleHit { t: min(t, f64::MAX), u, v: min(v, 1.0 - u) })
    }
}
