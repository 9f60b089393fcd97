//! What a hit looks like beyond its triangle and its material: the part of shading that reads attributes of corners.
//!
//! Only the *Detailed* path loop comes here ([`super::hot`]), and only for materials that show a difference.

pub(super) mod normals;

use glam::DVec3;

use self::normals::smooth;
use super::counters::EffectCounters;
use super::query::RayQuery;
use super::stage::{Shader, Stage};
use crate::error::TraceError;
use crate::trace::Hit;

/// See the module's text.
#[derive(Clone, Copy, Debug)]
pub(super) struct Detail {
    /// The unit normal that light falls on.
    pub normal: DVec3,
    /// From the triangle to where rays on the side that is seen begin, beside their offset.
    pub lift: DVec3,
}

impl Detail {
    /// A hit on a triangle whose unit normal, on the side of `view`, is `geometric`.
    pub fn at(
        stage: &Stage,
        query: &mut impl RayQuery,
        counters: &mut EffectCounters,
        hit: &Hit,
        shader: &Shader,
        (geometric, view): (DVec3, DVec3),
    ) -> Result<Detail, TraceError> {
        let mut detail = Detail { normal: geometric, lift: DVec3::ZERO };
        if stage.force_smooth {
            query.corner_attributes(hit.triangle)?;
        }
        if !(stage.smooth && shader.depends_on_normal) {
            return Ok(detail);
        }
        counters.attribute_lookups += 1;
        let attributes = query.corner_attributes(hit.triangle)?;
        if let Some(normals) = &attributes.normals {
            counters.smooth_hits += 1;
            let found = smooth(hit, normals, geometric, view);
            (detail.normal, detail.lift) = (found.normal, found.lift);
        }
        Ok(detail)
    }
}
