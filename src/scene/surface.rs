//! From the material record of the compiled file to the terms that shading uses.

use super::Finish;
use super::mixture::{Mixture, Terms, refractive_index, sensible};
use crate::model::MaterialRecord;

/// Shading terms of a material, derived once per render; where pictures say how rough or how much of a metal it is, once per hit.
///
/// The mapping (MTL names in brackets), with opacity `d` clamped to 0 ..= 1, of what is no metal:
///
/// | term | value | meaning |
/// |---|---|---|
/// | diffuse | `d Kd` | Lambert, per light and for ambient light, on the side that is seen |
/// | highlight | `Ks`, exponent `Ns` | Blinn: `Ks (n . h)^Ns` per light; not weakened by transparency, as glass keeps its highlights. Rough mirrors and rough glass have none: their lobe is it |
/// | mirror | `d min(Ks, 1)` if `illum >= 3` | reflects the scene |
/// | transmission | `1 - d` | the share that enters. If `Ni` is not 1, Fresnel's equations split it into a reflected and a refracted part that add up to it; if `Ni` is 1, all of it passes straight on |
/// | alpha | `Pr^2`, or the [`Finish`]'s roughness squared | GGX microfacets instead of a smooth mirror and smooth glass |
/// | absorption | `-ln Tf` | Beer-Lambert, per unit of length inside (the segment that ends at the surface from behind) |
///
/// `d min(Ks, 1) + (1 - d) <= 1` in each channel: no surface sends on more than it gets. The renderer's bound on
/// radiance rests on this. All numbers are finite and not negative.
///
/// Metal mirrors `min(Kd, 1)`, as rough as the rest, with a highlight of strength `Kd` where it is smooth, and has no diffuse part.
/// It hides what is behind it where the rest refracts (`Ni` is not 1), and is as see-through as the rest, by `d`, where it does
/// not. With metalness `m` (`Pm`) each term is `1 - m` times that of what is no metal and `m` times the metal's; so energy is kept
/// by any mix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Emitted radiance.
    pub emission: [f64; 3],
    /// Diffuse reflectance, opacity applied.
    pub diffuse: [f64; 3],
    /// Strength of the highlight of a light.
    pub highlight: [f64; 3],
    /// The part of it that lights with extent and the environment show too: that of what does not mirror them.
    pub area_highlight: [f64; 3],
    /// Blinn exponent of the highlight.
    pub exponent: f64,
    /// Share of incoming light that is mirrored, opacity applied; at most 1.
    pub mirror: [f64; 3],
    /// Share of incoming light that passes the surface, before Fresnel: 0 ..= 1.
    pub transmission: f64,
    /// Absorption coefficient per unit of length inside.
    pub absorption: [f64; 3],
    /// At least 1; exactly 1 passes light straight on.
    pub refractive_index: f64,
    /// GGX's alpha of mirror and glass; 0 if smooth, or neither.
    pub alpha: f64,
    /// Rank among overlapping media.
    pub priority: u8,
}

impl Surface {
    /// Largest absorption coefficient: `Tf` of zero means opaque within a unit, not a product of 0 and infinity.
    const ABSORPTION_MAX: f64 = 64.0;

    /// Derives the terms as the type's table says. Numbers that make no sense (negative, not finite) count as 0,
    /// a missing refractive index as 1.
    pub fn from_record(record: &MaterialRecord) -> Surface {
        Surface::with_finish(record, &Finish::default())
    }

    /// [`Surface::from_record`] and what a scene adds to it.
    pub fn with_finish(record: &MaterialRecord, finish: &Finish) -> Surface {
        let mixture = Mixture::new(record, finish);
        Surface::of_terms(record, finish, &mixture.at(&mixture.factors()))
    }

    /// These terms, and of the record those that are the same all over a surface.
    pub(crate) fn of_terms(record: &MaterialRecord, finish: &Finish, terms: &Terms) -> Surface {
        let Terms { diffuse, highlight, area_highlight, exponent, mirror, transmission, alpha } = *terms;
        Surface {
            emission: record.emission.map(sensible),
            diffuse: diffuse.to_array(),
            highlight: highlight.to_array(),
            area_highlight: area_highlight.to_array(),
            exponent,
            mirror: mirror.to_array(),
            transmission,
            absorption: record.transmission.map(|channel| {
                let share = sensible(channel).min(1.0);
                if share > 0.0 {
                    (-libm::log(share)).clamp(0.0, Self::ABSORPTION_MAX)
                } else {
                    Self::ABSORPTION_MAX
                }
            }),
            refractive_index: refractive_index(record),
            alpha,
            priority: finish.priority.unwrap_or(0),
        }
    }

    /// Whether light from a lamp shows on it: as diffuse light, in a highlight or in a rough lobe.
    pub fn is_lit(&self) -> bool {
        self.diffuse != [0.0; 3] || self.highlight != [0.0; 3] || self.alpha > 0.0
    }

    /// Whether it mirrors the scene in its own right (not by Fresnel).
    pub fn is_mirror(&self) -> bool {
        self.mirror != [0.0; 3]
    }

    /// Whether light passes through it.
    pub fn is_transparent(&self) -> bool {
        self.transmission > 0.0
    }

    /// Whether it looks different if its normal does: all but what only glows, or lets light pass straight on.
    pub fn depends_on_normal(&self) -> bool {
        self.is_lit() || self.is_mirror() || self.refracts()
    }

    /// Whether it splits light by Fresnel's equations.
    pub fn refracts(&self) -> bool {
        self.is_transparent() && self.refractive_index != 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn glass_of_the_gears_model() {
        let record = MaterialRecord {
            diffuse: [0.2, 0.8, 1.0],
            opacity: 0.2,
            refractive_index: 1.1,
            ..MaterialRecord::default()
        };
        let surface = Surface::from_record(&record);
        assert!(surface.refracts() && surface.is_lit() && !surface.is_mirror());
        assert!((surface.transmission - 0.8).abs() < 1e-7);
        assert!((surface.diffuse[1] - 0.16).abs() < 1e-7);
        assert_eq!(surface.absorption, [0.0; 3]);
    }

    #[test]
    fn nonsense_becomes_harmless() {
        let record = MaterialRecord {
            name: String::new(),
            diffuse: [f32::NAN, -1.0, 3.0],
            specular: [f32::INFINITY, 0.5, 7.0],
            shininess: f32::NAN,
            emission: [-0.0; 3],
            opacity: f32::NAN,
            transmission: [0.0, 2.0, f32::NAN],
            refractive_index: f32::NAN,
            mirror: true,
            roughness: f32::NAN,
            metalness: f32::NAN,
            exponent_by_roughness: false,
            images: None,
        };
        let surface = Surface::from_record(&record);
        assert_eq!(surface.diffuse, [0.0, 0.0, 3.0]);
        assert_eq!(surface.mirror, [0.0, 0.5, 1.0]);
        assert_eq!(surface.absorption, [Surface::ABSORPTION_MAX, 0.0, Surface::ABSORPTION_MAX]);
        assert_eq!((surface.refractive_index, surface.transmission, surface.exponent), (1.0, 0.0, 0.0));
        assert_eq!(surface.alpha, 0.0);
        let alpha = |roughness| Surface::from_record(&MaterialRecord { roughness, ..record.clone() }).alpha;
        assert_eq!([-1.0, f32::NEG_INFINITY, f32::INFINITY, 7.0].map(alpha), [0.0, 0.0, 1.0, 1.0]);
        let metal = MaterialRecord { metalness: 7.0, mirror: false, ..record };
        assert_eq!(Surface::from_record(&metal).mirror, [0.0, 0.0, 1.0]);
    }

    /// As much of each as there is, between a dielectric and a metal.
    #[test]
    fn metalness_mixes_two_materials() {
        let paint = MaterialRecord {
            diffuse: [0.25, 0.5, 2.0],
            specular: [0.0625; 3],
            roughness: 0.5,
            ..MaterialRecord::default()
        };
        let of = |metalness| Surface::from_record(&MaterialRecord { metalness, ..paint.clone() });
        let [matt, quarter, metal] = [0.0, 0.25, 1.0].map(of);
        assert_eq!((matt.mirror, matt.alpha, matt.highlight), ([0.0; 3], 0.0, [0.0625; 3]));
        assert_eq!((metal.mirror, metal.alpha, metal.highlight), ([0.25, 0.5, 1.0], 0.25, [0.0; 3]));
        assert_eq!((matt.diffuse, metal.diffuse), ([0.25, 0.5, 2.0], [0.0; 3]));
        assert_eq!((quarter.mirror, quarter.diffuse), ([0.0625, 0.125, 0.25], [0.1875, 0.375, 1.5]));
        // The paint keeps its highlight beside the metal's lobe, for all lights.
        assert_eq!((quarter.highlight, quarter.area_highlight), ([0.046_875; 3], [0.046_875; 3]));
        // Smooth metal has one, but shows lights with extent itself.
        let smooth =
            Surface::from_record(&MaterialRecord { roughness: 0.0, metalness: 1.0, ..paint.clone() });
        assert_eq!((smooth.highlight, smooth.area_highlight), ([0.25, 0.5, 2.0], [0.0; 3]));
        // Half of a pane of glass, and half of a veil, is metal.
        let half = |refractive_index| MaterialRecord {
            opacity: 0.5,
            refractive_index,
            metalness: 0.5,
            ..paint.clone()
        };
        let (pane, veil) = (Surface::from_record(&half(1.5)), Surface::from_record(&half(1.0)));
        assert_eq!((pane.transmission, pane.mirror), (0.25, [0.125, 0.25, 0.5]));
        assert_eq!((veil.transmission, veil.mirror), (0.5, [0.0625, 0.125, 0.25]));
        assert_eq!((pane.diffuse, veil.diffuse), ([0.0625, 0.125, 0.5], [0.0625, 0.125, 0.5]));
    }
}
