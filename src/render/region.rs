//! A rectangle of the picture by itself: what a worker of a cluster renders.

use std::sync::atomic::{AtomicBool, Ordering};

use super::counters::EffectCounters;
use super::film::Film;
use super::geometry::Surfaces;
use super::paths;
use super::query::SceneTracer;
use super::renderer::{Renderer, set};
use super::settings::RenderSettings;
use super::stage::Stage;
use super::tiles::{Area, TileGrid};
use super::workers::{Watch, Worker, tile_bytes};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, RenderError};
use crate::model::Model;
use crate::scene::Scene;
use crate::stats::TraceCounters;
use crate::units::Bytes;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Region {
    /// Left-most column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

impl Region {
    /// How many pixels it holds.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height)
    }
}

/// Renders one region after the other, on one thread. Made by [`Renderer::regions`]. A pixel is the same, bit for bit, whatever
/// regions the picture is cut into and whoever renders them (I2).
pub struct RegionRenderer<'r> {
    worker: Worker<'r, Flag<'r>, SceneTracer<'r>>,
    width: u32,
    height: u32,
    side_max: u32,
    _scratch: Reservation,
}

/// The caller's wish to stop.
struct Flag<'r>(&'r AtomicBool);

impl Watch for Flag<'_> {
    fn is_stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn add_samples(&self, _count: u64) {}

    fn report(&self) {}
}

impl Renderer<'_> {
    /// What [`Renderer::regions`] takes from the budget for each thread. An octree opened without a limit takes all that is left for
    /// its cache, so reserve this before, and drop that reservation after.
    ///
    /// # Errors
    /// As for [`Renderer::new`].
    pub fn region_bytes(
        scene: &Scene,
        model: &Model,
        settings: &RenderSettings,
    ) -> Result<Bytes, RenderError> {
        let (stage, _) = set(scene, &Surfaces::from(model), settings)?;
        // Caches are shared by all threads; a part of each thread's own is as much or more.
        let details = Renderer::detail_bytes(scene, model, settings, 1)?;
        Ok(Bytes(scratch_bytes(&stage).0 + details.0))
    }

    /// A renderer of regions for the calling thread. Regions may have at most the settings' `tile_size` pixels a side. While
    /// `stop` is set, rendering ends soon and gives nothing.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if its scratch does not fit, [`RenderError::Trace`] if the octree gives no more tracers.
    pub fn regions<'r>(&'r self, stop: &'r AtomicBool) -> Result<RegionRenderer<'r>, RenderError> {
        let scratch = self.budget.reserve(scratch_bytes(&self.stage), "a region's ray trees and pixels")?;
        let settings = &self.stage.settings;
        Ok(RegionRenderer {
            worker: Worker::new(Flag(stop), &self.stage, self.query()?),
            width: settings.width,
            height: settings.height,
            side_max: settings.tile_size,
            _scratch: scratch,
        })
    }
}

fn scratch_bytes(stage: &Stage) -> Bytes {
    Bytes((paths::bytes_needed(stage) + tile_bytes(stage)) as u64)
}

impl RegionRenderer<'_> {
    /// The pixels of `region`, row by row, in linear RGB; `None` if it was stopped.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a region that is empty, too large or not inside the picture; [`RenderError::Trace`] if a block cannot
    /// be brought in.
    pub fn render(&mut self, region: Region) -> Result<Option<&[[f32; 3]]>, RenderError> {
        let Region { x, y, width, height } = region;
        let is_inside =
            |start: u32, length: u32, end| start.checked_add(length).is_some_and(|sum| sum <= end);
        let sides = 1..=self.side_max;
        if !(is_inside(x, width, self.width)
            && is_inside(y, height, self.height)
            && sides.contains(&width)
            && sides.contains(&height))
        {
            return Err(RenderError::Setting {
                what: "region",
                reason: format!("{region:?} is empty, has a side of more than a tile, or leaves the picture"),
            });
        }
        match self.worker.render_area_to(Area { x, y, width, height }, None) {
            Ok(true) => Ok(Some(&self.worker.finished().pixels)),
            Ok(false) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Rays by effect, and work of the queries, since this renderer was made.
    pub fn counters(&self) -> (EffectCounters, TraceCounters) {
        (self.worker.effects(), self.worker.trace())
    }
}

/// A picture that is put together from regions, in any order. Drawn from the memory budget until dropped.
pub(crate) struct Canvas {
    film: Film,
    /// One cell for each pixel, so that any region is some cells.
    grid: TileGrid,
}

impl Canvas {
    /// A black picture with no pixel finished.
    pub fn new(width: u32, height: u32, budget: &MemoryBudget) -> Result<Canvas, BudgetError> {
        let grid = TileGrid { width, height, tile_size: 1 };
        Ok(Canvas { film: Film::new(&grid, budget)?, grid })
    }

    /// Takes over the pixels of `region`, which must lie in the picture, row by row.
    pub fn set(&mut self, region: Region, pixels: &[[f32; 3]]) {
        for (row, pixels) in pixels.chunks_exact(region.width as usize).enumerate() {
            // A row of the region, which has fewer than 2^32 pixels.
            let start = (region.y + row as u32) * self.grid.width + region.x;
            for (cell, pixel) in (start..).zip(pixels) {
                self.film.set_tile(&self.grid, cell, std::slice::from_ref(pixel));
            }
        }
    }

    pub fn film(&self) -> &Film {
        &self.film
    }

    pub fn into_film(self) -> Film {
        self.film
    }
}

impl std::fmt::Debug for RegionRenderer<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RegionRenderer").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Bytes;

    #[test]
    fn a_canvas_is_finished_when_its_regions_are() {
        let budget = MemoryBudget::new(Bytes::mib(1));
        let mut canvas = Canvas::new(5, 3, &budget).unwrap();
        canvas.set(Region { x: 0, y: 0, width: 5, height: 2 }, &[[1.0; 3]; 10]);
        assert!(!canvas.film().is_complete() && canvas.film().is_finished(4, 1));
        assert!(!canvas.film().is_finished(0, 2));
        canvas.set(Region { x: 1, y: 2, width: 4, height: 1 }, &[[2.0; 3]; 4]);
        canvas.set(Region { x: 0, y: 2, width: 1, height: 1 }, &[[3.0; 3]; 1]);
        let film = canvas.into_film();
        assert!(film.is_complete());
        assert_eq!([film.pixel(0, 2), film.pixel(4, 2), film.pixel(4, 1)], [[3.0; 3], [2.0; 3], [1.0; 3]]);
    }
}
