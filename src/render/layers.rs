//! What lies behind each pixel, beside its colour: depth, normal, triangle, material, albedo. For denoisers, compositing and
//! picking.

use std::path::Path;

use glam::DVec3;

use super::counters::EffectCounters;
use super::detail::query::SurfaceQuery;
use super::detail::{Cone, Detail, Seen};
use super::film::Film;
use super::image;
use super::progress::Progress;
use super::query::RayQuery;
use super::stage::{Loop, Stage};
use crate::budget::{MemoryBudget, Reservation};
use crate::compile::Control;
use crate::error::{RenderError, TraceError};
use crate::geom::Ray;
use crate::trace::Hit;
use crate::units::{Bytes, MaterialId, TriangleId};

/// What the ray through the middle of a pixel meets first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerPixel {
    /// Distance from the eye (from the image plane of an orthographic camera) along the ray.
    pub depth: f32,
    /// The triangle's unit normal on the side that is seen; zero for a triangle without area.
    pub normal: [f32; 3],
    /// The triangle.
    pub triangle: TriangleId,
    /// Its material.
    pub material: MaterialId,
    /// Diffuse and mirror reflectance together, pictures on the surface included, at most 1: what a denoiser divides by.
    pub albedo: [f32; 3],
}

/// One [`LayerPixel`] for each pixel, rows from the top; none where nothing is hit. Through the middle of each pixel and of the
/// lens, when the shutter opens: a pure function of scene, model and image size. Drawn from the memory budget until
/// dropped.
#[derive(Debug)]
pub struct Layers {
    width: u32,
    height: u32,
    pixels: Vec<Option<LayerPixel>>,
    _reservation: Reservation,
}

impl Layers {
    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row by row from the top.
    pub fn pixels(&self) -> &[Option<LayerPixel>] {
        &self.pixels
    }

    /// Writes `film` and these layers as one OpenEXR file (feature `exr`): channels `R G B`, `Z` (infinite where nothing is hit),
    /// `N.X N.Y N.Z`, `albedo.R albedo.G albedo.B`, and as 32-bit integers `triangle.low`, `triangle.high` and `material`, each
    /// with all bits set where nothing is hit. A film with [`PixelStatistics`](super::PixelStatistics) adds `samples`, as 32-bit
    /// integers, and `deviation`; one with [`PixelCost`](super::PixelCost) adds `cost.boxes` and `cost.triangles`, as 32-bit
    /// integers. The file appears under its name only when it is whole.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the film has another size, or `path` does not end in `.exr`, or the build lacks the
    /// feature; [`RenderError::Write`] if the file cannot be written.
    pub fn write(&self, film: &Film, path: impl AsRef<Path>) -> Result<(), RenderError> {
        if (film.width(), film.height()) != (self.width, self.height) {
            let reason = format!(
                "the film has {} x {} pixels, the layers {} x {}",
                film.width(),
                film.height(),
                self.width,
                self.height
            );
            return Err(RenderError::Setting { what: "layers", reason });
        }
        image::write_layers(film, self, path.as_ref())
    }

    /// What the layers of an image of so many pixels take from the budget while they are made. An octree opened without a limit
    /// takes all that is left for its cache, so reserve this before, and drop that reservation before
    /// [`Renderer::layers`](super::Renderer::layers).
    pub fn bytes_needed(width: u32, height: u32) -> Bytes {
        Bytes(Layers::own_bytes(width, height).0 + row_bytes(width).0)
    }

    /// What they take for as long as they live.
    fn own_bytes(width: u32, height: u32) -> Bytes {
        /// Channels of 32 bits that a file is written from.
        const WRITTEN_BYTES: u64 = 17 * 4;
        let count = u64::from(width) * u64::from(height);
        Bytes(count * (size_of::<Option<LayerPixel>>() as u64 + WRITTEN_BYTES))
    }
}

/// What the rays of a row and their hits take.
fn row_bytes(width: u32) -> Bytes {
    Bytes(u64::from(width) * (size_of::<Ray>() + size_of::<Option<Hit>>()) as u64)
}

/// Traces one ray per pixel, row by row.
pub(super) fn layers(
    stage: &Stage,
    budget: &MemoryBudget,
    query: impl RayQuery,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<Layers, RenderError> {
    let mut query = SurfaceQuery::new(stage, query);
    let (width, height) = (stage.grid.width, stage.grid.height);
    let reservation = budget.reserve(Layers::own_bytes(width, height), "the layers")?;
    let _row = budget.reserve(row_bytes(width), "a row of the layers")?;
    let mut pixels = Vec::with_capacity(width as usize * height as usize);
    let mut rays = Vec::with_capacity(width as usize);
    let mut hits = vec![None; width as usize];
    for y in 0..height {
        rays.clear();
        rays.extend((0..width).map(|x| stage.view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)));
        query.closest_hits(&rays, &mut hits)?;
        for (ray, hit) in rays.iter().zip(&hits) {
            pixels.push(match hit {
                Some(hit) => Some(layer_pixel(stage, &mut query, ray, hit)?),
                None => None,
            });
        }
        let state = Progress {
            samples: u64::from(y + 1) * u64::from(width),
            samples_total: u64::from(height) * u64::from(width),
            tiles: y + 1,
            tiles_total: height,
        };
        if progress(state) == Control::Cancel {
            return Err(RenderError::Cancelled);
        }
    }
    Ok(Layers { width, height, pixels, _reservation: reservation })
}

/// What is at a hit.
fn layer_pixel<Q: RayQuery>(
    stage: &Stage,
    query: &mut SurfaceQuery<'_, Q>,
    ray: &Ray,
    hit: &Hit,
) -> Result<LayerPixel, TraceError> {
    let direction = DVec3::from_array(ray.direction);
    let normal = DVec3::from_array(hit.normal()).normalize_or_zero();
    let is_behind = normal.dot(direction) > 0.0;
    let normal = normal * if is_behind { -1.0 } else { 1.0 };
    let shader = stage.shader(hit.material);
    let mut albedo = shader.diffuse + shader.mirror;
    if stage.path_loop == Loop::Detailed {
        let [width, spread] = stage.view.footprint();
        let width = Cone { width, spread }.width_at(hit.t);
        let seen = Seen { geometric: normal, is_behind, view: -direction, width };
        let mut counters = EffectCounters::default();
        if let Some(local) = Detail::at(stage, query, &mut counters, hit, shader, &seen)?.shader {
            albedo = local.diffuse + local.mirror;
        }
    }
    Ok(LayerPixel {
        depth: hit.t as f32,
        normal: normal.to_array().map(|x| x as f32),
        triangle: hit.triangle,
        material: hit.material,
        albedo: albedo.min(DVec3::ONE).to_array().map(|x| x as f32),
    })
}
