//! A ray of the world in the space of an instance's model, with all that it may be off.
//!
//! Only boxes and reject tests see it. Its errors are in where it begins: for every `t` at which the ray of the world meets a
//! triangle of the instance, the point at `t` of a ray from within [`MovedRay::origin_error`] of the start, in the very direction
//! that is used here, lies on the model's triangle (`docs/numerics.md`, "Instances"). That is what the kernels of `simd` take an
//! origin's error for.

use super::placed::{Placed, SLACK};
use crate::geom::{RayFrame, gamma};
use crate::octree::{MovedRay, power_of_two};

/// The ray of `frame`, whose hits up to `frame.t_max` matter, in the space of the instance's model.
#[inline(always)]
pub(super) fn moved(frame: &RayFrame, placed: &Placed) -> MovedRay {
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
    let way = placed.reach[longest] + origin[longest].abs() + origin_error[longest] + placed.error[longest];
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
    MovedRay {
        origin,
        origin_error: error * SLACK + f64::MIN_POSITIVE,
        direction: direction.map(|x| x * factor),
        t_factor: power_of_two(exponent) / frame.scale(),
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
