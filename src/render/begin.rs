//! Where ray trees begin: the camera rays of a batch of samples.

use glam::DVec3;

use super::bounce::Walk;
use super::detail::Cone;
use super::hot::EffectsOfLoop;
use super::paths::{Head, PathTracer};
use super::query::RayQuery;
use super::stage::{CameraSample, PixelSample};

impl<Q: RayQuery> PathTracer<'_, Q> {
    /// Makes the camera rays of these samples the heads.
    pub(super) fn begin<E: EffectsOfLoop>(&mut self, samples: impl Iterator<Item = PixelSample>) {
        self.heads.clear();
        self.rays.clear();
        self.walks.clear();
        self.radiance.clear();
        self.lost.clear();
        self.times.clear();
        if !E::SECONDARY && self.stage.has_middle_rays() {
            // A ray is all that a sample begins with.
            let stage = self.stage;
            self.rays.extend(samples.map(|PixelSample { x, y, .. }| stage.middle_ray(x, y)));
            self.count_samples();
            return;
        }
        let work = self.stage.settings.work_budget;
        for (slot, sample) in samples.enumerate() {
            let CameraSample { key, ray, time } = self.stage.pixel_sample(sample);
            if self.stage.are_moving {
                self.times.push(time);
            }
            self.rays.push(ray);
            if E::SECONDARY {
                self.heads.push(Head { slot: slot as u32, work, throughput: DVec3::ONE });
            }
            if E::SAMPLED {
                let mut walk = Walk::start(key);
                if E::DETAILED {
                    let [width, spread] = self.stage.view.footprint();
                    walk.cone = Cone { width, spread };
                }
                self.walks.push(walk);
                // A lens of radius 0 and a camera at rest see what the camera sees.
                let forced = [self.stage.force_lens, self.stage.force_shutter];
                self.forced.extend(forced.into_iter().filter(|forced| *forced).map(|_| ray));
            }
        }
        self.count_samples();
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
