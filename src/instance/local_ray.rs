//! A ray of the world in the space of an instance's model, with all that it may be off.
//!
//! Only boxes and reject tests see it. Its errors are in where it begins: for every `t` at which the ray of the world meets a
//! triangle of the instance, the point at `t` of a ray from within [`LocalRay::error`] of the start, in the very direction that is used here,
//! lies on the model's triangle (`docs/numerics.md`, "Instances"). That is what the kernels of `simd` take an origin's error for.

use super::placed::{Placed, SLACK};
use crate::geom::{RayFrame, gamma};
use crate::octree::{Fine, LazyOctree};
use crate::simd::{BoxRay, ErrorBounds, Interval, ParallelAxes, Simd, TestRay};

/// More than any rounding of a parameter in f32 arithmetic, with room for that of the product with it: 2^-18.
const MARGIN: f32 = 1.0 / (1u32 << 18) as f32;
/// More than the rounding of a difference of parameters in f64.
const MARGIN_F64: f64 = 4.0 * f64::EPSILON;
/// Twice the rounding of an f32, relative to its magnitude.
const ORIGIN_ROUNDING: f32 = 1.0 / (1u32 << 23) as f32;
/// Largest error of an origin with which the tests still make sense; coordinates of a frame stay below 2^41.
const ERROR_MAX: f32 = 1e30;

const fn power_of_two(exponent: i64) -> f64 {
    f64::from_bits(((1023 + exponent) as u64) << 52)
}

/// See the module's text.
#[derive(Clone, Copy, Debug)]
pub(super) struct LocalRay {
    pub test: TestRay,
    /// Where it begins in the model's space, and how far off that is, per axis.
    origin: [f64; 3],
    error: f64,
    widen: [f32; 3],
    /// Sum of the magnitudes of the scaled direction.
    direction_sum: f32,
    /// From `t` to the parameter that the tests use: first one factor, then the other (their product can leave the range of f64).
    t_factors: [f64; 2],
    /// That parameter where the ray begins.
    t_start: f64,
    /// Of the tree that it is in.
    base: [f64; 3],
    scale: f64,
    /// How far the tests' origin is off.
    origin_error: f32,
}

impl LocalRay {
    /// The ray of `frame`, whose hits up to `frame.t_max` matter, for an instance of the model of `octree`.
    #[inline(always)]
    pub fn new<S: Simd>(simd: S, frame: &RayFrame, placed: &Placed, octree: &LazyOctree) -> LocalRay {
        let space = &octree.space;
        let Moved { mut origin, mut error, direction, exponent } = Moved::new(frame, placed);
        let scale = space.frame.scale;
        let mut t_start = 0.0;
        if let Some((entry, at, more)) = approach(origin, direction, octree) {
            (origin, error, t_start) = (at, error + more, entry * scale);
        }
        error = error * SLACK + f64::MIN_POSITIVE;
        let parallel = ParallelAxes::new(direction, (error * scale) as f32 * (1.0 + 1e-6), &space.parallel);
        let mut ray = LocalRay {
            test: TestRay::UNSET,
            origin,
            error,
            widen: parallel.widen(),
            direction_sum: (1.0 + 1e-6) * direction.iter().map(|x| x.abs() as f32).sum::<f32>(),
            t_factors: [power_of_two(exponent) / frame.scale(), scale],
            t_start,
            base: [f64::NAN; 3],
            scale,
            origin_error: 0.0,
        };
        let direction = direction.map(|x| x as f32);
        let [x, y, z] = direction;
        ray.test.boxes.set_direction(simd, simd.load(&[x, y, z, 1.0, 1.0, 1.0, 1.0, 1.0]), &parallel);
        ray.test.triangles.direction = direction;
        ray.enter(simd, space.frame.base);
        ray
    }

    /// Moves into the space of a tree with this base; costs nothing if it is there.
    #[inline(always)]
    pub fn enter<S: Simd>(&mut self, simd: S, base: [f64; 3]) {
        if base == self.base {
            return;
        }
        self.base = base;
        let origin = [0, 1, 2].map(|axis| ((self.origin[axis] - base[axis]) * self.scale) as f32);
        let largest =
            origin.iter().fold(0.0f32, |largest, x| if x.abs() > largest { x.abs() } else { largest });
        self.origin_error =
            largest * ORIGIN_ROUNDING + f32::MIN_POSITIVE + (self.error * self.scale) as f32 * (1.0 + 1e-6);
        self.test.triangles.origin = origin;
        self.test.boxes.set_origin(simd, origin, self.widen);
        // Written so that NaN passes: every box is met then, and no triangle rejected.
        let is_known = self.origin_error < ERROR_MAX && origin.iter().all(|x| x.is_finite());
        if !is_known {
            self.test.boxes.set_origin_unknown();
            (self.test.triangles.origin, self.origin_error) = ([0.0; 3], f32::INFINITY);
        }
    }

    /// The bounds of the reject test in a block.
    #[inline(always)]
    pub fn bounds<S: Simd>(&self, simd: S, fine: &Fine<'_>) -> ErrorBounds<S> {
        let (low, high) = fine.extents();
        let origin = self.test.triangles.origin;
        let reach = (0..3).fold(0.0f32, |reach, axis| {
            let farthest = (high[axis] - origin[axis]).max(origin[axis] - low[axis]);
            if farthest > reach { farthest } else { reach }
        });
        let reach = reach * (1.0 + 1e-6) + self.origin_error + fine.vertex_error();
        ErrorBounds::new(simd, self.direction_sum, reach, self.origin_error, fine.vertex_error())
    }

    /// The tests' interval for hits from `t_min` to `t_max`: holds it, with room for the error of a hit's `t`.
    #[inline(always)]
    pub fn interval(&self, t_min: f64, t_max: f64) -> (f32, f32) {
        (self.low(t_min), self.high(t_max))
    }

    /// At least the parameter of `t`, and greater than 0.
    #[inline(always)]
    pub fn high(&self, t: f64) -> f32 {
        let local = self.parameter(t) + self.t_start * MARGIN_F64;
        let high = local as f32 * (1.0 + MARGIN) + f32::MIN_POSITIVE;
        // Hits beyond the range of f64 all have t = f64::MAX; NaN is infinity minus infinity.
        if t >= f64::MAX || high.is_nan() { f32::INFINITY } else { high.max(f32::MIN_POSITIVE) }
    }

    /// At most the parameter of `t`, or 0: no part of the model is before the start.
    #[inline(always)]
    fn low(&self, t: f64) -> f32 {
        let local = self.parameter(t) - self.t_start * MARGIN_F64;
        let low = local as f32 * (1.0 - MARGIN) - f32::MIN_POSITIVE;
        if low > 0.0 { low.min(f32::MAX) } else { 0.0 }
    }

    #[inline(always)]
    fn parameter(&self, t: f64) -> f64 {
        t * self.t_factors[0] * self.t_factors[1] - self.t_start
    }
}

/// The same in every lane.
#[inline(always)]
pub(super) fn splat<S: Simd>(simd: S, (low, high): (f32, f32)) -> Interval<S::F> {
    Interval { low: simd.splat(low), high: simd.splat(high) }
}

/// A ray in a model's space, in f64.
struct Moved {
    origin: [f64; 3],
    /// Of the origin, with what the direction and the vertices are off.
    error: f64,
    /// Largest magnitude 1 to 2.
    direction: [f64; 3],
    /// Of the power of two that the direction was divided by.
    exponent: i64,
}

impl Moved {
    #[inline(always)]
    fn new(frame: &RayFrame, placed: &Placed) -> Moved {
        let (from, along) = (frame.origin(), frame.direction());
        let to_origin = [0, 1, 2].map(|axis| from[axis] - placed.shift[axis]);
        let (origin, origin_sum) = apply(&placed.inverse, to_origin);
        let (direction, direction_sum) = apply(&placed.inverse, along);
        let origin_error = origin_sum.map(|sum| gamma(6) * sum);
        let direction_error = direction_sum.map(|sum| gamma(5) * sum);
        // The longest axis says how long the ray can be in the model's box.
        let mut longest = 0;
        for axis in 1..3 {
            if direction[axis].abs() > direction[longest].abs() {
                longest = axis;
            }
        }
        let way =
            placed.reach[longest] + origin[longest].abs() + origin_error[longest] + placed.error[longest];
        let speed = direction[longest].abs() - direction_error[longest];
        let most = frame.t_max / frame.scale();
        let until = if speed > 0.0 { (way / speed).min(most) } else { most } * SLACK;
        let errors = [0, 1, 2].map(|axis| {
            // No error times an infinite way is none.
            let drift = if direction_error[axis] > 0.0 { until * direction_error[axis] } else { 0.0 };
            origin_error[axis] + drift + placed.error[axis]
        });
        let is_known = errors.iter().all(|x| x.is_finite());
        let error = if is_known { errors[0].max(errors[1]).max(errors[2]) } else { f64::INFINITY };
        let exponent = ((direction[longest].abs().to_bits() >> 52) as i64 - 1023).clamp(-1000, 1000);
        let factor = power_of_two(-exponent);
        Moved { origin, error, direction: direction.map(|x| x * factor), exponent }
    }
}

/// A matrix times a vector, and the same with the magnitudes of all products.
#[inline(always)]
fn apply(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let mut sums = [0.0; 3];
    let products = [0, 1, 2].map(|row| {
        let [a, b, c] = [matrix[row][0] * v[0], matrix[row][1] * v[1], matrix[row][2] * v[2]];
        sums[row] = a.abs() + b.abs() + c.abs();
        a + b + c
    });
    (products, sums)
}

/// For a ray from outside the model: a start nearer to it, so that f32 can tell the model's parts apart. Gives the parameter, the place and
/// how much farther off it is.
#[inline(always)]
fn approach(origin: [f64; 3], direction: [f64; 3], octree: &LazyOctree) -> Option<(f64, [f64; 3], f64)> {
    let bounds = &octree.model().bounds;
    // Any parameter will do; the entry into a box of twice the model's size is a good one.
    let margin = 0.5 * bounds.extent().iter().fold(0.0f64, |largest, x| largest.max(*x));
    let mut entry = 0.0f64;
    for (axis, d) in direction.into_iter().enumerate() {
        let plane = if d > 0.0 { bounds.min[axis] - margin } else { bounds.max[axis] + margin };
        let t = (plane - origin[axis]) / d;
        if t.is_finite() && t > entry {
            entry = t;
        }
    }
    // A little before the entry, whatever the rounding: no hit is behind the start.
    entry *= 1.0 - 1.0 / (1u64 << 45) as f64;
    let moved = [0, 1, 2].map(|axis| origin[axis] + entry * direction[axis]);
    // Product and sum round once each; doubled for the rounding of the bound itself.
    let error = (0..3).fold(f64::MIN_POSITIVE, |error, axis| {
        error.max(f64::EPSILON * ((entry * direction[axis]).abs() + moved[axis].abs()))
    });
    let is_sensible = entry > 0.0 && moved.iter().chain([&error]).all(|x| x.is_finite());
    is_sensible.then_some((entry, moved, error))
}

impl LocalRay {
    /// For the tests of boxes.
    #[inline(always)]
    pub fn boxes(&self) -> &BoxRay {
        &self.test.boxes
    }
}
