//! The definition of a hit, written down once more in exact integers.

#![allow(dead_code)]

use dashu::base::BitTest;
use dashu::integer::IBig;
use dashu::rational::RBig;
use outcrop::geom::{Ray, TriangleHit};

/// `integer * 2^exponent`, exactly.
fn parts(x: f64) -> (IBig, i64) {
    assert!(x.is_finite());
    let bits = x.to_bits();
    let (biased, fraction) = ((bits >> 52 & 0x7ff) as i64, bits & ((1 << 52) - 1));
    let (mantissa, exponent) =
        if biased == 0 { (fraction, -1074) } else { (fraction | 1 << 52, biased - 1075) };
    let zeros = if mantissa == 0 { 0 } else { mantissa.trailing_zeros() };
    let mantissa = IBig::from(mantissa >> zeros);
    (if x < 0.0 { -mantissa } else { mantissa }, exponent + i64::from(zeros))
}

/// Vectors as integers on a common binary grid.
fn on_grid<const N: usize>(vectors: [[f64; 3]; N]) -> ([[IBig; 3]; N], i64) {
    let parts = vectors.map(|vector| vector.map(parts));
    let zero = IBig::ZERO;
    let unit = parts.iter().flatten().filter(|(m, _)| *m != zero).map(|(_, e)| *e).min().unwrap_or(0);
    let shifted = parts.map(|vector| {
        vector.map(|(m, e)| if m == zero { m } else { m << usize::try_from(e - unit).unwrap() })
    });
    (shifted, unit)
}

fn minus(a: &[IBig; 3], b: &[IBig; 3]) -> [IBig; 3] {
    [0, 1, 2].map(|axis| &a[axis] - &b[axis])
}

fn cross(a: &[IBig; 3], b: &[IBig; 3]) -> [IBig; 3] {
    [(1, 2), (2, 0), (0, 1)].map(|(j, k)| &a[j] * &b[k] - &a[k] * &b[j])
}

fn dot(a: &[IBig; 3], b: &[IBig; 3]) -> IBig {
    &a[0] * &b[0] + &a[1] * &b[1] + &a[2] * &b[2]
}

fn abs(a: IBig) -> IBig {
    if a < IBig::ZERO { -a } else { a }
}

/// -1, 0 or 1.
pub fn sign(a: &IBig) -> i32 {
    i32::from(*a > IBig::ZERO) - i32::from(*a < IBig::ZERO)
}

/// `|a 2^ea - b 2^eb| <= |b 2^eb| 2^-tolerance_bits`.
fn close(a: &IBig, ea: i64, b: &IBig, eb: i64, tolerance_bits: usize) -> bool {
    let unit = ea.min(eb);
    let (a, b) = (a << (ea - unit) as usize, b << (eb - unit) as usize);
    abs(a - &b) << tolerance_bits <= abs(b)
}

/// `integer * 2^exponent`.
fn scaled(integer: &IBig, exponent: i64) -> RBig {
    let power = RBig::from(IBig::ONE << exponent.unsigned_abs() as usize);
    let integer = RBig::from(integer.clone());
    if exponent < 0 { integer / power } else { integer * power }
}

/// The edge functions opposite to the vertices once the origin is moved by `(e, e^2, e^3)`, for an `e` that is smaller than
/// any number that 2000 bits on the common grid can tell from 0.
pub fn moved_edges(ray: &Ray, vertices: &[[f64; 3]; 3]) -> [IBig; 3] {
    const BITS: usize = 2000;
    let [a, b, c] = *vertices;
    let ([o, a, b, c], _) = on_grid([ray.origin, a, b, c]);
    let ([d], _) = on_grid([ray.direction]);
    let mut start = o.map(|x| x << (3 * BITS));
    for (axis, x) in start.iter_mut().enumerate() {
        *x += IBig::ONE << ((2 - axis) * BITS);
    }
    let [a, b, c] = [a, b, c].map(|vertex| minus(&vertex.map(|x| x << (3 * BITS)), &start));
    [dot(&d, &cross(&b, &c)), dot(&d, &cross(&c, &a)), dot(&d, &cross(&a, &b))]
}

/// `2^exponent`, as far as it is normal.
fn power(exponent: i64) -> f64 {
    f64::from_bits(((exponent.clamp(-1022, 1023) + 1023) as u64) << 52)
}

/// `(f, e)` such that `f * 2^e` is `a` rounded to 53 bits, ties to even.
fn nearest(a: &IBig) -> (f64, i64) {
    let magnitude = abs(a.clone());
    let excess = magnitude.bit_len().saturating_sub(54);
    // One bit more than kept, and one for all that follow.
    let mut short = &magnitude >> excess;
    let mut exponent = excess as i64;
    if (&short << excess) != magnitude {
        (short, exponent) = ((short << 1usize) + IBig::ONE, exponent - 1);
    }
    let short = i64::try_from(short).unwrap() as f64;
    (if *a < IBig::ZERO { -short } else { short }, exponent)
}

/// The ray's line and a triangle.
pub struct Exact {
    /// Edge functions opposite to the vertices; their sum is `determinant`.
    pub edges: [IBig; 3],
    determinant: IBig,
    numerator: IBig,
    /// `t = numerator / determinant * 2^exponent`.
    exponent: i64,
}

impl Exact {
    pub fn new(ray: &Ray, vertices: &[[f64; 3]; 3]) -> Exact {
        let [a, b, c] = *vertices;
        let ([o, a, b, c], unit) = on_grid([ray.origin, a, b, c]);
        let ([d], direction_unit) = on_grid([ray.direction]);
        let [a, b, c] = [&a, &b, &c].map(|x| minus(x, &o));
        let edges = [dot(&d, &cross(&b, &c)), dot(&d, &cross(&c, &a)), dot(&d, &cross(&a, &b))];
        let determinant = &edges[0] + &edges[1] + &edges[2];
        let numerator = dot(&a, &cross(&b, &c));
        Exact { edges, determinant, numerator, exponent: unit - direction_unit }
    }

    /// Whether the line meets the closed triangle.
    pub fn meets(&self) -> bool {
        let signs = self.edges.each_ref().map(sign);
        (signs.iter().all(|s| *s >= 0) || signs.iter().all(|s| *s <= 0)) && self.determinant != IBig::ZERO
    }

    pub fn determinant_sign(&self) -> i32 {
        sign(&self.determinant)
    }

    /// Sign of `t`.
    pub fn t_sign(&self) -> i32 {
        sign(&self.numerator) * sign(&self.determinant)
    }

    /// `t` of the plane. The line is not parallel to it.
    pub fn t(&self) -> RBig {
        scaled(&self.numerator, self.exponent) / RBig::from(self.determinant.clone())
    }

    /// Weights of the second and of the third vertex. The line is not parallel to the plane.
    pub fn weights(&self) -> [RBig; 2] {
        [1, 2].map(|edge| RBig::from(self.edges[edge].clone()) / RBig::from(self.determinant.clone()))
    }

    /// `t`, `u` and `v` as quotients of the determinants, each of these rounded to nearest: what ties promise. The line meets
    /// the triangle. None if `t` leaves the normal range.
    pub fn rounded_quotients(&self) -> Option<[f64; 3]> {
        let quotient = |numerator: &IBig, exponent: i64| {
            let ((n, en), (d, ed)) = (nearest(numerator), nearest(&self.determinant));
            let (quotient, exponent) = (n / d, exponent + en - ed);
            // In two steps, since a weight's exponent may be beyond a single power; the first is exact.
            quotient * power(exponent / 2) * power(exponent - exponent / 2)
        };
        let t = quotient(&self.numerator, self.exponent);
        let u = quotient(&self.edges[1], 0).clamp(0.0, 1.0);
        let v = quotient(&self.edges[2], 0).clamp(0.0, 1.0 - u);
        // Adding zero turns -0 into 0.
        (t == 0.0 || t.is_normal()).then_some([t + 0.0, u + 0.0, v + 0.0])
    }

    /// Whether `t` is off by a factor within `1 +- 2^-bits`.
    pub fn t_is(&self, t: f64, bits: usize) -> bool {
        let (m, e) = parts(t);
        close(&(m * &self.determinant), e, &self.numerator, self.exponent, bits)
    }

    /// Whether the weights are off by at most `2^-bits`.
    pub fn weights_are(&self, hit: &TriangleHit, bits: usize) -> bool {
        [(hit.u, &self.edges[1]), (hit.v, &self.edges[2])].into_iter().all(|(weight, edge)| {
            // |weight - edge / determinant| <= 2^-bits
            let (m, e) = parts(weight);
            assert!(e > -1100);
            let scaled_edge = edge << 1100;
            abs(((m * &self.determinant) << (e + 1100) as usize) - scaled_edge) << bits
                <= abs(self.determinant.clone()) << 1100
        })
    }
}

/// Whether `position` is within `error` per axis of the exact `a + u (b - a) + v (c - a)`.
pub fn position_is(vertices: &[[f64; 3]; 3], u: f64, v: f64, position: [f64; 3], error: f64) -> bool {
    let [a, b, c] = *vertices;
    // All on one grid: u and v ride along as a fourth vector.
    let ([a, b, c, p], unit) = on_grid([a, b, c, position]);
    let ([w], weight_unit) = on_grid([[u, v, 0.0]]);
    let ([e], error_unit) = on_grid([[error, 0.0, 0.0]]);
    let (ab, ac, ap) = (minus(&b, &a), minus(&c, &a), minus(&p, &a));
    (0..3).all(|axis| {
        let along = &w[0] * &ab[axis] + &w[1] * &ac[axis]; // unit + weight_unit
        let common = (unit + weight_unit).min(unit).min(error_unit);
        let off = (&ap[axis] << (unit - common) as usize) - (along << (unit + weight_unit - common) as usize);
        abs(off) <= &e[0] << (error_unit - common) as usize
    })
}
