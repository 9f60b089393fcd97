//! When determinants of f64 numbers are exact without any care: if the numbers are multiples of a power of two that is not much
//! finer than they are large (`docs/numerics.md`, "Short numbers").

/// The binary grids that a ray and a triangle lie on.
pub(super) struct Grid {
    /// Direction components are multiples of 2 to this.
    direction: i32,
    /// Coordinates are multiples of 2 to this.
    coordinate: i32,
}

/// A multiple of `g` below `2^52 g` is an f64 number, with a bit to spare.
pub(super) const F64_BITS: i32 = 52;
/// The same for double-length numbers: an error of `7 u^2` is less than one part in `2^103`, and a bit to spare.
pub(super) const DOUBLE_BITS: i32 = 102;
/// All f64 numbers are multiples of 2 to this.
const FINEST: i32 = -1074;

/// The largest `e` such that `x` is a multiple of `2^e`; for zero, which is one of every power, more than for all others.
fn exponent_of_unit(x: f64) -> i32 {
    let bits = x.to_bits() & !(1 << 63);
    if bits == 0 {
        return 1024;
    }
    let biased = (bits >> 52) as i32;
    // Zeros below the last bit set, the hidden one included; a subnormal number has none but counts in the same steps.
    let zeros = (bits | 1 << 52).trailing_zeros() as i32;
    if biased == 0 { FINEST + bits.trailing_zeros() as i32 } else { FINEST - 1 + biased + zeros }
}

/// `2^exponent` or the nearest normal number.
fn power_of_two(exponent: i32) -> f64 {
    f64::from_bits(((exponent.clamp(-1022, 1023) + 1023) as u64) << 52)
}

impl Grid {
    pub(super) fn of(direction: [f64; 3], points: &[[f64; 3]; 4]) -> Grid {
        let finest = |exponent: i32, x: &f64| exponent.min(exponent_of_unit(*x));
        Grid {
            direction: direction.iter().fold(1024, finest),
            coordinate: points.iter().flatten().fold(1024, finest),
        }
    }

    /// Whether numbers of `bits` bits hold the edge functions, the determinant, and all that they are computed from.
    /// `permanent` is at least the sum of their permanents, up to a factor of 2. False for NaN.
    pub(super) fn holds_edge_functions(&self, permanent: f64, bits: i32) -> bool {
        let unit = self.direction + 2 * self.coordinate;
        unit >= FINEST && permanent < power_of_two(unit + bits)
    }

    /// The same for the numerator of `t`, if its normal is held.
    pub(super) fn holds_numerator(&self, permanent: f64, bits: i32) -> bool {
        let unit = 3 * self.coordinate;
        unit >= FINEST && permanent < power_of_two(unit + bits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_are_odd_multiples_of_their_unit(mantissa in 0u64..1 << 52, biased in 0u64..2047, zeros in 0u32..53) {
            let x = f64::from_bits(biased << 52 | mantissa >> zeros << zeros);
            prop_assume!(x != 0.0);
            let exponent = exponent_of_unit(x);
            prop_assert!(exponent >= FINEST);
            // Division by a power of two in two exact steps.
            let half = exponent / 2;
            let multiple = x / power_of_two(half) / power_of_two(exponent - half);
            prop_assert_eq!(multiple.fract(), 0.0);
            prop_assert_eq!((multiple / 2.0).fract(), 0.5);
            prop_assert_eq!(exponent_of_unit(-x), exponent);
        }
    }

    #[test]
    fn zero_is_a_multiple_of_everything() {
        for zero in [0.0, -0.0] {
            assert!(exponent_of_unit(zero) > exponent_of_unit(2f64.powi(1023)));
        }
    }

    #[test]
    fn bits_are_counted_from_the_finest_component() {
        let points = [[1.0, 0.5, 0.0], [3.0, -8.0, 0.25], [0.0; 3], [16.0; 3]];
        let grid = Grid::of([0.0, 0.0, -1.5], &points);
        assert_eq!((grid.direction, grid.coordinate), (-1, -2));
        let unit = 2f64.powi(-5);
        assert!(grid.holds_edge_functions((2f64.powi(52) * unit).next_down(), F64_BITS));
        assert!(!grid.holds_edge_functions(2f64.powi(52) * unit, F64_BITS));
        assert!(grid.holds_edge_functions(2f64.powi(52) * unit, DOUBLE_BITS));
        assert!(!grid.holds_edge_functions(f64::NAN, DOUBLE_BITS));
        assert!(!grid.holds_edge_functions(f64::INFINITY, DOUBLE_BITS));
        assert!(grid.holds_numerator((2f64.powi(52 - 6)).next_down(), F64_BITS));
        assert!(!grid.holds_numerator(2f64.powi(52 - 6), F64_BITS));
        // Products finer than f64 are not held, however small.
        let fine = Grid::of([f64::from_bits(1); 3], &points);
        assert!(!fine.holds_edge_functions(0.0, DOUBLE_BITS));
    }
}
