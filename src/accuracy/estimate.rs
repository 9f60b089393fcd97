//! What the samples of a picture say about its error: a matter of statistics, not of proof.
//!
//! The two halves of a pixel's samples are two pictures of the same thing; half of their difference, `E`, has the distribution of
//! the picture's own error (a little wider, as the halves of a stratified set complement each other). That is so whether or not a
//! pixel's samples happened to see both sides of an edge: the estimate is over all pixels, not for each. Where samples had a say in
//! stopping, it is so no longer, and [`check`](super::check) says how large errors are.
//!
//! An upper estimate holds the error of *this* picture, which has luck of its own beside that of the estimate. So the variance that it
//! allows for is that of their difference.

use std::cell::OnceCell;
use std::ops::Deref;

use super::Metric;
use super::flip::{Seen, error_map_bound};
use super::greatest::Deviations;
use super::metric::mean;
use super::unseen::Unseen;
use crate::render::{mix, normal_quantile, student_widening};

/// An estimated error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// How the error is measured.
    pub metric: Metric,
    /// The best guess.
    pub value: f64,
    /// Above the error of sampling with the certificate's confidence; in [`Metric::Flip`] what was cut off is in it.
    pub upper: f64,
    /// Above the whole error: what is proven of what was cut off and what is estimated, together.
    pub whole: f64,
}

/// What is known about a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sampled {
    pub mean: [f32; 3],
    pub half_difference: [f32; 3],
    pub deviation: f64,
    pub lost: f64,
}

impl Sampled {
    /// Square of the half difference, over the channels.
    pub fn square(&self) -> f64 {
        mean_square(&self.half_difference)
    }
}

/// What is known of the pixels of a picture, row by row, and what the eye makes of it once somebody asks.
pub(super) struct Pixels {
    all: Vec<Sampled>,
    width: u32,
    seen: OnceCell<Seen>,
}

impl Pixels {
    /// # Panics
    /// When the eye is asked, if they are no whole number of rows.
    pub fn new(all: Vec<Sampled>, width: u32) -> Pixels {
        Pixels { all, width, seen: OnceCell::new() }
    }

    fn means(&self) -> Vec<[f32; 3]> {
        self.all.iter().map(|pixel| pixel.mean).collect()
    }

    fn seen(&self) -> &Seen {
        self.seen.get_or_init(|| Seen::of(&self.means(), self.width as usize))
    }
}

impl Deref for Pixels {
    type Target = [Sampled];

    fn deref(&self) -> &[Sampled] {
        &self.all
    }
}

/// Mean of the squares of three channels.
pub(super) fn mean_square(channels: &[f32; 3]) -> f64 {
    channels.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / 3.0
}

/// The square of the error of finitely many samples, mean over all channels of all pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MeanSquare {
    /// The best guess.
    pub value: f64,
    /// Above it with the confidence asked for.
    pub upper: f64,
}

impl MeanSquare {
    /// From the half differences of all pixels, where samples had no say in stopping.
    ///
    /// Let `x` and `y` be the errors of both halves of a pixel: its square error is `((x + y) / 2)^2`, its squared half difference
    /// `((x - y) / 2)^2`, and they differ by `x y`. Its variance, `E[x^2]^2`, is at most twice the mean fourth power of half
    /// differences, whatever the distribution.
    pub fn of_halves(pixels: &[Sampled], confidence: f64) -> MeanSquare {
        let terms = pixels.iter().map(|pixel| (pixel.square(), 2.0 * pixel.square().powi(2)));
        MeanSquare::of_sums(terms, pixels.len() as u64, confidence)
    }

    /// From square errors of pixels that were drawn, each over its chance.
    ///
    /// The variance of the difference between their sum and the sum of all square errors is at most the sum of their squares if both
    /// means of a pixel are equally distributed.
    pub fn of_draws(squares: impl Iterator<Item = f64>, pixels_total: u64, confidence: f64) -> MeanSquare {
        MeanSquare::of_sums(squares.map(|square| (square, square * square)), pixels_total, confidence)
    }

    /// From terms and, for each, the variance of what it is off by.
    pub fn of_sums(
        terms: impl Iterator<Item = (f64, f64)>,
        pixels_total: u64,
        confidence: f64,
    ) -> MeanSquare {
        let (mut sum, mut variances, mut cubes) = (0.0, 0.0, 0.0);
        for (term, variance) in terms {
            sum += term;
            variances += variance;
            cubes += term * term * term;
        }
        let count = pixels_total.max(1) as f64;
        let upper = sum + margin(variances, cubes, normal_quantile(confidence));
        MeanSquare { value: sum / count, upper: upper / count }
    }

    /// With another one beside it.
    pub fn plus(self, other: MeanSquare) -> MeanSquare {
        MeanSquare { value: self.value + other.value, upper: self.upper + other.upper }
    }

    /// From what square errors of pixels are thought to be, and the chances that they would have in a check: what is to be expected
    /// of the check of a picture of `pixels_total` pixels. Its margin, and two deviations of what is thought, as another
    /// certificate has its price.
    pub fn expected(probed: &[(f64, f64)], pixels_total: u64, confidence: f64) -> MeanSquare {
        let count = probed.len().max(1) as f64;
        let (mut sum, mut squares, mut drawn, mut cubes) = (0.0, 0.0, 0.0, 0.0);
        for (square, chance) in probed {
            sum += square;
            squares += square * square;
            drawn += square * square / chance;
            cubes += square * square * square / (chance * chance);
        }
        let value = sum / count;
        let own = ((squares / count - value * value).max(0.0) / count).sqrt();
        let total = pixels_total.max(1) as f64;
        let scale = total / count;
        let margin = margin(scale * drawn, scale * cubes, normal_quantile(confidence)) / total;
        MeanSquare { value, upper: value + 2.0 * own + margin }
    }
}

/// How far a sum of positive terms may lie below what it estimates, from its variance and the sum of their cubes. The second part
/// is for skewness (Johnson 1978): few large terms make a sum that is mostly too low. It is about the largest term once more: one
/// like it may have been missed.
fn margin(squares: f64, cubes: f64, quantile: f64) -> f64 {
    if squares <= 0.0 {
        return 0.0;
    }
    quantile * squares.sqrt() + (2.0 * quantile * quantile + 1.0) / 6.0 * cubes / squares
}

/// Side of the blocks of pixels whose means are taken as independent: well above the reach of FLIP's filters.
const BLOCK_SIDE: usize = 16;

/// Estimates an error from `pixels`, which stand for a picture of `pixels_total` pixels. What pixels have missed is
/// not in `squares`.
pub(super) fn estimate(
    metric: Metric,
    pixels: &Pixels,
    squares: MeanSquare,
    unseen: &Unseen,
    pixels_total: u64,
    confidence: f64,
) -> Estimate {
    let (value, upper) = match metric {
        Metric::Rmse => {
            let squares = squares.plus(unseen.squares(pixels_total, confidence));
            (squares.value.sqrt(), squares.upper.sqrt())
        }
        Metric::Max => {
            let halves = pixels.iter().flat_map(|pixel| pixel.half_difference);
            let value = halves.fold(0.0, |most: f64, x| most.max(f64::from(x.abs())));
            let share = pixels_total as f64 / pixels.len().max(1) as f64;
            let deviations = Deviations::new(pixels.iter().map(|pixel| pixel.deviation));
            (value, deviations.limit(1.0 - confidence, share, f64::INFINITY, unseen))
        }
        Metric::Flip => flip(pixels, squares, unseen, pixels_total, confidence),
    };
    let cut = cut_off(metric, pixels.iter().map(|pixel| pixel.lost)).unwrap_or(0.0);
    Estimate { metric, value, upper, whole: together(metric, upper, cut, pixels, pixels_total) }
}

/// The picture beside noisier ones: what FLIP makes of noise as large as the error, in this picture.
///
/// That the noise has the error's distribution is not enough. FLIP takes the *difference of the strengths* of features, and noise
/// on top of noise changes them less than the first noise changed the truth. [`error_map_bound`] takes the strength of the difference,
/// which is the same in distribution for the error and for the noise, and at least what FLIP takes.
fn flip(
    pixels: &Pixels,
    squares: MeanSquare,
    unseen: &Unseen,
    pixels_total: u64,
    confidence: f64,
) -> (f64, f64) {
    let quantile = normal_quantile(confidence);
    let (means, width) = (pixels.means(), pixels.width as usize);
    // With noise as large as it may be; twice, with signs that are independent: maps that differ as that of the error will differ
    // from them.
    let maps = [Signs::Kept, Signs::Drawn].map(|signs| {
        let mut noisy = noisy(pixels, squares.upper, signs);
        unseen.put_met(&mut noisy, &means);
        unseen.put_missed(&mut noisy, confidence, u64::from(signs == Signs::Drawn));
        error_map_bound(&Seen::of(&noisy, width), pixels.seen())
    });
    let most = 0.5 * (mean(&maps[0]) + mean(&maps[1]));
    let differences: Vec<f64> = maps[0].iter().zip(&maps[1]).map(|(a, b)| a - b).collect();
    let blocks = block_sums(&differences, width);
    let count = pixels.len().max(1) as f64;
    let spread = blocks.iter().map(|block| block * block).sum::<f64>().sqrt() / count;
    let margin = if pixels_total as usize > pixels.len() {
        // A part that stands for all: its own error, one deviation of it, and the margin that there will be.
        spread * (1.0 + quantile * (count / pixels_total as f64).sqrt())
    } else {
        spread * quantile * student_widening(blocks.len())
    };
    let less = if squares.upper > 0.0 { squares.value / squares.upper } else { 1.0 };
    (most * libm::pow(less, 0.5 * FLIP_POWER), most + margin)
}

/// FLIP grows with the error about to this power.
pub(super) const FLIP_POWER: f64 = 0.8;

/// What [`estimate`] of FLIP is about, at a third of the work: noise of the size that is held, once, and no margin for its luck.
pub(super) fn flip_expected(pixels: &Pixels, squares: MeanSquare, unseen: &Unseen, confidence: f64) -> f64 {
    let mut noisy = noisy(pixels, squares.upper, Signs::Kept);
    unseen.put_met(&mut noisy, &pixels.means());
    unseen.put_missed(&mut noisy, confidence, 0);
    mean(&error_map_bound(&Seen::of(&noisy, pixels.width as usize), pixels.seen()))
}

/// What FLIP makes of what pixels have missed, alone.
pub(super) fn unseen_flip(pixels: &Pixels, unseen: &Unseen, confidence: f64) -> f64 {
    let mut whole = pixels.means();
    unseen.put_missed(&mut whole, confidence, 0);
    mean(&error_map_bound(&Seen::of(&whole, pixels.width as usize), pixels.seen()))
}

/// Which sign noise has.
#[derive(Clone, Copy, PartialEq)]
enum Signs {
    /// That of half differences.
    Kept,
    /// Changed by luck in half of the pixels.
    Drawn,
}

/// The picture with noise of a mean square, and without what was cut off, which is missing everywhere. The noise is the half
/// differences. What they lack in square goes to pixels by the square of their deviations: there, the samples may all have been on
/// one side.
fn noisy(pixels: &[Sampled], mean_square: f64, signs: Signs) -> Vec<[f32; 3]> {
    let count = pixels.len().max(1) as f64;
    let halves = pixels.iter().map(Sampled::square).sum::<f64>() / count;
    let deviations = pixels.iter().map(|pixel| pixel.deviation.powi(2)).sum::<f64>() / count;
    let scale = if halves > 0.0 { (mean_square / halves).min(1.0) } else { 0.0 };
    let lacking = (mean_square - halves).max(0.0);
    (0u64..)
        .zip(pixels)
        .map(|(index, pixel)| {
            let luck = mix(index);
            let share = if deviations > 0.0 { pixel.deviation.powi(2) / deviations } else { 1.0 };
            let turn = if signs == Signs::Drawn && luck & 1 == 1 { -1.0 } else { 1.0 };
            [0, 1, 2].map(|channel| {
                let half = f64::from(pixel.half_difference[channel]);
                let size = (scale * half * half + lacking * share).sqrt();
                let sign = if half != 0.0 {
                    half.signum()
                } else if luck & 2 == 2 {
                    -1.0
                } else {
                    1.0
                };
                (f64::from(pixel.mean[channel]) + turn * sign * size + pixel.lost) as f32
            })
        })
        .collect()
}

/// How many deviations hold every channel of every pixel at once with this confidence, if all have the same (Bonferroni).
pub(super) fn max_quantile(pixels_total: u64, confidence: f64) -> f64 {
    normal_quantile(1.0 - (1.0 - confidence) / (6.0 * pixels_total.max(1) as f64))
}

/// The most that cutting off adds to the error, if there is a proof: `None` for FLIP, whose estimate holds it.
pub(super) fn cut_off(metric: Metric, lost: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let count = lost.len().max(1) as f64;
    match metric {
        Metric::Rmse => Some((lost.map(|lost| lost * lost).sum::<f64>() / count).sqrt()),
        Metric::Max => Some(lost.fold(0.0, f64::max)),
        Metric::Flip => None,
    }
}

/// The whole error, of which sampling makes at most `sampling` and cutting off at most `cut`: for FLIP, whose estimate holds both,
/// `sampling`.
///
/// Cutting off takes light away from each pixel, the same whatever the samples, and sampling adds noise without a bias. So in the
/// mean over a picture their squares add up, and not they: `|n - b|^2 = |n|^2 + |b|^2 - 2 n b`, where `n b` has the mean 0 and, as
/// pixels are independent of each other, at most the variance `9 sum B^2 s^2` for what pixels lack, `B`, and their deviations, `s`,
/// in any of three channels. It is allowed [`CROSS_QUANTILE`] deviations.
fn together(metric: Metric, sampling: f64, cut: f64, pixels: &[Sampled], pixels_total: u64) -> f64 {
    match metric {
        Metric::Flip => sampling,
        Metric::Max => sampling + cut,
        Metric::Rmse => {
            let products: f64 = pixels.iter().map(|pixel| (pixel.lost * pixel.deviation).powi(2)).sum();
            // Mean over the channels of the picture; the pixels at hand may stand for more.
            let variance = products / pixels.len().max(1) as f64 / pixels_total.max(1) as f64;
            let cross = 2.0 * CROSS_QUANTILE * variance.sqrt();
            (sampling * sampling + cut * cut + cross).sqrt().min(sampling + cut)
        }
    }
}

/// Deviations that a sum of many independent terms stays within, but for one time in 1,000.
const CROSS_QUANTILE: f64 = 3.1;

/// How large the error of sampling may be if cutting off adds up to `cut`; see [`together`].
pub(super) fn sampling_room(metric: Metric, bound: f64, cut: f64) -> f64 {
    match metric {
        Metric::Rmse => (bound * bound - cut * cut).max(0.0).sqrt(),
        Metric::Max | Metric::Flip => (bound - cut).max(0.0),
    }
}

/// What FLIP makes of all that may have been cut off: not a proof, as its filters do not know where light is missing.
pub(super) fn flip_cut_off(pixels: &[Sampled], width: u32) -> f64 {
    let means: Vec<[f32; 3]> = pixels.iter().map(|pixel| pixel.mean).collect();
    let [picture, whole] =
        [means, noisy(pixels, 0.0, Signs::Kept)].map(|pixels| Seen::of(&pixels, width as usize));
    mean(&error_map_bound(&whole, &picture))
}

/// Sums over squares of [`BLOCK_SIDE`] pixels, those at the border included.
fn block_sums(map: &[f64], width: usize) -> Vec<f64> {
    let columns = width.div_ceil(BLOCK_SIDE);
    let rows = (map.len() / width.max(1)).div_ceil(BLOCK_SIDE);
    let mut sums = vec![0.0; columns * rows];
    for (index, value) in map.iter().enumerate() {
        let (x, y) = (index % width / BLOCK_SIDE, index / width / BLOCK_SIDE);
        sums[y * columns + x] += value;
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    const SIDE: u32 = 64;
    const RUNS: u32 = 40;

    /// Normal noise, seeded.
    fn noise() -> impl FnMut() -> f64 {
        let mut random = Random::new(1);
        let mut uniform = move || random.unit();
        move || (-2.0 * (1.0 - uniform()).ln()).sqrt() * (std::f64::consts::TAU * uniform()).cos()
    }

    /// How often upper estimates at 90 % hold pictures of `truth` whose half means are off by `sigma` times noise, and the median of
    /// what they are above the error.
    fn held_of(truth: impl Fn(u32, u32) -> f64, sigma: impl Fn(u32, u32) -> f64) -> ([u32; 3], [f64; 3]) {
        let mut normal = noise();
        let (mut held, mut ratios) = ([0; 3], [(); 3].map(|()| Vec::new()));
        for _ in 0..RUNS {
            let (mut truths, mut sampled) = (Vec::new(), Vec::new());
            for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                let (truth, sigma) = (truth(x, y), sigma(x, y));
                truths.push([truth as f32; 3]);
                let [a, b] = [(); 2].map(|()| [(); 3].map(|()| truth + sigma * normal()));
                sampled.push(Sampled {
                    mean: [0, 1, 2].map(|c| (0.5 * (a[c] + b[c])) as f32),
                    half_difference: [0, 1, 2].map(|c| (0.5 * (a[c] - b[c])) as f32),
                    deviation: sigma / 2f64.sqrt(),
                    lost: 0.0,
                });
            }
            let found: Vec<[f32; 3]> = sampled.iter().map(|pixel| pixel.mean).collect();
            let sampled = Pixels::new(sampled, SIDE);
            let squares = MeanSquare::of_halves(&sampled, 0.9);
            for (index, metric) in Metric::ALL.into_iter().enumerate() {
                let total = u64::from(SIDE * SIDE);
                let estimate = estimate(metric, &sampled, squares, &Unseen::default(), total, 0.9);
                let error = metric.distance(&truths, &found, SIDE);
                held[index] += u32::from(error <= estimate.upper);
                ratios[index].push(estimate.upper / error);
                // The greatest of many is a matter of luck.
                let luck = if metric == Metric::Max { 1.6 } else { 1.25 };
                assert!(
                    luck * estimate.value > error && estimate.value < luck * error,
                    "{estimate:?}, in fact {error}"
                );
                assert!(estimate.upper < 2.0 * error, "{estimate:?}, in fact {error}");
            }
        }
        let median = |mut ratios: Vec<f64>| {
            ratios.sort_by(f64::total_cmp);
            ratios[ratios.len() / 2]
        };
        (held, ratios.map(median))
    }

    /// Pixels with a normal error that is known: the estimates hold it as often as they say, and are not far above it. Flat, where a
    /// comparison of two noisy pictures sees less than one with the truth; and with edges, some of which are noisier.
    #[test]
    fn estimates_hold_noise_that_is_known() {
        // Nine of ten, less two deviations of luck.
        let enough = RUNS * 9 / 10 - 4;
        for (name, (held, above)) in [
            ("flat", held_of(|_, _| 0.5, |_, _| 0.02)),
            (
                "edges",
                held_of(
                    |x, y| if (3 * x + 2 * y) % 60 < 30 { 0.75 } else { 0.2 },
                    |x, y| if (3 * x + 2 * y) % 30 < 4 && y < 40 { 0.06 } else { 0.003 },
                ),
            ),
        ] {
            assert!(held.iter().all(|held| *held >= enough), "{name}: {held:?} of {RUNS}");
            assert!(above[0] < 1.1 && above[2] < 1.25, "{name}: {above:?}");
        }
    }

    #[test]
    fn noise_has_the_mean_square_asked_for() {
        let mut normal = noise();
        let pixels: Vec<Sampled> = (0..SIDE * SIDE)
            .map(|index| Sampled {
                mean: [0.5; 3],
                // Every third pixel has samples that agree.
                half_difference: [(); 3]
                    .map(|()| if index % 3 == 0 { 0.0 } else { (0.01 * normal()) as f32 }),
                deviation: 0.02,
                lost: 0.0,
            })
            .collect();
        let own = MeanSquare::of_halves(&pixels, 0.9).value;
        for (factor, signs) in
            [(0.5, Signs::Kept), (1.0, Signs::Kept), (2.0, Signs::Kept), (2.0, Signs::Drawn)]
        {
            let noisy = noisy(&pixels, factor * own, signs);
            let squares: f64 = noisy.iter().flatten().map(|x| f64::from(x - 0.5).powi(2)).sum();
            let found = squares / (3 * noisy.len()) as f64;
            assert!((found / (factor * own) - 1.0).abs() < 1e-4, "{found}, not {factor} of {own}");
            // What agrees gets its share of what is lacking.
            assert_eq!(noisy[0] != [0.5; 3], factor > 1.0);
        }
    }

    /// Pictures that lack light, as much as is said or less, and have noise: squares add up, and what is not proven of that holds.
    #[test]
    fn what_is_cut_off_and_noise_add_up_in_squares() {
        let mut normal = noise();
        let (mut held, mut below_sum) = (0, 0);
        for run in 0..RUNS {
            let (mut sum, mut pixels) = (0.0, Vec::new());
            for index in 0..SIDE * SIDE {
                // Most of it in few pixels; noise there, too.
                let lost = if index % 16 == run % 16 { 0.04 } else { 0.001 };
                let sigma = if index % 8 == 0 { 0.03 } else { 0.005 };
                let errors = [(); 3].map(|()| sigma * normal() - lost);
                sum += errors.iter().map(|error| error * error).sum::<f64>() / 3.0;
                pixels.push(Sampled { mean: [0.0; 3], half_difference: [0.0; 3], deviation: sigma, lost });
            }
            let count = f64::from(SIDE * SIDE);
            let sampling = (pixels.iter().map(|pixel| pixel.deviation.powi(2)).sum::<f64>() / count).sqrt();
            let cut = cut_off(Metric::Rmse, pixels.iter().map(|pixel| pixel.lost)).unwrap();
            let whole = together(Metric::Rmse, 1.03 * sampling, cut, &pixels, u64::from(SIDE * SIDE));
            held += u32::from((sum / count).sqrt() <= whole);
            below_sum += u32::from(whole < 0.85 * (sampling + cut));
            // A part that stands for a larger picture says much the same.
            let part: Vec<Sampled> = pixels[..2048].to_vec();
            let of_part = together(Metric::Rmse, 1.03 * sampling, cut, &part, u64::from(SIDE * SIDE));
            assert!((of_part / whole - 1.0).abs() < 1e-3);
        }
        assert_eq!((held, below_sum), (RUNS, RUNS));
        assert_eq!(sampling_room(Metric::Rmse, 5.0, 3.0), 4.0);
        assert_eq!(sampling_room(Metric::Max, 5.0, 3.0), 2.0);
        assert_eq!(sampling_room(Metric::Rmse, 1.0, 2.0), 0.0);
    }

    #[test]
    fn what_is_cut_off_adds_up() {
        let lost = [0.0, 0.3, 0.4, 0.0];
        assert_eq!(cut_off(Metric::Rmse, lost.into_iter()), Some(0.25));
        assert_eq!(cut_off(Metric::Max, lost.into_iter()), Some(0.4));
        assert_eq!(cut_off(Metric::Flip, lost.into_iter()), None);
        let pixels = |lost: f64| {
            let pixel = Sampled { mean: [0.5; 3], half_difference: [0.1, -0.1, 0.0], deviation: 0.1, lost };
            vec![pixel; 64]
        };
        let whole = [[0.51f32; 3]; 64];
        let error = Metric::Flip.distance(&whole, &[[0.5; 3]; 64], 8);
        let found = flip_cut_off(&pixels(0.01), 8);
        assert!((found / error - 1.0).abs() < 1e-4, "{found}, not {error}");
        assert!(flip_cut_off(&pixels(0.0), 8) < 1e-9);
    }
}
