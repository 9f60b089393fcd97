//! Further samples of some pixels of a finished picture: means that had no say in where sampling stopped.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use glam::DVec3;
use parking_lot::Mutex;

use super::counters::EffectCounters;
use super::paths::PathTracer;
use super::query::RayQuery;
use super::stage::{PixelSample, Stage};
use super::workers::on_threads;
use crate::compile::{Control, Threads};
use crate::error::{RenderError, TraceError};
use crate::stats::TraceCounters;

/// A pixel and which samples of it are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SampledPixel {
    pub x: u32,
    pub y: u32,
    /// Number of the first, and how many they are.
    pub first: u32,
    pub samples: u32,
}

/// What the further samples say.
#[derive(Clone, Debug, Default)]
pub(crate) struct Resampled {
    /// Mean of the samples; in the order of the pixels.
    pub means: Vec<DVec3>,
    /// The most that these means may lack, beside them.
    pub lost: Vec<f64>,
    pub effects: EffectCounters,
    pub trace: TraceCounters,
}

/// What the threads share.
struct Shared<'a> {
    stage: &'a Stage,
    pixels: &'a [SampledPixel],
    /// Where groups of pixels that are traced together begin, and where the last one ends.
    groups: &'a [usize],
    next: AtomicUsize,
    is_stopped: AtomicBool,
    resampled: Mutex<Resampled>,
    stop: Mutex<&'a mut (dyn FnMut() -> Control + Send)>,
    error: Mutex<Option<RenderError>>,
}

/// The samples that are asked for of each pixel; `None` if `stop` said so. The means do not depend on threads and batches (I2).
///
/// # Errors
/// One of those that occurred before the threads stopped.
pub(crate) fn resample<Q: RayQuery>(
    stage: &Stage,
    pixels: &[SampledPixel],
    threads: &Threads,
    make_query: &(dyn Fn() -> Result<Q, TraceError> + Sync),
    stop: &mut (dyn FnMut() -> Control + Send),
) -> Result<Option<Resampled>, RenderError> {
    // A closure of its own ends the callback's lifetime with the shared state's.
    let mut stop = || stop();
    let groups = groups(pixels, stage.settings.batch_samples);
    let shared = Shared {
        stage,
        pixels,
        groups: &groups,
        next: AtomicUsize::new(0),
        is_stopped: AtomicBool::new(false),
        resampled: Mutex::new(Resampled {
            means: vec![DVec3::ZERO; pixels.len()],
            lost: vec![0.0; pixels.len()],
            ..Resampled::default()
        }),
        stop: Mutex::new(&mut stop),
        error: Mutex::new(None),
    };
    on_threads(threads, &|| {
        if let Err(error) = shared.work(make_query) {
            shared.is_stopped.store(true, Ordering::Relaxed);
            shared.error.lock().get_or_insert(error);
        }
    });
    if let Some(error) = shared.error.into_inner() {
        return Err(error);
    }
    Ok((!shared.is_stopped.into_inner()).then(|| shared.resampled.into_inner()))
}

/// What [`resample`] takes beside each thread's ray trees.
pub(crate) fn bytes_needed(pixels: usize) -> usize {
    pixels * (size_of::<SampledPixel>() + size_of::<DVec3>() + size_of::<f64>() + size_of::<usize>())
}

/// Runs of pixels whose samples fill a batch.
fn groups(pixels: &[SampledPixel], batch_samples: u32) -> Vec<usize> {
    let (mut groups, mut samples) = (vec![0], 0u64);
    for (index, pixel) in pixels.iter().enumerate() {
        samples += u64::from(pixel.samples);
        if samples >= u64::from(batch_samples) || index + 1 == pixels.len() {
            groups.push(index + 1);
            samples = 0;
        }
    }
    groups
}

impl Shared<'_> {
    fn work<Q: RayQuery>(
        &self,
        make_query: &(dyn Fn() -> Result<Q, TraceError> + Sync),
    ) -> Result<(), RenderError> {
        let mut paths = PathTracer::new(self.stage, make_query()?);
        let (mut sums, mut batch) = (Vec::new(), Vec::new());
        while !self.is_stopped.load(Ordering::Relaxed) {
            let group = self.next.fetch_add(1, Ordering::Relaxed);
            let Some(&[start, end]) = self.groups.get(group..group + 2) else { break };
            let pixels = &self.pixels[start..end];
            sums.clear();
            sums.resize(pixels.len(), (DVec3::ZERO, 0.0));
            let mut samples = pixels
                .iter()
                .enumerate()
                .flat_map(|(index, pixel)| (0..pixel.samples).map(move |sample| (index, sample)));
            loop {
                batch.clear();
                batch.extend(samples.by_ref().take(paths.batch_samples));
                if batch.is_empty() {
                    break;
                }
                paths.trace(batch.iter().map(|&(index, sample)| {
                    let SampledPixel { x, y, first, .. } = pixels[index];
                    PixelSample { x, y, number: first + sample }
                }))?;
                let found = paths.radiance().iter().zip(paths.lost());
                for (&(index, _), (radiance, lost)) in batch.iter().zip(found) {
                    sums[index].0 += *radiance;
                    sums[index].1 += *lost;
                }
                self.ask();
            }
            let mut resampled = self.resampled.lock();
            for (index, ((sum, lost), pixel)) in (start..end).zip(sums.iter().zip(pixels)) {
                resampled.means[index] = *sum / f64::from(pixel.samples);
                resampled.lost[index] = lost / f64::from(pixel.samples);
            }
        }
        let mut resampled = self.resampled.lock();
        resampled.effects.merge(&paths.counters);
        resampled.trace.merge(&paths.query.counters());
        Ok(())
    }

    /// Asks the caller whether to go on, unless another thread is just doing that.
    fn ask(&self) {
        let Some(mut stop) = self.stop.try_lock() else { return };
        if stop() == Control::Cancel {
            self.is_stopped.store(true, Ordering::Relaxed);
        }
    }
}
