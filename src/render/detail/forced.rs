//! Effects of surfaces where they are only forced: the work is done, and what it finds is multiplied by zero.
//!
//! Where a model has no attributes or a scene no pictures, there is something in their place: the triangle's own normal, its corners as
//! texture coordinates, a white texel.

use std::sync::Arc;

use glam::DVec3;

use super::bump::{Bend, TextureFrame};
use super::maps::Placed;
use super::normals::smooth;
use super::query::{SurfaceQuery, interpolate};
use super::{Seen, level};
use crate::error::TraceError;
use crate::model::MaterialRecord;
use crate::render::query::RayQuery;
use crate::scene::{Effect, EffectPlan, Finish, Look, Mixture, Scene};
use crate::texture::{Encoding, ImageKey, PixelImage, TextureId, Textures};
use crate::trace::Hit;

/// Texture coordinates of a triangle that has none.
pub(super) const STAND_IN_UVS: [[f32; 2]; 3] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];

/// A picture of one white texel, for scenes without any.
pub(crate) fn stand_in() -> Option<Arc<Textures>> {
    let key = ImageKey { path: "a texel in place of pictures".into(), encoding: Encoding::Linear };
    let texel = PixelImage { width: 1, height: 1, texels: vec![[u8::MAX; 4]] };
    // Without it lookups find black.
    Textures::in_memory([(key, texel)]).ok()
}

/// What is mixed anew at every hit where no material is.
fn half_metal() -> Mixture {
    let record = MaterialRecord {
        specular: [0.5; 3],
        metalness: 0.5,
        roughness: 0.5,
        exponent_by_roughness: true,
        ..MaterialRecord::default()
    };
    Mixture::new(&record, &Finish::default())
}

/// Which effects are forced that the plan leaves out, and the picture that they look up.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ForcedDetails {
    normals: bool,
    textures: bool,
    bumps: bool,
    finish: Option<Mixture>,
    pub cut_outs: bool,
    /// The scene's first, or the one in place of it.
    pub map: Placed,
}

impl ForcedDetails {
    /// None if nothing of the kind is forced.
    pub fn of(scene: &Scene, plan: &EffectPlan) -> Option<ForcedDetails> {
        let forces = |effect| plan.forces(effect) && !plan.has(effect);
        let first = TextureId(0);
        let textures = scene.textures().filter(|textures| textures.image_count() > 0);
        let forced = ForcedDetails {
            normals: forces(Effect::SmoothNormals),
            textures: forces(Effect::Textures),
            bumps: forces(Effect::BumpMaps),
            finish: forces(Effect::FinishMaps).then(half_metal),
            cut_outs: forces(Effect::AlphaCutouts),
            map: Placed::whole(first, textures.map_or([1; 2], |textures| textures.size(first))),
        };
        (forced.normals || forced.needs_textures()).then_some(forced)
    }

    /// Whether any looks up pictures.
    pub fn needs_textures(&self) -> bool {
        self.textures || self.bumps || self.finish.is_some() || self.cut_outs
    }

    /// Does at a hit what the effects would do there, cut-outs apart, which come before ([`super::query`]). Finite.
    pub(super) fn work<Q: RayQuery>(
        &self,
        query: &mut SurfaceQuery<'_, Q>,
        hit: &Hit,
        seen: &Seen,
    ) -> Result<DVec3, TraceError> {
        if !(self.normals || self.textures || self.bumps || self.finish.is_some()) {
            return Ok(DVec3::ZERO);
        }
        let attributes = query.forced_attributes(hit)?;
        let mut found = DVec3::ZERO;
        if self.normals {
            let normals = attributes.normals.unwrap_or([seen.geometric.to_array(); 3]);
            let smooth = smooth(hit, &normals, seen.geometric, seen.view);
            found += smooth.normal + smooth.lift;
        }
        if self.textures || self.bumps || self.finish.is_some() {
            let uvs = attributes.uvs.unwrap_or(STAND_IN_UVS);
            let uv = interpolate(&uvs, hit);
            let frame = TextureFrame::of(hit, &uvs);
            let level = frame.as_ref().map_or(0.0, |frame| level(&self.map, frame, seen));
            if self.textures {
                query.counters.forced_lookups += 1;
                let [red, green, blue, _] = query.look_up(&self.map, uv, level)?;
                found += DVec3::new(red, green, blue);
            }
            if let Some(mixture) = &self.finish {
                query.counters.forced_lookups += 1;
                let [_, roughness, metalness, _] = query.look_up(&self.map, uv, level)?;
                let terms = mixture.at(&Look { roughness, metalness, ..mixture.factors() });
                found += terms.diffuse + terms.mirror + terms.highlight * (terms.alpha + terms.exponent);
            }
            if let Some(frame) = frame.as_ref().filter(|_| self.bumps) {
                let front = if seen.is_behind { -seen.geometric } else { seen.geometric };
                let bend = Bend { frame, uv, front, is_behind: seen.is_behind, view: seen.view };
                let before = query.counters.bump_reads;
                let bent = bend.by_heights(&self.map, level, query)?;
                query.counters.forced_lookups += query.counters.bump_reads - before;
                query.counters.bump_reads = before;
                found += bent.unwrap_or(seen.geometric);
            }
        }
        Ok(if found.is_finite() { found } else { DVec3::ZERO })
    }
}
