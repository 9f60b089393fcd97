//! From scene and octree to a picture: shading, sampling, tiles, film, image files.
//!
//! [`Renderer`] puts it together. The picture is a pure function of scene, model and settings (I2): samples are keyed
//! by pixel and number, every sample adds up its light in the order of its own ray tree, and work budgets are divided,
//! not shared. An effect that the [`EffectPlan`](crate::scene::EffectPlan) leaves out makes no ray (I6). An error
//! in a query ends the render; there is never a hole in a picture that was returned as complete.
//!
//! # Example
//! The whole of a compiled model, with a camera and lights that suit it:
//! ```no_run
//! use std::path::Path;
//! use std::sync::Arc;
//!
//! use outcrop::octree::OctreeOptions;
//! use outcrop::render::{Control, RenderSettings, Renderer, Threads};
//! use outcrop::scene::Scene;
//! use outcrop::source::DiskSource;
//! use outcrop::units::Bytes;
//! use outcrop::{BlockSource, LazyOctree, MemoryBudget};
//!
//! let budget = MemoryBudget::new(Bytes::mib(256));
//! let source = Arc::new(DiskSource::open("statue.outcrop")?);
//! let settings = RenderSettings::new(640, 480);
//! let scene = Scene::automatic(&source.model().bounds, 640.0 / 480.0);
//! let threads = Threads::Count(4);
//!
//! // The octree's cache takes what is left of the budget, so the picture's share is set aside first.
//! let picture_bytes = Renderer::bytes_needed(&scene, source.model(), &settings, &threads)?;
//! let set_aside = budget.reserve(picture_bytes, "the picture")?;
//! let options = OctreeOptions { tracers_max: 4, ..OctreeOptions::default() };
//! let octree = LazyOctree::open(source, &budget, options)?;
//! drop(set_aside);
//!
//! let renderer = Renderer::new(&octree, &scene, &settings, &budget)?;
//! println!("{}", renderer.plan().explain());
//! let image = renderer.render(&threads, &mut |_| Control::Continue)?;
//! image.into_complete()?.write(Path::new("statue.png"))?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod absorption;
pub(crate) mod adaptive;
mod area_lights;
pub(crate) mod around;
mod begin;
mod bound;
mod children;
mod counters;
mod detail;
mod direct;
pub(crate) mod draft;
mod emission;
mod environment;
mod facets;
mod film;
mod follow;
mod frosted;
mod geometry;
mod ggx;
mod glossy;
mod hot;
mod image;
mod interreflection;
mod json;
mod layers;
mod light_samples;
mod media;
mod mirror;
mod path_sizes;
mod paths;
pub(crate) mod probe;
mod progress;
mod query;
mod random;
mod refraction;
mod region;
mod renderer;
mod report;
pub(crate) mod resample;
mod response;
mod sampling;
mod settings;
mod shade;
mod shadows;
mod stage;
mod tile_samples;
pub(crate) mod tiles;
mod waiting;
mod walk;
mod ways;
mod workers;

pub use crate::compile::{Control, Threads};
pub use adaptive::AdaptiveSampling;
pub(crate) use adaptive::{normal_quantile, student_widening, unseen_variance};
pub use counters::EffectCounters;
pub use film::{Film, PixelCost, PixelStatistics};
pub(crate) use film::{Kept, to_f32};
pub use image::ImageFormat;
pub use layers::{LayerPixel, Layers};
pub use progress::Progress;
pub(crate) use query::SceneTracer;
pub(crate) use region::Canvas;
pub use region::{Region, RegionCounters, RegionRenderer, Regions};
pub use renderer::{RenderedImage, Renderer};
pub use report::{Outcome, RenderReport, WaitingReport, WorkerSeconds};
pub use sampling::Filter;
pub(crate) use sampling::mix;
pub use settings::{ParseWaitingRaysError, PathEnd, RenderSettings, WaitingRays};
pub(crate) use stage::SECOND_SET;
pub(crate) use tiles::TileGrid;
pub(crate) use workers::worker_count;

#[cfg(test)]
mod tests;
