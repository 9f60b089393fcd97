//! The global lattice: one spacing for the whole model, so that neighbouring blocks decode a shared vertex
//! to the same position (I4).

/// How a compiled file holds positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Precision {
    /// Input floats, bit for bit.
    Float32,
    /// Integer multiples of one power of two.
    Lattice(Lattice),
}

/// A lattice with spacing `2^exponent` through the origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lattice {
    /// Base-two logarithm of the spacing, within `Lattice::EXPONENT_MIN ..= Lattice::EXPONENT_MAX`.
    pub exponent: i32,
}

impl Lattice {
    /// Finest spacing: products of three coordinate differences stay far from f64 underflow.
    pub const EXPONENT_MIN: i32 = -200;
    /// Coarsest spacing.
    pub const EXPONENT_MAX: i32 = 200;
    /// Largest magnitude of a lattice coordinate: positions are exact in f64.
    pub const COORDINATE_MAX: i64 = 1 << 52;

    /// The spacing as a number; exact.
    pub fn step(self) -> f64 {
        // A power of two in the normal range has an empty mantissa.
        f64::from_bits(((1023 + self.exponent) as u64) << 52)
    }

    /// The nearest lattice coordinate (ties to even), or `None` if it is out of range or `x` is not finite.
    pub fn quantize(self, x: f64) -> Option<i64> {
        // Division by a power of two is exact unless it overflows or underflows; both fail the range test or round to 0.
        let scaled = (x / self.step()).round_ties_even();
        (scaled.abs() <= Self::COORDINATE_MAX as f64).then_some(scaled as i64)
    }

    /// The position of a lattice coordinate; exact for `|coordinate| <= COORDINATE_MAX`.
    pub fn position(self, coordinate: i64) -> f64 {
        coordinate as f64 * self.step()
    }

    /// Largest distance, per axis, between a position and its lattice point.
    pub fn error_bound(self) -> f64 {
        0.5 * self.step()
    }
}
