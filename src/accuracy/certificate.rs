//! What is known about a finished picture.

use std::fmt;

use super::{Estimate, Goal, Knobs, Metric, MissedFeatures, SamplingCheck};
use crate::geom::{Aabb, Precision};
use crate::model::Model;
use crate::octree::Tier;
use crate::render::{EffectCounters, RenderSettings};
use crate::scene::{Camera, Projection};
use crate::stats::TraceCounters;

/// What a picture is worth: what is proven, apart from what is estimated, and what it took.
#[derive(Clone, Debug, PartialEq)]
pub struct Certificate {
    /// What was asked for.
    pub goal: Goal,
    /// Whether it was reached.
    pub verdict: Verdict,
    /// Proven: where things are and what is in front of what.
    pub geometry: GeometryBounds,
    /// Proven: light that was not followed. In expectation only, with effects that are sampled; see [`CutOffBounds`].
    pub cut_off: CutOffBounds,
    /// Estimated: the error of finitely many samples, in each metric that was asked for (see
    /// [`GoalOptions::every_metric`](super::GoalOptions::every_metric)). Empty if a
    /// pixel has a single sample, which says nothing about itself, or the picture is not whole.
    pub estimates: Vec<Estimate>,
    /// What some pixels that were sampled again show of the picture's error, where samples had a say in how many there are. None where
    /// sampling is not adaptive, and where there are no estimates.
    pub check: Option<SamplingCheck>,
    /// Estimated: what pixels have missed that others have met. None where there are no estimates.
    pub missed: Option<MissedFeatures>,
    /// Confidence of each upper estimate.
    pub confidence: f64,
    /// Samples per pixel, on average.
    pub samples_mean: f64,
    /// Everything that was chosen; makes the same picture again.
    pub knobs: Knobs,
    /// Everything that was done to choose and to render, pictures that missed the goal included.
    pub counters: GoalCounters,
    /// How long it took, by the clock.
    pub seconds: GoalSeconds,
}

/// Whether a goal was reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// It was.
    Met,
    /// It was not; the picture is the best that was made.
    NotMet {
        /// Why.
        reason: String,
    },
    /// The caller cancelled while the picture was made.
    Cancelled,
}

/// How certain geometry is. Not in units of light: how a shifted edge shows depends on what lies behind it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeometryBounds {
    /// How the compiled file holds positions.
    pub precision: Precision,
    /// Largest distance per axis between a vertex of the source and the one that is traced. If the caller did not say, it follows from
    /// `precision`: half a step of a lattice; for f32, which keeps f32 sources bit for bit, what rounding a source in f64 or text
    /// can have done at most.
    pub vertex: f64,
    /// By how many pixels that can shift a vertex in the picture, seen directly. None if geometry reaches the camera's plane.
    pub vertex_pixels: Option<f64>,
    /// Whether which triangle is hit first is decided exactly: no leak, no lost hit, ties by the lowest id.
    pub is_visibility_exact: bool,
    /// Largest relative error of a hit's distance; none for tiers without a proof.
    pub t_relative: Option<f64>,
}

/// Light that was not followed because it could not matter enough, or because a sample's work budget was spent. Against ray trees of at
/// most [`RenderSettings::work_budget`] rays in which nothing is cut, with the samples that the picture has.
///
/// With effects that are sampled (area lights, environment light, rough mirrors and glass, interreflection) the bounds hold in
/// expectation only. The proof is about the mean of what a ray brings back, and one ray may by chance bring more: the mean over
/// all luck of what pictures lack is at most the mean of their bounds, but a single picture can lack more than its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CutOffBounds {
    /// What it adds to the root mean square error, at most.
    pub rmse: f64,
    /// What any channel of any pixel lacks, at most.
    pub max: f64,
    /// Whether the picture has effects that are sampled, so that both hold in expectation only.
    pub in_expectation: bool,
}

impl CutOffBounds {
    /// The bound in a metric; none for FLIP.
    pub fn of(&self, metric: Metric) -> Option<f64> {
        match metric {
            Metric::Rmse => Some(self.rmse),
            Metric::Max => Some(self.max),
            Metric::Flip => None,
        }
    }
}

/// Exact counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GoalCounters {
    /// Rays and samples by effect.
    pub effects: EffectCounters,
    /// Work of the queries.
    pub trace: TraceCounters,
    /// Pictures made.
    pub attempts: u32,
}

/// Seconds by the clock.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GoalSeconds {
    /// Choosing the knobs.
    pub choosing: f64,
    /// Rendering, all pictures together.
    pub rendering: f64,
    /// Sampling some pixels again and estimating errors, of all pictures.
    pub checking: f64,
    /// Everything.
    pub total: f64,
}

impl Certificate {
    /// What was estimated in a metric, if it was.
    pub fn estimate(&self, metric: Metric) -> Option<&Estimate> {
        self.estimates.iter().find(|estimate| estimate.metric == metric)
    }

    /// What is known of the whole error in a metric, proven and estimated parts together; None if there is no estimate.
    pub fn error_bound(&self, metric: Metric) -> Option<f64> {
        Some(self.estimate(metric)?.whole)
    }
}

impl GeometryBounds {
    /// What follows from the compiled file, the tier, and where the camera stands.
    pub(super) fn of(
        model: &Model,
        tier: Tier,
        camera: &Camera,
        settings: &RenderSettings,
        vertex_error: Option<f64>,
    ) -> GeometryBounds {
        let reach =
            model.bounds.min.iter().chain(&model.bounds.max).fold(0.0f64, |reach, x| reach.max(x.abs()));
        let vertex = vertex_error.unwrap_or(match model.precision {
            Precision::Lattice(lattice) => lattice.error_bound(),
            // Half a unit in the last place of 24 bits.
            Precision::Float32 => reach * 2f64.powi(-24),
        });
        let is_certain = matches!(tier, Tier::Certified | Tier::Exact);
        GeometryBounds {
            precision: model.precision,
            vertex,
            vertex_pixels: shift_in_pixels(&model.bounds, camera, settings, vertex),
            is_visibility_exact: is_certain,
            // docs/numerics.md, "Ray parameter".
            t_relative: is_certain.then_some(2f64.powi(-40)),
        }
    }
}

/// How far, in pixels, moving a point inside `bounds` by up to `shift` along each axis can move its image within the picture.
fn shift_in_pixels(bounds: &Aabb, camera: &Camera, settings: &RenderSettings, shift: f64) -> Option<f64> {
    // The length of the move.
    let length = 3f64.sqrt() * shift;
    let height = f64::from(settings.height);
    match camera.projection() {
        Projection::Orthographic { height: units } => Some(length * height / units),
        Projection::Pinhole { fov_degrees } => {
            let (eye, [_, _, forward]) = (camera.eye(), camera.frame());
            let depth = (0..8).fold(f64::INFINITY, |depth, corner| {
                let along = (0..3).map(|axis| {
                    let at = [bounds.min, bounds.max][corner >> axis & 1][axis];
                    (at - eye[axis]) * forward[axis]
                });
                depth.min(along.sum::<f64>())
            });
            let left = depth - length;
            // At image position p (at unit distance) a point at depth z moves by (across + |p| along) / (z - along).
            let tan = libm::tan(0.5 * fov_degrees.to_radians());
            let aspect = f64::from(settings.width) / height;
            let corner = tan * (1.0 + aspect * aspect).sqrt();
            (left > 0.0).then(|| length * (1.0 + corner) / left * (0.5 * height / tan))
        }
    }
}

impl fmt::Display for Certificate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.verdict {
            Verdict::Met => writeln!(f, "goal met")?,
            Verdict::NotMet { reason } => writeln!(f, "goal not met: {reason}")?,
            Verdict::Cancelled => writeln!(f, "cancelled")?,
        }
        let geometry = &self.geometry;
        write!(f, "proven: vertices within {:.2e} of the source", geometry.vertex)?;
        match geometry.vertex_pixels {
            Some(pixels) => writeln!(f, ", {pixels:.2e} pixels")?,
            None => writeln!(f)?,
        }
        match geometry.t_relative {
            Some(t) => {
                writeln!(f, "proven: every hit decided exactly, its distance within {t:.1e} of itself")?
            }
            None => writeln!(f, "not proven: hits of this tier have no bound")?,
        }
        let CutOffBounds { rmse, max, in_expectation } = self.cut_off;
        let how = if in_expectation { "proven in expectation" } else { "proven" };
        writeln!(f, "{how}: light cut off adds at most {rmse:.2e} RMSE, {max:.2e} in any pixel")?;
        if self.estimates.is_empty() {
            writeln!(f, "no estimate of the error of sampling")?;
        }
        for Estimate { metric, value, upper, whole } in &self.estimates {
            let percent = 100.0 * self.confidence;
            let name = metric.name();
            write!(f, "estimated: {name} {value:.2e}, below {upper:.2e} with {percent} %")?;
            match metric {
                Metric::Flip => writeln!(f, ", what was cut off included")?,
                _ => writeln!(f, "; with what was cut off below {whole:.2e}")?,
            }
        }
        if let Some(SamplingCheck { pixels, samples, bias }) = self.check {
            write!(f, "checked: {pixels} pixels with {samples} further samples, which show ")?;
            if bias.is_finite() {
                writeln!(f, "{bias:.2} times the error that the picture's own do")?;
            } else {
                writeln!(f, "an error of which the picture's own say nothing")?;
            }
        }
        if let Some(MissedFeatures { met, missed, rmse }) = self.missed.filter(|found| found.met > 0) {
            writeln!(
                f,
                "estimated: {met} pixels met a feature by one sample, {missed:.0} others have missed one, which makes {rmse:.2e} RMSE of it"
            )?;
        }
        write!(
            f,
            "{:.1} samples per pixel, {} rays, {:.2} s to choose, {:.2} s to render, {:.2} s to check",
            self.samples_mean,
            self.counters.effects.rays(),
            self.seconds.choosing,
            self.seconds.rendering,
            self.seconds.checking
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shifted_corner_stays_within_the_pixels_said() {
        let bounds = Aabb { min: [-1.0, -2.0, -1.5], max: [1.0, 1.0, 0.5] };
        let settings = RenderSettings::new(300, 200);
        let near = Camera::pinhole([0.5, 0.5, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 60.0).unwrap();
        let parallel = Camera::orthographic([0.5, 0.5, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 5.0).unwrap();
        for camera in [near, parallel] {
            for shift in [1e-9, 1e-3, 0.1] {
                let said = shift_in_pixels(&bounds, &camera, &settings, shift).unwrap();
                let mut most = 0.0f64;
                for corner in 0..8 {
                    let at = |sign: f64| {
                        [0, 1, 2]
                            .map(|axis| [bounds.min, bounds.max][corner >> axis & 1][axis] + sign * shift)
                    };
                    let [a, b] = [project(&camera, &settings, at(0.0)), project(&camera, &settings, at(1.0))];
                    let c = project(&camera, &settings, at(-1.0));
                    let distance =
                        |p: [f64; 2], q: [f64; 2]| ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)).sqrt();
                    most = most.max(distance(a, b)).max(distance(a, c));
                }
                assert!(most <= said * (1.0 + 1e-6) && said < 10.0 * most, "{most} against {said}");
            }
        }
        let inside = Camera::pinhole([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0], 60.0).unwrap();
        assert_eq!(shift_in_pixels(&bounds, &inside, &settings, 1e-9), None);
    }

    fn project(camera: &Camera, settings: &RenderSettings, at: [f64; 3]) -> [f64; 2] {
        let eye = camera.eye();
        let [x, y, z] = camera.frame().map(|axis| (0..3).map(|i| axis[i] * (at[i] - eye[i])).sum::<f64>());
        let half = 0.5 * f64::from(settings.height);
        match camera.projection() {
            Projection::Orthographic { height } => [x, y].map(|x| x * 2.0 * half / height),
            Projection::Pinhole { fov_degrees } => {
                let tan = (0.5 * fov_degrees.to_radians()).tan();
                [x, y].map(|x| x / z / tan * half)
            }
        }
    }
}
