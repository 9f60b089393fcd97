//! The f64 side of a query, prepared when the first triangle needs a decision. Kept apart from what the traversal holds in
//! registers, and reused from ray to ray.

use crate::error::{LoadError, TraceError};
use crate::geom::{Ray, RayFrame, TriangleHit};
use crate::simd::{Operation, Simd};

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

    /// The certified decision for one triangle, for hits from `t_min` to `t_max`. The ray is the same from call to call.
    #[inline(always)]
    pub fn decide<S: Simd>(
        &mut self,
        simd: S,
        (ray, is_plain): (&Ray, bool),
        (t_min, t_max): (f64, f64),
        vertices: &[[f64; 3]; 3],
        exact_fallbacks: &mut u64,
    ) -> Option<TriangleHit> {
        simd.enter(Decide { exact: self, ray, is_plain, t_min, t_max, vertices, exact_fallbacks })
    }

    /// The ray prepared, for hits from `t_min` to `t_max`. `is_plain`: see [`RayGroup`](crate::octree::RayGroup).
    #[inline(always)]
    pub fn frame(&mut self, ray: &Ray, is_plain: bool, t_min: f64, t_max: f64) -> &RayFrame {
        if !self.ready {
            self.frame = if is_plain { RayFrame::of_plain(ray) } else { new_frame(ray) };
            self.ready = true;
            self.frame.t_min = t_min;
        }
        self.frame.t_max = t_max;
        &self.frame
    }
}

/// [`ExactRay::decide`], once for each set of instructions and not for each kernel.
struct Decide<'d> {
    exact: &'d mut ExactRay,
    ray: &'d Ray,
    is_plain: bool,
    t_min: f64,
    t_max: f64,
    vertices: &'d [[f64; 3]; 3],
    exact_fallbacks: &'d mut u64,
}

impl<S: Simd> Operation<S> for Decide<'_> {
    type Output = Option<TriangleHit>;

    #[inline(always)]
    fn run(self, _: S) -> Option<TriangleHit> {
        let Decide { exact, ray, is_plain, t_min, t_max, vertices, exact_fallbacks } = self;
        exact.frame(ray, is_plain, t_min, t_max).intersect_inlined(vertices, exact_fallbacks)
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
