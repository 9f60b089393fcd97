//! A look at a few pixels all over the picture, before it is made: what samples tell there at every count, and what they cost.
//!
//! The samples are those that the picture will have, so what adaptive sampling would do in a probed pixel is known exactly for every
//! threshold. Pixels come in cells of four by four, so that neighbours, which it asks for contrast, are mostly probed anyway.

use glam::DVec3;

use super::adaptive::SampleBlocks;
use super::around::{Around, look_around};
use super::counters::EffectCounters;
use super::film::to_f32;
use super::paths::{self, PathTracer};
use super::query::RayQuery;
use super::stage::{PixelSample, Stage};
use super::tiles::Area;
use crate::budget::{MemoryBudget, Reservation};
use crate::compile::Control;
use crate::error::RenderError;
use crate::stats::TraceCounters;
use crate::units::Bytes;

/// Pixels across a cell.
const CELL_SIDE: u32 = 4;
/// Where doubling ends.
const SAMPLES_LAST: u32 = 1 << 31;
/// Doublings that a probe can hold: from 4 samples to 2^31.
const LEVELS_MAX: usize = 30;

/// What the samples of a pixel say at one count.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Level {
    pub samples: u32,
    pub mean: [f32; 3],
    pub half_difference: [f32; 3],
    pub deviation: f64,
    pub lost: f64,
}

/// A pixel while it is probed.
#[derive(Clone, Debug)]
pub(crate) struct ProbedPixel {
    blocks: SampleBlocks,
    pub around: Around,
    /// From the first samples on, each with twice the samples of the one before.
    pub levels: Vec<Level>,
}

impl Level {
    fn of(blocks: &SampleBlocks, contrast: DVec3) -> Level {
        Level {
            samples: blocks.samples(),
            mean: to_f32(blocks.mean()),
            half_difference: to_f32(blocks.half_difference()),
            deviation: blocks.deviation(contrast),
            lost: blocks.lost(),
        }
    }
}

impl ProbedPixel {
    fn record(&mut self) {
        self.levels.push(Level::of(&self.blocks, self.around.contrast));
    }

    /// The level at which adaptive sampling stops, as far as the pixel was probed.
    pub fn stop(&self, deviation: f64, samples_max: u32) -> usize {
        // The probe's construction recorded the first.
        let last = self.levels.len() - 1;
        let is_enough = |level: &Level| level.deviation <= deviation || level.samples >= samples_max;
        self.levels.iter().position(is_enough).unwrap_or(last)
    }

    /// Whether [`ProbedPixel::stop`] is known, and a level behind it, which shows how good it was.
    fn is_probed(&self, deviation: f64, samples_max: u32) -> bool {
        let stop = self.stop(deviation, samples_max);
        let level = &self.levels[stop];
        (level.deviation <= deviation || level.samples >= samples_max)
            && (stop + 1 < self.levels.len() || level.samples >= SAMPLES_LAST)
    }

    fn samples(&self) -> u32 {
        self.blocks.samples()
    }
}

/// A square of pixels and what its rays cost.
#[derive(Clone, Debug)]
pub(crate) struct ProbedCell {
    pub area: Area,
    /// Row by row.
    pub pixels: Vec<ProbedPixel>,
    pub samples: u64,
    /// Rays of all kinds that the samples took.
    pub rays: u64,
}

/// Cells all over the picture, and how many samples they have so far.
pub(crate) struct Probe<'s, Q> {
    stage: &'s Stage,
    paths: PathTracer<'s, Q>,
    pub cells: Vec<ProbedCell>,
    /// Cells across.
    pub columns: usize,
    _reservation: Reservation,
}

impl<'s, Q: RayQuery> Probe<'s, Q> {
    /// Takes the first `samples_min` samples of about `pixel_count` pixels; `None` if `stop` said so.
    pub fn new(
        stage: &'s Stage,
        query: Q,
        pixel_count: u32,
        samples_min: u32,
        budget: &MemoryBudget,
        stop: &mut dyn FnMut() -> Control,
    ) -> Result<Option<Probe<'s, Q>>, RenderError> {
        let areas = areas(stage, pixel_count);
        let columns = areas.iter().take_while(|area| area.y == areas[0].y).count();
        let reservation =
            budget.reserve(Probe::<Q>::bytes_needed(stage, pixel_count), "the probe of the picture")?;
        let paths = PathTracer::new(stage, query);
        let mut probe = Probe {
            stage,
            paths,
            cells: Vec::with_capacity(areas.len()),
            columns,
            _reservation: reservation,
        };
        for area in areas {
            if stop() == Control::Cancel {
                return Ok(None);
            }
            let cell = probe.first_samples(area, samples_min)?;
            probe.cells.push(cell);
        }
        Ok(Some(probe))
    }

    /// What [`Probe::new`] takes from the budget.
    pub fn bytes_needed(stage: &Stage, pixel_count: u32) -> Bytes {
        Bytes((paths::bytes_needed(stage) + areas(stage, pixel_count).len() * cell_bytes()) as u64)
    }

    /// Rays by effect so far.
    pub fn effects(&self) -> EffectCounters {
        self.paths.counters
    }

    /// Work of the queries so far.
    pub fn queries(&self) -> TraceCounters {
        self.paths.query.counters()
    }

    /// Doubles the samples of every pixel until its deviation is at most `deviation` or it has `samples_max`, and once more: what
    /// adaptive sampling would not take shows how good its choice was. False if `stop` said so before the end.
    pub fn refine(
        &mut self,
        deviation: f64,
        samples_max: u32,
        stop: &mut dyn FnMut() -> Control,
    ) -> Result<bool, RenderError> {
        for index in 0..self.cells.len() {
            if stop() == Control::Cancel {
                return Ok(false);
            }
            loop {
                let cell = &self.cells[index];
                let open: Vec<usize> = (0..cell.pixels.len())
                    .filter(|&pixel| !cell.pixels[pixel].is_probed(deviation, samples_max))
                    .collect();
                // The pixels of a cell go on together by count: those with the fewest samples first.
                let Some(samples) = open.iter().map(|&pixel| cell.pixels[pixel].samples()).min() else {
                    break;
                };
                let active: Vec<usize> =
                    open.into_iter().filter(|&pixel| cell.pixels[pixel].samples() == samples).collect();
                self.double(index, &active, samples)?;
            }
        }
        Ok(true)
    }

    fn first_samples(&mut self, area: Area, samples_min: u32) -> Result<ProbedCell, RenderError> {
        let ground = self.stage.grid.surroundings(&area);
        let mut blocks = vec![SampleBlocks::EMPTY; ground.width as usize * ground.height as usize];
        let places: Vec<[u32; 2]> = (0..ground.height)
            .flat_map(|y| (0..ground.width).map(move |x| [ground.x + x, ground.y + y]))
            .collect();
        let rays = self.trace(&places, 0, samples_min, |place, radiance, lost| {
            blocks[place].add(radiance, lost);
        })?;
        let size = [ground.width as usize, ground.height as usize];
        let first = |x: usize, y: usize| blocks[y * size[0] + x].first_samples();
        let mut pixels = Vec::with_capacity(area.width as usize * area.height as usize);
        for y in area.y - ground.y..area.y - ground.y + area.height {
            for x in area.x - ground.x..area.x - ground.x + area.width {
                let at = [x as usize, y as usize];
                let (place, around) = (at[1] * size[0] + at[0], look_around(size, at, first));
                let mut pixel = ProbedPixel { blocks: blocks[place], around, levels: Vec::new() };
                pixel.record();
                pixels.push(pixel);
            }
        }
        Ok(ProbedCell { area, pixels, samples: places.len() as u64 * u64::from(samples_min), rays })
    }

    /// Takes as many samples again of some pixels of a cell, which have `samples` each.
    fn double(&mut self, index: usize, active: &[usize], samples: u32) -> Result<(), RenderError> {
        let mut cell = std::mem::replace(
            &mut self.cells[index],
            ProbedCell {
                area: Area { x: 0, y: 0, width: 0, height: 0 },
                pixels: Vec::new(),
                samples: 0,
                rays: 0,
            },
        );
        let area = cell.area;
        let places: Vec<[u32; 2]> = active
            .iter()
            .map(|&pixel| [area.x + pixel as u32 % area.width, area.y + pixel as u32 / area.width])
            .collect();
        let pixels = &mut cell.pixels;
        let rays = self.trace(&places, samples, samples, |place, radiance, lost| {
            pixels[active[place]].blocks.add(radiance, lost);
        });
        cell.rays += rays?;
        cell.samples += places.len() as u64 * u64::from(samples);
        active.iter().for_each(|&pixel| cell.pixels[pixel].record());
        self.cells[index] = cell;
        Ok(())
    }

    /// Traces samples `first .. first + count` of each place and gives them away in order; returns how many rays it took.
    fn trace(
        &mut self,
        places: &[[u32; 2]],
        first: u32,
        count: u32,
        mut add: impl FnMut(usize, DVec3, f64),
    ) -> Result<u64, RenderError> {
        let before = self.paths.counters.rays();
        let total = places.len() * count as usize;
        let mut start = 0;
        while start < total {
            let end = total.min(start + self.paths.batch_samples);
            let rays = (start..end).map(|index| {
                let [x, y] = places[index / count as usize];
                PixelSample { x, y, number: first + (index % count as usize) as u32 }
            });
            self.paths.trace(rays)?;
            for (index, (radiance, lost)) in
                (start..end).zip(self.paths.radiance().iter().zip(self.paths.lost()))
            {
                add(index / count as usize, *radiance, *lost);
            }
            start = end;
        }
        Ok(self.paths.counters.rays() - before)
    }
}

/// Cells in rows and columns over the whole picture, together about `pixel_count` pixels, or every pixel if it has no more.
fn areas(stage: &Stage, pixel_count: u32) -> Vec<Area> {
    let sides = [stage.settings.width, stage.settings.height];
    let pixels = f64::from(sides[0]) * f64::from(sides[1]);
    let spacing = (pixels / f64::from(pixel_count.max(1))).sqrt().max(1.0) * f64::from(CELL_SIDE);
    let starts = sides.map(|side| {
        let count = (f64::from(side) / spacing).ceil().max(1.0) as u32;
        let step = f64::from(side) / f64::from(count);
        let start = |index: u32| {
            // In the middle of its step, whole and inside.
            let middle = (f64::from(index) + 0.5) * step - 0.5 * f64::from(CELL_SIDE);
            (middle.round().max(0.0) as u32).min(side.saturating_sub(CELL_SIDE))
        };
        let mut starts: Vec<u32> = (0..count).map(start).collect();
        starts.dedup();
        starts
    });
    let [width, height] = sides.map(|side| side.min(CELL_SIDE));
    starts[1].iter().flat_map(|&y| starts[0].iter().map(move |&x| Area { x, y, width, height })).collect()
}

/// What a cell takes at most.
fn cell_bytes() -> usize {
    let pixels = (CELL_SIDE * CELL_SIDE) as usize;
    size_of::<ProbedCell>()
        + pixels * (size_of::<ProbedPixel>() + LEVELS_MAX.next_power_of_two() * size_of::<Level>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::RenderSettings;
    use crate::scene::{Camera, EffectOptions, EffectPlan, Scene};

    #[test]
    fn cells_lie_all_over_the_picture_and_inside() {
        for (width, height, count) in
            [(256, 256, 4096), (640, 480, 4096), (3, 2, 4096), (17, 1000, 200), (8, 8, 64), (5, 5, 64)]
        {
            let camera = Camera::orthographic([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 1.0).unwrap();
            let scene = Scene::new(camera);
            let plan = EffectPlan::of_materials(&scene, [], &EffectOptions::default());
            let stage = Stage::new(&scene, &[], &plan, &RenderSettings::new(width, height));
            let areas = areas(&stage, count);
            let pixels: u32 = areas.iter().map(|area| area.width * area.height).sum();
            assert!(
                pixels <= 3 * count.max(32) && 4 * pixels >= count.min(width * height),
                "{pixels} of {count}"
            );
            assert!(areas.iter().all(|area| area.x + area.width <= width && area.y + area.height <= height));
        }
    }
}
