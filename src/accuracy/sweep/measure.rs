//! One picture, measured.

use std::time::Instant;

use crate::LazyOctree;
use crate::accuracy::run::with_certificate;
use crate::accuracy::{Certificate, GoalProgress, Knobs, Metric, Sampling, render_with_knobs};
use crate::budget::MemoryBudget;
use crate::compile::{Control, Threads};
use crate::error::RenderError;
use crate::geom::Ray;
use crate::render::{EffectCounters, Film, RenderSettings};
use crate::scene::Scene;
use crate::stats::TraceCounters;
use crate::units::TriangleId;

/// A model as it is open, and what is to be seen of it.
#[derive(Clone, Copy)]
pub struct Subject<'a> {
    /// The model; its tier is the one that is measured.
    pub octree: &'a LazyOctree,
    /// What is pictured.
    pub scene: &'a Scene,
    /// Size, filter and seed; the rest is set by knobs.
    pub settings: &'a RenderSettings,
    /// Where the memory comes from.
    pub budget: &'a MemoryBudget,
    /// Threads that render.
    pub threads: &'a Threads,
}

/// What pictures are held against.
#[derive(Debug)]
pub struct Reference {
    /// The picture.
    pub film: Film,
    /// What is seen in the middle of each pixel.
    pub triangles: Vec<Option<TriangleId>>,
    /// What is known about its own error. Differences below it mean nothing.
    pub certificate: Certificate,
}

/// A picture that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Measurement {
    /// Which knob was turned.
    pub knob: String,
    /// To what.
    pub value: String,
    /// Errors against the reference, in the order of [`Metric::ALL`].
    pub errors: [f64; 3],
    /// Errors against the picture in which this knob alone is at its best, with the same samples: what is due to the knob. Zero where
    /// no such picture was given.
    pub isolated: [f64; 3],
    /// Pixels whose middle shows another triangle than in the reference, or one where there is none.
    pub wrong_triangles: u64,
    /// Pixels whose middle shows a triangle in the reference and none here.
    pub leaks: u64,
    /// Cost in seconds (processor time where the system tells it), one per repetition.
    pub seconds: Vec<f64>,
    /// Rays and samples.
    pub effects: EffectCounters,
    /// Work of the queries of the last repetition.
    pub trace: TraceCounters,
}

impl Measurement {
    /// The error against the reference in a metric.
    pub fn error(&self, metric: Metric) -> f64 {
        // The enum's order is that of `ALL`.
        self.errors[metric as usize]
    }

    /// Median of the costs; 0 if there is none.
    pub fn seconds_median(&self) -> f64 {
        let mut sorted = self.seconds.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
    }

    /// Lowest and highest cost.
    pub fn seconds_range(&self) -> [f64; 2] {
        let low = self.seconds.iter().copied().fold(f64::INFINITY, f64::min);
        [if low.is_finite() { low } else { 0.0 }, self.seconds.iter().copied().fold(0.0, f64::max)]
    }
}

impl Subject<'_> {
    /// Knobs of this subject with fixed samples.
    pub fn fixed(&self, samples: u32, contribution_bound: f64) -> Knobs {
        Knobs {
            tier: self.octree.tier(),
            contribution_bound,
            work_budget: self.settings.work_budget,
            sampling: Sampling::Fixed { samples },
            tile_size: self.settings.tile_size,
        }
    }

    /// Makes the reference: `samples` samples per pixel and `contribution_bound`, keyed apart from the pictures that are measured.
    ///
    /// # Errors
    /// As for [`render_with_knobs`]; [`RenderError::Cancelled`] if `progress` said so.
    pub fn reference(
        &self,
        samples: u32,
        contribution_bound: f64,
        progress: &mut (dyn FnMut(GoalProgress) -> Control + Send),
    ) -> Result<Reference, RenderError> {
        let settings = RenderSettings {
            samples_per_pixel: samples,
            contribution_bound,
            // Any other key: with the same one, the first samples would be those of the pictures.
            seed: self.settings.seed ^ 0x5eed_7ea1,
            ..*self.settings
        };
        let goal = with_certificate(self.octree, self.scene, &settings, self.threads, self.budget, progress)?;
        let film = goal.image.into_complete()?;
        Ok(Reference { film, triangles: self.triangles()?, certificate: goal.certificate })
    }

    /// What is seen in the middle of each pixel.
    ///
    /// # Errors
    /// [`RenderError::Trace`] if a block cannot be brought in.
    pub fn triangles(&self) -> Result<Vec<Option<TriangleId>>, RenderError> {
        let RenderSettings { width, height, .. } = *self.settings;
        let view = self.scene.camera().view(width, height);
        let mut tracer = self.octree.tracer()?;
        let mut triangles = Vec::with_capacity(width as usize * height as usize);
        let (mut rays, mut hits): (Vec<Ray>, Vec<_>) = (Vec::new(), vec![None; width as usize]);
        for y in 0..height {
            rays.clear();
            rays.extend((0..width).map(|x| view.ray(f64::from(x) + 0.5, f64::from(y) + 0.5)));
            tracer.closest_hits(&rays, &mut hits)?;
            triangles.extend(hits.iter().map(|hit| hit.map(|hit| hit.triangle)));
        }
        Ok(triangles)
    }

    /// Makes the picture of `knobs` `repetitions` times (at least once) and measures it. `base` is the picture in which the knob is at its
    /// best.
    ///
    /// # Errors
    /// As for [`render_with_knobs`]; [`RenderError::Cancelled`] if `progress` said so.
    pub fn measure(
        &self,
        [knob, value]: [&str; 2],
        knobs: &Knobs,
        reference: &Reference,
        base: Option<&Film>,
        repetitions: u32,
        progress: &mut (dyn FnMut() -> Control + Send),
    ) -> Result<(Measurement, Film), RenderError> {
        let mut seconds = Vec::new();
        let image = loop {
            let start = Instant::now();
            let before = processor_seconds(start);
            let image = render_with_knobs(
                self.octree,
                self.scene,
                self.settings,
                knobs,
                self.threads,
                self.budget,
                &mut |_| progress(),
            )?;
            seconds.push(processor_seconds(start) - before);
            if seconds.len() >= repetitions as usize {
                break image;
            }
        };
        let (effects, trace) = (image.report.effects, image.report.trace);
        let film = image.into_complete()?;
        let distances =
            |to: &Film| Metric::ALL.map(|metric| metric.distance(to.pixels(), film.pixels(), film.width()));
        let (mut wrong_triangles, mut leaks) = (0, 0);
        for (found, expected) in self.triangles()?.iter().zip(&reference.triangles) {
            let is_leak = found.is_none() && expected.is_some();
            leaks += u64::from(is_leak);
            wrong_triangles += u64::from(found != expected && !is_leak);
        }
        let measurement = Measurement {
            knob: knob.to_string(),
            value: value.to_string(),
            errors: distances(&reference.film),
            isolated: base.map_or([0.0; 3], distances),
            wrong_triangles,
            leaks,
            seconds,
            effects,
            trace,
        };
        Ok((measurement, film))
    }
}

/// Processor time of this process in seconds, all threads together; by the clock, since `start`, on systems that do not tell.
pub fn processor_seconds(start: Instant) -> f64 {
    #[cfg(unix)]
    {
        let _ = start;
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    {
        start.elapsed().as_secs_f64()
    }
}

impl std::fmt::Debug for Subject<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Subject").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measurements_have_medians() {
        let measurement = Measurement {
            knob: String::new(),
            value: String::new(),
            errors: [0.1, 0.2, 0.3],
            isolated: [0.0; 3],
            wrong_triangles: 0,
            leaks: 0,
            seconds: vec![3.0, 1.0, 2.0],
            effects: EffectCounters::default(),
            trace: TraceCounters::default(),
        };
        assert_eq!((measurement.seconds_median(), measurement.seconds_range()), (2.0, [1.0, 3.0]));
        assert_eq!(Metric::ALL.map(|metric| measurement.error(metric)), [0.1, 0.2, 0.3]);
    }
}
