//! The exact stage of the triangle test: the same determinants as the f64 stage, as expansions.

use super::TriangleHit;
use super::expansion::{Expansion, difference};
use super::frame::{COORDINATE_MAX, RayFrame};

/// A vector of exact differences.
type Difference = [Expansion<2>; 3];

fn differences(a: [f64; 3], b: [f64; 3]) -> Difference {
    [0, 1, 2].map(|axis| difference(a[axis], b[axis]))
}

/// `direction x a`.
fn moment(direction: [f64; 3], a: &Difference) -> [Expansion<8>; 3] {
    [(1, 2), (2, 0), (0, 1)]
        .map(|(j, k)| a[k].scaled::<4>(direction[j]).minus(&a[j].scaled::<4>(direction[k])))
}

/// `a x b`.
fn cross(a: &Difference, b: &Difference) -> [Expansion<16>; 3] {
    [(1, 2), (2, 0), (0, 1)].map(|(j, k)| a[j].times::<4, 8>(&b[k]).minus(&a[k].times::<4, 8>(&b[j])))
}

/// `a . b`; `P` is 4 `N`, `S` is 8 `N`.
fn dot<const N: usize, const D: usize, const P: usize, const S: usize, const T: usize>(
    a: &[Expansion<N>; 3],
    b: &Difference,
) -> Expansion<T> {
    let [x, y, z] = [0, 1, 2].map(|axis| a[axis].times::<D, P>(&b[axis]));
    x.plus::<P, S>(&y).plus(&z)
}

fn edge_function(edge: &Difference, moment: &[Expansion<8>; 3]) -> Expansion<96> {
    dot::<8, 16, 32, 64, 96>(moment, edge)
}

/// [`RayFrame::intersect`] without an f64 stage. One to two orders of magnitude slower.
#[cold]
#[inline(never)]
pub(super) fn intersect(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> Option<TriangleHit> {
    // Written so that NaN fails. Inside this range nothing below overflows.
    if !vertices.iter().flatten().all(|x| x.abs() <= COORDINATE_MAX) {
        return None;
    }
    let [a, b, c] = *vertices;
    let (to_a, to_b) = (differences(a, frame.origin), differences(b, frame.origin));
    let (ab, ac, bc) = (differences(b, a), differences(c, a), differences(c, b));
    let moment_a = moment(frame.direction, &to_a);
    let w = edge_function(&ab, &moment_a);
    let v = edge_function(&ac, &moment_a).negated();
    if w.sign() * v.sign() < 0 {
        return None;
    }
    let u = edge_function(&bc, &moment(frame.direction, &to_b));
    let signs = [u.sign(), v.sign(), w.sign()];
    if signs.contains(&1) == signs.contains(&-1) {
        // Both signs: a miss. Neither: all three are zero, so their sum, the determinant, is too.
        return None;
    }
    // With one sign among them the sum cannot be zero.
    let [determinant, numerator] = plane(frame, &ab, &ac, &to_a);
    frame.accept(numerator / determinant, v.value() / determinant, w.value() / determinant)
}

/// The determinant and the numerator of `t`.
fn plane(frame: &RayFrame, ab: &Difference, ac: &Difference, to_a: &Difference) -> [f64; 2] {
    let normal = cross(ab, ac);
    let [x, y, z] = [0, 1, 2].map(|axis| normal[axis].scaled::<32>(frame.direction[axis]));
    let determinant = x.plus::<32, 64>(&y).plus::<32, 96>(&z).value();
    [determinant, dot::<16, 32, 64, 128, 192>(&normal, to_a).value()]
}

/// What `t` and the weights are ratios of, each rounded to nearest.
pub(super) struct Determinants {
    pub v: f64,
    pub w: f64,
    /// Not zero.
    pub determinant: f64,
    pub numerator: f64,
}

/// The determinants of a line and a triangle, whether they meet or not; none outside of the domain and for a line parallel
/// to the plane.
#[cold]
#[inline(never)]
pub(super) fn determinants(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> Option<Determinants> {
    if !vertices.iter().flatten().all(|x| x.abs() <= COORDINATE_MAX) {
        return None;
    }
    let [a, b, c] = *vertices;
    let (to_a, ab, ac) = (differences(a, frame.origin), differences(b, a), differences(c, a));
    let moment = moment(frame.direction, &to_a);
    let [determinant, numerator] = plane(frame, &ab, &ac, &to_a);
    let v = edge_function(&ac, &moment).negated().value();
    let w = edge_function(&ab, &moment).value();
    (determinant != 0.0).then_some(Determinants { v, w, determinant, numerator })
}

/// The sign that all three edge functions have once the origin is moved by `(e, e^2, e^3)`, `e` infinitesimal; 0 if they
/// differ, or if the triangle is parallel to the ray.
#[cold]
#[inline(never)]
pub(super) fn moved_sign(frame: &RayFrame, vertices: &[[f64; 3]; 3]) -> i32 {
    if !vertices.iter().flatten().all(|x| x.abs() <= COORDINATE_MAX) {
        return 0;
    }
    let [a, b, c] = *vertices;
    // `d . A x B` grows with the origin by `d x (b - a)`.
    let moved =
        |edge: Difference, moment_of_start: &[Expansion<8>; 3]| match edge_function(&edge, moment_of_start)
            .sign()
        {
            0 => moment(frame.direction, &edge)
                .iter()
                .map(Expansion::sign)
                .find(|sign| *sign != 0)
                .unwrap_or(0),
            sign => sign,
        };
    let moment_a = moment(frame.direction, &differences(a, frame.origin));
    let w = moved(differences(b, a), &moment_a);
    let v = -moved(differences(c, a), &moment_a);
    if w != v {
        return 0;
    }
    let u = moved(differences(c, b), &moment(frame.direction, &differences(b, frame.origin)));
    if u == v { u } else { 0 }
}

/// Whether the exact normal is zero.
#[cold]
#[inline(never)]
pub(super) fn is_degenerate(vertices: &[[f64; 3]; 3]) -> bool {
    if !vertices.iter().flatten().all(|x| x.abs() <= COORDINATE_MAX) {
        return false;
    }
    let [a, b, c] = *vertices;
    cross(&differences(b, a), &differences(c, a)).iter().all(|component| component.sign() == 0)
}
