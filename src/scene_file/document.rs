//! The file's tables and keys, as they are written. A key that is not here is an error.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Deserialize;
use toml::Spanned;

use crate::render::{Filter, PathEnd};

/// Everything.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Document {
    pub background: Option<Spanned<[f32; 3]>>,
    pub ambient: Option<Spanned<[f32; 3]>>,
    #[serde(default)]
    pub interreflection: bool,
    #[serde(default)]
    pub model: Vec<Spanned<ModelTable>>,
    pub camera: Option<Spanned<CameraTable>>,
    #[serde(default)]
    pub light: LightTables,
    pub environment: Option<Spanned<EnvironmentTable>>,
    #[serde(default)]
    pub finish: BTreeMap<String, Spanned<FinishTable>>,
    pub settings: Option<Spanned<SettingsTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ModelTable {
    pub file: PathBuf,
    #[serde(default)]
    pub place: Vec<Spanned<PlaceTable>>,
}

/// Scaled, then turned, then moved; or by a matrix.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlaceTable {
    pub scale: Option<Scale>,
    #[serde(default)]
    pub rotate: Vec<RotateTable>,
    pub translate: Option<[f64; 3]>,
    pub matrix: Option<[[f64; 4]; 3]>,
    /// Where it is when the shutter closes: a place without a shutter of its own.
    pub shutter: Option<Box<Spanned<PlaceTable>>>,
}

#[derive(Debug, Deserialize)]
#[serde(untagged, expecting = "a number, or three")]
pub(super) enum Scale {
    All(f64),
    Each([f64; 3]),
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RotateTable {
    pub axis: [f64; 3],
    pub degrees: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraTable {
    pub eye: [f64; 3],
    pub look_at: [f64; 3],
    pub up: Option<[f64; 3]>,
    pub fov_degrees: Option<f64>,
    pub orthographic_height: Option<f64>,
    pub lens: Option<Spanned<LensTable>>,
    pub shutter: Option<Spanned<ShutterTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct LensTable {
    pub radius: f64,
    pub focus_distance: f64,
}

/// Where the camera is when the shutter closes; what is left out is as when it opened.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShutterTable {
    pub eye: Option<[f64; 3]>,
    pub look_at: Option<[f64; 3]>,
    pub up: Option<[f64; 3]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct LightTables {
    pub point: Vec<Spanned<PointTable>>,
    pub directional: Vec<Spanned<DirectionalTable>>,
    pub spot: Vec<Spanned<SpotTable>>,
    pub rectangle: Vec<Spanned<RectangleTable>>,
    pub disc: Vec<Spanned<DiscTable>>,
    pub sphere: Vec<Spanned<SphereTable>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PointTable {
    pub position: [f64; 3],
    pub intensity: [f32; 3],
    pub radius: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DirectionalTable {
    pub direction: [f64; 3],
    pub intensity: [f32; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SpotTable {
    pub position: [f64; 3],
    pub direction: [f64; 3],
    pub intensity: [f32; 3],
    pub radius: Option<f64>,
    pub inner_degrees: f64,
    pub outer_degrees: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RectangleTable {
    pub corner: [f64; 3],
    pub edges: [[f64; 3]; 2],
    pub radiance: [f32; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DiscTable {
    pub center: [f64; 3],
    pub normal: [f64; 3],
    pub radius: f64,
    pub radiance: [f32; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SphereTable {
    pub center: [f64; 3],
    pub radius: f64,
    pub radiance: [f32; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EnvironmentTable {
    pub radiance: Option<[f32; 3]>,
    pub file: Option<PathBuf>,
    pub scale: Option<f32>,
    pub up: Option<[f64; 3]>,
    pub front: Option<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct FinishTable {
    pub roughness: Option<f32>,
    pub priority: Option<u8>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SettingsTable {
    pub size: Option<[u32; 2]>,
    pub samples: Option<u32>,
    pub adaptive: Option<AdaptiveTable>,
    pub filter: Option<FilterName>,
    pub seed: Option<u64>,
    pub contribution_bound: Option<f64>,
    pub path_end: Option<PathEndName>,
    pub work_budget: Option<u64>,
    pub memory: Option<Spanned<String>>,
    pub output: Option<Spanned<PathBuf>>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AdaptiveTable {
    pub samples_min: u32,
    pub error: f64,
    pub confidence: f64,
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum FilterName {
    Box,
    Tent,
    Gaussian,
}

impl From<FilterName> for Filter {
    fn from(name: FilterName) -> Filter {
        match name {
            FilterName::Box => Filter::Box,
            FilterName::Tent => Filter::Tent,
            FilterName::Gaussian => Filter::Gaussian,
        }
    }
}

#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum PathEndName {
    Cut,
    Roulette,
}

impl From<PathEndName> for PathEnd {
    fn from(name: PathEndName) -> PathEnd {
        match name {
            PathEndName::Cut => PathEnd::Cut,
            PathEndName::Roulette => PathEnd::Roulette,
        }
    }
}
