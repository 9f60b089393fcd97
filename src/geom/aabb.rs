//! Axis-aligned boxes with exact f64 bounds.

use super::float::{relative_down_f32, relative_up_f32};

/// A closed axis-aligned box. The empty box has `min = +inf`, `max = -inf`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lowest corner.
    pub min: [f64; 3],
    /// Highest corner.
    pub max: [f64; 3],
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Aabb = Aabb { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    /// Grows the box to hold `point` (components must not be NaN).
    pub fn grow(&mut self, point: [f64; 3]) {
        for (axis, x) in point.into_iter().enumerate() {
            self.min[axis] = self.min[axis].min(x);
            self.max[axis] = self.max[axis].max(x);
        }
    }

    /// Grows the box to hold `other`.
    pub fn merge(&mut self, other: &Aabb) {
        for axis in 0..3 {
            self.min[axis] = self.min[axis].min(other.min[axis]);
            self.max[axis] = self.max[axis].max(other.max[axis]);
        }
    }

    /// Whether the box holds nothing.
    pub fn is_empty(&self) -> bool {
        (0..3).any(|axis| self.min[axis] > self.max[axis])
    }

    /// Edge lengths; negative or NaN for the empty box.
    pub fn extent(&self) -> [f64; 3] {
        [self.max[0] - self.min[0], self.max[1] - self.min[1], self.max[2] - self.min[2]]
    }

    /// The middle, rounded.
    pub fn center(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| 0.5 * self.min[axis] + 0.5 * self.max[axis])
    }

    /// Whether `other` lies inside this box, borders included.
    pub fn contains(&self, other: &Aabb) -> bool {
        (0..3).all(|axis| self.min[axis] <= other.min[axis] && other.max[axis] <= self.max[axis])
    }

    /// The box less `base`, rounded outward: lowest and highest corner of the smallest f32 box around the exact one.
    /// The empty box stays empty. `base` is finite.
    pub fn relative_to(&self, base: [f64; 3]) -> ([f32; 3], [f32; 3]) {
        (
            [0, 1, 2].map(|axis| relative_down_f32(self.min[axis], base[axis])),
            [0, 1, 2].map(|axis| relative_up_f32(self.max[axis], base[axis])),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_boxes_round_outward() {
        let whole = Aabb { min: [1e7 + 0.1, -1.0, 0.1], max: [1e7 + 0.3, -1.0, 0.1] };
        let (min, max) = whole.relative_to([1e7, 1.0, 0.0]);
        assert_eq!((min[1], max[1]), (-2.0, -2.0));
        assert!(f64::from(min[2]) < 0.1 && 0.1 < f64::from(max[2]) && max[2] == min[2].next_up());
        assert!(f64::from(min[0]) <= whole.min[0] - 1e7 && whole.max[0] - 1e7 <= f64::from(max[0]));
        let (min, max) = Aabb::EMPTY.relative_to([1.0; 3]);
        assert!((0..3).all(|axis| min[axis] > max[axis]));
    }
}
