//! A pool as a query whose answers come at once.

use crate::access::BlockSketch;
use crate::attributes::AttributeReader;
use crate::block::attributes::CornerAttributes;
use crate::error::TraceError;
use crate::geom::Ray;
use crate::render::query::RayQuery;
use crate::stats::TraceCounters;
use crate::trace::{Hit, MaterialSet, Occlusion, RayPool};
use crate::units::TriangleId;

/// For camera rays, and whatever few rays are asked for beside a path: they load what they need.
pub(in crate::render) struct PoolQuery<'o> {
    pub pool: RayPool<'o>,
    pub attributes: Option<AttributeReader<'o>>,
}

impl RayQuery for PoolQuery<'_> {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        self.pool.at_once(|tracer| tracer.closest_hits(rays, hits))
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        self.pool.at_once(|tracer| tracer.closest_hits_after(rays, after, hits))
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        self.pool.at_once(|tracer| tracer.occluded(rays, ignore, out))
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        match &mut self.attributes {
            Some(reader) => Ok(reader.get(triangle)?),
            None => Ok(CornerAttributes::default()),
        }
    }

    fn may_have_normals(&self, triangle: TriangleId) -> bool {
        self.attributes.as_ref().is_some_and(|reader| reader.may_have_normals(triangle))
    }

    fn counters(&self) -> TraceCounters {
        self.pool.counters()
    }

    fn take_touched(&mut self) -> BlockSketch {
        self.pool.take_touched()
    }
}
