//! The effects by name, sets of them, and what a caller may ask for beside what a scene calls for.

use serde::{Deserialize, Serialize};

/// Something that light does, at the price of rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Lights without extent show on diffuse surfaces and make highlights.
    DirectLight,
    /// One ray per point and light that asks what stands between.
    Shadows,
    /// Lights with extent: sampled, so their shadows are soft, and seen by rays that cross them.
    AreaLight,
    /// Light from all around, sampled.
    EnvironmentLight,
    /// Mirrors, and the reflected part of glass.
    Reflection,
    /// Blurred reflection of rough mirrors.
    GlossyReflection,
    /// Light passes through surfaces: refracted, straight, and through shadows.
    Transmission,
    /// Blurred refraction and reflection of rough glass.
    RoughRefraction,
    /// Light weakens inside transparent bodies.
    Absorption,
    /// Transparent bodies that overlap or touch, by priority.
    NestedMedia,
    /// Light that comes to matt surfaces from other surfaces.
    Interreflection,
    /// A lens in place of the pinhole.
    DepthOfField,
    /// The camera, or instances, move while the shutter is open.
    MotionBlur,
    /// More than one sample per pixel.
    Antialiasing,
    /// Light falls on the curved surface that a mesh stands for: interpolated normals.
    SmoothNormals,
    /// Colours from image files.
    Textures,
    /// Surfaces that are not there where an image says so.
    AlphaCutouts,
    /// Heights or normals from image files bend what light falls on.
    BumpMaps,
    /// Surfaces that glow.
    Emission,
    /// Roughness and metalness from image files.
    FinishMaps,
}

impl Effect {
    /// All effects.
    pub const ALL: [Effect; 20] = [
        Effect::DirectLight,
        Effect::Shadows,
        Effect::AreaLight,
        Effect::EnvironmentLight,
        Effect::Reflection,
        Effect::GlossyReflection,
        Effect::Transmission,
        Effect::RoughRefraction,
        Effect::Absorption,
        Effect::NestedMedia,
        Effect::Interreflection,
        Effect::DepthOfField,
        Effect::MotionBlur,
        Effect::Antialiasing,
        Effect::SmoothNormals,
        Effect::Textures,
        Effect::AlphaCutouts,
        Effect::BumpMaps,
        Effect::Emission,
        Effect::FinishMaps,
    ];

    /// The name used in reports.
    pub fn name(self) -> &'static str {
        match self {
            Effect::DirectLight => "direct light",
            Effect::Shadows => "shadows",
            Effect::AreaLight => "area light",
            Effect::EnvironmentLight => "environment light",
            Effect::Reflection => "reflection",
            Effect::GlossyReflection => "glossy reflection",
            Effect::Transmission => "transmission",
            Effect::RoughRefraction => "rough refraction",
            Effect::Absorption => "absorption",
            Effect::NestedMedia => "nested media",
            Effect::Interreflection => "interreflection",
            Effect::DepthOfField => "depth of field",
            Effect::MotionBlur => "motion blur",
            Effect::Antialiasing => "antialiasing",
            Effect::SmoothNormals => "smooth normals",
            Effect::Textures => "textures",
            Effect::AlphaCutouts => "alpha cut-outs",
            Effect::BumpMaps => "bump maps",
            Effect::Emission => "emission",
            Effect::FinishMaps => "finish maps",
        }
    }
}

/// A set of effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EffectSet(u32);

impl EffectSet {
    /// No effect.
    pub const EMPTY: EffectSet = EffectSet(0);
    /// Every effect.
    pub const ALL: EffectSet = EffectSet((1 << Effect::ALL.len()) - 1);

    /// This set and `effect`.
    #[must_use]
    pub const fn with(self, effect: Effect) -> EffectSet {
        EffectSet(self.0 | 1 << effect as u32)
    }

    /// This set without `effect`.
    #[must_use]
    pub const fn without(self, effect: Effect) -> EffectSet {
        EffectSet(self.0 & !(1 << effect as u32))
    }

    /// Whether `effect` is in the set.
    pub const fn contains(self, effect: Effect) -> bool {
        self.0 >> effect as u32 & 1 == 1
    }
}

impl FromIterator<Effect> for EffectSet {
    fn from_iter<I: IntoIterator<Item = Effect>>(effects: I) -> EffectSet {
        effects.into_iter().fold(EffectSet::EMPTY, EffectSet::with)
    }
}

/// What the caller wants beside what the scene calls for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EffectOptions {
    /// Samples per pixel; above 1 calls for antialiasing.
    pub samples_per_pixel: u32,
    /// Left out even if the scene calls for it. The picture changes. ([`Effect::Antialiasing`] is left out by
    /// asking for one sample.)
    pub switched_off: EffectSet,
    /// Simulated even if the scene has no use for it, and multiplied by zero: the picture does not change by a bit. For
    /// tests and for measuring what the plan saves. Rays are traced, pictures looked up (a texel of its own where the scene has none),
    /// normals interpolated. ([`Effect::Antialiasing`] has no work of its own.)
    pub forced: EffectSet,
}

impl Default for EffectOptions {
    fn default() -> EffectOptions {
        EffectOptions { samples_per_pixel: 1, switched_off: EffectSet::EMPTY, forced: EffectSet::EMPTY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets() {
        assert!(Effect::ALL.iter().all(|effect| EffectSet::ALL.contains(*effect)));
        assert_eq!(Effect::ALL.into_iter().collect::<EffectSet>(), EffectSet::ALL);
        assert!(!EffectSet::EMPTY.with(Effect::Shadows).contains(Effect::Reflection));
        assert!(!EffectSet::ALL.without(Effect::Shadows).contains(Effect::Shadows));
        assert!(EffectSet::ALL.without(Effect::Shadows).contains(Effect::Reflection));
    }

    #[test]
    fn places_in_the_list_are_places_in_the_set() {
        for (index, effect) in Effect::ALL.into_iter().enumerate() {
            assert_eq!(effect as usize, index);
        }
    }
}
