//! Light from all around: constant, or a picture of the surroundings, sampled by importance.

#[cfg(feature = "exr")]
mod exr;
mod hdr;
mod image;
mod surroundings;
mod table;

pub use image::EnvironmentImage;
pub use surroundings::Environment;
pub(crate) use surroundings::EnvironmentEmitter;
