//! What a query over instances looks for.

use crate::geom::RayFrame;
use crate::trace::{Hit, MaterialSet};
use crate::units::{MaterialId, TriangleId};

/// A triangle that the reject test let through, in the world.
pub(super) struct Candidate {
    pub triangle: TriangleId,
    pub material: MaterialId,
    pub vertices: [[f64; 3]; 3],
}

/// See the module's text.
pub(super) trait Goal {
    /// Hits before this do not matter.
    fn begins(&self) -> Option<f64> {
        None
    }

    /// Whether a triangle of this material can matter.
    fn wants(&self, material: MaterialId) -> bool;

    /// Takes a candidate. Lowers `frame.t_max` to where hits that matter end now; gives whether nothing more can.
    fn take(&mut self, candidate: Candidate, frame: &mut RayFrame, exact_fallbacks: &mut u64) -> bool;
}

/// The least hit by (t, triangle) behind `after`.
pub(super) struct Closest {
    pub after: Option<(f64, TriangleId)>,
    pub best: Option<Hit>,
}

impl Goal for Closest {
    #[inline(always)]
    fn begins(&self) -> Option<f64> {
        self.after.map(|(t, _)| t)
    }

    #[inline(always)]
    fn wants(&self, _: MaterialId) -> bool {
        true
    }

    #[inline(always)]
    fn take(&mut self, candidate: Candidate, frame: &mut RayFrame, exact_fallbacks: &mut u64) -> bool {
        let Candidate { triangle, material, vertices } = candidate;
        let Some(found) = frame.intersect(&vertices, exact_fallbacks) else { return false };
        let is_behind = match self.after {
            Some(after) => (found.t, triangle) > after || after.0.is_nan(),
            None => true,
        };
        let is_least = self.best.as_ref().is_none_or(|best| (found.t, triangle) < (best.t, best.triangle));
        if is_behind && is_least {
            // Hits beyond the range of f64 all have t = f64::MAX, and only an infinite end admits them.
            if found.t < f64::MAX {
                frame.t_max = found.t;
            }
            self.best = Some(Hit { t: found.t, u: found.u, v: found.v, triangle, material, vertices });
        }
        false
    }
}

/// Anything of a material that is not ignored, and whether anything of one that is.
pub(super) struct Any<'m> {
    pub ignore: Option<&'m MaterialSet>,
    pub filtered: bool,
    pub blocked: bool,
}

impl Any<'_> {
    #[inline(always)]
    fn ignores(&self, material: MaterialId) -> bool {
        self.ignore.is_some_and(|set| set.contains(material))
    }
}

impl Goal for Any<'_> {
    #[inline(always)]
    fn wants(&self, material: MaterialId) -> bool {
        !(self.filtered && self.ignores(material))
    }

    #[inline(always)]
    fn take(&mut self, candidate: Candidate, frame: &mut RayFrame, exact_fallbacks: &mut u64) -> bool {
        if frame.intersect(&candidate.vertices, exact_fallbacks).is_some() {
            if self.ignores(candidate.material) {
                self.filtered = true;
            } else {
                self.blocked = true;
            }
        }
        self.blocked
    }
}
