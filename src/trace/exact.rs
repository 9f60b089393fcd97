//! The f64 side of a query, prepared when the first triangle needs a decision. Kept apart from what the traversal holds in
//! registers, and reused from ray to ray.

use crate::error::{LoadError, TraceError};
use crate::geom::{Ray, RayFrame, TriangleHit};

/// The ray of the query at hand, for decisions.
pub(super) struct ExactRay {
    frame: RayFrame,
    ready: bool,
}

impl ExactRay {
    pub fn new() -> ExactRay {
        ExactRay { frame: RayFrame::new(&Ray::new([0.0; 3], [0.0; 3])), ready: false }
    }

    /// Forgets the ray before.
    #[inline(always)]
    pub fn reset(&mut self) {
        self.ready = false;
    }

    /// The certified decision for one triangle, for hits up to `t_max`. `ray` is the same from call to call.
    #[inline(always)]
    pub fn decide(
        &mut self,
        ray: &Ray,
        t_min: f64,
        t_max: f64,
        vertices: &[[f64; 3]; 3],
        exact_fallbacks: &mut u64,
    ) -> Option<TriangleHit> {
        self.frame(ray, t_min, t_max).intersect(vertices, exact_fallbacks)
    }

    /// The ray prepared, for hits from `t_min` to `t_max`.
    #[inline(always)]
    pub fn frame(&mut self, ray: &Ray, t_min: f64, t_max: f64) -> &RayFrame {
        if !self.ready {
            (self.frame, self.ready) = (RayFrame::new(ray), true);
            self.frame.t_min = t_min;
        }
        self.frame.t_max = t_max;
        &self.frame
    }
}

/// Why one ray could not be traced.
pub(super) enum RayError {
    Invalid(&'static str),
    Load(LoadError),
}

impl RayError {
    /// The error for the ray at `index` of its slice.
    #[cold]
    pub fn at(self, index: usize) -> TraceError {
        match self {
            RayError::Invalid(reason) => TraceError::InvalidRay { index, reason },
            RayError::Load(error) => TraceError::Load(error),
        }
    }
}

impl From<LoadError> for RayError {
    fn from(error: LoadError) -> RayError {
        RayError::Load(error)
    }
}
