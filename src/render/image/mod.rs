//! Picture files: PNG (8 bit, sRGB), OpenEXR (32-bit float, linear) and PFM (the same, uncompressed).

#[cfg(feature = "exr")]
mod exr;
#[cfg(feature = "exr")]
mod exr_layers;
mod pfm;
#[cfg(feature = "png")]
mod png;
mod publish;
#[cfg(feature = "png")]
mod srgb;

use std::path::Path;

use super::{Film, Layers};
use crate::error::RenderError;

/// A kind of picture file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageFormat {
    /// 8 bits per channel, sRGB (feature `png`).
    Png,
    /// OpenEXR, 32-bit float, linear (feature `exr`).
    Exr,
    /// Portable float map, linear.
    Pfm,
}

impl ImageFormat {
    /// The format that the extension of `path` names, in any case of letters. Ask before a long render.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if it names none, or one that this build leaves out.
    pub fn of_path(path: impl AsRef<Path>) -> Result<ImageFormat, RenderError> {
        let path = path.as_ref();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("");
        let error = |reason: String| Err(RenderError::Setting { what: "image file", reason });
        match extension.to_ascii_lowercase().as_str() {
            "png" if cfg!(feature = "png") => Ok(ImageFormat::Png),
            "exr" if cfg!(feature = "exr") => Ok(ImageFormat::Exr),
            "pfm" => Ok(ImageFormat::Pfm),
            known @ ("png" | "exr") => {
                error(format!("{}: build with the feature `{known}` to write it", path.display()))
            }
            _ => error(format!("{}: the name must end in .png, .exr or .pfm", path.display())),
        }
    }
}

/// Writes `film` to `path`; see [`Film::write`].
pub(super) fn write(film: &Film, path: &Path) -> Result<(), RenderError> {
    let format = ImageFormat::of_path(path)?;
    publish::atomically(path, |file| match format {
        #[cfg(feature = "png")]
        ImageFormat::Png => png::encode(film, file),
        #[cfg(feature = "exr")]
        ImageFormat::Exr => exr::encode(film, file),
        ImageFormat::Pfm => pfm::encode(film, file),
        // `of_path` does not give formats that the build leaves out.
        #[allow(unreachable_patterns)]
        _ => Err(std::io::ErrorKind::Unsupported.into()),
    })
    .map_err(|error| RenderError::Write { path: path.to_path_buf(), error })
}

/// Writes `film` with `layers` to `path`; see [`Layers::write`].
pub(super) fn write_layers(film: &Film, layers: &Layers, path: &Path) -> Result<(), RenderError> {
    if ImageFormat::of_path(path)? != ImageFormat::Exr {
        let reason = format!("{}: layers need a name that ends in .exr", path.display());
        return Err(RenderError::Setting { what: "image file", reason });
    }
    publish::atomically(path, |file| {
        #[cfg(feature = "exr")]
        let result = exr_layers::encode(film, layers, file);
        // `of_path` does not give a format that the build leaves out.
        #[cfg(not(feature = "exr"))]
        let result = {
            let _ = (film, layers, file);
            Err(std::io::ErrorKind::Unsupported.into())
        };
        result
    })
    .map_err(|error| RenderError::Write { path: path.to_path_buf(), error })
}

#[cfg(test)]
mod tests;
