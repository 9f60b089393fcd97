//! Where ray trees begin: the camera rays of a batch of samples.

use glam::DVec3;

use super::detail::Cone;
use super::hot::EffectsOfLoop;
use super::paths::{Head, PathTracer};
use super::query::RayQuery;
use super::stage::{CameraSample, PixelSample};
use super::walk::Walk;

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Makes the camera rays of these samples the rays that are traced next. What they hit decides which loop they
    /// [enter](PathTracer::enter).
    pub(super) fn begin(&mut self, samples: impl Iterator<Item = PixelSample>) {
        self.heads.clear();
        self.rays.clear();
        self.walks.clear();
        self.radiance.clear();
        self.lost.clear();
        self.times.clear();
        // Of samples that an error ended.
        self.shadows.forget();
        self.forced.clear();
        let stage = self.stage;
        if stage.has_middle_rays() {
            self.rays.extend(samples.map(|PixelSample { x, y, .. }| stage.middle_ray(x, y)));
        } else {
            for sample in samples {
                let CameraSample { ray, time } = stage.pixel_sample(sample);
                if stage.are_moving {
                    self.times.push(time);
                }
                self.rays.push(ray);
            }
        }
        self.count_samples();
    }

    /// Gives the samples of the last [`PathTracer::begin`] what the loop keeps beside their rays.
    pub(super) fn enter<E: EffectsOfLoop>(&mut self, samples: impl Iterator<Item = PixelSample>) {
        let stage = self.stage;
        if E::SECONDARY {
            let work = stage.settings.work_budget;
            let slots = 0..self.rays.len() as u32;
            self.heads.extend(slots.map(|slot| Head { slot, work, throughput: DVec3::ONE }));
        }
        if E::SAMPLED {
            let [width, spread] = stage.view.footprint();
            let cone = Cone { width, spread };
            self.walks.extend(samples.map(|sample| Walk { cone, ..Walk::start(stage.key(sample)) }));
            // A lens of radius 0 and a camera at rest see what the camera sees.
            for forced in [stage.force_lens, stage.force_shutter] {
                if forced {
                    self.forced.extend_from_slice(&self.rays);
                }
            }
        }
    }

    /// Books the camera rays, and makes each sample a place for its light.
    fn count_samples(&mut self) {
        let count = self.rays.len();
        self.radiance.resize(count, DVec3::ZERO);
        self.lost.resize(count, 0.0);
        self.lost_by_shadows.clear();
        if self.stage.transparent.is_some() {
            self.lost_by_shadows.resize(count, 0.0);
        }
        let count = count as u64;
        self.counters.samples += count;
        self.counters.primary_rays += count;
        if self.stage.view.has_lens() {
            self.counters.lens_rays += count;
            self.counters.random_numbers += 2 * count;
        }
        if self.stage.draws_time() {
            self.counters.shutter_rays += count;
            self.counters.random_numbers += count;
        }
    }

    /// What belongs to a ray that is about to be traced.
    #[inline]
    pub(super) fn head<E: EffectsOfLoop>(&self, index: usize) -> Head {
        if E::SECONDARY {
            self.heads[index]
        } else {
            // Camera rays only, which carry all.
            Head { slot: index as u32, work: self.stage.settings.work_budget, throughput: DVec3::ONE }
        }
    }
}
