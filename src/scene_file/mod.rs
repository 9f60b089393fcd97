//! Scenes described in TOML files: which model, seen and lit how, and how the picture is made. Feature `scene-file`.
//!
//! `docs/scene-file.md` has every key. A file is untrusted (I5): its length is bounded, an unknown key is an error, and every error
//! names file, line and key.
//!
//! # Example
//! ```
//! # let folder = tempfile::tempdir()?;
//! # let path = folder.path().join("scene.toml");
//! # let text = r#"
//! [[model]]
//! file = "ball.ply"
//!
//! [camera]
//! eye = [0, 1, 5]
//! look_at = [0, 0, 0]
//!
//! [[light.sphere]]
//! center = [2, 3, 4]
//! radius = 0.5
//! radiance = [20, 20, 18]
//!
//! [settings]
//! size = [320, 240]
//! samples = 16
//! # "#;
//! # std::fs::write(&path, text)?;
//! use outcrop::scene_file::SceneFile;
//!
//! let file = SceneFile::read(&path)?;
//! assert_eq!(file.models[0].file, folder.path().join("ball.ply"));
//! assert_eq!(file.settings.width, 320);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "scene-file")]
mod check;
#[cfg(feature = "scene-file")]
mod document;
#[cfg(feature = "scene-file")]
mod read;

#[cfg(feature = "scene-file")]
pub use read::{Place, SceneFile, SceneModel};
