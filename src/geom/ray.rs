//! A ray: six f64 numbers, taken as exact.

/// The set of points `origin + t * direction` for `t_min <= t <= t_max`. `direction` need not be unit length;
/// `t` is measured in its length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Where `t` is 0.
    pub origin: [f64; 3],
    /// Finite and not zero; any length.
    pub direction: [f64; 3],
    /// At least 0.
    pub t_min: f64,
    /// At least `t_min`; may be infinite.
    pub t_max: f64,
}

impl Ray {
    /// The ray from `origin` along `direction` without an end.
    pub fn new(origin: [f64; 3], direction: [f64; 3]) -> Ray {
        Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY }
    }

    /// The point at `t`, rounded.
    pub fn at(&self, t: f64) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.origin[axis] + t * self.direction[axis])
    }

    /// Whether the ray can be traced.
    ///
    /// # Errors
    /// Why it cannot: a component that is not finite, a direction of zero, or an interval that is not `0 <= t_min <= t_max` with a finite
    /// `t_min`.
    pub fn validate(&self) -> Result<(), &'static str> {
        if self.origin.iter().chain(&self.direction).any(|x| !x.is_finite()) {
            return Err("a component of its origin or direction is not finite");
        }
        if self.direction == [0.0; 3] {
            return Err("its direction is zero");
        }
        // Written so that NaN fails.
        if !(self.t_min >= 0.0 && self.t_min <= self.t_max && self.t_min < f64::INFINITY) {
            return Err("its interval does not satisfy 0 <= t_min <= t_max");
        }
        Ok(())
    }
}
