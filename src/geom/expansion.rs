//! Exact arithmetic on sums of f64 numbers, on the stack.
//!
//! An expansion is an unevaluated sum of nonoverlapping f64 terms in order of increasing magnitude (J. Shewchuk, "Adaptive
//! Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates", 1997). The operations here need no more than
//! "nonoverlapping": sums use his LINEAR-EXPANSION-SUM, since FAST-EXPANSION-SUM asks for strongly nonoverlapping terms, which
//! SCALE-EXPANSION does not promise.
//!
//! Everything is exact as long as nothing overflows and every product of two terms is a multiple of `2^-1074`; the caller
//! argues that from the range of its inputs (`docs/numerics.md`, "The proven domain").

use super::float::{fast_two_sum, two_diff, two_product, two_sum};

/// An exact sum of at most `N` f64 terms: nonzero, nonoverlapping, of increasing magnitude. No terms mean zero.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expansion<const N: usize> {
    terms: [f64; N],
    len: usize,
}

impl<const N: usize> Expansion<N> {
    const ZERO: Expansion<N> = Expansion { terms: [0.0; N], len: 0 };

    fn terms(&self) -> &[f64] {
        &self.terms[..self.len]
    }

    /// Appends a term no smaller than the last one; zeros are dropped, which keeps every later operation short.
    #[inline]
    fn push(&mut self, term: f64) {
        if term != 0.0 {
            self.terms[self.len] = term;
            self.len += 1;
        }
    }

    /// `-self`.
    pub(crate) fn negated(mut self) -> Expansion<N> {
        for term in &mut self.terms[..self.len] {
            *term = -*term;
        }
        self
    }

    /// `self + other` (LINEAR-EXPANSION-SUM, theorem 16).
    pub(crate) fn plus<const M: usize, const K: usize>(&self, other: &Expansion<M>) -> Expansion<K> {
        const { assert!(K >= N + M) }
        let mut sum = Expansion::ZERO;
        let (mut e, mut f) = (self.terms(), other.terms());
        // The next term of the two in order of magnitude.
        let mut next = || match (e, f) {
            ([a, rest @ ..], [b, ..]) if a.abs() < b.abs() => {
                e = rest;
                Some(*a)
            }
            (_, [b, rest @ ..]) => {
                f = rest;
                Some(*b)
            }
            ([a, rest @ ..], []) => {
                e = rest;
                Some(*a)
            }
            ([], []) => None,
        };
        let Some(first) = next() else { return sum };
        let Some(second) = next() else {
            sum.push(first);
            return sum;
        };
        let (mut high, mut low) = fast_two_sum(second, first);
        while let Some(term) = next() {
            let (middle, done) = fast_two_sum(term, low);
            sum.push(done);
            (high, low) = two_sum(high, middle);
        }
        sum.push(low);
        sum.push(high);
        sum
    }

    /// `self - other`.
    pub(crate) fn minus<const M: usize, const K: usize>(&self, other: &Expansion<M>) -> Expansion<K> {
        self.plus(&other.negated())
    }

    /// `self * factor` (SCALE-EXPANSION, theorem 19).
    pub(crate) fn scaled<const K: usize>(&self, factor: f64) -> Expansion<K> {
        const { assert!(K >= 2 * N) }
        let mut product = Expansion::ZERO;
        let Some((&first, rest)) = self.terms().split_first() else { return product };
        let (mut high, low) = two_product(first, factor);
        product.push(low);
        for &term in rest {
            let (term_high, term_low) = two_product(term, factor);
            let (sum, low) = two_sum(high, term_low);
            product.push(low);
            let (sum, low) = fast_two_sum(term_high, sum);
            product.push(low);
            high = sum;
        }
        product.push(high);
        product
    }

    /// `self * other`.
    pub(crate) fn times<const H: usize, const K: usize>(&self, other: &Expansion<2>) -> Expansion<K> {
        const { assert!(H >= 2 * N && K >= 2 * H) }
        match other.terms() {
            [] => Expansion::ZERO,
            [factor] => self.scaled::<H>(*factor).plus(&Expansion::<0>::ZERO_TERMS),
            [low, high, ..] => self.scaled::<H>(*low).plus(&self.scaled::<H>(*high)),
        }
    }

    /// -1, 0 or 1. The largest term has the sign of the sum, since the others are smaller than its last bit.
    pub(crate) fn sign(&self) -> i32 {
        match self.terms().last() {
            None => 0,
            Some(term) if *term > 0.0 => 1,
            Some(_) => -1,
        }
    }

    /// The sum rounded to nearest, ties to even; zero has no sign.
    pub(crate) fn value(&self) -> f64 {
        let Some((&last, mut rest)) = self.terms().split_last() else { return 0.0 };
        let mut high = last;
        while let Some((&term, below)) = rest.split_last() {
            rest = below;
            let (sum, error) = fast_two_sum(high, term);
            high = sum;
            if error == 0.0 {
                continue;
            }
            // What is below is smaller than the last bit of `term`, of which `error` and half a unit of `high` are multiples: it
            // matters only if `error` is that half, a tie, and points the same way.
            if let Some(&next) = rest.last()
                && (next > 0.0) == (error > 0.0)
            {
                let other = high + 2.0 * error;
                if other - high == 2.0 * error {
                    high = other;
                }
            }
            break;
        }
        high
    }
}

impl Expansion<0> {
    /// Zero, as an operand.
    const ZERO_TERMS: Expansion<0> = Expansion { terms: [], len: 0 };
}

/// The exact `a - b`.
pub(crate) fn difference(a: f64, b: f64) -> Expansion<2> {
    let (high, low) = two_diff(a, b);
    let mut exact = Expansion::ZERO;
    exact.push(low);
    exact.push(high);
    exact
}

#[cfg(test)]
mod tests {
    use super::*;
    use dashu::rational::RBig;
    use proptest::prelude::*;

    fn exact(x: f64) -> RBig {
        RBig::try_from(x).unwrap()
    }

    fn distance(a: &RBig, b: &RBig) -> RBig {
        if a > b { a - b } else { b - a }
    }

    proptest! {
        #[test]
        fn values_are_rounded_to_nearest_even(top in 1u64..1 << 54, ends in prop::collection::vec((0i32..60, -2i32..3), 0..6)) {
            // Terms are small multiples of powers of two far apart or close by, so that ties and all but ties are common.
            let mut sum: Expansion<16> = Expansion::ZERO;
            sum.push(top as f64);
            let mut total = exact(top as f64);
            let mut exponent = 0;
            for (gap, multiple) in ends {
                exponent -= gap;
                let term = f64::from(multiple) * 2f64.powi(exponent);
                total += exact(term);
                let mut other: Expansion<1> = Expansion::ZERO;
                other.push(term);
                let longer: Expansion<17> = sum.plus(&other);
                prop_assume!(longer.len <= 16);
                sum = Expansion::ZERO;
                for &term in longer.terms() {
                    sum.push(term);
                }
            }
            let value = sum.value();
            let error = distance(&exact(value), &total);
            for neighbour in [value.next_up(), value.next_down()] {
                let other = distance(&exact(neighbour), &total);
                prop_assert!(error < other || error == other && value.to_bits() & 1 == 0, "{sum:?}");
            }
            prop_assert_eq!(sum.negated().value(), -value);
        }
    }

    #[test]
    fn a_tie_is_broken_by_what_is_below() {
        let sum = |terms: &[f64]| {
            let mut sum: Expansion<4> = Expansion::ZERO;
            terms.iter().for_each(|term| sum.push(*term));
            sum.value()
        };
        let half = f64::EPSILON / 2.0;
        assert_eq!(sum(&[half, 1.0]), 1.0);
        assert_eq!(sum(&[1e-300, half, 1.0]), 1.0 + f64::EPSILON);
        assert_eq!(sum(&[-1e-300, half, 1.0]), 1.0);
        assert_eq!(sum(&[-1e-300, -half / 2.0, 1.0]), 1f64.next_down());
        assert_eq!(sum(&[1e-300, -half / 2.0, 1.0]), 1.0);
        assert_eq!(sum(&[]).to_bits(), 0);
    }
}
