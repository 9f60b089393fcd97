//! Whether a finished picture is as good as its samples say, found out with samples that had no say in it.
//!
//! Adaptive sampling stops where samples happen to agree, so what they say about their own error is too good. Some pixels, drawn with
//! chances that are known, get as many samples again. The difference between both means estimates the error of the first
//! whatever made it stop, and each such pixel stands for as many as its chance says (Horvitz and Thompson 1952). Chances follow
//! the deviation that a pixel is thought to have, so a few hundred pixels tell; a part of them does not depend on it, so a
//! deviation that is wrong is found out.

use super::estimate::{MeanSquare, Sampled};
use super::unseen::Unseen;
use crate::render::PixelStatistics;
use crate::render::SECOND_SET;
use crate::render::mix;
use crate::render::resample::SampledPixel;

/// Part of the samples of a check that is spread evenly.
const EVEN_SHARE: f64 = 0.2;

/// What sampling pixels again has shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplingCheck {
    /// Pixels that were sampled again.
    pub pixels: u32,
    /// Samples that took.
    pub samples: u64,
    /// The root mean square error that they show, over what half differences say. Above 1 where pixels stopped because their
    /// samples happened to agree; below 1 where half differences are too large, as those of stratified samples are; infinite where
    /// no pixel has halves that differ (single samples have none).
    pub bias: f64,
}

/// The samples of a check over those of the picture.
///
/// With `k` pixels the margin of the estimate is about `2 k^-1/2` of it, and what is lost to the margin costs 1.6 times as
/// many samples; `k / n + 3 k^-1/2` is least near `(2 n)^2/3`.
pub(super) fn share(pixels_total: u64) -> f64 {
    let pixels = pixels_total.max(1) as f64;
    (libm::pow(2.0 * pixels, 2.0 / 3.0) / pixels).min(1.0)
}

/// Deviations by which squares that were drawn may be above what they estimate.
const DRAW_DEVIATIONS: f64 = 2.0;

/// Which chance pixels have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plan {
    even: f64,
    slope: f64,
}

impl Plan {
    /// For pixels of which samples and deviations are given; some that stand for all will do.
    pub fn new(pixels: impl Iterator<Item = (u32, f64)>, pixels_total: u64) -> Plan {
        let share = share(pixels_total);
        let (mut samples, mut weights) = (0.0, 0.0);
        for (count, deviation) in pixels {
            samples += f64::from(count);
            weights += weight(count, deviation) * f64::from(count);
        }
        if share >= 1.0 || weights <= 0.0 {
            return Plan { even: share, slope: 0.0 };
        }
        Plan { even: EVEN_SHARE * share, slope: (1.0 - EVEN_SHARE) * share * samples / weights }
    }

    /// The chance of a pixel, above 0 and at most 1.
    pub fn chance(&self, samples: u32, deviation: f64) -> f64 {
        (self.even + self.slope * weight(samples, deviation)).min(1.0)
    }
}

/// Errors are found where they are large, and cheaply where samples are few: for an error `e` and a cost of `n`, an estimate of the
/// sum of `e^2` varies least if chances follow `e^2 n^-1/2`. As `e` is only thought to be that, its first power is safer.
fn weight(samples: u32, deviation: f64) -> f64 {
    deviation / f64::from(samples.max(1)).sqrt()
}

/// The part of the square difference between a pixel's mean of so many samples and that of as many further samples that is its own square
/// error.
///
/// The expected square difference is the sum of both square errors. They are equal on average where the pixel's samples differ as
/// such samples do. Where they hardly differ it may be wrong without a sign of it, and then its own error is the greater one: if
/// all of `n` samples lie on one side, the share `p` of the other is about `1 / n`, and so is the error of the pixel. That of the further
/// samples is known to have a square of `p / n`, and of `p n^-3/2` where the share is that on one side of an edge, as they are stratified:
/// `n^-1/2` of the pixel's.
pub(super) fn own_part(pixel: &Sampled, samples: u32) -> f64 {
    let most = pixel.half_difference.iter().fold(0.0f32, |most, x| most.max(x.abs()));
    let n = f64::from(samples);
    if f64::from(most) < 0.25 * pixel.deviation { 1.0 / (1.0 + n.sqrt().recip()) } else { 0.5 }
}

/// A pixel that was drawn.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drawn {
    /// Its index.
    pub index: usize,
    /// The chance that it had.
    pub chance: f64,
    /// Samples that it has.
    pub samples: u32,
    /// How far it stood out after its first samples.
    pub stands_out: f32,
}

/// The pixels that are drawn of those of a film for its `look`th check, and where they are. A pure function of film, seed and look.
pub(super) fn draw(
    pixels: &[Sampled],
    statistics: &[PixelStatistics],
    width: u32,
    seed: u64,
    look: u32,
) -> (Vec<Drawn>, Vec<SampledPixel>) {
    let known = || statistics.iter().zip(pixels).map(|(known, pixel)| (known.samples, pixel.deviation));
    let plan = Plan::new(known(), pixels.len() as u64);
    known()
        .enumerate()
        .filter_map(|(index, (samples, deviation))| {
            let chance = plan.chance(samples, deviation);
            // 53 bits of luck, apart from that of sample positions.
            let key =
                mix(seed ^ mix(index as u64 ^ 0x636f_6e74_726f_6c73) ^ u64::from(look).rotate_right(16));
            let luck = (key >> 11) as f64 / (1u64 << 53) as f64;
            // Films have fewer than 2^32 pixels.
            let (x, y) = (index as u32 % width, index as u32 / width);
            let stands_out = statistics[index].stands_out;
            let drawn = Drawn { index, chance, samples, stands_out };
            (luck < chance).then_some((drawn, SampledPixel { x, y, first: SECOND_SET, samples }))
        })
        .unzip()
}

/// The mean square error of `pixels`, a whole picture, from the means of further samples of those that were drawn.
pub(super) fn mean_square(
    pixels: &[Sampled],
    drawn: &[Drawn],
    again: impl Iterator<Item = [f64; 3]>,
    unseen: &Unseen,
    confidence: f64,
) -> MeanSquare {
    let squares = drawn.iter().zip(again).map(|(drawn, again)| {
        let Drawn { index, chance, samples, .. } = drawn;
        let pixel = &pixels[*index];
        let square = |channel: usize| (f64::from(pixel.mean[channel]) - again[channel]).powi(2);
        let difference = (0..3).map(square).sum::<f64>() / 3.0;
        (own_part(pixel, *samples) * difference / chance, unseen.explains(drawn, pixel, difference))
    });
    let squares: Vec<(f64, bool)> = squares.collect();
    let of = |is_explained: bool| {
        let of = squares.iter().filter(move |(_, explained)| *explained == is_explained);
        of.map(|(square, _)| *square)
    };
    // What is accounted for is not counted again, but not much more than that: as far as it may be by the luck of the draw, which is great, as few
    // are met that stand for many.
    let total = pixels.len() as u64;
    let accounted = unseen.squares(total, confidence).upper * total as f64;
    let luck = of(true).map(|square| square * square).sum::<f64>().sqrt();
    let excess = (of(true).sum::<f64>() - DRAW_DEVIATIONS * luck - accounted).max(0.0);
    MeanSquare::of_draws(of(false).chain([excess]), total, confidence)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_check_takes_its_share_and_looks_where_errors_are() {
        let share = share(1 << 14);
        assert!(share > 0.05 && share < 0.07 && super::share(3) == 1.0);
        // Half of the pixels are even, and the others need more samples.
        let pixels = (0..1u32 << 14).map(|pixel| {
            if pixel % 2 == 0 { (4, 0.0) } else { (4 << (pixel % 7), 0.01 + 1e-6 * f64::from(pixel)) }
        });
        let plan = Plan::new(pixels.clone(), 1 << 14);
        let (mut taken, mut all) = (0.0, 0.0);
        for (samples, deviation) in pixels {
            let chance = plan.chance(samples, deviation);
            assert!(chance >= EVEN_SHARE * share && chance <= 1.0);
            taken += chance * f64::from(samples);
            all += f64::from(samples);
        }
        assert!((taken / all - share).abs() < 1e-9, "{} instead of {share}", taken / all);
        assert!(plan.chance(4, 0.02) > 5.0 * plan.chance(4, 0.0));
        // Nothing is known to have an error: each has the same chance.
        let even = Plan::new((0..100).map(|_| (4, 0.0)), 1 << 14);
        assert_eq!(even.chance(4, 0.0), share);
    }

    /// Pixels that stop when samples agree, and otherwise go on: their half differences are too small, and the check knows.
    #[test]
    fn a_check_holds_what_stopping_hides() {
        const PIXELS: u64 = 6000;
        const RUNS: u32 = 40;
        let (mut held, mut held_by_halves, mut above) = (0, 0, 0.0);
        for run in 0..RUNS {
            let mut drawn = 0u64;
            let mut luck = || {
                drawn += 1;
                (mix(u64::from(run) << 40 | drawn) >> 11) as f64 / (1u64 << 53) as f64
            };
            let (mut sampled, mut known, mut truths) = (Vec::new(), Vec::new(), Vec::new());
            for pixel in 0..PIXELS {
                // A tenth of the pixels have an edge in them.
                let share = if pixel % 10 == 0 { luck() } else { 0.0 };
                let mut samples = Vec::new();
                let (mean, deviation) = loop {
                    let more = samples.len().max(4);
                    samples.extend((0..more).map(|_| f64::from(luck() < share)));
                    let count = samples.len() as f64;
                    let mean = samples.iter().sum::<f64>() / count;
                    // As far as it knows, with an edge in every fifth pixel's neighbourhood.
                    let unseen = if pixel % 10 < 2 { 1.0 / (count + 2.0) } else { 0.0 };
                    let deviation = (mean * (1.0 - mean) / count).sqrt().max(unseen);
                    if deviation < 0.18 || samples.len() == 256 {
                        break (mean, deviation);
                    }
                };
                let count = samples.len();
                let half = samples[..count / 2].iter().sum::<f64>() / (count / 2) as f64 - mean;
                let again = (0..count).map(|_| f64::from(luck() < share)).sum::<f64>() / count as f64;
                sampled.push(Sampled {
                    mean: [mean as f32; 3],
                    half_difference: [half as f32; 3],
                    deviation,
                    lost: 0.0,
                });
                known.push((count as u32, deviation, again));
                truths.push((mean - share).powi(2));
            }
            let plan = Plan::new(known.iter().map(|(count, deviation, ..)| (*count, *deviation)), PIXELS);
            let (mut drawn, mut further) = (Vec::new(), Vec::new());
            for (index, &(count, deviation, again)) in known.iter().enumerate() {
                let chance = plan.chance(count, deviation);
                if luck() < chance {
                    drawn.push(Drawn { index, chance, samples: count, stands_out: 0.0 });
                    further.push([again; 3]);
                }
            }
            let truth = truths.iter().sum::<f64>() / PIXELS as f64;
            let found = mean_square(&sampled, &drawn, further.into_iter(), &Unseen::default(), 0.9);
            held += u32::from(truth <= found.upper);
            held_by_halves += u32::from(truth <= MeanSquare::of_halves(&sampled, 0.9).upper);
            above += (found.upper / truth).sqrt() / f64::from(RUNS);
        }
        assert!(held >= RUNS * 9 / 10 - 4, "{held} of {RUNS}");
        assert!(held_by_halves < RUNS / 2, "what a check is for: {held_by_halves}");
        assert!(above < 1.3, "{above}");
    }
}
