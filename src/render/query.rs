//! What the renderer asks of geometry. [`Tracer`] answers from the octree; the tests' naive twin
//! tries every triangle, and both must give the same picture bit for bit.

use crate::error::TraceError;
use crate::geom::Ray;
use crate::stats::TraceCounters;
use crate::trace::{Hit, MaterialSet, Occlusion, Tracer};
use crate::units::TriangleId;

/// Queries on streams of rays. Output slices are as long as `rays`.
pub(crate) trait RayQuery {
    /// The first hit of each ray by (t, triangle id).
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError>;

    /// The first hit of each ray strictly behind `after` in the order of (t, triangle id).
    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError>;

    /// What lies between each ray's ends, materials in `ignore` apart from the others.
    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError>;

    /// What was done so far.
    fn counters(&self) -> TraceCounters;
}

impl RayQuery for Tracer<'_> {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        Tracer::closest_hits(self, rays, hits)
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        Tracer::closest_hits_after(self, rays, after, hits)
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        Tracer::occluded(self, rays, ignore, out)
    }

    fn counters(&self) -> TraceCounters {
        Tracer::counters(self)
    }
}
