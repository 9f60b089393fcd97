//! A rectangle of the picture by itself: what a worker of a cluster renders.

use std::sync::atomic::{AtomicBool, Ordering};

use super::counters::EffectCounters;
use super::renderer::Renderer;
use super::tiles::Area;
use super::workers::{Watch, Worker, tile_bytes};
use super::paths;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::RenderError;
use crate::stats::TraceCounters;
use crate::trace::Tracer;
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
    worker: Worker<'r, Flag<'r>, Tracer<'r>>,
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
    /// What [`Renderer::regions`] takes from the budget for each thread.
    pub fn region_bytes(&self) -> Bytes {
        Bytes((paths::bytes_needed(&self.stage) + tile_bytes(&self.stage)) as u64)
    }

    /// A renderer of regions for the calling thread. Regions may have at most the settings' `tile_size` pixels a side. While
    /// `stop` is set, rendering ends soon and gives nothing.
    ///
    /// # Errors
    /// [`RenderError::Budget`] if its scratch does not fit, [`RenderError::Trace`] if the octree gives no more tracers.
    pub fn regions<'r>(&'r self, stop: &'r AtomicBool) -> Result<RegionRenderer<'r>, RenderError> {
        let scratch = MemoryBudget::reserve(&self.budget, self.region_bytes(), "a region's ray trees and pixels")?;
        let settings = &self.stage.settings;
        Ok(RegionRenderer {
            worker: Worker::new(Flag(stop), &self.stage, self.octree.tracer()?),
            width: settings.width,
            height: settings.height,
            side_max: settings.tile_size,
            _scratch: scratch,
        })
    }
}

impl RegionRenderer<'_> {
    /// The pixels of `region`, row by row, in linear RGB; `None` if it was stopped.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a region that is empty, too large or not inside the picture; [`RenderError::Trace`] if a block cannot
    /// be brought in.
    pub fn render(&mut self, region: Region) -> Result<Option<&[[f32; 3]]>, RenderError> {
        let Region { x, y, width, height } = region;
        let is_inside = |start: u32, length: u32, end| start.checked_add(length).is_some_and(|sum| sum <= end);
        let sides = 1..=self.side_max;
        if !(is_inside(x, width, self.width) && is_inside(y, height, self.height))
            || !(sides.contains(&width) && sides.contains(&height))
        {
            return Err(RenderError::Setting {
                what: "region",
                reason: format!("{region:?} is empty, has a side of more than a tile, or leaves the picture"),
            });
        }
        match self.worker.render_area(Area { x, y, width, height }) {
            Ok(true) => Ok(Some(self.worker.finished())),
            Ok(false) => Ok(None),
            Err(error) => Err(error.into()),
        }
    }

    /// Rays by effect, and work of the queries, since this renderer was made.
    pub fn counters(&self) -> (EffectCounters, TraceCounters) {
        (self.worker.effects(), self.worker.trace())
    }
}
