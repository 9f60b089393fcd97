//! When a pixel has had enough samples: how far its mean may be off, estimated from the samples themselves.
//!
//! Two things make the usual `s^2 / n` wrong here. Samples are *stratified*: the mean of `n` of them is far better than that of `n`
//! independent ones (at an edge its variance falls as `n^-3/2`), and `s^2` does not see it. And the samples of a pixel at an edge are
//! *bimodal*: while all of them happen to lie on one side, `s^2` is 0 and the pixel looks finished. So:
//!
//! - *Block means.* A pixel's samples are kept as the sums of at most eight blocks of consecutive samples. In the Sobol sequence each
//!   aligned block of `2^k` samples is itself stratified, with a scramble of its own, so block means are equally good estimates of
//!   the pixel, and the variance of their mean follows from how they differ. Blocks complement each other, so this errs to the safe
//!   side: by 2.8 in variance at a straight edge, by nothing for noise that is not stratified. As few blocks may agree by
//!   chance, their deviation is widened as Student's distribution is (at 95 %).
//! - *The mode not seen.* After `n` samples on one side the share `p` of the other has, by Laplace's rule of succession, the
//!   distribution Beta(1, n + 1), with variance `(n + 1) / ((n + 2)^2 (n + 3))`. If the other mode is `D` away, the mean is off by `p D`.
//!   `D` is the contrast of the pixel with its eight neighbours, from the least to the greatest of their first samples: an edge
//!   that comes into the pixel passes through them as well. Single samples, as those are what lies on one side or the other: means
//!   of a few mix both sides, come too near to each other, and let pixels stop that are wrong. In even regions `D` is next to nothing and
//!   costs no sample.
//!
//! The variance that counts is the greater of both: once a pixel has seen its modes, its blocks tell. What neither a pixel's first
//! samples nor its neighbours' have met is not known to any estimate.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::around::{Around, FirstSamples};
use super::film::{PixelStatistics, to_f32};
use crate::geom::round_up_f32;

/// Sampling that goes on in each pixel until its error is small enough.
///
/// Every pixel gets `samples_min` samples; then their number is doubled until the half width of the confidence interval of its mean is at
/// most `error` in each channel, or [`samples_per_pixel`](super::RenderSettings::samples_per_pixel) is reached. The samples of a
/// pixel are the first of the same sequence that fixed sampling uses, and where it stops depends on its own samples
/// and on the first ones of its neighbours alone: so the picture is a pure function of scene and settings (I2).
///
/// A tile traces the first samples of the pixels around it as well, to know the contrast at its border. They are counted, so
/// counters depend on the tile size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AdaptiveSampling {
    /// Samples of every pixel before its error is looked at; a power of two. With fewer than four, pixels of even regions get
    /// fewer, and what is known of neighbours is known from fewer samples.
    pub samples_min: u32,
    /// Half width of the confidence interval at which a pixel is done: radiance, in the unit of the lights. 0 goes on to the most samples
    /// wherever samples differ at all.
    pub error: f64,
    /// Confidence that the pixel's value lies in the interval, above 0.5 and below 1. A statement of statistics, not a
    /// proof: the mean is taken as normally distributed with the variance estimated.
    pub confidence: f64,
}

impl AdaptiveSampling {
    /// How many standard deviations the interval spans on either side.
    pub(crate) fn quantile(&self) -> f64 {
        normal_quantile(0.5 + 0.5 * self.confidence)
    }
}

/// Most blocks of a pixel.
const BLOCKS: usize = 8;

/// A pixel's samples, as the sums of at most [`BLOCKS`] blocks.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SampleBlocks {
    sums: [DVec3; BLOCKS],
    samples: u32,
    /// Samples of a full block; a power of two.
    block_samples: u32,
    /// Sum over the samples of what was cut from them.
    lost: f64,
}

impl SampleBlocks {
    pub const EMPTY: SampleBlocks =
        SampleBlocks { sums: [DVec3::ZERO; BLOCKS], samples: 0, block_samples: 1, lost: 0.0 };

    /// How many blocks so many samples are, a power of two.
    pub fn count_of(samples: u32) -> u32 {
        samples.min(BLOCKS as u32)
    }

    /// Adds the next sample, with the most that it may lack.
    pub fn add(&mut self, radiance: DVec3, lost: f64) {
        if self.samples as usize == BLOCKS * self.block_samples as usize {
            for pair in 0..BLOCKS / 2 {
                self.sums[pair] = self.sums[2 * pair] + self.sums[2 * pair + 1];
            }
            self.sums[BLOCKS / 2..].fill(DVec3::ZERO);
            self.block_samples *= 2;
        }
        self.sums[(self.samples / self.block_samples) as usize] += radiance;
        self.samples += 1;
        self.lost += lost;
    }

    pub fn samples(&self) -> u32 {
        self.samples
    }

    pub fn mean(&self) -> DVec3 {
        self.sums.iter().sum::<DVec3>() / f64::from(self.samples.max(1))
    }

    /// The least and the greatest sample per channel; of blocks, once they hold more than one.
    pub fn range(&self) -> [DVec3; 2] {
        self.blocks().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], (sum, size)| {
            [low.min(sum / size), high.max(sum / size)]
        })
    }

    /// What the neighbours are held against, and what is held against them.
    pub fn first_samples(&self) -> FirstSamples {
        let [least, greatest] = self.range();
        FirstSamples { least, greatest, mean: self.mean(), blocks: self.blocks().count() as u32 }
    }

    /// The most that the mean may lack.
    pub fn lost(&self) -> f64 {
        self.lost / f64::from(self.samples.max(1))
    }

    /// Sum and size of each block that holds a sample.
    fn blocks(&self) -> impl Iterator<Item = (DVec3, f64)> + '_ {
        let full = self.samples / self.block_samples;
        let rest = self.samples % self.block_samples;
        let sizes = std::iter::repeat_n(self.block_samples, full as usize).chain((rest > 0).then_some(rest));
        self.sums.iter().copied().zip(sizes.map(f64::from))
    }

    /// Variance of the mean per channel as the blocks tell it; infinite if there are fewer than two.
    fn variance(&self) -> DVec3 {
        let mean = self.mean();
        let (mut squares, mut count) = (DVec3::ZERO, 0u32);
        for (sum, size) in self.blocks() {
            let off = sum / size - mean;
            squares += size * off * off;
            count += 1;
        }
        if count < 2 {
            return DVec3::INFINITY;
        }
        squares / (f64::from(count - 1) * f64::from(self.samples))
    }

    /// How many times wider than a normal distribution says an interval has to be, because the variance is known from so few blocks.
    fn widening(&self) -> f64 {
        student_widening(self.blocks().count().saturating_sub(1))
    }

    /// Standard deviation of the mean, in the channel where it is greatest, widened for how few blocks tell it; `contrast` is how
    /// far the other mode may be away. Of a single sample it is what that alone says.
    pub fn deviation(&self, contrast: DVec3) -> f64 {
        let unseen = unseen_variance(self.samples) * contrast * contrast;
        if self.samples == 1 {
            return unseen.max_element().sqrt();
        }
        let widening = self.widening();
        (widening * widening * self.variance()).max(unseen).max_element().sqrt()
    }

    /// Half of the difference between the mean of the first and of the second half of the samples. If the halves were independent,
    /// it would be distributed as the error of the whole mean. Zero if there is one sample.
    pub fn half_difference(&self) -> DVec3 {
        let count = self.blocks().count();
        let mean = |(sum, size): (DVec3, f64), (block_sum, block_size): (DVec3, f64)| {
            (sum + block_sum, size + block_size)
        };
        let (first, first_size) = self.blocks().take(count / 2).fold((DVec3::ZERO, 0.0), mean);
        let (second, second_size) = self.blocks().skip(count / 2).fold((DVec3::ZERO, 0.0), mean);
        if count < 2 { DVec3::ZERO } else { 0.5 * (first / first_size - second / second_size) }
    }

    /// What a film shows of them, with a deviation that was found with neighbours, and what those say.
    pub fn statistics(&self, deviation: f64, around: &Around) -> PixelStatistics {
        PixelStatistics {
            samples: self.samples(),
            deviation: deviation as f32,
            half_difference: to_f32(self.half_difference()),
            lost: round_up_f32(self.lost()),
            stands_out: around.stands_out,
            surround: around.surround,
        }
    }
}

/// Variance of the share of a mode that none of so many samples has met, by Laplace's rule of succession.
pub(crate) fn unseen_variance(samples: u32) -> f64 {
    let n = f64::from(samples);
    (n + 1.0) / ((n + 2.0) * (n + 2.0) * (n + 3.0))
}

/// Student's distribution over the normal one at 95 %, by degrees of freedom; above seven it is that of seven.
pub(crate) fn student_widening(freedom: usize) -> f64 {
    const STUDENT: [f64; BLOCKS - 1] = [6.483, 2.195, 1.624, 1.417, 1.312, 1.248, 1.206];
    STUDENT[freedom.clamp(1, BLOCKS - 1) - 1]
}

/// The `p`-quantile of the standard normal distribution, `0 < p < 1`, off by less than 2e-9 of itself (Acklam's rational
/// approximation, 2003). From `libm` and square roots, so the same on every machine (I2).
pub(crate) fn normal_quantile(p: f64) -> f64 {
    const A: [f64; 6] = [
        -3.969683028665376e1,
        2.209460984245205e2,
        -2.759285104469687e2,
        1.38357751867269e2,
        -3.066479806614716e1,
        2.506628277459239,
    ];
    const B: [f64; 6] = [
        -5.447609879822406e1,
        1.615858368580409e2,
        -1.556989798598866e2,
        6.680131188771972e1,
        -1.328068155288572e1,
        1.0,
    ];
    const C: [f64; 6] = [
        -7.784894002430293e-3,
        -3.223964580411365e-1,
        -2.400758277161838,
        -2.549732539343734,
        4.374664141464968,
        2.938163982698783,
    ];
    const D: [f64; 5] =
        [7.784695709041462e-3, 3.224671290700398e-1, 2.445134137142996, 3.754408661907416, 1.0];
    const TAIL: f64 = 0.02425;
    let polynomial = |coefficients: &[f64], x: f64| coefficients.iter().fold(0.0, |sum, c| sum * x + c);
    if p > 0.5 {
        -normal_quantile(1.0 - p)
    } else if p < TAIL {
        let x = (-2.0 * libm::log(p)).sqrt();
        polynomial(&C, x) / polynomial(&D, x)
    } else {
        let x = p - 0.5;
        x * polynomial(&A, x * x) / polynomial(&B, x * x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::Filter;
    use crate::render::sampling::pixel_offset;

    #[test]
    fn quantiles_of_the_normal_distribution() {
        for (p, expected) in [
            (0.5, 0.0),
            (0.975, 1.959963984540054),
            (0.995, 2.575829303548901),
            (0.999999, 4.753424308822899),
            (0.01, -2.326347874040841),
        ] {
            assert!((normal_quantile(p) - expected).abs() <= 2e-9 * f64::max(1.0, expected.abs()), "{p}");
        }
    }

    /// The naive twin: the samples kept.
    fn naive_variance(samples: &[f64]) -> f64 {
        let size = (samples.len().div_ceil(BLOCKS)).next_power_of_two();
        let mean = samples.iter().sum::<f64>() / samples.len() as f64;
        let blocks: Vec<&[f64]> = samples.chunks(size).collect();
        let squares: f64 = blocks
            .iter()
            .map(|block| {
                let off = block.iter().sum::<f64>() / block.len() as f64 - mean;
                block.len() as f64 * off * off
            })
            .sum();
        squares / ((blocks.len() - 1) as f64 * samples.len() as f64)
    }

    #[test]
    fn blocks_are_what_the_samples_say() {
        let samples: Vec<f64> = (0..200u32).map(|k| f64::from(k * k % 97) / 97.0).collect();
        let mut blocks = SampleBlocks::EMPTY;
        assert_eq!(blocks.variance(), DVec3::INFINITY);
        for (index, sample) in samples.iter().enumerate() {
            blocks.add(DVec3::new(*sample, 0.0, 2.0 * sample), 0.25);
            let seen = &samples[..=index];
            let mean = seen.iter().sum::<f64>() / seen.len() as f64;
            assert!((blocks.mean().x - mean).abs() < 1e-12 && blocks.lost() == 0.25);
            if seen.len() <= BLOCKS {
                let least = seen.iter().copied().fold(f64::INFINITY, f64::min);
                let greatest = seen.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                assert_eq!(blocks.range().map(|of| of.x), [least, greatest]);
            }
            if index == 0 {
                assert_eq!((blocks.variance(), blocks.half_difference()), (DVec3::INFINITY, DVec3::ZERO));
                continue;
            }
            let expected = naive_variance(seen);
            let found = blocks.variance();
            assert!((found.x - expected).abs() < 1e-12, "{index}: {found} {expected}");
            assert!((found.z - 4.0 * expected).abs() < 1e-12 && found.y == 0.0);
            if seen.len().is_power_of_two() {
                let [a, b] = [&seen[..seen.len() / 2], &seen[seen.len() / 2..]]
                    .map(|half| half.iter().sum::<f64>() / half.len() as f64);
                assert!((blocks.half_difference().x - 0.5 * (a - b)).abs() < 1e-12);
            }
        }
    }

    /// Pixels cut by a straight edge, sampled until they are done: how many are off by more than they say. This is the case
    /// that fools `s^2 / n`.
    #[test]
    fn intervals_hold_at_edges_as_often_as_they_say() {
        for (confidence, error) in [(0.9, 0.05), (0.95, 0.02), (0.99, 0.02)] {
            let adaptive = AdaptiveSampling { samples_min: 8, error, confidence };
            let (mut misses, mut plain_misses, mut samples) = (0u32, 0u32, 0u64);
            const PIXELS: u64 = 4000;
            for pixel in 0..PIXELS {
                // The edge's slope and where it cuts the pixel's middle, anywhere in the support of the filter.
                let [slope, place] = pixel_offset(77, pixel, 0, 2, Filter::Box);
                let (slope, place) = (2.0 * slope - 1.0, 2.0 * place - 0.5);
                let lit = |[x, y]: [f64; 2]| f64::from(x + slope * (y - 0.5) < place);
                let value = |sample, seed| lit(pixel_offset(seed, pixel, sample, u32::MAX, Filter::Box));
                let truth = (0..1 << 14).map(|sample| value(sample, 1)).sum::<f64>() / f64::from(1 << 14);
                let run = |is_enough: &dyn Fn(&SampleBlocks, f64) -> bool| {
                    let (mut blocks, mut squares) = (SampleBlocks::EMPTY, 0.0);
                    loop {
                        for _ in 0..blocks.samples().max(adaptive.samples_min) {
                            let sample = value(blocks.samples(), 2);
                            squares += sample * sample;
                            blocks.add(DVec3::splat(sample), 0.0);
                        }
                        if blocks.samples() == 4096 || is_enough(&blocks, squares) {
                            return blocks;
                        }
                    }
                };
                let done =
                    run(&|blocks, _| adaptive.quantile() * blocks.deviation(DVec3::ONE) <= adaptive.error);
                let plain = run(&|blocks, squares| {
                    let (n, mean) = (f64::from(blocks.samples()), blocks.mean().x);
                    let variance = (squares / n - mean * mean) / (n - 1.0);
                    adaptive.quantile() * variance.sqrt() <= adaptive.error
                });
                misses += u32::from((done.mean().x - truth).abs() > adaptive.error);
                plain_misses += u32::from((plain.mean().x - truth).abs() > adaptive.error);
                samples += u64::from(done.samples());
            }
            let allowed = (1.0 - confidence) * PIXELS as f64;
            assert!(f64::from(misses) <= allowed, "{misses} of {PIXELS} at {confidence}");
            // What it is for: the plain estimate does not keep what it says, at no great price.
            assert!(
                confidence < 0.95 || f64::from(plain_misses) > 2.0 * allowed,
                "{plain_misses} by s^2 / n"
            );
            assert!(samples / PIXELS < 512, "{samples} samples");
        }
    }
}
