//! Numbers of twice the length of f64, for decisions that f64 leaves open but that need no exact arithmetic.
//!
//! M. Joldes, J.-M. Muller, V. Popescu, "Tight and rigorous error bounds for basic building blocks of double-word arithmetic"
//! (ACM TOMS 44, 2017), algorithms 6 and 10. With `u = 2^-53` each operation returns its result times `1 + d`, `|d| <= 7 u^2`,
//! under the conditions of [`two_product`] on overflow and underflow.

use super::float::{fast_two_sum, two_diff, two_product, two_sum};

/// The number `high + low`, where `high = fl(high + low)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Double {
    high: f64,
    low: f64,
}

impl Double {
    /// The exact `a - b`.
    #[inline]
    pub(super) fn difference(a: f64, b: f64) -> Double {
        let (high, low) = two_diff(a, b);
        Double { high, low }
    }

    /// The nearest f64.
    #[inline]
    pub(super) fn value(self) -> f64 {
        self.high
    }

    /// The nearest f64 to a number that is within `error` of `self`, if there is but one candidate.
    #[inline]
    pub(super) fn certainly_rounded(self, error: f64) -> Option<f64> {
        if error == 0.0 {
            return Some(self.high);
        }
        // Rounding is monotone; twice the error covers the roundings of the two sums.
        let (below, above) = (self.low - 2.0 * error, self.low + 2.0 * error);
        (self.high + below == self.high && self.high + above == self.high).then_some(self.high)
    }

    /// `self + other` (algorithm 6: relative error at most `3 u^2 / (1 - 4 u)`, cancellation included).
    #[inline]
    pub(super) fn plus(self, other: Double) -> Double {
        let (high, low) = two_sum(self.high, other.high);
        let (carry, rest) = two_sum(self.low, other.low);
        let (high, low) = fast_two_sum(high, low + carry);
        let (high, low) = fast_two_sum(high, rest + low);
        Double { high, low }
    }

    /// `self - other`.
    #[inline]
    pub(super) fn minus(self, other: Double) -> Double {
        self.plus(-other)
    }

    /// `self * other` (algorithm 10: relative error at most `7 u^2`).
    #[inline]
    pub(super) fn times(self, other: Double) -> Double {
        let (high, low) = two_product(self.high, other.high);
        let (high, low) = fast_two_sum(high, low + (self.high * other.low + self.low * other.high));
        Double { high, low }
    }
}

impl From<f64> for Double {
    fn from(x: f64) -> Double {
        Double { high: x, low: 0.0 }
    }
}

impl std::ops::Neg for Double {
    type Output = Double;

    #[inline]
    fn neg(self) -> Double {
        Double { high: -self.high, low: -self.low }
    }
}

/// Three of them.
pub(super) type Vector = [Double; 3];

/// The exact `a - b`.
#[inline]
pub(super) fn difference(a: [f64; 3], b: [f64; 3]) -> Vector {
    [0, 1, 2].map(|axis| Double::difference(a[axis], b[axis]))
}

/// `a x b`: two operations on every path.
#[inline]
pub(super) fn cross(a: &Vector, b: &Vector) -> Vector {
    [(1, 2), (2, 0), (0, 1)].map(|(j, k)| a[j].times(b[k]).minus(a[k].times(b[j])))
}

/// `a . b`: three operations on the longest path.
#[inline]
pub(super) fn dot(a: &Vector, b: &Vector) -> Double {
    a[0].times(b[0]).plus(a[1].times(b[1])).plus(a[2].times(b[2]))
}
