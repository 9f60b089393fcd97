//! How positions will be held: the choice that [`PrecisionChoice::Auto`](super::PrecisionChoice::Auto) stands for.

use super::faces::Faces;
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
#[derive(Debug, Default)]
pub(super) struct RoundingWatch {
    exceeded: bool,
}

impl RoundingWatch {
    /// Whether rounding to f32 moves a vertex of a triangle seen so far by more than the tolerance allows.
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
        let VertexStore::Float64 { rounded, exact, .. } = store else { return Ok(()) };
        // Seen from the rounded vertices an edge is shorter than it is by at most the moves of its ends, each at most the tolerance
        // times the edge if the test below holds; so the factor makes it hold for the true edge too.
        let tolerance = AUTO_TOLERANCE / (1.0 + 4.0 * AUTO_TOLERANCE);
        for triangle in triangles {
            let [a, b, c] = [rounded.get(triangle[0])?, rounded.get(triangle[1])?, rounded.get(triangle[2])?];
            let moved = f64::from(a[3].max(b[3]).max(c[3]));
            let [ab, bc, ca] = [square_distance(a, b), square_distance(b, c), square_distance(c, a)];
            let shortest =
                [ab, bc, ca].into_iter().filter(|square| *square > 0.0).fold(f64::INFINITY, f64::min);
            let zero_edge = ab == 0.0 || bc == 0.0 || ca == 0.0;
            // An edge that vanishes in f32 must be zero in the source too.
            let collapsed = zero_edge && moved > 0.0 && {
                let [p, q, r] = [exact.get(triangle[0])?, exact.get(triangle[1])?, exact.get(triangle[2])?];
                (ab == 0.0 && p != q) || (bc == 0.0 && q != r) || (ca == 0.0 && r != p)
            };
            // For coordinates that are not finite nothing is decided here.
            if collapsed || moved * moved > tolerance * tolerance * shortest {
                self.exceeded = true;
                return Ok(());
            }
        }
        Ok(())
    }
}

fn square_distance(a: [f32; 4], b: [f32; 4]) -> f64 {
    (0..3).map(|axis| (f64::from(a[axis]) - f64::from(b[axis])).powi(2)).sum()
}

/// The coarsest lattice that moves no vertex by more than the tolerance times the shortest edge, or the finest that
/// covers `magnitude_max` if there is none.
pub(super) fn coarsest_lattice(
    faces: &mut Faces,
    store: &mut VertexStore,
    magnitude_max: f64,
) -> Result<Decision, CompileError> {
    let mut shortest = f64::INFINITY;
    faces.replay(|triangles, _, _| {
        for triangle in triangles {
            let [a, b, c] =
                [store.position(triangle[0])?, store.position(triangle[1])?, store.position(triangle[2])?];
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let square: f64 = (0..3).map(|axis| (p[axis] - q[axis]).powi(2)).sum();
                // Also false for NaN.
                if square > 0.0 && square < shortest {
                    shortest = square;
                }
            }
        }
        Ok(())
    })?;
    // A lattice moves a vertex by at most half its step along each axis, so by sqrt(3)/2 steps. The margin covers the rounding of the
    // edges.
    let step_max = shortest.sqrt() * (AUTO_TOLERANCE * 2.0 / 3_f64.sqrt()) * (1.0 - 1e-12);
    let wanted =
        if step_max.is_finite() && step_max > 0.0 { libm::ilogb(step_max) } else { Lattice::EXPONENT_MIN };
    let covering =
        if magnitude_max > 0.0 { libm::ilogb(magnitude_max) + 1 - 52 } else { Lattice::EXPONENT_MIN };
    let exponent = wanted.max(covering).clamp(Lattice::EXPONENT_MIN, Lattice::EXPONENT_MAX);
    Ok(Decision { precision: Precision::Lattice(Lattice { exponent }), tolerance_met: exponent <= wanted })
}
