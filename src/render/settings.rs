//! What a caller chooses about a picture beside the scene.

use std::fmt::{self, Display};
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::adaptive::AdaptiveSampling;
use super::sampling::Filter;
use super::tiles::TileGrid;
use crate::error::RenderError;
use crate::scene::{EffectOptions, EffectSet};

/// What becomes of a ray that cannot add more than the contribution bound.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum PathEnd {
    /// It is cut. Each cut takes at most [`RenderSettings::contribution_bound`] from its sample, in expectation where effects
    /// are sampled, and the report counts the cuts.
    #[default]
    Cut,
    /// Russian roulette: it goes on with a probability of its largest possible contribution over the bound, and carries that
    /// much more. Nothing is lost on average; the bound then only trades time for noise. Luck is keyed by the seed.
    Roulette,
}

/// What a ray does that reaches a block which is not resident. In the tiers `Certified` and `Exact` the picture is the same, bit for bit; what differs is how
/// often a block is loaded where the cache holds few of the blocks that rays reach.
///
/// Camera rays come in an order in which neighbours follow each other through the same blocks, so their thread loads for them in
/// any case. It is all other rays that can wait: each for the block that it needs, until that is loaded for all that wait for it
/// ([`RayPool`](crate::trace::RayPool)), while other samples go on. That takes memory for the samples on their way, 1 to 4
/// kilobytes for each ray that may wait, and it is no use where all blocks are resident.
///
/// Pictures of instances and pictures that keep [costs](RenderSettings::keep_costs) are always made as by [`WaitingRays::Never`].
/// Where regions are rendered ([`Renderer::with_regions`](super::Renderer::with_regions)), only samples of one region of a thread
/// are on their way at one time, so the larger it is the more of them share a load.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum WaitingRays {
    /// Its thread loads the block at once.
    Never,
    /// They wait if there are fewer slots than blocks and the scene has interreflection, whose rays go anywhere. Those of mirrors
    /// and glass mostly follow each other, as camera rays do, and taking them out of their order was found to cost more loads than
    /// it saves as often as not. As many may wait as a part of the memory that all blocks would take holds, with no more than the
    /// cache has, at most 65,536; fewer or none if the budget has no room for them: nothing fails for that.
    #[default]
    Auto,
    /// So many may wait, all threads together; at least 1.
    Count(u32),
}

/// Why a text does not say which rays wait.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not auto, never or a number of rays")]
pub struct ParseWaitingRaysError {
    text: String,
}

impl FromStr for WaitingRays {
    type Err = ParseWaitingRaysError;

    /// Reads `auto`, `never` or a number of rays.
    fn from_str(text: &str) -> Result<WaitingRays, ParseWaitingRaysError> {
        match text {
            "auto" => Ok(WaitingRays::Auto),
            "never" => Ok(WaitingRays::Never),
            count => count
                .parse()
                .map(WaitingRays::Count)
                .map_err(|_| ParseWaitingRaysError { text: text.to_string() }),
        }
    }
}

impl Display for WaitingRays {
    /// What is read as the same.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            WaitingRays::Auto => f.write_str("auto"),
            WaitingRays::Never => f.write_str("never"),
            WaitingRays::Count(rays) => rays.fmt(f),
        }
    }
}

/// Size, quality and limits of a picture. The picture is a pure function of scene, model and the fields above
/// `tile_size` (I2); `tile_size`, `detail_bytes`, `batch_samples` and how rays wait trade memory for speed and do not show.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RenderSettings {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples per pixel; a single one lies in the pixel's middle. With `adaptive`, the most that a pixel gets.
    pub samples_per_pixel: u32,
    /// Where set, a pixel gets samples until its error is small enough.
    pub adaptive: Option<AdaptiveSampling>,
    /// Whether the film keeps [`PixelStatistics`](super::PixelStatistics) beside each pixel. Does not show.
    pub keep_statistics: bool,
    /// Whether the film keeps the [`PixelCost`](super::PixelCost) of each pixel. Does not show, but rays of different pixels are
    /// then not traced together, which takes longer.
    pub keep_costs: bool,
    /// How samples are spread around their pixel.
    pub filter: Filter,
    /// Key of the sample positions and of all other random numbers.
    pub seed: u64,
    /// A ray is not followed, and a lamp not asked for, if it could not add more than this to any channel of its sample:
    /// throughput times a proven bound on the radiance that can arrive. Linear, in the unit of the lights; 0 follows
    /// everything that could add anything at all.
    pub contribution_bound: f64,
    /// What becomes of rays and lamps below that bound.
    pub path_end: PathEnd,
    /// Most rays that one sample's tree may hold, shadow rays not counted. There is no limit on depth; this guards
    /// against lossless mirrors that face each other. A budget is divided among the rays that a ray spawns, so it
    /// cuts the same rays in every run, and the report says how often it did.
    pub work_budget: u64,
    /// Effects that are left out although the scene calls for them; see [`EffectOptions::switched_off`].
    pub switched_off: EffectSet,
    /// Effects that are traced although they cannot matter; see [`EffectOptions::forced`].
    pub forced: EffectSet,
    /// Side of a tile in pixels, 1 to 4096.
    pub tile_size: u32,
    /// Bytes of the memory budget that hold attributes and textures at most, if the picture needs any; more is taken only if threads
    /// need it. Does not show.
    pub detail_bytes: u64,
    /// Samples that are traced together at most; each holds up to four kilobytes in each thread.
    pub batch_samples: u32,
    /// Whether rays wait for blocks that are not resident. A matter of the process that renders: it is not serialised.
    #[serde(skip)]
    pub waiting: WaitingRays,
    /// Threads beside those of the render that load blocks while rays wait for them; with 0, each thread of the render loads for
    /// its own rays and traces nothing meanwhile. None is started where no ray waits. Not serialised.
    #[serde(skip)]
    pub loader_threads: u32,
}

impl RenderSettings {
    /// A picture of `width` by `height` pixels with one sample each.
    pub fn new(width: u32, height: u32) -> RenderSettings {
        RenderSettings {
            width,
            height,
            samples_per_pixel: 1,
            adaptive: None,
            keep_statistics: false,
            keep_costs: false,
            filter: Filter::default(),
            seed: 0,
            contribution_bound: 1e-3,
            path_end: PathEnd::Cut,
            work_budget: 1 << 14,
            switched_off: EffectSet::EMPTY,
            forced: EffectSet::EMPTY,
            tile_size: 32,
            detail_bytes: 64 << 20,
            batch_samples: 1024,
            waiting: WaitingRays::default(),
            loader_threads: 0,
        }
    }

    /// Checks every field.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for the first that makes no sense.
    pub fn validate(&self) -> Result<(), RenderError> {
        let check = |holds: bool, what: &'static str, reason: &str| {
            if holds { Ok(()) } else { Err(RenderError::Setting { what, reason: reason.to_string() }) }
        };
        const SIDE_MAX: u32 = 1 << 20;
        let sides = [self.width, self.height];
        check(
            sides.iter().all(|side| (1..=SIDE_MAX).contains(side))
                && u64::from(self.width) * u64::from(self.height) <= u64::from(u32::MAX),
            "image size",
            "each side must be between 1 and 1,048,576 pixels and the image below 2^32 pixels",
        )?;
        check(self.samples_per_pixel >= 1, "samples per pixel", "there must be at least one")?;
        if let Some(adaptive) = self.adaptive {
            let (least, most) = (adaptive.samples_min, self.samples_per_pixel);
            check(
                least.is_power_of_two(),
                "adaptive sampling",
                "the first samples of a pixel must be a power of two",
            )?;
            check(
                most.is_power_of_two() && most >= least,
                "adaptive sampling",
                "samples per pixel, the most that a pixel gets, must be a power of two and not below the first samples",
            )?;
            check(
                adaptive.error >= 0.0 && adaptive.error.is_finite(),
                "adaptive sampling",
                "the error must be finite and not negative",
            )?;
            check(
                adaptive.confidence > 0.5 && adaptive.confidence < 1.0,
                "adaptive sampling",
                "the confidence must lie above 0.5 and below 1",
            )?;
        }
        check(
            self.contribution_bound >= 0.0 && self.contribution_bound.is_finite(),
            "contribution bound",
            "it must be finite and not negative",
        )?;
        check(self.work_budget >= 1, "work budget", "a sample needs at least one ray")?;
        check((1..=4096).contains(&self.tile_size), "tile size", "it must be between 1 and 4096 pixels")?;
        check(
            (1..=1 << 20).contains(&self.batch_samples),
            "batch size",
            "it must be between 1 and 1,048,576 samples",
        )?;
        check(
            self.waiting != WaitingRays::Count(0),
            "waiting rays",
            "at least one must be allowed to wait; if none shall, say never",
        )?;
        check(self.loader_threads <= 1024, "loader threads", "there may be at most 1,024")
    }

    pub(crate) fn effect_options(&self) -> EffectOptions {
        EffectOptions {
            samples_per_pixel: self.samples_per_pixel,
            switched_off: self.switched_off,
            forced: self.forced,
        }
    }

    pub(crate) fn grid(&self) -> TileGrid {
        TileGrid { width: self.width, height: self.height, tile_size: self.tile_size }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn waiting_rays_are_read_as_they_are_written() {
        for waiting in
            [WaitingRays::Auto, WaitingRays::Never, WaitingRays::Count(0), WaitingRays::Count(4096)]
        {
            assert_eq!(waiting.to_string().parse(), Ok(waiting));
        }
        for text in ["", "Auto", "-1", "4294967296", "12 rays"] {
            assert!(text.parse::<WaitingRays>().is_err(), "{text}");
        }
    }
}
