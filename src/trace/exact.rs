//! The f64 side of a query, prepared when the first triangle needs a decision. Kept apart from what the traversal holds in
//! registers, and reused from ray to ray.

use crate::error::{LoadError, TraceError};
use crate::geom::{Ray, RayFrame};

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

    /// The ray prepared, for hits from `t_min` to `t_max`; the ray is the same from call to call. `is_plain`: see
    /// [`RayGroup`](crate::octree::RayGroup).
    #[inline(always)]
    pub fn frame(&mut self, ray: &Ray, is_plain: bool, t_min: f64, t_max: f64) -> &RayFrame {
        if !self.ready {
            // Each is written where it belongs: one that is chosen first and moved then goes through memory twice.
            if is_plain {
                self.frame = RayFrame::of_plain(ray);
            } else {
                self.frame = new_frame(ray);
            }
            self.ready = true;
            self.frame.t_min = t_min;
        }
        self.frame.t_max = t_max;
        &self.frame
    }
}

#[cold]
#[inline(never)]
fn new_frame(ray: &Ray) -> RayFrame {
    RayFrame::new(ray)
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
