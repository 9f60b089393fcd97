//! What the effects of a picture cost in rays.

use serde::{Deserialize, Serialize};

use super::detail::query::DetailCounters;
use crate::scene::Effect;

/// Rays and samples by effect. Exact, and the same for any tile size, thread count and cache size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct EffectCounters {
    /// Samples taken.
    pub samples: u64,
    /// Rays from the camera; one per sample.
    pub primary_rays: u64,
    /// Questions whether a lamp is hidden from a point.
    pub shadow_rays: u64,
    /// Queries that carried shadow rays on through transparent surfaces, after the first answer.
    pub shadow_segments: u64,
    /// Rays that left a surface by reflection: mirrors and Fresnel.
    pub reflection_rays: u64,
    /// Rays that passed a surface, refracted or straight.
    pub transmission_rays: u64,
    /// Rays that left a rough mirror.
    pub glossy_rays: u64,
    /// Rays that left rough glass, reflected or refracted.
    pub frosted_rays: u64,
    /// Rays that left a surface by diffuse reflection.
    pub bounce_rays: u64,
    /// Queries for surfaces that coincide with the border of a medium.
    pub medium_rays: u64,
    /// Rays of forced effects that could not matter.
    pub forced_rays: u64,
    /// Points of lights with extent that were sampled.
    pub area_light_samples: u64,
    /// Rays that crossed a light with extent and gathered its radiance.
    pub light_crossings: u64,
    /// Directions to the environment that were sampled.
    pub environment_samples: u64,
    /// Segments of paths and of shadow rays that lost light inside a transparent body.
    pub absorbed_segments: u64,
    /// Surfaces that were no border because they lie inside a stronger body.
    pub passed_surfaces: u64,
    /// Bodies not told apart because too many overlap. Not zero means that refraction may be wrong there.
    pub medium_overflows: u64,
    /// Camera rays through a sampled point of the lens.
    pub lens_rays: u64,
    /// Camera rays at a sampled time.
    pub shutter_rays: u64,
    /// Hits whose triangle was asked for the attributes of its corners.
    pub attribute_lookups: u64,
    /// Hits that were shaded with an interpolated normal.
    pub smooth_hits: u64,
    /// Lookups in pictures of colours.
    pub texture_reads: u64,
    /// Hits of which it was asked whether the surface is cut out there.
    pub cutout_tests: u64,
    /// Those that rays passed because it is.
    pub cutouts_passed: u64,
    /// Queries that carried rays on behind what is cut out.
    pub cutout_rays: u64,
    /// Lookups in pictures of heights and normals.
    pub bump_reads: u64,
    /// Hits on surfaces that glow.
    pub glowing_hits: u64,
    /// Lookups in pictures of roughness and metalness.
    pub finish_reads: u64,
    /// Lookups of attributes and in pictures by forced effects, that could not matter.
    pub forced_lookups: u64,
    /// Random numbers drawn by effects; positions in pixels not counted. [`EffectCounters::numbers_of`] has those of each.
    pub random_numbers: u64,
    /// Those of them for rough mirrors.
    pub glossy_numbers: u64,
    /// Those for rough glass.
    pub frosted_numbers: u64,
    /// Those for the directions of diffuse bounces, and for which ray goes on after one.
    pub bounce_numbers: u64,
    /// Those for Russian roulette.
    pub roulette_numbers: u64,
    /// Rays and lamps not followed because they could not add more than the contribution bound.
    pub contribution_cuts: u64,
    /// Rays and lamps that Russian roulette ended.
    pub roulette_ends: u64,
    /// Rays not followed because their sample's work budget was spent. Not zero means that light is missing.
    pub work_cuts: u64,
}

impl EffectCounters {
    /// Adds `other` to every field.
    pub fn merge(&mut self, other: &EffectCounters) {
        for ((_, sum), (_, count)) in self.fields_mut().into_iter().zip(other.fields()) {
            *sum += count;
        }
    }

    /// Adds what was looked up.
    pub(in crate::render) fn add_details(&mut self, found: &DetailCounters) {
        let DetailCounters {
            attribute_lookups,
            texture_reads,
            cutout_tests,
            cutouts_passed,
            cutout_rays,
            bump_reads,
            finish_reads,
            forced_lookups,
            forced_rays,
        } = found;
        self.attribute_lookups += attribute_lookups;
        self.texture_reads += texture_reads;
        self.cutout_tests += cutout_tests;
        self.cutouts_passed += cutouts_passed;
        self.cutout_rays += cutout_rays;
        self.bump_reads += bump_reads;
        self.finish_reads += finish_reads;
        self.forced_lookups += forced_lookups;
        self.forced_rays += forced_rays;
    }

    /// Every counter with its name.
    pub fn fields(&self) -> [(&'static str, u64); 37] {
        let mut copy = *self;
        copy.fields_mut().map(|(name, count)| (name, *count))
    }

    fn fields_mut(&mut self) -> [(&'static str, &mut u64); 37] {
        // Taken apart, so that a new counter cannot be forgotten.
        let EffectCounters {
            samples,
            primary_rays,
            shadow_rays,
            shadow_segments,
            reflection_rays,
            transmission_rays,
            glossy_rays,
            frosted_rays,
            bounce_rays,
            medium_rays,
            forced_rays,
            area_light_samples,
            light_crossings,
            environment_samples,
            absorbed_segments,
            passed_surfaces,
            medium_overflows,
            lens_rays,
            shutter_rays,
            attribute_lookups,
            smooth_hits,
            texture_reads,
            cutout_tests,
            cutouts_passed,
            cutout_rays,
            bump_reads,
            glowing_hits,
            finish_reads,
            forced_lookups,
            random_numbers,
            glossy_numbers,
            frosted_numbers,
            bounce_numbers,
            roulette_numbers,
            contribution_cuts,
            roulette_ends,
            work_cuts,
        } = self;
        [
            ("samples", samples),
            ("primary_rays", primary_rays),
            ("shadow_rays", shadow_rays),
            ("shadow_segments", shadow_segments),
            ("reflection_rays", reflection_rays),
            ("transmission_rays", transmission_rays),
            ("glossy_rays", glossy_rays),
            ("frosted_rays", frosted_rays),
            ("bounce_rays", bounce_rays),
            ("medium_rays", medium_rays),
            ("forced_rays", forced_rays),
            ("area_light_samples", area_light_samples),
            ("light_crossings", light_crossings),
            ("environment_samples", environment_samples),
            ("absorbed_segments", absorbed_segments),
            ("passed_surfaces", passed_surfaces),
            ("medium_overflows", medium_overflows),
            ("lens_rays", lens_rays),
            ("shutter_rays", shutter_rays),
            ("attribute_lookups", attribute_lookups),
            ("smooth_hits", smooth_hits),
            ("texture_reads", texture_reads),
            ("cutout_tests", cutout_tests),
            ("cutouts_passed", cutouts_passed),
            ("cutout_rays", cutout_rays),
            ("bump_reads", bump_reads),
            ("glowing_hits", glowing_hits),
            ("finish_reads", finish_reads),
            ("forced_lookups", forced_lookups),
            ("random_numbers", random_numbers),
            ("glossy_numbers", glossy_numbers),
            ("frosted_numbers", frosted_numbers),
            ("bounce_numbers", bounce_numbers),
            ("roulette_numbers", roulette_numbers),
            ("contribution_cuts", contribution_cuts),
            ("roulette_ends", roulette_ends),
            ("work_cuts", work_cuts),
        ]
    }

    /// The random numbers that `effect` drew; together with [`EffectCounters::roulette_numbers`] they are all.
    pub fn numbers_of(&self, effect: Effect) -> u64 {
        match effect {
            // A place on the light, a direction, a place on the lens: two numbers each.
            Effect::AreaLight => 2 * self.area_light_samples,
            Effect::EnvironmentLight => 2 * self.environment_samples,
            Effect::DepthOfField => 2 * self.lens_rays,
            Effect::MotionBlur => self.shutter_rays,
            Effect::GlossyReflection => self.glossy_numbers,
            Effect::RoughRefraction => self.frosted_numbers,
            Effect::Interreflection => self.bounce_numbers,
            Effect::DirectLight
            | Effect::Shadows
            | Effect::Reflection
            | Effect::Transmission
            | Effect::Absorption
            | Effect::NestedMedia
            | Effect::Antialiasing
            | Effect::SmoothNormals
            | Effect::Textures
            | Effect::AlphaCutouts
            | Effect::BumpMaps
            | Effect::Emission
            | Effect::FinishMaps => 0,
        }
    }

    /// All rays that were traced.
    pub fn rays(&self) -> u64 {
        self.primary_rays
            + self.shadow_rays
            + self.shadow_segments
            + self.reflection_rays
            + self.transmission_rays
            + self.glossy_rays
            + self.frosted_rays
            + self.bounce_rays
            + self.medium_rays
            + self.cutout_rays
            + self.forced_rays
    }
}
