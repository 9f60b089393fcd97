//! Everything that trades error for time in a picture, and the picture that follows from it.

use serde::{Deserialize, Serialize};

use crate::LazyOctree;
use crate::budget::MemoryBudget;
use crate::compile::{Control, Threads};
use crate::error::RenderError;
use crate::octree::Tier;
use crate::render::{AdaptiveSampling, Progress, RenderSettings, RenderedImage, Renderer};
use crate::scene::Scene;
use crate::units::TileId;

/// What was chosen for a picture. With scene, model and settings it gives the picture again, bit for bit, also from a file that was
/// written with serde, in a format that keeps every bit of an f64 (`serde_json` does with its feature `float_roundtrip`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Knobs {
    /// How sure hits are; that of the octree.
    pub tier: Tier,
    /// See [`RenderSettings::contribution_bound`].
    pub contribution_bound: f64,
    /// See [`RenderSettings::work_budget`].
    pub work_budget: u64,
    /// How many samples pixels get.
    pub sampling: Sampling,
    /// The tiles that thresholds are for.
    pub tile_size: u32,
}

/// How many samples pixels get.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Sampling {
    /// All the same.
    Fixed {
        /// Samples per pixel.
        samples: u32,
    },
    /// Until the error is small enough; see [`AdaptiveSampling`].
    Adaptive {
        /// Samples of every pixel.
        samples_min: u32,
        /// Most samples of a pixel.
        samples_max: u32,
        /// Confidence of the pixels' intervals.
        confidence: f64,
        /// The first holds from tile 0 on; each until the next. More than one only where the clock had a say.
        thresholds: Vec<TileThreshold>,
    },
}

/// An error threshold for a run of tiles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TileThreshold {
    /// From this tile on, in the order in which tiles are handed out.
    pub first_tile: TileId,
    /// See [`AdaptiveSampling::error`].
    pub error: f64,
}

impl Knobs {
    /// `settings` with these knobs, and with statistics kept.
    pub fn settings(&self, settings: &RenderSettings) -> RenderSettings {
        let (samples_per_pixel, adaptive) = match &self.sampling {
            Sampling::Fixed { samples } => (*samples, None),
            Sampling::Adaptive { samples_min, samples_max, confidence, thresholds } => {
                let error = thresholds.first().map_or(0.0, |first| first.error);
                (
                    *samples_max,
                    Some(AdaptiveSampling { samples_min: *samples_min, error, confidence: *confidence }),
                )
            }
        };
        RenderSettings {
            samples_per_pixel,
            adaptive,
            contribution_bound: self.contribution_bound,
            work_budget: self.work_budget,
            tile_size: self.tile_size,
            keep_statistics: true,
            ..*settings
        }
    }

    /// The threshold of a tile, if sampling is adaptive.
    pub fn threshold(&self, tile: TileId) -> Option<f64> {
        match &self.sampling {
            Sampling::Fixed { .. } => None,
            Sampling::Adaptive { thresholds, .. } => thresholds
                .iter()
                .rev()
                .find(|threshold| threshold.first_tile <= tile)
                .map(|found| found.error),
        }
    }
}

/// Makes the picture that `knobs` stand for. What `settings` say about samples, cut-off, work budget and tile size does not matter.
///
/// # Errors
/// As for [`Renderer::new`] and [`Renderer::render`]; [`RenderError::Setting`] if the octree was opened with another tier.
pub fn render_with_knobs(
    octree: &LazyOctree,
    scene: &Scene,
    settings: &RenderSettings,
    knobs: &Knobs,
    threads: &Threads,
    budget: &MemoryBudget,
    progress: &mut (dyn FnMut(Progress) -> Control + Send),
) -> Result<RenderedImage, RenderError> {
    if octree.tier() != knobs.tier {
        let reason = format!(
            "the octree is open as {}, the knobs are for {}; open it with that tier",
            octree.tier().name(),
            knobs.tier.name()
        );
        return Err(RenderError::Setting { what: "tier", reason });
    }
    let renderer = Renderer::new(octree, scene, &knobs.settings(settings), budget)?;
    renderer.render_steered(threads, &|tile| knobs.threshold(tile), progress)
}
