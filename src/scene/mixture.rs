//! What a surface is of where a part of it is metal: the mix of two materials by metalness (glTF 2.0, appendix B), at the factors
//! of a material or at one place of its pictures. The same few multiplications serve both, so that a picture of one texel looks as
//! its numbers would.

use glam::DVec3;
use smallvec::SmallVec;

use super::Finish;
use super::finish::{ALPHA_MIN, alpha_of};
use crate::model::{ImageMap, MaterialRecord};
use crate::texture::{Encoding, Textures};

/// What is known of a place on a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Look {
    /// Colours of pictures, white without any.
    pub diffuse: DVec3,
    pub specular: DVec3,
    /// 0 to 1, factors included.
    pub metalness: f64,
    pub roughness: f64,
}

/// The terms of a surface that may differ from place to place; see [`Surface`](super::Surface).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Terms {
    pub diffuse: DVec3,
    pub highlight: DVec3,
    /// The part of `highlight` that lights with extent show too.
    pub area_highlight: DVec3,
    pub exponent: f64,
    pub mirror: DVec3,
    pub transmission: f64,
    pub alpha: f64,
}

/// The channels of pictures of numbers, as in glTF, where one picture has both.
pub(crate) const ROUGHNESS_CHANNEL: usize = 1;
pub(crate) const METALNESS_CHANNEL: usize = 2;

/// Between which numbers the pictures of a material have its metalness and roughness, factors apart; none where there is no picture
/// that shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Variation {
    pub metalness: Option<[f64; 2]>,
    pub roughness: Option<[f64; 2]>,
}

impl Variation {
    /// What the pictures of a material change that shows with these effects: nothing where there is no metal to begin with, where a
    /// finish says how rough it is, or where nothing depends on it.
    pub fn of(
        record: &MaterialRecord,
        finish: &Finish,
        effects: &Simulated,
        textures: &Textures,
    ) -> Variation {
        let Some(images) = &record.images else { return Variation::default() };
        let mixture = Mixture::new(record, finish).simulated(effects);
        let is_metal = mixture.metalness > 0.0;
        let has_highlight =
            mixture.highlight != DVec3::ZERO || is_metal && mixture.metal_highlight != DVec3::ZERO;
        let shows_roughness = mixture.has_lobes || mixture.exponent_by_roughness && has_highlight;
        let is_rough = mixture.roughness > 0.0 && finish.roughness.is_none();
        let range = |map: &ImageMap, channel: usize| {
            let found = textures.find(&map.path, Encoding::Linear);
            found.map_or([0.0, 1.0], |texture| textures.color_ranges(texture)[channel])
        };
        let metalness = images.metalness.as_ref().filter(|_| is_metal);
        let roughness = images.roughness.as_ref().filter(|_| is_rough && shows_roughness);
        Variation {
            metalness: metalness.map(|map| range(map, METALNESS_CHANNEL)),
            roughness: roughness.map(|map| range(map, ROUGHNESS_CHANNEL)),
        }
    }

    /// Whether they change anything.
    pub fn is_any(self) -> bool {
        self.metalness.is_some() || self.roughness.is_some()
    }
}

/// Effects that terms are for; what others would need is left out of them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Simulated {
    /// Any light that makes highlights.
    pub highlights: bool,
    pub reflection: bool,
    pub transmission: bool,
    /// Roughness of mirrors, and of what refracts.
    pub glossy: bool,
    pub frosted: bool,
    /// Whether surfaces may send on no more than they get.
    pub keeps_energy: bool,
}

/// A material of which a share is metal. What is not has the terms of MTL.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mixture {
    diffuse: DVec3,
    highlight: DVec3,
    mirror: DVec3,
    transmission: f64,
    /// Reflectance of the metal, and the strength of its highlight where it is smooth.
    metal: DVec3,
    metal_highlight: DVec3,
    /// Whether light that passes is refracted; metal lets none through then.
    refracts: bool,
    exponent: f64,
    exponent_by_roughness: bool,
    /// Factors.
    pub metalness: f64,
    pub roughness: f64,
    reflection: bool,
    /// Whether what is mirrored or refracted is spread by the roughness: for the material as a whole, so that one place has no lobe
    /// that the ends of its pictures lack.
    has_lobes: bool,
}

impl Mixture {
    /// With all effects. Numbers that make no sense are taken as [`Surface::from_record`](super::Surface::from_record) says.
    pub fn new(record: &MaterialRecord, finish: &Finish) -> Mixture {
        let opacity =
            if record.opacity.is_finite() { f64::from(record.opacity).clamp(0.0, 1.0) } else { 1.0 };
        let color = |color: [f32; 3]| DVec3::from_array(color.map(sensible));
        let (diffuse, specular) = (color(record.diffuse), color(record.specular));
        let refracts = refractive_index(record) != 1.0;
        let mixture = Mixture {
            diffuse: diffuse * opacity,
            highlight: specular,
            mirror: if record.mirror { specular.min(DVec3::ONE) * opacity } else { DVec3::ZERO },
            transmission: 1.0 - opacity,
            metal: diffuse.min(DVec3::ONE) * if refracts { 1.0 } else { opacity },
            metal_highlight: diffuse,
            refracts,
            exponent: sensible(record.shininess),
            exponent_by_roughness: record.exponent_by_roughness,
            metalness: sensible(record.metalness).min(1.0),
            roughness: finish.roughness_of(record),
            reflection: true,
            has_lobes: false,
        };
        Mixture { has_lobes: mixture.may_have_lobes(true, true), ..mixture }
    }

    /// Whether lobes are simulated, by whether mirrors may have them and what refracts: a place that does both has one roughness,
    /// and is smooth if either is to be.
    fn may_have_lobes(&self, glossy: bool, frosted: bool) -> bool {
        let mirrors = self.mirror != DVec3::ZERO || self.metalness > 0.0 && self.metal != DVec3::ZERO;
        match (mirrors, self.refracts && self.transmission > 0.0) {
            (true, true) => glossy && frosted,
            (true, false) => glossy,
            (false, true) => frosted,
            (false, false) => false,
        }
    }

    /// Leaves out what belongs to other effects.
    #[must_use]
    pub fn simulated(mut self, effects: &Simulated) -> Mixture {
        if !effects.highlights {
            (self.highlight, self.metal_highlight) = (DVec3::ZERO, DVec3::ZERO);
        }
        if !effects.reflection {
            (self.mirror, self.metal) = (DVec3::ZERO, DVec3::ZERO);
        }
        if !effects.transmission {
            self.transmission = 0.0;
        }
        if effects.keeps_energy {
            // The metal keeps it by itself, and so does any mix of the two.
            self.diffuse = self.diffuse.min((DVec3::ONE - self.mirror - self.transmission).max(DVec3::ZERO));
        }
        self.reflection = effects.reflection;
        self.has_lobes = self.may_have_lobes(effects.glossy, effects.frosted);
        self
    }

    /// What is known without pictures.
    pub fn factors(&self) -> Look {
        let Mixture { metalness, roughness, .. } = *self;
        Look { diffuse: DVec3::ONE, specular: DVec3::ONE, metalness, roughness }
    }

    /// Whether what passes depends on how much is metal.
    pub fn transmits_by_metalness(&self) -> bool {
        self.refracts && self.transmission > 0.0
    }

    /// The share of light that passes where so much is metal.
    pub fn transmission_at(&self, metalness: f64) -> f64 {
        if self.refracts { self.transmission * (1.0 - metalness) } else { self.transmission }
    }

    /// The terms at a place.
    pub fn at(&self, look: &Look) -> Terms {
        let Look { diffuse, specular, metalness, roughness } = *look;
        let rest = 1.0 - metalness;
        let mirror = self.mirror * specular * rest;
        let transmission = self.transmission_at(metalness);
        let (is_mirror, is_glass) = (mirror != DVec3::ZERO, self.refracts && transmission > 0.0);
        let reflected = mirror + self.metal * diffuse * metalness;
        let is_rough = self.has_lobes && (reflected != DVec3::ZERO || is_glass);
        let alpha = if is_rough { alpha_of(roughness) } else { 0.0 };
        // A rough lobe is the highlight.
        let highlight = match alpha > 0.0 && (is_mirror || is_glass) {
            true => DVec3::ZERO,
            false => self.highlight * specular * rest,
        };
        let of_metal = match alpha > 0.0 {
            true => DVec3::ZERO,
            false => self.metal_highlight * diffuse * metalness,
        };
        // What mirrors shows lights with extent itself.
        let mut area_highlight = if is_mirror || is_glass { DVec3::ZERO } else { highlight };
        if !self.reflection {
            area_highlight += of_metal;
        }
        let exponent = match self.exponent_by_roughness {
            true => f64::from(MaterialRecord::exponent_of(roughness as f32)),
            false => self.exponent,
        };
        Terms {
            diffuse: self.diffuse * diffuse * rest,
            highlight: highlight + of_metal,
            area_highlight,
            exponent,
            mirror: reflected,
            transmission,
            alpha,
        }
    }

    /// The terms at the ends of what pictures can make of the material. All terms but `alpha` and the exponent are linear in the
    /// metalness, so that what is linear in them is nowhere more than at one of these; and nowhere is a lobe sharper. Pictures of
    /// one number have one end, which is what [`Mixture::at`] gives for it, bit for bit.
    pub fn ends(&self, variation: Variation) -> SmallVec<[Terms; 4]> {
        /// For what lookups are off by rounding.
        const CERTAIN: f64 = 1.0 - 1e-9;
        let factors = self.factors();
        let [low, high] = variation.metalness.unwrap_or([1.0; 2]);
        let metal = [high, low].map(|share| factors.metalness * share);
        let [low, high] = variation.roughness.unwrap_or([1.0; 2]);
        let rough = match low < high {
            // Smooth, and as sharp as a lobe can be; or that of the least number.
            true if low == 0.0 => [ALPHA_MIN.sqrt().min(factors.roughness * high), 0.0],
            true => [factors.roughness * low * CERTAIN; 2],
            false => [factors.roughness * low; 2],
        };
        let mut ends = SmallVec::new();
        for metalness in metal.into_iter().take(if metal[0] == metal[1] { 1 } else { 2 }) {
            for roughness in rough.into_iter().take(if rough[0] == rough[1] { 1 } else { 2 }) {
                ends.push(self.at(&Look { metalness, roughness, ..factors }));
            }
        }
        ends
    }
}

impl Terms {
    /// The greater of each; `alpha` too, so that it is 0 only if both are smooth.
    #[must_use]
    pub fn max(&self, other: &Terms) -> Terms {
        Terms {
            diffuse: self.diffuse.max(other.diffuse),
            highlight: self.highlight.max(other.highlight),
            area_highlight: self.area_highlight.max(other.area_highlight),
            exponent: self.exponent.max(other.exponent),
            mirror: self.mirror.max(other.mirror),
            transmission: self.transmission.max(other.transmission),
            alpha: self.alpha.max(other.alpha),
        }
    }
}

/// A number of a record that is finite and not negative; 0 for others.
pub(super) fn sensible(x: f32) -> f64 {
    if x.is_finite() { f64::from(x.max(0.0)) } else { 0.0 }
}

/// At least 1; what makes no sense counts as 1.
pub(super) fn refractive_index(record: &MaterialRecord) -> f64 {
    let index = sensible(record.refractive_index);
    if index >= 1.0 { index } else { 1.0 }
}
