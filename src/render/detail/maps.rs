//! The pictures of each material, found among those that are open.

use super::forced::ForcedDetails;
use crate::model::{ImageMap, MaterialRecord};
use crate::scene::{Effect, EffectPlan, Mixture, Scene, Variation};
use crate::texture::{Address, Encoding, TextureId, Textures};
use crate::trace::MaterialSet;
use crate::units::MaterialId;

/// A picture, and how it lies on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Placed {
    pub texture: TextureId,
    pub address: Address,
    scale: [f64; 2],
    offset: [f64; 2],
    pub strength: f64,
    /// Width and height in texels.
    pub size: [f64; 2],
}

impl Placed {
    /// The whole of a picture on a unit of texture coordinates.
    pub fn whole(texture: TextureId, size: [u32; 2]) -> Placed {
        Placed {
            texture,
            address: Address::Repeat,
            scale: [1.0; 2],
            offset: [0.0; 2],
            strength: 1.0,
            size: size.map(f64::from),
        }
    }

    fn find(map: &ImageMap, encoding: Encoding, textures: &Textures) -> Option<Placed> {
        let texture = textures.find(&map.path, encoding)?;
        Some(Placed {
            texture,
            address: if map.clamp { Address::Clamp } else { Address::Repeat },
            scale: map.scale.map(f64::from),
            offset: map.offset.map(f64::from),
            strength: f64::from(map.strength),
            size: textures.size(texture).map(f64::from),
        })
    }

    /// Where texture coordinates of a surface are in the picture.
    pub fn coordinates(&self, uv: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|axis| uv[axis] * self.scale[axis] + self.offset[axis])
    }

    /// Texels along a unit of each texture coordinate.
    pub fn density(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.scale[axis] * self.size[axis])
    }
}

/// Where a surface is not there: the channel of a picture that says so.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CutOut {
    pub map: Placed,
    pub channel: usize,
    /// Below this the surface is not there; exactly there it is.
    pub threshold: f64,
}

impl CutOut {
    const THRESHOLD: f64 = 0.5;
    const RED: usize = 0;
    const ALPHA: usize = 3;
}

/// The pictures of a material that the plan needs.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MaterialMaps {
    pub diffuse: Option<Placed>,
    pub specular: Option<Placed>,
    pub cut_out: Option<CutOut>,
    pub bump: Option<Placed>,
    pub normal: Option<Placed>,
    pub emission: Option<Placed>,
    pub roughness: Option<Placed>,
    pub metalness: Option<Placed>,
    /// What the material is made of, if terms are to be mixed anew wherever it is hit.
    pub mixture: Option<Mixture>,
    /// Between which numbers the pictures of roughness and metalness say they are.
    pub variation: Variation,
}

impl MaterialMaps {
    pub const NONE: MaterialMaps = MaterialMaps {
        diffuse: None,
        specular: None,
        cut_out: None,
        bump: None,
        normal: None,
        emission: None,
        roughness: None,
        metalness: None,
        mixture: None,
        variation: Variation { metalness: None, roughness: None },
    };

    /// Whether a hit that is there looks different by them.
    pub fn are_seen(&self) -> bool {
        self.change_terms() || self.bump.is_some() || self.normal.is_some()
    }

    /// Whether pictures say how rough the material is, or how much of a metal.
    pub fn change_finish(&self) -> bool {
        self.roughness.is_some() || self.metalness.is_some()
    }

    /// Whether terms of the material are others where it is hit.
    pub fn change_terms(&self) -> bool {
        let colors = [&self.diffuse, &self.specular, &self.emission];
        self.change_finish() || colors.into_iter().any(Option::is_some)
    }

    /// A surface of which it is asked whether it is there, and which always is.
    fn forced_cut_out(map: Placed) -> CutOut {
        CutOut { map, channel: CutOut::ALPHA, threshold: 0.0 }
    }

    fn of(record: &MaterialRecord, textures: &Textures, scene: &Scene, plan: &EffectPlan) -> MaterialMaps {
        let Some(images) = &record.images else { return MaterialMaps::NONE };
        let find = |effect, map: &Option<ImageMap>, encoding| {
            let map = map.as_ref().filter(|_| plan.has(effect))?;
            Placed::find(map, encoding, textures)
        };
        let opacity = find(Effect::AlphaCutouts, &images.opacity, Encoding::Linear);
        let color = find(Effect::AlphaCutouts, &images.diffuse, Encoding::Srgb);
        let by_color = || color.filter(|map| textures.has_alpha(map.texture));
        let glows = plan.has(Effect::Emission) && record.emission.iter().any(|channel| *channel > 0.0);
        let variation = plan.variation(scene, record);
        let number = |is_wanted: bool, map: &Option<ImageMap>| {
            find(Effect::FinishMaps, map, Encoding::Linear).filter(|_| is_wanted)
        };
        let mixture = plan.mixture(scene, record);
        let diffuse = find(Effect::Textures, &images.diffuse, Encoding::Srgb);
        let specular = find(Effect::Textures, &images.specular, Encoding::Srgb);
        // Colours are those of either part alone.
        let has_colored_parts = mixture.metalness > 0.0 && (diffuse.is_some() || specular.is_some());
        MaterialMaps {
            diffuse,
            specular,
            cut_out: match opacity {
                Some(map) => {
                    let channel = if textures.has_alpha(map.texture) { CutOut::ALPHA } else { CutOut::RED };
                    Some(CutOut { map, channel, threshold: CutOut::THRESHOLD })
                }
                None => {
                    by_color().map(|map| CutOut { map, channel: CutOut::ALPHA, threshold: CutOut::THRESHOLD })
                }
            },
            // A map of normals says more than one of heights.
            bump: match images.normal {
                None => find(Effect::BumpMaps, &images.bump, Encoding::Linear),
                Some(_) => None,
            },
            normal: find(Effect::BumpMaps, &images.normal, Encoding::Linear),
            emission: find(Effect::Textures, &images.emission, Encoding::Srgb).filter(|_| glows),
            roughness: number(variation.roughness.is_some(), &images.roughness),
            metalness: number(variation.metalness.is_some(), &images.metalness),
            mixture: Some(mixture).filter(|_| variation.is_any() || has_colored_parts),
            variation,
        }
    }
}

/// Materials that may be cut out.
#[derive(Debug)]
pub(crate) struct CutOuts {
    pub materials: MaterialSet,
    /// And those that shadows shine through.
    pub or_transparent: MaterialSet,
}

/// The pictures of all materials; empty if none has any that the plan needs.
pub(crate) fn maps(
    scene: &Scene,
    materials: &[MaterialRecord],
    plan: &EffectPlan,
    forced: Option<&ForcedDetails>,
) -> Vec<MaterialMaps> {
    let effects = [Effect::Textures, Effect::AlphaCutouts, Effect::BumpMaps, Effect::FinishMaps];
    let mut maps: Vec<MaterialMaps> = match scene.textures() {
        Some(textures) if effects.into_iter().any(|effect| plan.has(effect)) => {
            materials.iter().map(|record| MaterialMaps::of(record, textures, scene, plan)).collect()
        }
        _ => Vec::new(),
    };
    if let Some(forced) = forced.filter(|forced| forced.cut_outs) {
        maps.resize(materials.len(), MaterialMaps::NONE);
        maps.iter_mut().for_each(|maps| maps.cut_out = Some(MaterialMaps::forced_cut_out(forced.map)));
    }
    maps
}

/// The materials with a cut-out; none if there are none. `transparent` are those that shadows shine through.
pub(crate) fn cut_outs(maps: &[MaterialMaps], transparent: Option<&MaterialSet>) -> Option<CutOuts> {
    let ids = || (0..=u16::MAX).map(MaterialId).take(maps.len());
    let materials: MaterialSet = ids().filter(|id| maps[usize::from(id.0)].cut_out.is_some()).collect();
    if materials.is_empty() {
        return None;
    }
    let is_passed = |id: &MaterialId| {
        materials.contains(*id) || transparent.is_some_and(|transparent| transparent.contains(*id))
    };
    let or_transparent = ids().filter(is_passed).collect();
    Some(CutOuts { materials, or_transparent })
}
