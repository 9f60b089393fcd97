//! How long the lists of a path tracer are.

use glam::DVec3;

use super::detail::query::SurfaceQuery;
use super::media::Borders;
use super::paths::{Head, Point, Waiting};
use super::response::Scatter;
use super::shadows::ShadowBatch;
use super::stage::{Loop, Shader, Stage};
use super::walk::Walk;
use crate::geom::Ray;
use crate::trace::Hit;

/// Sizes of the lists, all fixed by the settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sizes {
    pub batch: usize,
    pub stack_depth: usize,
    pub shadows: usize,
    pub forced: usize,
    /// Places of the lists that only loops with sampled effects have.
    pub walks: usize,
    pub borders: usize,
}

impl Sizes {
    pub fn of(stage: &Stage) -> Sizes {
        Sizes::of_batch(stage, stage.settings.batch_samples.min(tile_samples_max(stage)) as usize)
    }

    /// For calls of at most `batch` samples.
    pub fn of_batch(stage: &Stage, batch: usize) -> Sizes {
        let lamps = stage.emitters.len().clamp(1, 4);
        let is_sampled = matches!(stage.path_loop, Loop::Sampled | Loop::Detailed);
        let has_shadows = stage.shadows || stage.force_shadows || stage.samples_lights();
        let halvings = stage.settings.work_budget.ilog2() as usize + 1;
        Sizes {
            batch,
            stack_depth: match (stage.transmission && stage.reflection, stage.interreflection) {
                // Only a surface that both passes and reflects can split a ray in two.
                (true, false) => halvings,
                // Two rays wait while a third one with at most a third of the work goes on: less than log2, twice.
                (_, true) if stage.transmission || stage.reflection => 2 * halvings,
                _ => 0,
            },
            shadows: if has_shadows { batch * lamps } else { 0 },
            forced: if stage.force_reflection || stage.force_transmission || stage.forces_a_sampled_effect() {
                // At most one for each forced effect and sample.
                7 * batch
            } else {
                0
            },
            walks: if is_sampled { batch } else { 0 },
            borders: if stage.nested || stage.force_nested { batch } else { 0 },
        }
    }

    /// What lists of these sizes take, in bytes.
    pub fn bytes(&self, stage: &Stage) -> usize {
        let per_sample = 2 * (size_of::<Head>() + size_of::<Ray>())
            + size_of::<Option<Hit>>()
            + size_of::<Point>()
            + self.stack_depth * size_of::<Option<Waiting>>()
            + size_of::<u8>()
            + size_of::<DVec3>()
            + 2 * size_of::<f64>();
        self.batch * per_sample
            + self.walks
                * (2 * size_of::<Walk>()
                    + size_of::<Scatter>()
                    + self.stack_depth * size_of::<Option<Walk>>())
            // A copy of the hits where nested media are only forced.
            + Borders::bytes_needed(self.borders)
            + self.borders * size_of::<Option<Hit>>()
            + ShadowBatch::bytes_needed(self.shadows, stage.transparent.is_some())
            + self.forced * (size_of::<Ray>() + size_of::<Option<Hit>>())
            + if stage.path_loop == Loop::Detailed { 2 * self.batch * size_of::<Shader>() } else { 0 }
            // A sample's time, its ray's, and those that queries keep.
            + if stage.are_moving { 4 * self.batch.max(self.shadows) * size_of::<f64>() } else { 0 }
            + SurfaceQuery::<()>::bytes_needed(stage, self.batch.max(self.shadows).max(self.forced))
    }
}

/// Most samples that a tile can hold, saturated: larger batches never come about.
fn tile_samples_max(stage: &Stage) -> u32 {
    let settings = &stage.settings;
    let pixels = settings.tile_size.min(settings.width) * settings.tile_size.min(settings.height);
    pixels.saturating_mul(settings.samples_per_pixel)
}
