//! How positions will be held: the choice that [`PrecisionChoice::Auto`](super::PrecisionChoice::Auto) stands for.

use super::options::AUTO_TOLERANCE;
use super::vertices::VertexStore;
use crate::error::CompileError;
use crate::geom::{Lattice, Precision};

/// A choice and whether it keeps its promise.
#[derive(Clone, Copy, Debug)]
pub(super) struct Decision {
    pub(super) precision: Precision,
    pub(super) tolerance_met: bool,
}

/// Watches triangles for one whose vertices f32 would move too far.
#[derive(Debug)]
pub(super) struct RoundingWatch {
    exceeded: bool,
    certain: bool,
    /// Square of the shortest edge above zero, where the store keeps nothing but exact vertices.
    shortest: f64,
}

impl RoundingWatch {
    pub(super) fn new() -> RoundingWatch {
        RoundingWatch { exceeded: false, certain: false, shortest: f64::INFINITY }
    }

    /// Whether [`RoundingWatch::exceeded`] would say the same with the exact vertices at hand.
    pub(super) fn is_certain(&self) -> bool {
        self.certain
    }

    /// The square of the shortest edge above zero of the triangles seen so far. Only for stores of exact vertices.
    pub(super) fn shortest_square(&self) -> f64 {
        self.shortest
    }

    /// Whether rounding to f32 moves a vertex of a triangle seen so far by more than the tolerance allows (or by an
    /// amount that cannot be told for want of the exact vertices).
    pub(super) fn exceeded(&self) -> bool {
        self.exceeded
    }

    /// Looks at triangles. Vertices that came as f32 never move.
    pub(super) fn watch(
        &mut self,
        triangles: &[[u32; 3]],
        store: &mut VertexStore,
    ) -> Result<(), CompileError> {
        if self.exceeded {
            return Ok(());
        }
        let (rounded, exact) = match store {
            VertexStore::Float32 { .. } => return Ok(()),
            VertexStore::Rounded { rounded, exact, .. } => (rounded, exact),
            VertexStore::Exact(_) => {
                self.shortest = shortest_square(triangles, store, self.shortest)?;
                return Ok(());
            }
        };
        // Seen from the rounded vertices an edge is longer than it is by at most the moves of its ends, each at most the
        // tolerance times the edge if the test below holds; so the divisor makes it hold for the true edge too.
        let tolerance = AUTO_TOLERANCE / (1.0 + 4.0 * AUTO_TOLERANCE);
        let square_tolerance = tolerance * tolerance;
        for triangle in triangles {
            let [a, b, c] = [rounded.get(triangle[0])?, rounded.get(triangle[1])?, rounded.get(triangle[2])?];
            let moved = f64::from(a[3].max(b[3]).max(c[3]));
            let (ab, bc, ca) = (square_distance(a, b), square_distance(b, c), square_distance(c, a));
            let shortest = ab.min(bc).min(ca);
            // The usual case. False if an edge is zero and something moved, for coordinates that are not finite, and beyond f32, where
            // edges may seem infinite.
            if moved < f64::INFINITY && moved * moved <= square_tolerance * shortest {
                continue;
            }
            if [a, b, c].iter().any(|vertex| vertex[3].is_nan()) {
                // Not finite, which the scatter deals with.
                continue;
            }
            if moved == f64::INFINITY {
                // Beyond f32, whatever the edges.
                (self.exceeded, self.certain) = (true, true);
                return Ok(());
            }
            let positive = |square: f64| if square > 0.0 { square } else { f64::INFINITY };
            let shortest = positive(ab).min(positive(bc)).min(positive(ca));
            // An edge that vanishes in f32 must be zero in the source too.
            let collapsed = match exact {
                _ if ab > 0.0 && bc > 0.0 && ca > 0.0 => false,
                Some(exact) => {
                    let [p, q, r] =
                        [exact.get(triangle[0])?, exact.get(triangle[1])?, exact.get(triangle[2])?];
                    (ab == 0.0 && p != q) || (bc == 0.0 && q != r) || (ca == 0.0 && r != p)
                }
                None => true,
            };
            if collapsed || moved * moved > square_tolerance * shortest {
                self.exceeded = true;
                self.certain = exact.is_some() || !collapsed;
                return Ok(());
            }
        }
        Ok(())
    }
}

#[inline]
fn square_distance(a: [f32; 4], b: [f32; 4]) -> f64 {
    let difference = |axis: usize| f64::from(a[axis]) - f64::from(b[axis]);
    let (x, y, z) = (difference(0), difference(1), difference(2));
    x * x + y * y + z * z
}

/// The least of `shortest` and the squares of the triangles' edges that are longer than zero.
pub(super) fn shortest_square(
    triangles: &[[u32; 3]],
    store: &mut VertexStore,
    mut shortest: f64,
) -> Result<f64, CompileError> {
    for triangle in triangles {
        let [a, b, c] =
            [store.position(triangle[0])?, store.position(triangle[1])?, store.position(triangle[2])?];
        for (p, q) in [(a, b), (b, c), (c, a)] {
            let (x, y, z) = (p[0] - q[0], p[1] - q[1], p[2] - q[2]);
            let square = x * x + y * y + z * z;
            // Also false for NaN.
            if square > 0.0 && square < shortest {
                shortest = square;
            }
        }
    }
    Ok(shortest)
}

/// The coarsest lattice that moves no vertex by more than the tolerance times the shortest edge, or the finest that
/// covers `magnitude_max` if there is none.
pub(super) fn coarsest_lattice(shortest_square: f64, magnitude_max: f64) -> Decision {
    // A lattice moves a vertex by at most half its step along each axis, so by sqrt(3)/2 steps. The margin covers the rounding of the
    // edges.
    let step_max = shortest_square.sqrt() * (AUTO_TOLERANCE * 2.0 / 3_f64.sqrt()) * (1.0 - 1e-12);
    let wanted =
        if step_max.is_finite() && step_max > 0.0 { libm::ilogb(step_max) } else { Lattice::EXPONENT_MIN };
    let covering =
        if magnitude_max > 0.0 { libm::ilogb(magnitude_max) + 1 - 52 } else { Lattice::EXPONENT_MIN };
    let exponent = wanted.max(covering).clamp(Lattice::EXPONENT_MIN, Lattice::EXPONENT_MAX);
    Decision { precision: Precision::Lattice(Lattice { exponent }), tolerance_met: exponent <= wanted }
}
