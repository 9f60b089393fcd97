//! From scene and octree to a picture: shading, sampling, tiles, film, image files.
//!
//! The picture is a pure function of scene, model and settings (I2): samples are keyed
//! by pixel and number, every sample adds up its light in the order of its own ray tree, and work budgets are divided,
//! not shared. An effect that the [`EffectPlan`](crate::scene::EffectPlan) leaves out makes no ray (I6). An error
//! in a query ends the render; there is never a hole in a picture that was returned as complete.

mod control;
mod counters;
mod film;
mod image;
mod json;
mod optics;
mod report;
mod sampling;
mod settings;
mod tiles;

pub use control::{Control, Progress, Threads};
pub use counters::EffectCounters;
pub use film::Film;
pub use image::ImageFormat;
pub use report::{Outcome, RenderReport, WorkerSeconds};
pub use sampling::Filter;
pub use settings::RenderSettings;
