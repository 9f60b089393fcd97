//! A picture to an error goal, in steps: it goes on until what is known of its error is small enough, and takes no sample twice.
//!
//! What a step is expected to bring follows from what is known of each pixel. Only the certificate at its end counts: if that says that
//! more was expected than came of it, the next step is expected to bring that much less.

use std::rc::Rc;
use std::time::Instant;

use super::check;
use super::choose::cut_off_share;
use super::estimate::{
    FLIP_POWER, MeanSquare, Pixels, cut_off, estimate, flip_expected, max_quantile, sampling_room,
    unseen_flip,
};
use super::greatest::Deviations;
use super::job::{FIRST_SAMPLES, Job, PIXEL_CONFIDENCE};
use super::run::{Evidence, GoalImage, Known, sampled};
use super::unseen::Unseen;
use super::{Certificate, GoalProgress, Knobs, Metric, Sampling, Verdict};
use crate::error::RenderError;
use crate::render::{Outcome, Progress, RenderedImage, Renderer, normal_quantile};

/// Pictures made for an error goal, at most: another one has another contribution bound.
const ATTEMPTS_MAX: u32 = 3;
/// Steps of a picture, and certificates on the way, at most.
const STEPS_MAX: u32 = 32;
const CERTIFICATES_MAX: u32 = 6;
/// What is aimed at of an error goal.
const AIM: f64 = 0.98;
/// Mean square error of pixels over what their halves say, before a check tells: halves complement each other, and pixels stop where they agree.
const STOPPING: f64 = 0.85;
/// What a certificate says of FLIP over what is expected of it, before one is known: margins for luck.
const FLIP_MARGIN: f64 = 1.04;
/// How much too large FLIP may be with single samples for more to be added where they are needed most, and not everywhere.
const FLIP_SINGLES: f64 = 1.4;
/// How far above what is asked for FLIP is not looked at.
const FLIP_FAR: f64 = 1.25;
/// Mean square of what a pixel's deviation is over the threshold at which it stopped, as it falls by `2^-3/4` with each doubling.
const BELOW_THRESHOLD: f64 = 0.62;

/// A picture on its way to an error goal.
struct Steps<'r, 'a> {
    renderer: &'r Renderer<'a>,
    metric: Metric,
    bound: f64,
    contribution_bound: f64,
    /// Samples of every pixel, and whether no pixel has more.
    samples_first: u32,
    fixed: Option<u32>,
    /// Confidence of pixels' intervals, and how many deviations they span.
    confidence: f64,
    quantile: f64,
    /// As it is now, with all that its steps took.
    image: Option<RenderedImage>,
    /// What is known of its pixels, once somebody has asked.
    sampled: Option<Rc<Pixels>>,
    /// What pixels may have missed by their first samples.
    unseen: Rc<Unseen>,
    /// Samples of every pixel when each last looked at its neighbours.
    looked_at: Option<u32>,
    /// FLIP as it was expected last, and the mean square error that it was expected of.
    flip: Option<(f64, f64)>,
    /// What a check of it as it is now has said, and a certificate.
    known: Option<Known>,
    certificate: Option<Certificate>,
    /// The error that was expected last, and what was certified over what was expected.
    expected: f64,
    surprise: f64,
    /// The threshold of the step before.
    deviation: f64,
    /// Mean square error of single samples over what their deviations say.
    singles: f64,
}

/// What is to be done next.
enum Next {
    /// On to where pixels have this deviation.
    GoOn(f64),
    /// It may be good enough.
    Certify,
    /// No more samples help.
    End,
}

impl Job<'_, '_> {
    pub(super) fn max_error(&mut self, metric: Metric, bound: f64) -> Result<GoalImage, RenderError> {
        let mut contribution_bound = self.choose_contribution_bound(metric, bound)?;
        self.seconds.choosing = self.start.elapsed().as_secs_f64();
        let mut best: Option<(f64, GoalImage)> = None;
        loop {
            let found = self.in_steps(metric, bound, contribution_bound)?;
            let is_cancelled = found.certificate.verdict == Verdict::Cancelled;
            if is_cancelled && best.is_some() {
                break;
            }
            let reached = found.certificate.error_bound(metric).unwrap_or(f64::INFINITY);
            let cut = found.certificate.cut_off.of(metric).unwrap_or(0.0);
            let is_done = is_cancelled || reached <= bound;
            if is_done || best.as_ref().is_none_or(|(least, _)| reached < *least) {
                best = Some((reached, found));
            }
            // More samples do not help against what is cut off.
            let most = cut_off_share(metric) * bound;
            if is_done || cut <= most || self.counters.attempts >= ATTEMPTS_MAX {
                break;
            }
            contribution_bound *= (most / cut).max(1.0 / 64.0);
        }
        let (_, mut best) = best.ok_or(RenderError::Cancelled)?;
        best.certificate.counters = self.counters;
        best.certificate.seconds = self.seconds;
        best.certificate.seconds.total = self.start.elapsed().as_secs_f64();
        Ok(best)
    }

    /// A picture with this contribution bound, as good as is asked for or as can be.
    fn in_steps(
        &mut self,
        metric: Metric,
        bound: f64,
        contribution_bound: f64,
    ) -> Result<GoalImage, RenderError> {
        let (confidence, quantile) = match metric {
            Metric::Max => {
                let confidence = 1.0 - (1.0 - self.options.confidence) / (3.0 * self.pixels_total() as f64);
                (confidence, max_quantile(self.pixels_total(), self.options.confidence))
            }
            _ => (PIXEL_CONFIDENCE, normal_quantile(0.5 + 0.5 * PIXEL_CONFIDENCE)),
        };
        let samples_first = FIRST_SAMPLES;
        let knobs = Knobs { contribution_bound, ..self.knobs(self.adaptive(samples_first, confidence, 0.0)) };
        let mut renderer = self.renderer(&knobs)?;
        renderer.keep_draft(self.threads)?;
        self.counters.attempts += 1;
        let mut steps = Steps {
            renderer: &renderer,
            metric,
            bound,
            contribution_bound,
            samples_first,
            fixed: None,
            confidence,
            quantile,
            image: None,
            sampled: None,
            unseen: Rc::default(),
            looked_at: None,
            flip: None,
            known: None,
            certificate: None,
            expected: 0.0,
            surprise: if metric == Metric::Flip { FLIP_MARGIN } else { 1.0 },
            singles: 1.0,
            deviation: f64::INFINITY,
        };
        let certificate = self.take_steps(&mut steps)?;
        let image = steps.image.ok_or(RenderError::Cancelled)?;
        Ok(GoalImage { image, certificate })
    }

    fn take_steps(&mut self, steps: &mut Steps<'_, '_>) -> Result<Certificate, RenderError> {
        if let Some(certificate) = self.few_samples(steps)? {
            return Ok(certificate);
        }
        if !self.first_steps(steps)? {
            return self.certify(steps);
        }
        let mut certificates = 0;
        for _ in 0..STEPS_MAX {
            let unseen = Rc::clone(&steps.unseen);
            match self.next(steps, &unseen) {
                Next::GoOn(deviation) => {
                    steps.deviation = deviation;
                    self.step(steps, deviation)?;
                }
                Next::Certify => {
                    let certificate = self.certify(steps)?;
                    certificates += 1;
                    let is_missed = matches!(certificate.verdict, Verdict::NotMet { .. });
                    if !is_missed || certificates == CERTIFICATES_MAX {
                        return Ok(certificate);
                    }
                    steps.learn_from(certificate);
                }
                Next::End => break,
            }
            if steps.is_cancelled() {
                break;
            }
        }
        match steps.certificate.take() {
            // No step was taken since.
            Some(certificate) => Ok(certificate),
            None => self.certify(steps),
        }
    }

    /// The same few samples everywhere, if they are enough: nothing stops early then. `None` if they are not, or in the greatest
    /// error of many pixels, which is not known from so few.
    fn few_samples(&mut self, steps: &mut Steps<'_, '_>) -> Result<Option<Certificate>, RenderError> {
        if steps.metric == Metric::Max {
            return Ok(None);
        }
        // In FLIP single samples may be enough. What they are worth is told by a check.
        if steps.metric == Metric::Flip {
            steps.samples_first = 1;
            let is_whole = self.first_step(steps)? && self.look_at_singles(steps)?;
            let unseen = Rc::clone(&steps.unseen);
            if !is_whole || matches!(self.next(steps, &unseen), Next::Certify) {
                let certificate = self.certify(steps)?;
                if !matches!(certificate.verdict, Verdict::NotMet { .. }) {
                    return Ok(Some(certificate));
                }
                steps.learn_from(certificate);
            }
            if steps.expected * steps.surprise < FLIP_SINGLES * steps.bound && self.fits(steps, &unseen) {
                return Ok(None);
            }
        }
        for samples in [2, FIRST_SAMPLES] {
            steps.samples_first = samples;
            if steps.metric == Metric::Flip {
                if !self.first_step(steps)? {
                    return self.certify(steps).map(Some);
                }
            } else {
                self.step(steps, f64::INFINITY)?;
            }
            let pixels = steps.pixels();
            let squares = MeanSquare::of_halves(&pixels, self.confidence());
            let expected = match steps.metric {
                Metric::Flip => {
                    let unseen = Rc::clone(&steps.unseen);
                    self.flip(steps, &pixels, squares, &unseen, steps.bound)
                }
                _ => squares.upper.sqrt(),
            };
            // Twice the samples will not halve it.
            if expected > 2.0 * steps.bound {
                break;
            }
            if expected > steps.bound {
                continue;
            }
            steps.fixed = Some(samples);
            let certificate = self.certify(steps)?;
            steps.fixed = None;
            if !matches!(certificate.verdict, Verdict::NotMet { .. }) {
                return Ok(Some(certificate));
            }
        }
        steps.samples_first = FIRST_SAMPLES;
        Ok(None)
    }

    /// Has a check tell how large errors of single samples are over what their deviations say; false if the caller wants no more.
    fn look_at_singles(&mut self, steps: &mut Steps<'_, '_>) -> Result<bool, RenderError> {
        let pixels = steps.pixels();
        let Some(image) = steps.image.take() else { return Ok(false) };
        if image.report.outcome == Outcome::Cancelled {
            steps.image = Some(image);
            return Ok(false);
        }
        let begun = Instant::now();
        let known = self.check(steps.renderer, &image, &pixels, &steps.unseen.at(steps.deviation))?;
        (steps.image, steps.known) = (Some(image), Some(known));
        self.seconds.checking += begun.elapsed().as_secs_f64();
        let Known::Squares(squares, _) = known else { return Ok(false) };
        let own =
            pixels.iter().map(|pixel| pixel.deviation.powi(2)).sum::<f64>() / pixels.len().max(1) as f64;
        if own > 0.0 {
            steps.singles = squares.value / own;
        }
        Ok(true)
    }

    /// FLIP to be expected. Where it is far above `limit` it follows from how it was when it was last looked at, as a look takes as long as
    /// half a sample of each pixel.
    fn flip(
        &self,
        steps: &mut Steps<'_, '_>,
        pixels: &Pixels,
        squares: MeanSquare,
        missed: &Unseen,
        limit: f64,
    ) -> f64 {
        let confidence = self.confidence();
        let size = squares.plus(missed.squares(self.pixels_total(), confidence)).upper;
        if let Some((flip, before)) = steps.flip {
            if size == before {
                // Nothing has been added since.
                return flip;
            }
            let follows = flip * libm::pow(size / before, 0.5 * FLIP_POWER);
            if follows > FLIP_FAR * limit {
                return follows;
            }
        }
        let flip = flip_expected(pixels, squares, missed, confidence);
        steps.flip = (size > 0.0).then_some((flip, size));
        flip
    }

    /// Goes on until every pixel has first samples, as many as leave little of what pixels miss. False if the caller wants no more.
    fn first_steps(&mut self, steps: &mut Steps<'_, '_>) -> Result<bool, RenderError> {
        // It may be where it begins already, if few samples have been tried.
        loop {
            if steps.looked_at != Some(steps.samples_first) && !self.first_step(steps)? {
                return Ok(false);
            }
            if steps.unseen.is_empty() {
                return Ok(true);
            }
            let deviation = match self.next(steps, &Unseen::default()) {
                Next::GoOn(deviation) => deviation,
                Next::Certify | Next::End => steps.deviation,
            };
            let unseen = steps.unseen.at(deviation);
            let most = self.options.samples_max / steps.samples_first;
            let times = std::iter::successors(Some(1u32), |times| times.checked_mul(2))
                .take_while(|times| *times <= most)
                .find(|times| self.fits(steps, &unseen.with_times(*times)));
            let Some(times) = times.filter(|times| *times > 1) else { return Ok(true) };
            steps.samples_first *= times;
        }
    }

    /// Whether what pixels have missed leaves enough of the goal for the rest.
    fn fits(&self, steps: &mut Steps<'_, '_>, unseen: &Unseen) -> bool {
        if unseen.is_empty() {
            return true;
        }
        let confidence = self.confidence();
        let cut = cut_off(steps.metric, steps.pixels().iter().map(|pixel| pixel.lost)).unwrap_or(0.0);
        let bound = sampling_room(steps.metric, AIM * steps.bound / steps.surprise, cut);
        match steps.metric {
            Metric::Rmse => unseen.squares(self.pixels_total(), confidence).upper <= 0.5 * bound * bound,
            Metric::Max => unseen.missed_above(0.9 * bound) <= 0.5 * (1.0 - confidence),
            Metric::Flip => unseen_flip(&steps.pixels(), unseen, confidence) <= 0.5 * bound,
        }
    }

    /// Goes on until every pixel has its first samples, looks at what is known of each beside its neighbours, and closer at those that
    /// stand out. False if the caller wants no more.
    fn first_step(&mut self, steps: &mut Steps<'_, '_>) -> Result<bool, RenderError> {
        self.step(steps, f64::INFINITY)?;
        (steps.unseen, steps.looked_at) = (Rc::default(), None);
        let is_cancelled = steps.is_cancelled();
        if let Some(image) = steps.image.as_mut().filter(|_| !is_cancelled) {
            steps.renderer.look_around(&mut image.film);
            steps.sampled = None;
        }
        steps.open_none();
        let pixels = steps.pixels();
        let Some(image) = steps.image.as_ref().filter(|_| !is_cancelled) else { return Ok(false) };
        let begun = Instant::now();
        let sampling = self.adaptive(steps.samples_first, steps.confidence, 0.0);
        let unseen = self.look_closer(steps.renderer, image, &pixels, &sampling)?;
        self.seconds.checking += begun.elapsed().as_secs_f64();
        let Some(unseen) = unseen else {
            steps.known = Some(Known::Cancelled);
            return Ok(false);
        };
        steps.unseen = unseen;
        steps.looked_at = Some(steps.samples_first);
        Ok(true)
    }

    /// Goes on until every pixel has its first samples and none that can go on has a greater deviation.
    fn step(&mut self, steps: &mut Steps<'_, '_>, deviation: f64) -> Result<(), RenderError> {
        if steps.is_cancelled() {
            return Ok(());
        }
        let begun = Instant::now();
        let error = deviation * steps.quantile;
        if let Some(draft) = steps.renderer.draft() {
            draft.set_least(steps.samples_first);
        }
        let attempt = self.counters.attempts;
        let told = &mut *self.progress;
        let mut progress = |progress: Progress| told(GoalProgress { attempt, progress });
        (steps.sampled, steps.known, steps.certificate) = (None, None, None);
        // The film is made anew, so that of the step before is not needed any longer.
        let before = steps.image.take().map(|image| image.report);
        let mut image = steps.renderer.render_steered(self.threads, &|_| Some(error), &mut progress)?;
        self.counters.effects.merge(&image.report.effects);
        self.counters.trace.merge(&image.report.trace);
        if image.report.outcome == Outcome::Cancelled {
            // What the steps before have brought is not lost.
            steps.renderer.fill_in(&mut image.film);
        }
        if let Some(before) = before {
            image.report.add_before(&before);
        }
        steps.image = Some(image);
        self.seconds.rendering += begun.elapsed().as_secs_f64();
        Ok(())
    }

    /// What the picture as it is stands for.
    fn knobs_of(&self, steps: &Steps<'_, '_>) -> Knobs {
        let sampling = match steps.fixed {
            Some(samples) => Sampling::Fixed { samples },
            None => self.adaptive(steps.samples_first, steps.confidence, steps.deviation * steps.quantile),
        };
        Knobs { contribution_bound: steps.contribution_bound, ..self.knobs(sampling) }
    }

    /// What is known of the picture as it is, and whether that is enough.
    fn certify(&mut self, steps: &mut Steps<'_, '_>) -> Result<Certificate, RenderError> {
        let (knobs, pixels) = (self.knobs_of(steps), steps.pixels());
        let Some(image) = &mut steps.image else { return Err(RenderError::Cancelled) };
        image.report.samples_per_pixel = steps.fixed.unwrap_or(self.options.samples_max);
        let unseen =
            (steps.metric == Metric::Flip || steps.fixed.is_none()).then(|| Rc::clone(&steps.unseen));
        let evidence =
            Evidence { renderer: steps.renderer, pixels: Some(pixels), known: steps.known, unseen };
        let mut certificate = self.certificate(image, knobs, evidence)?;
        self.looks += 1;
        if certificate.verdict != Verdict::Cancelled {
            let reached = certificate.error_bound(steps.metric).unwrap_or(f64::INFINITY);
            let cut = certificate.cut_off.of(steps.metric).unwrap_or(0.0);
            certificate.verdict = if reached <= steps.bound {
                Verdict::Met
            } else {
                self.why_missed(image, certificate.missed, [reached, cut, steps.bound])
            };
        }
        Ok(certificate)
    }

    /// What is to be done next, by what is known of each pixel.
    fn next(&self, steps: &mut Steps<'_, '_>, unseen: &Unseen) -> Next {
        let (metric, aim) = (steps.metric, AIM * steps.bound / steps.surprise);
        let pixels = steps.pixels();
        let samples_max = self.options.samples_max;
        let samples = steps.samples();
        let can_go_on = |index: usize| samples[index] < samples_max && pixels[index].deviation > 0.0;
        let cut = cut_off(metric, pixels.iter().map(|pixel| pixel.lost)).unwrap_or(0.0);
        let room = sampling_room(metric, aim, cut);
        let missed = unseen.at(steps.deviation);
        let widest = (0..pixels.len())
            .filter(|&index| can_go_on(index))
            .fold(0.0f64, |most, index| most.max(pixels[index].deviation));
        if metric == Metric::Max {
            let deviations = Deviations::new(pixels.iter().map(|pixel| pixel.deviation));
            let chance = 1.0 - self.confidence();
            let limit = |most: f64, missed: &Unseen| deviations.limit(chance, 1.0, most, missed);
            let found = limit(f64::INFINITY, &missed);
            steps.expected = found + cut;
            if found <= room {
                return Next::Certify;
            }
            // Those that have all the samples they may stay as they are.
            let exhausted = (0..pixels.len()).filter(|&index| !can_go_on(index));
            let exhausted = Deviations::new(exhausted.map(|index| pixels[index].deviation));
            let least = exhausted.limit(chance, 1.0, f64::INFINITY, &unseen.at(0.0));
            if widest == 0.0 || least > room {
                return Next::End;
            }
            let (mut high, mut low) = (widest, widest * 1e-9);
            for _ in 0..24 {
                let middle = (high * low).sqrt();
                let reached = limit(BELOW_THRESHOLD.sqrt() * middle, &unseen.at(middle));
                if reached > room { high = middle } else { low = middle }
            }
            // What pixels really come to may be a little above what is expected of them.
            return Next::GoOn(low.min(0.93 * steps.deviation));
        }
        // Single samples have no halves, and stopping makes those of others too small.
        let singles = steps.singles;
        let square = |index: usize| match samples[index] {
            1 => singles * pixels[index].deviation.powi(2),
            _ => STOPPING * pixels[index].square(),
        };
        let known = || samples.iter().copied().zip(pixels.iter().map(|pixel| pixel.deviation));
        let plan = check::Plan::new(known(), self.pixels_total());
        let chances = known().map(|(samples, deviation)| plan.chance(samples, deviation));
        let squares: Vec<(f64, f64)> = (0..pixels.len()).map(square).zip(chances).collect();
        let squares = MeanSquare::expected(&squares, self.pixels_total(), self.confidence());
        let confidence = self.confidence();
        let expected = if metric == Metric::Flip {
            self.flip(steps, &pixels, squares, &missed, aim)
        } else {
            estimate(metric, &pixels, squares, &missed, self.pixels_total(), confidence).whole
        };
        steps.expected = expected;
        if expected <= aim {
            return Next::Certify;
        }
        if widest == 0.0 || room <= 0.0 {
            return Next::End;
        }
        // The mean square of sampling over that which is there.
        let less = if metric == Metric::Flip {
            let fixed = if missed.is_empty() { 0.0 } else { unseen_flip(&pixels, &missed, confidence) };
            libm::pow((aim - fixed).max(0.0) / (expected - fixed), 2.0 / FLIP_POWER)
        } else {
            room * room / (expected * expected - cut * cut)
        };
        if less <= 0.0 {
            return Next::End;
        }
        // A long way is gone in parts, as what is expected of it is not certain.
        let less = if less < 0.5 { libm::pow(less, 0.75) } else { less };
        let open = OpenPixels::new(
            (0..pixels.len()).map(|index| (pixels[index].deviation, square(index), can_go_on(index))),
        );
        let missed = |deviation: f64| {
            let missed = unseen.at(deviation).squares(self.pixels_total(), confidence);
            if metric == Metric::Flip { 0.0 } else { missed.value * pixels.len() as f64 }
        };
        let sum_at = |deviation: f64| open.sum_at(deviation) + missed(deviation);
        let wanted = less * (open.sum_at(f64::INFINITY) + missed(steps.deviation));
        let (mut high, mut low) = (widest, widest * 1e-9);
        if missed(low) > wanted {
            // More samples of some do not help.
            return Next::End;
        }
        for _ in 0..40 {
            let middle = (high * low).sqrt();
            if sum_at(middle) > wanted { high = middle } else { low = middle }
        }
        Next::GoOn(low.min(0.999 * steps.deviation))
    }
}

/// Square errors of pixels, in the order of their deviations.
struct OpenPixels {
    /// Of those that can go on, the greatest first: deviation, square errors of those before over their square deviations, and
    /// square errors of it and those behind.
    pixels: Vec<(f64, f64, f64)>,
    /// Square errors of the others.
    others: f64,
    /// Square errors over square deviations of all that can go on.
    over: f64,
}

impl OpenPixels {
    /// From deviations, square errors, and which ones can go on.
    fn new(pixels: impl Iterator<Item = (f64, f64, bool)>) -> OpenPixels {
        let (mut open, mut others) = (Vec::new(), 0.0);
        for (deviation, square, can_go_on) in pixels {
            if can_go_on {
                open.push((deviation, square / (deviation * deviation), square));
            } else {
                others += square;
            }
        }
        // Stable, so that the sums are the same each time.
        open.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut over, mut behind) = (0.0, 0.0);
        for (_, ratio, _) in &mut open {
            let before = over;
            over += *ratio;
            *ratio = before;
        }
        for (_, _, square) in open.iter_mut().rev() {
            behind += *square;
            *square = behind;
        }
        OpenPixels { pixels: open, others, over }
    }

    /// What square errors are expected to add up to if pixels go on until none has a greater deviation.
    fn sum_at(&self, deviation: f64) -> f64 {
        let wider = self.pixels.partition_point(|pixel| pixel.0 > deviation);
        let (over, behind) = self.pixels.get(wider).map_or((self.over, 0.0), |pixel| (pixel.1, pixel.2));
        let gone_on = if wider > 0 { BELOW_THRESHOLD * deviation * deviation * over } else { 0.0 };
        self.others + gone_on + behind
    }
}

impl Steps<'_, '_> {
    fn is_cancelled(&self) -> bool {
        matches!(self.known, Some(Known::Cancelled))
            || self.image.as_ref().is_some_and(|image| image.report.outcome == Outcome::Cancelled)
    }

    /// Expects as much more from here on as a certificate says that was too little.
    fn learn_from(&mut self, certificate: Certificate) {
        let reached = certificate.error_bound(self.metric).unwrap_or(f64::INFINITY);
        self.certificate = Some(certificate);
        // A little more is done than must be, as another certificate has its price.
        self.surprise = 1.01 * reached / self.expected.max(f64::MIN_POSITIVE);
    }

    /// Sets the threshold to one at which no pixel goes on.
    fn open_none(&mut self) {
        let widest = self.pixels().iter().fold(0.0, |most: f64, pixel| most.max(pixel.deviation));
        // Films hold deviations as f32.
        self.deviation = widest * (1.0 + 1e-6);
    }

    /// What is known of each pixel.
    fn pixels(&mut self) -> Rc<Pixels> {
        let known = || match &self.image {
            Some(image) => sampled(&image.film),
            None => Pixels::new(Vec::new(), 1),
        };
        Rc::clone(self.sampled.get_or_insert_with(|| Rc::new(known())))
    }

    /// Samples of each pixel.
    fn samples(&self) -> Vec<u32> {
        let statistics = self.image.as_ref().and_then(|image| image.film.statistics()).unwrap_or_default();
        statistics.iter().map(|pixel| pixel.samples).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    /// Against the sum pixel by pixel.
    #[test]
    fn sums_of_open_pixels_are_those_of_each() {
        let mut random = Random::new(3);
        let pixels: Vec<(f64, f64, bool)> = (0..500)
            .map(|index| {
                // Some are alike.
                let deviation = 0.01 * (1.0 + (20.0 * random.unit()).floor());
                (deviation, random.unit(), index % 7 != 0)
            })
            .collect();
        let open = OpenPixels::new(pixels.iter().copied());
        for threshold in [0.0, 0.005, 0.01, 0.055, 0.1, 0.13, 0.2, 0.5, f64::INFINITY] {
            let left = |&(deviation, square, can_go_on): &(f64, f64, bool)| {
                let over = deviation / threshold;
                if can_go_on && over > 1.0 { square * BELOW_THRESHOLD / (over * over) } else { square }
            };
            let expected: f64 = pixels.iter().map(left).sum();
            let found = open.sum_at(threshold);
            assert!((found - expected).abs() <= 1e-9 * expected, "{threshold}: {found}, not {expected}");
        }
        assert_eq!(OpenPixels::new(std::iter::empty()).sum_at(1.0), 0.0);
    }
}
