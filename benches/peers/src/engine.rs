//! What every tracer here can do.

use std::ops::Range;

use crate::rays::Rays;

/// No triangle.
pub const MISS: u32 = u32::MAX;

/// The closest hit of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    pub t: f64,
    /// Ordinal of the triangle in the model file, or [`MISS`].
    pub triangle: u32,
}

impl Found {
    pub const NONE: Found = Found { t: f64::INFINITY, triangle: MISS };

    pub fn is_hit(self) -> bool {
        self.triangle != MISS
    }
}

/// What shading needs to know of the closest hit.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    pub t: f64,
    /// Of the triangle; any length.
    pub normal: [f64; 3],
}

/// A tracer with a model in it. Queries take a range of the rays, as a renderer traces them: a tile at a time.
pub trait Engine {
    fn name(&self) -> &str;

    /// Closest hits of `rays[range]`, to the same places of `found`.
    fn closest(&mut self, rays: &Rays, range: Range<usize>, found: &mut [Found]);

    /// Whether each of `rays[range]` hits anything.
    fn occluded(&mut self, rays: &Rays, range: Range<usize>, blocked: &mut [bool]);

    /// As [`Engine::closest`], with the triangles' normals.
    fn surfaces(&mut self, rays: &Rays, range: Range<usize>, surfaces: &mut [Option<Surface>]);

    /// Exact counts of the work done since the last call, if the tracer has them.
    fn take_counters(&mut self) -> Option<String> {
        None
    }
}
