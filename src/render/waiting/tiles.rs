//! Tiles of which samples are on their way.

use std::collections::VecDeque;

use glam::DVec3;

use crate::render::stage::{PixelSample, Stage};
use crate::render::tile_samples::{FinishedTile, TileSamples};
use crate::render::tiles::Area;
use crate::units::TileId;

/// A tile to be rendered.
#[derive(Clone, Copy)]
pub(in crate::render) struct OpenedTile {
    pub id: TileId,
    /// What it is told by when it is finished.
    pub cell: u32,
    /// Its pixels: at most a tile of the settings.
    pub area: Area,
    /// Its error threshold, if it is not that of the settings.
    pub threshold: Option<f64>,
}

/// Gives the next tile, until there is none.
pub(in crate::render) type NextTile<'f> = dyn FnMut() -> Option<OpenedTile> + 'f;

/// A tile, and the samples of its round.
struct Job {
    tile: OpenedTile,
    samples: TileSamples,
    /// So many have begun, and so many, in order, have been added to their pixels.
    begun: u64,
    added: u64,
    /// Samples that are done while one before them is not: by their index, modulo its length.
    done: Vec<Option<(DVec3, f64)>>,
}

/// See the module's text.
pub(super) struct Tiles {
    jobs: Vec<Job>,
    jobs_max: usize,
    /// In the order in which they were opened.
    open: VecDeque<u32>,
    free: Vec<u32>,
    /// Samples of a tile that may be on their way or done out of order.
    window: usize,
    finished: FinishedTile,
}

/// What came of a sample that is done.
#[derive(Default)]
pub(super) struct Delivered {
    /// Samples of the picture that are done with it.
    pub samples: u64,
    /// What its tile is told by, if that is finished with it.
    pub finished_cell: Option<u32>,
}

impl Tiles {
    pub fn new(jobs_max: usize, window: usize) -> Tiles {
        Tiles {
            jobs: Vec::with_capacity(jobs_max),
            jobs_max,
            open: VecDeque::with_capacity(jobs_max),
            free: Vec::with_capacity(jobs_max),
            window,
            finished: FinishedTile::default(),
        }
    }

    /// What [`Tiles::new`] and all that follows allocate.
    pub fn bytes_needed(stage: &Stage, jobs_max: usize, window: usize) -> usize {
        let one = size_of::<Job>()
            + 2 * size_of::<u32>()
            + window * size_of::<Option<(DVec3, f64)>>()
            + TileSamples::bytes_needed(stage);
        jobs_max * one + FinishedTile::bytes_needed(stage)
    }

    /// The tile that was opened first of those that are not finished.
    pub fn first_open(&self) -> Option<TileId> {
        self.open.front().map(|job| self.jobs[*job as usize].tile.id)
    }

    /// The next sample to begin, as tile and index; opens another tile if those that are open have none.
    pub fn next(&mut self, stage: &Stage, next_tile: &mut NextTile<'_>) -> Option<(u32, u64)> {
        let window = self.window as u64;
        loop {
            for place in &self.open {
                let job = &mut self.jobs[*place as usize];
                if job.begun < job.samples.round_total().min(job.added + window) {
                    job.begun += 1;
                    return Some((*place, job.begun - 1));
                }
            }
            if self.open.len() == self.jobs_max {
                return None;
            }
            let tile = next_tile()?;
            let place = self.free.pop().unwrap_or_else(|| {
                self.jobs.push(Job {
                    tile,
                    samples: TileSamples::default(),
                    begun: 0,
                    added: 0,
                    done: vec![None; self.window],
                });
                self.jobs.len() as u32 - 1
            });
            let job = &mut self.jobs[place as usize];
            job.tile = tile;
            job.samples.begin(stage, tile.area, tile.threshold);
            (job.begun, job.added) = (0, 0);
            self.open.push_back(place);
        }
    }

    /// What is known of a sample before it begins.
    pub fn sample(&self, tile: u32, index: u64) -> PixelSample {
        self.jobs[tile as usize].samples.sample(index)
    }

    /// Takes in a sample that is done.
    pub fn deliver(&mut self, stage: &Stage, tile: u32, index: u64, result: (DVec3, f64)) -> Delivered {
        let mut delivered = Delivered::default();
        let job = &mut self.jobs[tile as usize];
        let window = self.window as u64;
        job.done[(index % window) as usize] = Some(result);
        while let Some((radiance, lost)) = job.done[(job.added % window) as usize].take() {
            delivered.samples += job.samples.add(job.added, &[radiance], &[lost]);
            job.added += 1;
        }
        if job.added < job.samples.round_total() {
            return delivered;
        }
        (job.begun, job.added) = (0, 0);
        if !job.samples.next_round(stage, job.tile.threshold) {
            // Samples that need not be taken are as good as done.
            delivered.samples += job.samples.finish(stage, &mut self.finished);
            delivered.finished_cell = Some(job.tile.cell);
            self.open.retain(|open| *open != tile);
            self.free.push(tile);
        }
        delivered
    }

    /// The tile that was finished last.
    pub fn finished(&self) -> &FinishedTile {
        &self.finished
    }
}
