//! Rounding errors: [`gamma`] and [`gamma_f32`], the only epsilons of the library, and operations on f64 whose rounding error
//! is itself an f64 number.
//!
//! Sources: N. Higham, "Accuracy and Stability of Numerical Algorithms", section 3.1 (`gamma`); T. Dekker, "A
//! floating-point technique for extending the available precision" (1971); J. Shewchuk, "Adaptive Precision
//! Floating-Point Arithmetic and Fast Robust Geometric Predicates" (1997), theorems 6, 7 and 18.

/// Unit roundoff of f64, `2^-53`: `fl(a op b) = (a op b) (1 + d)` with `|d| <= U64` unless the result overflows or
/// underflows.
pub const U64: f64 = f64::EPSILON / 2.0;

/// Unit roundoff of f32, `2^-24`.
pub const U32: f32 = f32::EPSILON / 2.0;

/// `n u / (1 - n u)` for `u = 2^-53`, rounded up: a product of `n` factors `(1 + d)` or `1 / (1 + d)` with `|d| <= u`
/// differs from 1 by at most this.
///
/// # Panics
/// If `n` is `2^20` or more: a bound counted that high is a mistake.
pub const fn gamma(n: u32) -> f64 {
    assert!(n < 1 << 20);
    // n u and 1 - n u are exact (n has at most 20 bits), so one step up covers the rounding of the quotient.
    let nu = n as f64 * U64;
    (nu / (1.0 - nu)).next_up()
}

/// [`gamma`] for f32, `u = 2^-24`.
///
/// # Panics
/// If `n` is `2^20` or more.
pub const fn gamma_f32(n: u32) -> f32 {
    assert!(n < 1 << 20);
    // Exact in f64 up to the quotient's rounding, which one step of f32 dwarfs.
    let nu = n as f64 * U32 as f64;
    ((nu / (1.0 - nu)) as f32).next_up()
}

/// `(s, e)` with `s = fl(a + b)` and `s + e = a + b` exactly (Knuth).
///
/// Exact for any finite operands, subnormal ones too, as long as `a + b` does not overflow: the sum of two f64 numbers never
/// underflows inexactly.
#[inline]
pub(crate) fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let s = a + b;
    let b_part = s - a;
    let a_part = s - b_part;
    (s, (a - a_part) + (b - b_part))
}

/// [`two_sum`] for `|a| >= |b|` or `a = 0` (Dekker).
#[inline]
pub(crate) fn fast_two_sum(a: f64, b: f64) -> (f64, f64) {
    debug_assert!(a == 0.0 || a.abs() >= b.abs() || a.is_nan() || b.is_nan());
    let s = a + b;
    (s, b - (s - a))
}

/// `(s, e)` with `s = fl(a - b)` and `s + e = a - b` exactly; conditions as for [`two_sum`].
#[inline]
pub(crate) fn two_diff(a: f64, b: f64) -> (f64, f64) {
    two_sum(a, -b)
}

/// `(p, e)` with `p = fl(a * b)` and `p + e = a * b` exactly.
///
/// Exact if `|a|` and `|b|` are below `2^995`, the product does not overflow, and `ulp(a) ulp(b) >= 2^-1074` (the error, and
/// every partial product below, is a multiple of `ulp(a) ulp(b)`, so it is then a representable number). The error term of a
/// product is one definite number, so the fused form and Dekker's give the same bits.
///
/// The fused form is used only where the target always has the instruction: elsewhere `mul_add` is a call into the
/// system's C library, which is slower than Dekker's 17 operations and far slower where the CPU lacks the instruction.
#[inline]
pub(crate) fn two_product(a: f64, b: f64) -> (f64, f64) {
    if cfg!(target_feature = "fma") {
        let p = a * b;
        (p, a.mul_add(b, -p))
    } else {
        two_product_dekker(a, b)
    }
}

/// [`two_product`] from plain multiplications and additions.
#[inline]
fn two_product_dekker(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    let (a_high, a_low) = split(a);
    let (b_high, b_low) = split(b);
    let e = ((a_high * b_high - p) + a_high * b_low + a_low * b_high) + a_low * b_low;
    (p, e)
}

/// `a = high + low` exactly, each half with at most 26 significant bits (Veltkamp). For `|a| < 2^995`.
#[inline]
fn split(a: f64) -> (f64, f64) {
    const SPLITTER: f64 = (1u64 << 27) as f64 + 1.0;
    let c = SPLITTER * a;
    let high = c - (c - a);
    (high, a - high)
}

/// The largest f32 that is at most `x`. NaN stays NaN; below `-f32::MAX` it is `-inf`.
#[inline]
pub fn round_down_f32(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) > x { nearest.next_down() } else { nearest }
}

/// The least f32 that is at least `x`. NaN stays NaN; above `f32::MAX` it is `+inf`.
#[inline]
pub fn round_up_f32(x: f64) -> f32 {
    let nearest = x as f32;
    if f64::from(nearest) < x { nearest.next_up() } else { nearest }
}

/// The largest f32 that is at most the exact `x - base`. For finite `x` and `base` whose difference does not overflow f64.
#[inline]
pub fn relative_down_f32(x: f64, base: f64) -> f32 {
    let (difference, error) = two_diff(x, base);
    let down = round_down_f32(difference);
    // Rounding is monotone: were the exact difference below `down`, then so would be `difference`, or equal.
    if f64::from(down) == difference && error < 0.0 { down.next_down() } else { down }
}

/// The least f32 that is at least the exact `x - base`. Conditions as for [`relative_down_f32`].
#[inline]
pub fn relative_up_f32(x: f64, base: f64) -> f32 {
    -relative_down_f32(-x, -base)
}

/// The tightest f32 bounds, per axis, on the exact `point - base`: a ray's origin as the f32 box tests need it.
/// Conditions as for [`relative_down_f32`].
#[inline]
pub fn relative_bounds_f32(point: [f64; 3], base: [f64; 3]) -> ([f32; 3], [f32; 3]) {
    (
        [0, 1, 2].map(|axis| relative_down_f32(point[axis], base[axis])),
        [0, 1, 2].map(|axis| relative_up_f32(point[axis], base[axis])),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use dashu::rational::RBig;
    use proptest::prelude::*;

    fn exact(x: f64) -> RBig {
        RBig::try_from(x).unwrap()
    }

    #[test]
    fn gamma_covers_its_definition() {
        for n in [1, 2, 7, 9, 10, 1000, (1 << 20) - 1] {
            for (gamma, u) in [(gamma(n), U64), (f64::from(gamma_f32(n)), f64::from(U32))] {
                if f64::from(n) * u < 0.01 {
                    let nu = exact(u) * RBig::from(n);
                    let defined = nu.clone() / (RBig::ONE - nu);
                    assert!(exact(gamma) >= defined);
                    assert!(exact(gamma) <= defined * exact(1.0 + 1e-6));
                }
            }
        }
    }

    /// Any sign and mantissa, exponents in a range.
    fn number(exponents: std::ops::Range<i32>) -> impl Strategy<Value = f64> {
        (any::<u64>(), exponents)
            .prop_map(|(bits, e)| f64::from_bits(bits & !(0x7ff << 52) | ((e + 1023) as u64) << 52))
    }

    proptest! {
        #[test]
        fn transforms_are_exact(a in number(-450..500), b in number(-450..500)) {
            let (s, e) = two_sum(a, b);
            prop_assert_eq!(s, a + b);
            prop_assert_eq!(exact(s) + exact(e), exact(a) + exact(b));
            let (s, e) = two_diff(a, b);
            prop_assert_eq!(exact(s) + exact(e), exact(a) - exact(b));
            let (s, e) = if a.abs() > b.abs() { fast_two_sum(a, b) } else { fast_two_sum(b, a) };
            prop_assert_eq!(exact(s) + exact(e), exact(a) + exact(b));
            let (p, e) = two_product(a, b);
            prop_assert_eq!(p, a * b);
            prop_assert_eq!(exact(p) + exact(e), exact(a) * exact(b));
            // Dekker and a fused multiply give the same bits.
            prop_assert_eq!(two_product_dekker(a, b).1, a.mul_add(b, -p));
        }

        #[test]
        fn sums_are_exact_among_subnormals(a in any::<u64>(), b in any::<u64>(), shift in 0u32..12) {
            let [a, b] = [a, b].map(|bits| f64::from_bits(bits >> shift & 0x801f_ffff_ffff_ffff));
            let (s, e) = two_sum(a, b);
            prop_assert_eq!(exact(s) + exact(e), exact(a) + exact(b));
        }

        #[test]
        fn f32_rounding_is_tight(x in number(-160..130), base in number(-160..130)) {
            for (x, base) in [(x, base), (x, 0.0), (f64::from(x as f32), base), (f64::from(x as f32), 0.0), (base, base)] {
                if !x.is_finite() {
                    continue;
                }
                let difference = exact(x) - exact(base);
                let (down, up) = (relative_down_f32(x, base), relative_up_f32(x, base));
                let real = |x: f32| if x.is_infinite() { exact(f64::from(x.signum()) * 2.0f64.powi(200)) } else { exact(f64::from(x)) };
                prop_assert!(real(down) <= difference && difference <= real(up));
                prop_assert!(real(down.next_up()) > difference || down == f32::INFINITY);
                prop_assert!(real(up.next_down()) < difference || up == f32::NEG_INFINITY);
                if base == 0.0 {
                    prop_assert_eq!((round_down_f32(x), round_up_f32(x)), (down, up));
                }
            }
        }
    }

    #[test]
    fn f32_rounding_at_the_ends() {
        assert_eq!(round_down_f32(1e300), f32::MAX);
        assert_eq!(round_up_f32(1e300), f32::INFINITY);
        assert_eq!(round_down_f32(-1e300), f32::NEG_INFINITY);
        assert_eq!(round_up_f32(1e-300), f32::from_bits(1));
        assert_eq!(round_down_f32(1e-300), 0.0);
        assert!(round_down_f32(f64::NAN).is_nan());
    }
}
