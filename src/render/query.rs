//! What the renderer asks of geometry. [`Tracer`] answers from the octree; the tests' naive twin
//! tries every triangle, and both must give the same picture bit for bit.

use crate::attributes::AttributeReader;
use crate::block::attributes::CornerAttributes;
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

    /// The attributes of a triangle's corners.
    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError>;

    /// What was done so far.
    fn counters(&self) -> TraceCounters;
}

/// A tracer, and a reader of attributes if the picture needs any.
pub(crate) struct SceneTracer<'o> {
    pub tracer: Tracer<'o>,
    pub attributes: Option<AttributeReader<'o>>,
}

impl RayQuery for SceneTracer<'_> {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.tracer.closest_hits(rays, hits)
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        self.tracer.closest_hits_after(rays, after, hits)
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        self.tracer.occluded(rays, ignore, out)
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        match &mut self.attributes {
            Some(reader) => Ok(reader.get(triangle)?),
            None => Ok(CornerAttributes::default()),
        }
    }

    fn counters(&self) -> TraceCounters {
        self.tracer.counters()
    }
}

impl<Q: RayQuery> RayQuery for &mut Q {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        (**self).closest_hits(rays, hits)
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        (**self).closest_hits_after(rays, after, hits)
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        (**self).occluded(rays, ignore, out)
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        (**self).corner_attributes(triangle)
    }

    fn counters(&self) -> TraceCounters {
        (**self).counters()
    }
}
