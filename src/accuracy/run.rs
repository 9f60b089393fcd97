//! From a goal to a picture and its certificate.

use std::rc::Rc;
use std::time::{Duration, Instant};

use glam::DVec3;

use super::certificate::{Certificate, CutOffBounds, GeometryBounds, GoalSeconds, Verdict};
use super::check::{self, SamplingCheck};
use super::estimate::{MeanSquare, Pixels, Sampled, cut_off, estimate};
use super::job::{FIRST_SAMPLES, GoalProgressFn, Job, PIXEL_CONFIDENCE, PROBE_PIXELS, ask};
use super::time::{self, Steering};
use super::unseen::{self, MissedFeatures, Unseen};
use super::{Goal, GoalOptions, GoalProgress, Knobs, Metric, Sampling};
use crate::LazyOctree;
use crate::budget::MemoryBudget;
use crate::compile::{Control, Threads};
use crate::error::RenderError;
use crate::model::Model;
use crate::octree::Tier;
use crate::render::adaptive::SampleBlocks;
use crate::render::draft::Draft;
use crate::render::resample::SampledPixel;
use crate::render::{
    AdaptiveSampling, Film, Kept, Outcome, Progress, RenderSettings, RenderedImage, Renderer,
    normal_quantile, resample, worker_count,
};
use crate::scene::{EffectPlan, Scene};
use crate::units::{Bytes, TileId};

/// Tiles for a time goal: each is about the error of the time.
const STEERED_TILES_MIN: usize = 200;
/// Part of a time goal that may go into choosing.
const CHOOSING_SHARE: f64 = 0.1;

/// A picture made to a goal.
#[derive(Debug)]
pub struct GoalImage {
    /// The picture, with statistics, and what making it took.
    pub image: RenderedImage,
    /// What it is worth.
    pub certificate: Certificate,
}

/// Makes a picture to the goal of `options`, with size, filter, seed, effects and tile size of `settings`; an error goal sets
/// contribution bound and samples, a time goal samples and, for small pictures, smaller tiles, and [`Goal::Exact`] the contribution
/// bound.
///
/// If the goal cannot be met, the best picture comes back and its certificate says why it is not met. The clock has a say
/// only in time goals; all that it chose stands in the knobs.
///
/// `progress` is called now and then, also while the knobs are chosen; [`Control::Cancel`] then ends with
/// [`RenderError::Cancelled`], and later with the tiles that are finished.
///
/// # Errors
/// As for [`Renderer::new`] and [`Renderer::render`]; [`RenderError::Setting`] for options that make no sense.
pub fn render_to_goal(
    octree: &LazyOctree,
    scene: &Scene,
    settings: &RenderSettings,
    options: &GoalOptions,
    threads: &Threads,
    budget: &MemoryBudget,
    progress: &mut (dyn FnMut(GoalProgress) -> Control + Send),
) -> Result<GoalImage, RenderError> {
    options.validate()?;
    settings.validate()?;
    let _reserved = budget.reserve(own_bytes(settings, options), "the choice of accuracy")?;
    let mut progress = for_good(progress);
    let mut job = Job::new(octree, scene, settings, options, threads, budget, &mut progress);
    match options.goal {
        Goal::Exact => job.exact(),
        Goal::MaxTime(limit) => job.max_time(limit),
        Goal::MaxError { metric, bound } => job.max_error(metric, bound),
    }
}

/// What [`render_to_goal`] takes from the budget at most; see [`Renderer::bytes_needed`].
///
/// # Errors
/// As for [`Renderer::new`].
pub fn bytes_needed(
    scene: &Scene,
    model: &Model,
    settings: &RenderSettings,
    options: &GoalOptions,
    threads: &Threads,
) -> Result<Bytes, RenderError> {
    options.validate()?;
    let adaptive = AdaptiveSampling { samples_min: 4, error: 0.0, confidence: options.confidence };
    let most = RenderSettings {
        samples_per_pixel: if options.goal == Goal::Exact {
            settings.samples_per_pixel
        } else {
            options.samples_max
        },
        adaptive: (options.goal != Goal::Exact).then_some(adaptive),
        keep_statistics: true,
        ..*settings
    };
    let render = Renderer::bytes_needed(scene, model, &most, threads)?;
    // While a further picture is made, the best so far is kept.
    let film = Film::bytes_needed(&most.grid(), Kept { statistics: true, costs: most.keep_costs });
    let probe = match options.goal {
        Goal::MaxError { .. } => Draft::bytes_needed(&most, worker_count(threads)),
        _ => Renderer::probe_bytes(scene, model, &most, PROBE_PIXELS)?,
    };
    // While one renderer is there for its probe, others come and go.
    let details = Renderer::detail_bytes(scene, model, &most, worker_count(threads) as u32)?;
    // Ray trees of the check are not more than those of the picture.
    let pixels = settings.width as usize * settings.height as usize;
    let check = resample::bytes_needed(pixels) as u64;
    Ok(Bytes(render.0 + 2 * details.0 + film.0 + probe.0 + check + own_bytes(settings, options).0))
}

/// Tables and, for FLIP, planes of numbers.
fn own_bytes(settings: &RenderSettings, options: &GoalOptions) -> Bytes {
    const FLIP_BYTES_PER_PIXEL: u64 = 384;
    let pixels = u64::from(settings.width) * u64::from(settings.height);
    let steering = if matches!(options.goal, Goal::MaxTime(_)) {
        time::bytes_needed(&RenderSettings { tile_size: tile_size_to_steer(settings), ..*settings }).0
    } else {
        0
    };
    Bytes(pixels * FLIP_BYTES_PER_PIXEL + steering)
}

/// A callback that goes on cancelling once it has: the last word of one step may be that the next is not wanted.
fn for_good<'p>(
    progress: &'p mut (dyn FnMut(GoalProgress) -> Control + Send),
) -> impl FnMut(GoalProgress) -> Control + Send + 'p {
    let mut is_cancelled = false;
    move |state| {
        is_cancelled = is_cancelled || progress(state) == Control::Cancel;
        if is_cancelled { Control::Cancel } else { Control::Continue }
    }
}

/// The picture of `settings` as they stand, with fixed samples, and what it is worth.
pub(super) fn with_certificate(
    octree: &LazyOctree,
    scene: &Scene,
    settings: &RenderSettings,
    threads: &Threads,
    budget: &MemoryBudget,
    progress: &mut GoalProgressFn<'_>,
) -> Result<GoalImage, RenderError> {
    let options = GoalOptions::new(Goal::Exact);
    settings.validate()?;
    let _reserved = budget.reserve(own_bytes(settings, &options), "the choice of accuracy")?;
    let mut progress = for_good(progress);
    let mut job = Job::new(octree, scene, settings, &options, threads, budget, &mut progress);
    let knobs = job.knobs(Sampling::Fixed { samples: settings.samples_per_pixel });
    let renderer = job.renderer(&knobs)?;
    let image = job.picture(&renderer, None)?;
    let certificate = job.certificate(&image, knobs, Evidence::of(&renderer))?;
    Ok(GoalImage { image, certificate })
}

/// What is estimated of a picture's mean square error.
#[derive(Clone, Copy)]
pub(super) enum Known {
    Squares(MeanSquare, Option<SamplingCheck>),
    Nothing,
    /// The caller did not want to wait.
    Cancelled,
}

/// What a certificate goes by beside the picture.
pub(super) struct Evidence<'e, 'r> {
    /// One with the picture's settings, for further samples.
    pub renderer: &'e Renderer<'r>,
    /// What the film says of each pixel, if that was asked for already.
    pub pixels: Option<Rc<Pixels>>,
    /// What a check has said of the picture.
    pub known: Option<Known>,
    /// What pixels may have missed by their first samples, if that is known.
    pub unseen: Option<Rc<Unseen>>,
}

impl<'e, 'r> Evidence<'e, 'r> {
    /// No more than the picture itself.
    fn of(renderer: &'e Renderer<'r>) -> Evidence<'e, 'r> {
        Evidence { renderer, pixels: None, known: None, unseen: None }
    }
}

impl<'a> Job<'a, '_> {
    /// For pictures with these knobs.
    pub(super) fn renderer(&self, knobs: &Knobs) -> Result<Renderer<'a>, RenderError> {
        Renderer::new(self.octree, self.scene, &knobs.settings(&self.settings), self.budget)
    }
}

impl Job<'_, '_> {
    fn exact(&mut self) -> Result<GoalImage, RenderError> {
        let knobs = Knobs {
            contribution_bound: 0.0,
            ..self.knobs(Sampling::Fixed { samples: self.settings.samples_per_pixel })
        };
        let renderer = self.renderer(&knobs)?;
        let image = self.picture(&renderer, None)?;
        let mut certificate = self.certificate(&image, knobs, Evidence::of(&renderer))?;
        if certificate.verdict != Verdict::Cancelled {
            let tier = self.octree.tier();
            certificate.verdict = if !matches!(tier, Tier::Certified | Tier::Exact) {
                not_met(format!(
                    "hits of tier {} are not certain; open the octree with the tier certified",
                    tier.name()
                ))
            } else if image.report.effects.work_cuts > 0 {
                not_met("the work budget cut rays; raise it".to_string())
            } else {
                Verdict::Met
            };
        }
        Ok(GoalImage { image, certificate })
    }

    pub(super) fn why_missed(
        &self,
        image: &RenderedImage,
        missed: Option<MissedFeatures>,
        [reached, cut, bound]: [f64; 3],
    ) -> Verdict {
        let most = self.options.samples_max;
        let statistics = image.film.statistics().unwrap_or_default();
        let full = statistics.iter().filter(|pixel| pixel.samples >= most).count();
        let cause = if cut > bound {
            format!(
                "{cut:.2e} of it because the work budget or the contribution bound cut rays; raise the work budget"
            )
        } else if full > 0 {
            format!("{full} pixels have the most samples allowed, {most}; allow more")
        } else if let Some(MissedFeatures { missed, .. }) = missed.filter(|found| found.missed >= 0.5) {
            format!(
                "{missed:.0} pixels may have missed a feature smaller than they are; allow more samples, {most} now"
            )
        } else {
            "it is only little above; ask for a little less".to_string()
        };
        not_met(format!("the error may be {reached:.2e}, not {bound:.2e}: {cause}"))
    }

    fn max_time(&mut self, limit: Duration) -> Result<GoalImage, RenderError> {
        self.settings.tile_size = tile_size_to_steer(&self.settings);
        let settings = self.probe_settings();
        let renderer = Renderer::new(self.octree, self.scene, &settings, self.budget)?;
        let begun = Instant::now();
        let mut probe = self.probe(&renderer)?;
        // Ever more samples, until choosing has had its share of the time.
        let mut deviation = self.prediction(&probe).deviation_max();
        let samples_max = self.options.samples_max;
        while begun.elapsed() < limit.mul_f64(0.5 * CHOOSING_SHARE)
            && !self.prediction(&probe).is_exhausted(deviation)
        {
            deviation *= 0.5;
            if !probe.refine(deviation, samples_max, &mut || ask(self.progress))? {
                return Err(RenderError::Cancelled);
            }
        }
        let rays: u64 = probe.cells.iter().map(|cell| cell.rays).sum();
        let workers = worker_count(self.threads);
        let rate = rays as f64 / begun.elapsed().as_secs_f64().max(1e-9) * workers as f64;
        let quantile = normal_quantile(0.5 + 0.5 * PIXEL_CONFIDENCE);
        let prediction = self.prediction(&probe);
        // The certificate takes time, too: FLIP, as much per pixel as it does here, and a check, its share of the samples.
        let closing = Instant::now();
        if self.is_asked(Metric::Flip) {
            prediction.estimate(Metric::Flip, deviation);
        }
        let share = self.pixels_total() as f64 / prediction.pixels() as f64;
        let left = limit.saturating_sub(closing.elapsed().mul_f64(share) + self.start.elapsed());
        let closer = Duration::from_secs_f64((prediction.rays_closer() / rate).min(left.as_secs_f64()));
        let left = left - closer;
        let until = self.start.elapsed() + left.div_f64(1.0 + check::share(self.pixels_total()));
        let steering = Steering::new(&prediction, &self.settings, quantile, self.start, until, workers, rate);
        self.count(&probe);
        self.seconds.choosing = self.start.elapsed().as_secs_f64();
        let left = until.saturating_sub(self.start.elapsed()).as_secs_f64();
        let least = steering.rays_min();
        drop(probe);

        let mut knobs = self.knobs(self.adaptive(FIRST_SAMPLES, PIXEL_CONFIDENCE, 0.0));
        knobs.contribution_bound = self.settings.contribution_bound;
        let steering = if left * rate < least {
            // Too little time to look at errors: the most samples that fit, the same everywhere.
            let first = f64::from(FIRST_SAMPLES);
            let samples = (left * rate / least * first).floor().clamp(1.0, first - 1.0) as u32;
            knobs.sampling = Sampling::Fixed { samples };
            None
        } else {
            Some(steering)
        };
        let renderer = self.renderer(&knobs)?;
        let image = self.picture(&renderer, steering.as_ref())?;
        if let (Sampling::Adaptive { thresholds, .. }, Some(steering)) = (&mut knobs.sampling, steering) {
            *thresholds = steering.into_thresholds();
        }
        let mut certificate = self.certificate(&image, knobs, Evidence::of(&renderer))?;
        if certificate.verdict != Verdict::Cancelled {
            certificate.verdict = if certificate.seconds.total <= 1.1 * limit.as_secs_f64() {
                Verdict::Met
            } else {
                not_met(format!(
                    "it took {:.2} s, not {:.2} s",
                    certificate.seconds.total,
                    limit.as_secs_f64()
                ))
            };
        }
        Ok(GoalImage { image, certificate })
    }

    /// Makes a picture and adds what it took; with `steering`, to the clock.
    fn picture(
        &mut self,
        renderer: &Renderer<'_>,
        steering: Option<&Steering>,
    ) -> Result<RenderedImage, RenderError> {
        let begun = Instant::now();
        let attempt = self.counters.attempts + 1;
        let told = &mut *self.progress;
        let mut progress = |progress: Progress| told(GoalProgress { attempt, progress });
        let threshold = |tile: TileId| steering.map(|steering| steering.threshold(tile));
        let image = renderer.render_steered(self.threads, &threshold, &mut progress)?;
        self.counters.attempts = attempt;
        self.counters.effects.merge(&image.report.effects);
        self.counters.trace.merge(&image.report.trace);
        self.seconds.rendering += begun.elapsed().as_secs_f64();
        Ok(image)
    }

    /// Everything but whether the goal is met.
    pub(super) fn certificate(
        &mut self,
        image: &RenderedImage,
        knobs: Knobs,
        Evidence { renderer, pixels, known, unseen }: Evidence<'_, '_>,
    ) -> Result<Certificate, RenderError> {
        let begun = Instant::now();
        let is_whole = image.report.outcome == Outcome::Complete;
        let statistics = image.film.statistics().unwrap_or_default();
        let count = statistics.len().max(1) as f64;
        let lost = || statistics.iter().map(|pixel| f64::from(pixel.lost));
        // One sample is nothing to go by, but a check goes by others.
        let is_known = match knobs.sampling {
            Sampling::Fixed { samples } => samples > 1,
            Sampling::Adaptive { .. } => true,
        };
        let is_known = is_known && is_whole && !statistics.is_empty();
        let pixels = match pixels {
            Some(pixels) => pixels,
            None if is_known => Rc::new(sampled(&image.film)),
            None => Rc::new(Pixels::new(Vec::new(), image.film.width())),
        };
        // Few samples do not tell the greatest error of many pixels.
        let (Sampling::Fixed { samples: least } | Sampling::Adaptive { samples_min: least, .. }) =
            knobs.sampling;
        let few = least < FIRST_SAMPLES;
        let is_told = |metric: &Metric| self.is_asked(*metric) && !(few && *metric == Metric::Max);
        let asked: Vec<Metric> = Metric::ALL.into_iter().filter(is_told).collect();
        // Half differences of all samples hold what single pixels have missed, over all.
        let halves_hold = matches!(knobs.sampling, Sampling::Fixed { .. });
        let is_needed = asked.iter().any(|metric| !(halves_hold && *metric == Metric::Rmse));
        let unseen = match unseen {
            None if is_known && is_needed => self.look_closer(renderer, image, &pixels, &knobs.sampling)?,
            None => Some(Rc::default()),
            found => found,
        };
        let missed = unseen.as_ref().map_or_else(Unseen::default, |unseen| {
            unseen.at_each(deviations(&knobs, &self.settings, image.film.width()))
        });
        let known = match (&knobs.sampling, known) {
            _ if !is_known => Known::Nothing,
            (_, Some(Known::Cancelled)) => Known::Cancelled,
            _ if unseen.is_none() => Known::Cancelled,
            // What a check says is of samples that stop; of fixed ones the halves tell.
            (Sampling::Fixed { .. }, _) => {
                Known::Squares(MeanSquare::of_halves(&pixels, self.confidence()), None)
            }
            (_, Some(known)) => known,
            (_, None) => self.check(renderer, image, &pixels, &missed)?,
        };
        let (estimates, check, missed) = match known {
            Known::Squares(squares, check) => {
                let total = self.pixels_total();
                let confidence = self.confidence();
                let nothing = Unseen::default();
                let estimates = asked.into_iter().map(|metric| {
                    let missed = if halves_hold && metric == Metric::Rmse { &nothing } else { &missed };
                    estimate(metric, &pixels, squares, missed, total, confidence)
                });
                (estimates.collect(), check, is_needed.then(|| missed.found(total)))
            }
            Known::Nothing | Known::Cancelled => (Vec::new(), None, None),
        };
        self.seconds.checking += begun.elapsed().as_secs_f64();
        let is_cancelled = !is_whole || matches!(known, Known::Cancelled);
        Ok(Certificate {
            goal: self.options.goal,
            verdict: if is_cancelled { Verdict::Cancelled } else { Verdict::Met },
            geometry: GeometryBounds::of(
                self.octree.model(),
                self.octree.tier(),
                self.scene.camera(),
                &self.settings,
                self.options.vertex_error,
            ),
            cut_off: CutOffBounds {
                rmse: cut_off(Metric::Rmse, lost()).unwrap_or(0.0),
                max: cut_off(Metric::Max, lost()).unwrap_or(0.0),
                in_expectation: self.has_sampled_effects(),
            },
            estimates,
            check,
            missed,
            confidence: self.options.confidence,
            samples_mean: statistics.iter().map(|pixel| f64::from(pixel.samples)).sum::<f64>() / count,
            knobs,
            counters: self.counters,
            seconds: GoalSeconds { total: self.start.elapsed().as_secs_f64(), ..self.seconds },
        })
    }

    /// Whether the certificate is to say something about a metric.
    fn is_asked(&self, metric: Metric) -> bool {
        let goal = matches!(self.options.goal, Goal::MaxError { metric: Metric::Flip, .. });
        metric != Metric::Flip || goal || self.options.every_metric
    }

    /// Whether any effect chooses its rays by luck.
    fn has_sampled_effects(&self) -> bool {
        EffectPlan::scan(self.scene, self.octree.model(), &self.settings.effect_options())
            .has_sampled_effects()
    }

    /// The mean square error that further samples show, taken by a renderer with the picture's seed and contribution bound.
    pub(super) fn check(
        &mut self,
        renderer: &Renderer<'_>,
        image: &RenderedImage,
        pixels: &[Sampled],
        missed: &Unseen,
    ) -> Result<Known, RenderError> {
        let confidence = self.confidence();
        let halves = MeanSquare::of_halves(pixels, confidence);
        let statistics = image.film.statistics().unwrap_or_default();
        let seed = self.settings.seed;
        let (drawn, places) = check::draw(pixels, statistics, image.film.width(), seed, self.looks);
        let Some(further) = self.sample_again(renderer, image, &places)? else {
            return Ok(Known::Cancelled);
        };
        let further = further.iter().map(|mean| mean.to_array());
        let squares = check::mean_square(pixels, &drawn, further, missed, confidence);
        let is_same = squares.value == halves.value;
        // Infinite where single samples have no halves.
        let bias = if is_same { 1.0 } else { (squares.value / halves.value).sqrt() };
        let samples = places.iter().map(|pixel| u64::from(pixel.samples)).sum();
        let check = SamplingCheck { pixels: places.len() as u32, samples, bias };
        Ok(Known::Squares(squares, Some(check)))
    }

    /// What pixels have missed by their first samples, from further samples of those that stand out; `None` if the caller did not want to
    /// wait.
    pub(super) fn look_closer(
        &mut self,
        renderer: &Renderer<'_>,
        image: &RenderedImage,
        pixels: &[Sampled],
        sampling: &Sampling,
    ) -> Result<Option<Rc<Unseen>>, RenderError> {
        let width = image.film.width();
        let seed = self.settings.seed;
        let (candidates, samples) = match sampling {
            Sampling::Fixed { samples } => {
                let around = unseen::stands_out(pixels, width, *samples).into_iter();
                (unseen::candidates(around, width, *samples, (*samples).min(2), seed), *samples)
            }
            Sampling::Adaptive { samples_min, .. } => {
                let statistics = image.film.statistics().unwrap_or_default();
                let around = statistics.iter().map(|pixel| [pixel.stands_out, pixel.surround]);
                let blocks = SampleBlocks::count_of(*samples_min);
                (unseen::candidates(around, width, *samples_min, blocks, seed), *samples_min)
            }
        };
        if candidates.is_empty() {
            return Ok(Some(Rc::default()));
        }
        let places: Vec<SampledPixel> = candidates.iter().map(|candidate| candidate.place).collect();
        let Some(further) = self.sample_again(renderer, image, &places)? else { return Ok(None) };
        let further = further.iter().map(|mean| mean.to_array());
        Ok(Some(Rc::new(Unseen::of(pixels, width, samples, &candidates, further))))
    }

    /// The means of further samples of some pixels; `None` if the caller did not want to wait.
    fn sample_again(
        &mut self,
        renderer: &Renderer<'_>,
        image: &RenderedImage,
        places: &[SampledPixel],
    ) -> Result<Option<Vec<DVec3>>, RenderError> {
        let (attempt, told) = (self.counters.attempts, &mut *self.progress);
        let progress = whole(image);
        let mut stop = || told(GoalProgress { attempt, progress });
        let Some(again) = renderer.resample(places, self.threads, &mut stop)? else { return Ok(None) };
        self.counters.effects.merge(&again.effects);
        self.counters.trace.merge(&again.trace);
        Ok(Some(again.means))
    }
}

/// The deviation at which each pixel stops, by the tile that it lies in; any will do where samples are fixed.
fn deviations(knobs: &Knobs, settings: &RenderSettings, width: u32) -> impl Fn(usize) -> f64 {
    let settings = knobs.settings(settings);
    let grid = settings.grid();
    let (quantile, thresholds) = match (&knobs.sampling, settings.adaptive) {
        (Sampling::Adaptive { thresholds, .. }, Some(adaptive)) => {
            (adaptive.quantile(), thresholds.as_slice())
        }
        _ => (1.0, [].as_slice()),
    };
    let mut deviations = vec![f64::INFINITY; grid.tile_count()];
    let mut next = thresholds.iter().peekable();
    let mut deviation = f64::INFINITY;
    for (tile, cell) in (0..).zip(grid.hilbert_order()) {
        while let Some(threshold) = next.next_if(|threshold| threshold.first_tile <= TileId(tile)) {
            deviation = threshold.error / quantile;
        }
        deviations[cell as usize] = deviation;
    }
    // Films have fewer than 2^32 pixels.
    move |index| deviations[grid.cell_at(index as u32 % width, index as u32 / width) as usize]
}

/// What is known of each pixel of a film with statistics.
pub(super) fn sampled(film: &Film) -> Pixels {
    let pixels = film.pixels().iter().zip(film.statistics().unwrap_or_default());
    let all = pixels
        .map(|(mean, known)| Sampled {
            mean: *mean,
            half_difference: known.half_difference,
            deviation: f64::from(known.deviation),
            lost: f64::from(known.lost),
        })
        .collect();
    Pixels::new(all, film.width())
}

/// The progress of a picture that is finished.
fn whole(image: &RenderedImage) -> Progress {
    let tiles = image.report.tiles_total;
    let samples = image.film.pixels().len() as u64 * u64::from(image.report.samples_per_pixel);
    Progress { samples, samples_total: samples, tiles, tiles_total: tiles }
}

/// Tiles small enough that there are at least [`STEERED_TILES_MIN`], but not so small that their borders cost much.
fn tile_size_to_steer(settings: &RenderSettings) -> u32 {
    let mut size = settings.tile_size;
    while size > 16
        && (RenderSettings { tile_size: size, ..*settings }).grid().tile_count() < STEERED_TILES_MIN
    {
        size /= 2;
    }
    size.max(settings.tile_size.min(16))
}

fn not_met(reason: String) -> Verdict {
    Verdict::NotMet { reason }
}
