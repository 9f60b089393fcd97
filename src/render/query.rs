//! What the renderer asks of geometry. [`Tracer`] answers from the octree; the tests' naive twin
//! tries every triangle, and both must give the same picture bit for bit.

use crate::access::BlockSketch;
use crate::attributes::AttributeReader;
use crate::block::attributes::CornerAttributes;
use crate::error::TraceError;
use crate::geom::Ray;
use crate::instance::{InstanceTracer, InstanceTriangle, Instances};
use crate::stats::TraceCounters;
use crate::trace::{Hit, MaterialSet, Occlusion, Tracer};
use crate::units::TriangleId;

/// Queries on streams of rays. Output slices are as long as `rays`.
pub(crate) trait RayQuery {
    /// The first hit of each ray by (t, triangle id).
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError>;

    /// The first hit of each ray strictly behind `after` in the order of (t, triangle id); where its `t` is NaN, the first of all.
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

    /// Sets when the rays of the next call are traced, one time each, where the scene moves; else all are at 0. Needs no answer
    /// where nothing can move.
    fn at_times(&mut self, _times: &mut dyn Iterator<Item = f64>) {}

    /// Sets when attributes are asked for, from here on.
    fn at_time(&mut self, _time: f64) {}

    /// The attributes of a triangle's corners.
    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError>;

    /// Whether the corners of a triangle may have normals, as far as directories tell: nothing is read for it.
    fn may_have_normals(&self, triangle: TriangleId) -> bool;

    /// What was done so far.
    fn counters(&self) -> TraceCounters;

    /// Which blocks of the model were entered since this was called last, roughly; none where there are several models.
    fn take_touched(&mut self) -> BlockSketch {
        BlockSketch::default()
    }
}

/// A tracer, and readers of attributes if the picture needs any. Which one it is is asked once per call.
#[expect(clippy::large_enum_variant, reason = "there is one for each thread")]
pub(crate) enum SceneTracer<'o> {
    Model {
        tracer: Tracer<'o>,
        attributes: Option<AttributeReader<'o>>,
    },
    /// A reader for each model that has attributes; none at all if the picture needs none.
    Instances {
        instances: &'o Instances,
        tracer: InstanceTracer<'o>,
        attributes: Vec<Option<AttributeReader<'o>>>,
        /// When attributes are asked for.
        time: f64,
    },
}

impl RayQuery for SceneTracer<'_> {
    fn closest_hits(&mut self, rays: &[Ray], hits: &mut [Option<Hit>]) -> Result<(), TraceError> {
        match self {
            SceneTracer::Model { tracer, .. } => tracer.closest_hits(rays, hits),
            SceneTracer::Instances { tracer, .. } => tracer.closest_hits(rays, hits),
        }
    }

    fn closest_hits_after(
        &mut self,
        rays: &[Ray],
        after: &[(f64, TriangleId)],
        hits: &mut [Option<Hit>],
    ) -> Result<(), TraceError> {
        match self {
            SceneTracer::Model { tracer, .. } => tracer.closest_hits_after(rays, after, hits),
            SceneTracer::Instances { tracer, .. } => tracer.closest_hits_after(rays, after, hits),
        }
    }

    fn occluded(
        &mut self,
        rays: &[Ray],
        ignore: Option<&MaterialSet>,
        out: &mut [Occlusion],
    ) -> Result<(), TraceError> {
        match self {
            SceneTracer::Model { tracer, .. } => tracer.occluded(rays, ignore, out),
            SceneTracer::Instances { tracer, .. } => tracer.occluded(rays, ignore, out),
        }
    }

    fn at_times(&mut self, times: &mut dyn Iterator<Item = f64>) {
        if let SceneTracer::Instances { tracer, .. } = self {
            tracer.at_times(times);
        }
    }

    fn at_time(&mut self, now: f64) {
        if let SceneTracer::Instances { time, .. } = self {
            *time = now;
        }
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        match self {
            SceneTracer::Model { attributes: Some(reader), .. } => Ok(reader.get(triangle)?),
            SceneTracer::Model { attributes: None, .. } => Ok(CornerAttributes::default()),
            SceneTracer::Instances { instances, attributes, time, .. } => {
                let InstanceTriangle { instance, triangle } = InstanceTriangle::of(triangle);
                let Some(placed) = instances.placed(instance, *time) else {
                    return Ok(CornerAttributes::default());
                };
                match attributes.get_mut(placed.model as usize) {
                    Some(Some(reader)) => Ok(placed.attributes(reader.get(triangle)?)),
                    _ => Ok(CornerAttributes::default()),
                }
            }
        }
    }

    fn may_have_normals(&self, triangle: TriangleId) -> bool {
        match self {
            SceneTracer::Model { attributes, .. } => {
                attributes.as_ref().is_some_and(|reader| reader.may_have_normals(triangle))
            }
            SceneTracer::Instances { instances, attributes, .. } => {
                let InstanceTriangle { instance, triangle } = InstanceTriangle::of(triangle);
                // Which model it shows does not depend on the time.
                let reader = instances.model_of(instance).and_then(|model| attributes.get(model as usize));
                reader.is_some_and(|reader| reader.as_ref().is_some_and(|r| r.may_have_normals(triangle)))
            }
        }
    }

    fn counters(&self) -> TraceCounters {
        match self {
            SceneTracer::Model { tracer, .. } => tracer.counters(),
            SceneTracer::Instances { tracer, .. } => tracer.counters(),
        }
    }

    fn take_touched(&mut self) -> BlockSketch {
        match self {
            SceneTracer::Model { tracer, .. } => tracer.take_touched(),
            SceneTracer::Instances { .. } => BlockSketch::default(),
        }
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

    fn at_times(&mut self, times: &mut dyn Iterator<Item = f64>) {
        (**self).at_times(times);
    }

    fn at_time(&mut self, time: f64) {
        (**self).at_time(time);
    }

    fn corner_attributes(&mut self, triangle: TriangleId) -> Result<CornerAttributes, TraceError> {
        (**self).corner_attributes(triangle)
    }

    fn may_have_normals(&self, triangle: TriangleId) -> bool {
        (**self).may_have_normals(triangle)
    }

    fn counters(&self) -> TraceCounters {
        (**self).counters()
    }

    fn take_touched(&mut self) -> BlockSketch {
        (**self).take_touched()
    }
}
