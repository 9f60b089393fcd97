//! From a file to a scene.

use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

use super::check;
use super::document::Document;
use crate::budget::MemoryBudget;
use crate::error::{RenderError, SceneFileError};
use crate::geom::{Aabb, Affine};
use crate::instance::Instance;
use crate::render::RenderSettings;
use crate::scene::{Camera, Environment, EnvironmentImage, Finish, Light, Scene};
use crate::units::Bytes;

/// A scene as a file describes it. No other file was looked at yet.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFile {
    /// The models; at least one.
    pub models: Vec<SceneModel>,
    /// Size and quality of the picture.
    pub settings: RenderSettings,
    /// The budget of everything together, if the file says.
    pub memory: Option<Bytes>,
    /// Where the picture goes, if the file says.
    pub output: Option<PathBuf>,
    /// If the file has none: one that shows all of the model.
    pub camera: Option<Camera>,
    /// If the file says nothing about light: lights that suit the camera.
    pub(super) lighting: Option<Lighting>,
    pub(super) interreflection: bool,
    /// By material.
    pub(super) finishes: Vec<(String, Finish)>,
}

/// A model of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneModel {
    /// The model file or compiled file. A relative path is relative to the scene file.
    pub file: PathBuf,
    /// Where it stands; if empty, once and as it is.
    pub places: Vec<Place>,
}

/// Where an instance stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// From the model to the scene.
    pub map: Affine,
    /// The same when the shutter closes, if it moves.
    pub end: Option<Affine>,
}

impl SceneModel {
    /// Its places, or the one that it has as it is.
    fn places(&self) -> impl Iterator<Item = Place> + '_ {
        let as_it_is = self.places.is_empty().then_some(Place::at_rest(Affine::IDENTITY));
        as_it_is.into_iter().chain(self.places.iter().copied())
    }
}

impl Place {
    /// A place for an instance at rest.
    pub fn at_rest(map: Affine) -> Place {
        Place { map, end: None }
    }
}

/// What the file says about light.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lighting {
    pub lights: Vec<Light>,
    pub background: [f32; 3],
    pub ambient: [f32; 3],
    pub environment: Option<Surroundings>,
}

/// An environment before its picture is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Surroundings {
    Constant([f32; 3]),
    Picture { file: PathBuf, scale: f32, up: [f64; 3], front: [f64; 3] },
}

impl SceneFile {
    /// Longest file, 4 MiB.
    pub const BYTES_MAX: u64 = 4 << 20;

    /// Reads and checks a file.
    ///
    /// # Errors
    /// [`SceneFileError`].
    pub fn read(path: impl AsRef<Path>) -> Result<SceneFile, SceneFileError> {
        let path = path.as_ref();
        let io = |error| SceneFileError::Io { path: path.to_path_buf(), error };
        let mut bytes = Vec::new();
        // One more tells a file that is too long.
        File::open(path).map_err(io)?.take(SceneFile::BYTES_MAX + 1).read_to_end(&mut bytes).map_err(io)?;
        let broken =
            |reason: &str| SceneFileError::Text { path: path.to_path_buf(), reason: reason.to_string() };
        if bytes.len() as u64 > SceneFile::BYTES_MAX {
            return Err(broken("longer than 4 MiB; a scene file names geometry, it does not hold it"));
        }
        let text = String::from_utf8(bytes).map_err(|_| broken("not valid UTF-8, as TOML has to be"))?;
        SceneFile::parse(&text, path)
    }

    /// Reads and checks the text of a file at `path`, which relative paths in it are relative to.
    ///
    /// # Errors
    /// [`SceneFileError::Key`].
    pub fn parse(text: &str, path: &Path) -> Result<SceneFile, SceneFileError> {
        let text = Text { text, path };
        let document = text.document()?;
        check::check(&document, path.parent().unwrap_or(Path::new(""))).map_err(|refused| text.error(refused))
    }

    /// Where the models stand, numbered as they are; `None` for one model as it is, which needs no instances.
    pub fn instances(&self) -> Option<Vec<Instance>> {
        if let [SceneModel { places, .. }] = self.models.as_slice()
            && places.is_empty()
        {
            return None;
        }
        let mut instances = Vec::new();
        for (number, model) in (0u32..).zip(&self.models) {
            instances.extend(model.places().map(|place| Instance { model: number, map: place.map }));
        }
        Some(instances)
    }

    /// Where those of [`SceneFile::instances`] that move are when the shutter closes: for
    /// [`Instances::move_while_open`](crate::instance::Instances::move_while_open).
    pub fn movements(&self) -> Vec<(usize, Affine)> {
        let places = self.models.iter().flat_map(SceneModel::places).enumerate();
        places.filter_map(|(number, place)| Some((number, place.end?))).collect()
    }

    /// The picture of the environment, if there is one.
    pub fn environment_file(&self) -> Option<&Path> {
        match self.lighting.as_ref()?.environment.as_ref()? {
            Surroundings::Picture { file, .. } => Some(file),
            Surroundings::Constant(_) => None,
        }
    }

    /// The scene over models that fill `bounds`, in a picture of the settings' shape. Reads the picture of the environment, if there is
    /// one, into memory of `budget`; pictures that materials name are not opened ([`Textures::open`](crate::texture::Textures::open)).
    ///
    /// # Errors
    /// As for [`EnvironmentImage::read`].
    pub fn scene(&self, bounds: &Aabb, budget: &MemoryBudget) -> Result<Scene, RenderError> {
        let aspect = f64::from(self.settings.width) / f64::from(self.settings.height);
        let camera = self.camera.unwrap_or_else(|| Camera::framing(bounds, aspect));
        let mut scene = Scene::new(camera);
        match &self.lighting {
            None => scene = scene.with_automatic_lights(),
            Some(lighting) => {
                scene = scene.with_lights(lighting.lights.iter().copied());
                scene = scene.with_background(lighting.background).with_ambient(lighting.ambient);
                if let Some(surroundings) = &lighting.environment {
                    scene = scene.with_environment(surroundings.open(budget)?);
                }
            }
        }
        if self.interreflection {
            scene = scene.with_interreflection();
        }
        for (material, finish) in &self.finishes {
            scene = scene.with_finish(material.clone(), *finish);
        }
        Ok(scene)
    }
}

impl Surroundings {
    fn open(&self, budget: &MemoryBudget) -> Result<Environment, RenderError> {
        Ok(match self {
            Surroundings::Constant(radiance) => Environment::Constant(*radiance),
            Surroundings::Picture { file, scale, up, front } => {
                let image = Arc::new(EnvironmentImage::read(file, budget)?);
                Environment::Image { image, scale: *scale, up: *up, front: *front }
            }
        })
    }
}

/// A part that makes no sense.
pub(super) struct Refused {
    pub at: Range<usize>,
    pub key: String,
    pub reason: String,
}

impl Refused {
    /// About a key whose value or table is `place`.
    pub fn new<T>(place: &Spanned<T>, key: impl Into<String>, reason: impl Into<String>) -> Refused {
        Refused { at: place.span(), key: key.into(), reason: reason.into() }
    }

    /// What a room above says about the value at `place`.
    pub fn because<T>(place: &Spanned<T>, key: impl Into<String>) -> impl FnOnce(RenderError) -> Refused {
        let (at, key) = (place.span(), key.into());
        move |error| Refused { at, key, reason: error.to_string() }
    }
}

/// A text and where it stands.
struct Text<'t> {
    text: &'t str,
    path: &'t Path,
}

impl Text<'_> {
    fn document(&self) -> Result<Document, SceneFileError> {
        toml::from_str(self.text).map_err(|error| {
            let at = error.span().unwrap_or(0..0);
            let key = key_at(self.text, &at);
            self.error(Refused { at, key, reason: error.message().to_string() })
        })
    }

    fn error(&self, Refused { at, key, reason }: Refused) -> SceneFileError {
        let before = self.text.as_bytes().iter().take(at.start);
        let line = 1 + before.filter(|byte| **byte == b'\n').count() as u64;
        SceneFileError::Key { path: self.path.to_path_buf(), line, key, reason }
    }
}

/// The keys that lead to what stands at `place`, which is that of a key or of a value; nothing if there is no such place.
fn key_at(text: &str, place: &Range<usize>) -> String {
    // What is no TOML has no keys.
    let Ok(root) = DeTable::parse(text) else { return String::new() };
    let mut tables = vec![(String::new(), root.get_ref())];
    let mut arrays: Vec<(String, &DeArray<'_>)> = Vec::new();
    loop {
        let mut children = Vec::new();
        if let Some((path, table)) = tables.pop() {
            for (key, value) in table {
                let dot = if path.is_empty() { "" } else { "." };
                let child = format!("{path}{dot}{}", key.get_ref());
                if key.span() == *place {
                    return child;
                }
                children.push((child, value));
            }
        } else if let Some((path, array)) = arrays.pop() {
            for (index, value) in array.iter().enumerate() {
                children.push((format!("{path}[{index}]"), value));
            }
        } else {
            return String::new();
        }
        for (child, value) in children {
            if value.span() == *place {
                return child;
            }
            match value.get_ref() {
                DeValue::Table(table) => tables.push((child, table)),
                DeValue::Array(array) => arrays.push((child, array)),
                _ => {}
            }
        }
    }
}
