//! Absorption along the way through a medium.

use glam::DVec3;

use super::hot::EffectsOfLoop;
use super::paths::PathTracer;
use super::query::RayQuery;

/// What is left of light after `length` in a medium, per channel (Beer-Lambert).
pub(crate) fn absorb(coefficients: DVec3, length: f64) -> DVec3 {
    if coefficients == DVec3::ZERO {
        return DVec3::ONE;
    }
    let channel = |coefficient: f64| if coefficient == 0.0 { 1.0 } else { libm::exp(-coefficient * length) };
    DVec3::new(channel(coefficients.x), channel(coefficients.y), channel(coefficients.z))
}

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// What is left of `throughput` where a ray hits at `t`, having come through a medium with these coefficients.
    #[inline(always)]
    pub(super) fn absorbed<E: EffectsOfLoop>(&mut self, throughput: DVec3, medium: DVec3, t: f64) -> DVec3 {
        if E::SECONDARY && medium != DVec3::ZERO {
            self.counters.absorbed_segments += 1;
            throughput * absorb(medium, t)
        } else if E::SECONDARY && self.stage.force_absorption {
            throughput * (DVec3::ONE + absorb(DVec3::ONE, t) * 0.0)
        } else {
            throughput
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn absorption_multiplies_along_the_way() {
        let coefficients = DVec3::new(0.0, 0.5, 64.0);
        let once = absorb(coefficients, 3.0);
        assert_eq!(once.x, 1.0);
        assert!((once.y - libm::exp(-1.5)).abs() < 1e-16);
        assert!((absorb(coefficients, 6.0) - once * once).length() < 1e-15);
    }
}
