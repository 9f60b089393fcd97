//! Light that points ask for by luck (next-event estimation): one sample of each light with extent and of the environment at every
//! lit point, weighted against the rays that find the same light by themselves.

use std::time::Instant;

use glam::DVec3;

use super::paths::{PathTracer, Point};
use super::query::RayQuery;
use super::random::Dimension;
use super::response::{Lobes, Scatter};
use super::stage::Stage;
use crate::error::TraceError;
use crate::geom::Ray;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Asks for the light of every light with extent and of the environment at every point, light by light.
    pub(super) fn light_by_samples(&mut self) -> Result<(), TraceError> {
        let stage = self.stage;
        if stage.areas.is_empty() && stage.environment.is_none() {
            return Ok(());
        }
        let mut start = Instant::now();
        // Rays of rough lobes find light through glass by themselves, and so do all rays with interreflection.
        let parts: &[(Lobes, bool)] = match (stage.interreflection, stage.has_rough) {
            (true, _) => &[(Lobes::All, true)],
            (false, true) => &[(Lobes::Lamp, false), (Lobes::Rough, true)],
            (false, false) => &[(Lobes::All, false)],
        };
        for (lobes, straight_only) in parts {
            self.shadows.pass_straight_only(*straight_only);
            start = self.light_of_areas(*lobes, start)?;
            start = self.light_of_environment(*lobes, start)?;
            if !self.shadows.is_empty() {
                start = self.resolve_shadows(start)?;
            }
        }
        self.shadows.pass_straight_only(false);
        self.seconds.shading += start.elapsed().as_secs_f64();
        Ok(())
    }

    /// Adds `contribution` to its sample unless something stands in the way of `ray`, or it is too faint.
    #[expect(clippy::too_many_arguments, reason = "all belong to one light sample")]
    pub(super) fn claim(
        &mut self,
        point: &Point,
        scatter: &Scatter,
        mut contribution: DVec3,
        ray: Ray,
        luck: Dimension,
        is_forced: bool,
        start: Instant,
    ) -> Result<Instant, TraceError> {
        let stage = self.stage;
        contribution = self.worth_asking(point.slot, scatter, contribution, luck);
        if contribution == DVec3::ZERO && !(is_forced || stage.force_shadows) {
            return Ok(start);
        }
        if !(stage.shadows || stage.force_shadows || is_forced) {
            self.radiance[point.slot as usize] += contribution;
            return Ok(start);
        }
        self.shadows.push(point.slot, contribution, ray);
        if self.shadows.is_full() { self.resolve_shadows(start) } else { Ok(start) }
    }

    /// What is to be made of light that arrives if nothing hides it: zero if it is cut, more if luck lets it go on.
    pub(super) fn worth_asking(
        &mut self,
        slot: u32,
        scatter: &Scatter,
        contribution: DVec3,
        luck: Dimension,
    ) -> DVec3 {
        let bound = self.stage.settings.contribution_bound;
        let largest = contribution.max_element();
        if largest > bound || largest == 0.0 {
            return contribution;
        }
        if !self.stage.roulette {
            self.counters.contribution_cuts += 1;
            self.lost[slot as usize] += largest;
            return DVec3::ZERO;
        }
        self.counters.random_numbers += 1;
        self.counters.roulette_numbers += 1;
        if scatter.walk.key.one(scatter.vertex, luck) * bound < largest {
            return contribution * (bound / largest);
        }
        self.counters.roulette_ends += 1;
        DVec3::ZERO
    }
}

impl Stage {
    /// Whether points keep a [`Scatter`] beside them, and lights with extent are asked for.
    pub fn samples_lights(&self) -> bool {
        !self.areas.is_empty() || self.environment.is_some()
    }
}
