//! What the effects of a picture cost in rays.

use serde::{Deserialize, Serialize};

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
    /// Rays of forced effects that could not matter.
    pub forced_rays: u64,
    /// Rays and lamps not followed because they could not add more than the contribution bound.
    pub contribution_cuts: u64,
    /// Rays not followed because their sample's work budget was spent. Not zero means that light is missing.
    pub work_cuts: u64,
}

impl EffectCounters {
    /// Adds `other` to every field.
    pub fn merge(&mut self, other: &EffectCounters) {
        let EffectCounters {
            samples,
            primary_rays,
            shadow_rays,
            shadow_segments,
            reflection_rays,
            transmission_rays,
            forced_rays,
            contribution_cuts,
            work_cuts,
        } = other;
        self.samples += samples;
        self.primary_rays += primary_rays;
        self.shadow_rays += shadow_rays;
        self.shadow_segments += shadow_segments;
        self.reflection_rays += reflection_rays;
        self.transmission_rays += transmission_rays;
        self.forced_rays += forced_rays;
        self.contribution_cuts += contribution_cuts;
        self.work_cuts += work_cuts;
    }

    /// All rays that were traced.
    pub fn rays(&self) -> u64 {
        self.primary_rays
            + self.shadow_rays
            + self.shadow_segments
            + self.reflection_rays
            + self.transmission_rays
            + self.forced_rays
    }
}
