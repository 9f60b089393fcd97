//! What surfaces send out by themselves.

use super::hot::EffectsOfLoop;
use super::paths::{Head, PathTracer};
use super::query::RayQuery;
use super::stage::Shader;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Adds what a hit sends everywhere: its emission, and its share of ambient light.
    #[inline(always)]
    pub(super) fn glow<E: EffectsOfLoop>(&mut self, head: &Head, shader: &Shader) {
        let slot = head.slot as usize;
        let glow =
            if E::DETAILED { shader.emission + shader.diffuse * self.stage.ambient } else { shader.glow };
        self.radiance[slot] += head.throughput * glow;
        if E::SECONDARY {
            self.counters.glowing_hits += u64::from(shader.glows);
            if self.stage.force_emission {
                // Black, as the plan left it.
                self.radiance[slot] += head.throughput * shader.emission;
            }
        }
    }
}
