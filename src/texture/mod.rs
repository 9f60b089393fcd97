//! Pictures on surfaces, larger than memory: image files become tiles of a pyramid of ever smaller pictures, tiles come into cache slots
//! when a hit is shaded with them.
//!
//! [`Textures`] is the pictures that a model's materials name, converted once to one file of tiles (`convert`, in the memory of a few rows
//! of tiles: PNG files of any size; JPEG files, feature `jpeg`, are decoded as a whole) or made in memory. [`TextureCache`] holds tiles in
//! slots of the [`cache`](crate::cache) room, under the same budget as everything else (I1). [`TextureReader`] looks up: filtered
//! linearly in the picture and between two of its sizes.
//!
//! Colours are decoded from sRGB to linear before anything is averaged; other pictures (alpha, heights, normals) are taken as they are.

mod cache;
#[cfg_attr(not(any(feature = "png", feature = "jpeg")), allow(dead_code, reason = "no decoder calls it"))]
mod convert;
#[cfg_attr(not(any(feature = "png", feature = "jpeg")), allow(dead_code, reason = "no decoder calls it"))]
mod decode;
mod file;
mod layout;
mod part;
#[cfg_attr(not(any(feature = "png", feature = "jpeg")), allow(dead_code, reason = "no decoder calls it"))]
mod pyramid;
mod srgb;
#[cfg(test)]
mod tests;

pub use cache::{Address, TextureCache, TextureReader};
pub use file::{PixelImage, Textures};
pub use layout::{Encoding, ImageKey, TILE_SIDE, TextureId};
