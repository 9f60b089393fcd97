//! Features much smaller than a pixel, far apart: some pixels have met theirs, others have missed it, look finished and are wrong.
//!
//! Of features that cover a share `c` of a pixel and stand out by `D`, the first `n` samples meet one with a chance of `q = n c`. A pixel
//! that met one by one sample stands out from its neighbours by `x = D / n` then, and by `m = c D = q x` in truth. So what it is over what
//! it was first is the chance that it had, and as each pixel that was drawn stands for as many as its chance says (Horvitz and Thompson
//! 1952), it stands for `(1 - q) / q = (x - m) / m` others, which have missed their feature and lack `m`. Their square errors add up to
//! `m (x - m)`. What `m` is, further samples of the pixel tell: there are few such pixels. `docs/accuracy.md` derives it.

use glam::Vec3;

use super::check::Drawn;
use super::estimate::{MeanSquare, Sampled};
use crate::render::adaptive::SampleBlocks;
use crate::render::around::{Around, FirstSamples, look_around};
use crate::render::resample::SampledPixel;
use crate::render::{SECOND_SET, mix, unseen_variance};

/// Further samples of a pixel that has met something, unless it has more: at most and at least so many times its first ones, and so many at
/// most and at least.
const CLOSER_TIMES: [u32; 2] = [64, 16];
const CLOSER: [u32; 2] = [2048, 64];
/// How far single samples stand out over how far those of the neighbours lie apart: less is a matter of luck. Means of several stand
/// out less by luck than each of them.
const CLEAR: f64 = 2.0;
/// Part of the first samples of a picture that all of these may be, and how many per pixel.
const CLOSER_SHARE: f64 = 0.25;
const CLOSER_PER_PIXEL: f64 = 1.0;
/// Deviation of the mean of one stratified sample of a pixel with an edge in it, from black to white; that of `n` is `n^-3/4` of it. And how
/// many deviations a pixel may be off.
const EDGE: f64 = 0.5;
const DEVIATIONS: f64 = 2.0;
/// Deviations from which on a difference is sudden.
const SUDDEN: f64 = 4.0;
/// The least chance of having been met that is thought of: the less, the more pixels have missed a feature, which is fainter in them.
const CHANCE_MIN: f64 = 0.01;

/// Features much smaller than a pixel that pixels have missed, by what others have met (`docs/accuracy.md`). They are in all estimates of the
/// certificate, except RMSE where samples are fixed, whose halves tell of them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissedFeatures {
    /// Pixels that stand out from their neighbours by a single one of their first samples, where pixels that had not met anything would have
    /// stopped.
    pub met: u32,
    /// How many pixels have missed one like it, on average over luck.
    pub missed: f64,
    /// The root mean square error that this adds to the picture's.
    pub rmse: f64,
}

/// A pixel that has met what its neighbours have not.
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    index: usize,
    /// Which further samples of it are to be taken.
    pub place: SampledPixel,
    /// By how much it stood out after its first samples.
    first: f64,
    /// How far samples of its neighbours lay apart.
    surround: f64,
    /// For how many like it it stands.
    weight: f64,
}

/// A feature that was met.
#[derive(Clone, Copy, Debug)]
struct Met {
    /// The pixel, what it was with its first samples, and what it is by further ones.
    index: usize,
    shown: [f32; 3],
    mean: [f64; 3],
    /// By how much the pixel stood out after its first samples: root mean square over the channels.
    first: f64,
    /// How far samples of its neighbours lay apart.
    surround: f64,
    /// By how much it stands out in truth, per channel.
    colour: [f64; 3],
    /// The same, root mean square, and the standard deviation of it.
    size: f64,
    off: f64,
    /// For how many like it it stands.
    weight: f64,
}

impl Met {
    /// The chance that it had.
    fn chance(&self) -> f64 {
        (self.size / self.first).clamp(CHANCE_MIN, 1.0)
    }

    /// How many pixels have missed one like it.
    fn missed(&self) -> f64 {
        let chance = self.chance();
        self.weight * (1.0 - chance) / chance
    }

    /// Sum of the square errors of these. That of what further samples are off would be missing from it, as it takes their square away.
    fn square(&self) -> f64 {
        let taken = if self.size < self.first { self.weight * self.off * self.off } else { 0.0 };
        self.missed() * self.size * self.size + taken
    }

    /// What no channel of it is above.
    fn greatest(&self) -> f64 {
        greatest(&self.colour) * (1.0 + DEVIATIONS * self.off / self.size.max(f64::MIN_POSITIVE))
    }

    /// As it would be with so many times the first samples: what has been met then can be missed no longer.
    fn with_times(&self, times: f64) -> Met {
        let first = (self.first / times).max(self.size);
        // More of them would have been met.
        Met {
            first,
            weight: self.weight * (self.size / first).clamp(CHANCE_MIN, 1.0) / self.chance(),
            ..*self
        }
    }
}

/// What is known of features that pixels have missed.
#[derive(Clone, Debug, Default)]
pub(super) struct Unseen {
    met: Vec<Met>,
    samples_first: u32,
    /// What stood out most.
    first_most: f64,
}

/// Whether a pixel stands out for more than luck, by what it and its neighbours are with so many blocks of samples.
fn is_out([stands_out, surround]: [f32; 2], blocks: u32) -> bool {
    f64::from(stands_out) > CLEAR / f64::from(blocks).sqrt() * f64::from(surround)
}

/// Further samples for each of `count` pixels that stand out among `total` with so many first ones, and how many may have them: as many as there
/// is room for, of all; if even the fewest are too many, of some.
fn closer(count: usize, total: usize, samples_first: u32) -> (u32, f64) {
    let [most, least] = CLOSER_TIMES
        .map(|times| samples_first.saturating_mul(times).clamp(CLOSER[1], CLOSER[0]).max(samples_first));
    let per_pixel = (CLOSER_SHARE * f64::from(samples_first)).min(CLOSER_PER_PIXEL);
    let room = (per_pixel * total as f64).max(f64::from(least));
    let each = room / count as f64;
    let halves = std::iter::successors(Some(most), |samples| Some(samples / 2));
    let fitting = halves.take_while(|samples| *samples > least).find(|samples| f64::from(*samples) <= each);
    let samples = fitting.unwrap_or(least);
    (samples, (room / f64::from(samples)).min(count as f64))
}

/// Samples that it takes to look closer at a picture like this, adaptive.
pub(super) fn samples_closer(around: impl Iterator<Item = [f32; 2]>, samples_first: u32) -> f64 {
    let blocks = SampleBlocks::count_of(samples_first);
    let (mut count, mut total) = (0, 0);
    for around in around {
        count += usize::from(is_out(around, blocks));
        total += 1;
    }
    let (samples, looked_at) = closer(count, total, samples_first);
    f64::from(samples) * looked_at
}

/// Pixels that stand out. `around`: of each pixel, how far it stood out after its first `samples_first` samples, and how far those of its
/// neighbours lay apart, or the means of so many `blocks` of them.
pub(super) fn candidates(
    around: impl ExactSizeIterator<Item = [f32; 2]> + Clone,
    width: u32,
    samples_first: u32,
    blocks: u32,
    seed: u64,
) -> Vec<Candidate> {
    let total = around.len();
    let out = around.enumerate().filter(|(_, around)| is_out(*around, blocks));
    let count = out.clone().count();
    let (samples, looked_at) = closer(count, total, samples_first);
    let chance = looked_at / count as f64;
    let key = mix(seed ^ 0x6c6f_6f6b_2063_6c6f ^ u64::from(samples_first).rotate_right(16));
    let drawn = out.filter(|(index, _)| unit(mix(*index as u64 ^ key)) < chance);
    drawn
        .map(|(index, [first, surround])| {
            let [first, surround] = [first, surround].map(f64::from);
            // Films have fewer than 2^32 pixels.
            let (x, y) = (index as u32 % width, index as u32 / width);
            let weight = (1.0 / chance).max(1.0);
            let place = SampledPixel { x, y, first: SECOND_SET, samples };
            Candidate { index, place, first, surround, weight }
        })
        .collect()
}

/// What [`candidates`] asks of each pixel, for a picture with fixed samples, so many.
pub(super) fn stands_out(pixels: &[Sampled], width: u32, samples: u32) -> Vec<[f32; 2]> {
    let size = [width as usize, pixels.len() / width.max(1) as usize];
    let first = |x: usize, y: usize| {
        let pixel = &pixels[y * size[0] + x];
        let [mean, half] = [pixel.mean, pixel.half_difference].map(|of| Vec3::from(of).as_dvec3());
        // A single sample has no halves.
        let blocks = if samples > 1 { 2 } else { 1 };
        FirstSamples { least: mean - half.abs(), greatest: mean + half.abs(), mean, blocks }
    };
    let places = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| [x, y]));
    places
        .map(|place| {
            let Around { stands_out, surround, .. } = look_around(size, place, first);
            [stands_out, surround]
        })
        .collect()
}

impl Unseen {
    /// From the means of further samples of pixels that stand out.
    pub fn of(
        pixels: &[Sampled],
        width: u32,
        samples_first: u32,
        candidates: &[Candidate],
        further: impl Iterator<Item = [f64; 3]>,
    ) -> Unseen {
        let met = candidates.iter().zip(further).map(|(candidate, mean)| {
            let &Candidate { index, place, first, surround, weight } = candidate;
            let shown = pixels[index].mean;
            let colour = beyond_neighbours(pixels, width as usize, index, mean);
            let size = root_mean_square(&colour);
            // The faintest that is thought of looks as what stands out in the picture.
            let least = CHANCE_MIN * first;
            let further = f64::from(place.samples);
            let whole = first * f64::from(samples_first);
            // No worse than samples that are not stratified.
            let off =
                (EDGE * whole * libm::pow(further, -0.75)).min((size.max(least) * whole / further).sqrt());
            if size >= least {
                return Met { index, shown, mean, first, surround, colour, size, off, weight };
            }
            let out = beyond_neighbours(pixels, width as usize, index, shown.map(f64::from));
            let over = root_mean_square(&out);
            let colour = if over > 0.0 { out.map(|channel| channel * least / over) } else { [least; 3] };
            Met { index, shown, mean, first, surround, colour, size: least, off, weight }
        });
        Unseen::new(met.collect(), samples_first)
    }

    fn new(met: Vec<Met>, samples_first: u32) -> Unseen {
        let first_most = met.iter().fold(0.0, |most: f64, met| most.max(met.first));
        Unseen { met, samples_first, first_most }
    }

    /// What pixels miss that stop at a deviation.
    pub fn at(&self, deviation: f64) -> Unseen {
        self.at_each(|_| deviation)
    }

    /// What pixels miss if each stops at a deviation of its own.
    pub fn at_each(&self, deviation: impl Fn(usize) -> f64) -> Unseen {
        let share = unseen_variance(self.samples_first).sqrt();
        let met = self.met.iter().filter(|met| share * met.surround <= deviation(met.index));
        Unseen::new(met.copied().collect(), self.samples_first)
    }

    /// What would be missed with so many times the first samples.
    pub fn with_times(&self, times: u32) -> Unseen {
        let met = self.met.iter().map(|met| met.with_times(f64::from(times)));
        Unseen::new(met.collect(), self.samples_first.saturating_mul(times))
    }

    /// The mean square error that this adds to a picture of so many pixels.
    pub fn squares(&self, pixels_total: u64, confidence: f64) -> MeanSquare {
        // A term is held against the luck of those that it stands for.
        let terms = self.met.iter().map(|met| {
            let square = met.square();
            (square, square * (square + met.size * met.size))
        });
        MeanSquare::of_sums(terms, pixels_total, confidence)
    }

    /// What a certificate says of it, for a picture of so many pixels.
    pub fn found(&self, pixels_total: u64) -> MissedFeatures {
        // More than there are pixels there cannot be.
        let missed = self.met.iter().map(Met::missed).sum::<f64>().min(pixels_total as f64);
        let rmse = self.met.iter().map(Met::square).sum::<f64>() / pixels_total.max(1) as f64;
        // Films have fewer than 2^32 pixels. Sums of nothing are -0.
        MissedFeatures { met: self.met.len() as u32, missed: missed + 0.0, rmse: (rmse + 0.0).sqrt() }
    }

    /// How many pixels may lack more than `limit` in a channel.
    pub fn missed_above(&self, limit: f64) -> f64 {
        let above = self.met.iter().filter(|met| met.greatest() > limit);
        above.map(Met::missed).sum()
    }

    /// Nothing lacks more than this in any channel.
    pub fn greatest(&self) -> f64 {
        self.met.iter().fold(0.0, |most, met| most.max(met.greatest()))
    }

    /// Whether the square difference between a pixel and further samples of it shows no more than that it has missed a feature like those that
    /// were met.
    pub fn explains(&self, drawn: &Drawn, pixel: &Sampled, difference: f64) -> bool {
        let difference = difference.sqrt();
        let has_met = 2.0 * f64::from(drawn.stands_out) > difference;
        let is_sudden = difference > SUDDEN * pixel.deviation;
        drawn.samples == self.samples_first && !has_met && is_sudden && difference <= self.first_most
    }

    pub fn is_empty(&self) -> bool {
        self.met.is_empty()
    }

    /// Puts what is known of pixels that have met something into `picture`, where `pixels` still are what they were with their first samples.
    pub fn put_met(&self, picture: &mut [[f32; 3]], pixels: &[[f32; 3]]) {
        for met in self.met.iter().filter(|met| pixels[met.index] == met.shown) {
            picture[met.index] = met.mean.map(|channel| channel as f32);
        }
    }

    /// Puts what pixels have missed into `picture`, as many as there may be with a confidence, at places by `luck`.
    pub fn put_missed(&self, picture: &mut [[f32; 3]], confidence: f64, luck: u64) {
        let missed = self.met.iter().map(Met::missed).map(|missed| (missed, missed * (missed + 1.0)));
        let found = MeanSquare::of_sums(missed, 1, confidence);
        if found.value <= 0.0 {
            return;
        }
        // More than there are pixels there cannot be.
        let scale = (found.upper / found.value).min(picture.len() as f64 / found.value);
        let mut drawn = mix(luck ^ 0x6d69_7373_6564_2121);
        let mut draw = || {
            drawn = mix(drawn.wrapping_add(0x9e37_79b9_7f4a_7c15));
            drawn
        };
        for met in &self.met {
            let count = met.missed() * scale + unit(draw());
            for _ in 0..count as u64 {
                let place = (draw() % picture.len() as u64) as usize;
                for (channel, lacking) in picture[place].iter_mut().zip(met.colour) {
                    *channel += lacking as f32;
                }
            }
        }
    }
}

/// 53 bits of luck, in [0, 1).
fn unit(luck: u64) -> f64 {
    (luck >> 11) as f64 / (1u64 << 53) as f64
}

fn root_mean_square(colour: &[f64; 3]) -> f64 {
    (colour.iter().map(|channel| channel * channel).sum::<f64>() / 3.0).sqrt()
}

fn greatest(colour: &[f64; 3]) -> f64 {
    colour.iter().fold(0.0, |most: f64, channel| most.max(channel.abs()))
}

/// How far `own` lies outside of the range of the means of a pixel's neighbours, per channel.
fn beyond_neighbours(pixels: &[Sampled], width: usize, index: usize, own: [f64; 3]) -> [f64; 3] {
    let (x, y, height) = (index % width, index / width, pixels.len() / width);
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for row in y.saturating_sub(1)..height.min(y + 2) {
        for column in x.saturating_sub(1)..width.min(x + 2) {
            if [column, row] != [x, y] {
                let beside = pixels[row * width + column].mean.map(f64::from);
                for channel in 0..3 {
                    low[channel] = low[channel].min(beside[channel]);
                    high[channel] = high[channel].max(beside[channel]);
                }
            }
        }
    }
    [0, 1, 2].map(|c| if low[c] <= high[c] { own[c] - own[c].clamp(low[c], high[c]) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    const SIDE: u32 = 96;

    /// A picture of even ground with features in every third pixel of every third row, each of which the first `samples` of its pixel have met or
    /// not, and what the picture lacks in truth: square errors of pixels that have missed theirs.
    fn picture(samples: u32, random: &mut Random) -> (Vec<Sampled>, Vec<[f64; 3]>, f64) {
        picture_of(samples, random, |random| 0.3 * random.unit().powi(2))
    }

    /// The same with features that cover as much of their pixel as `share` says.
    fn picture_of(
        samples: u32,
        random: &mut Random,
        share: impl Fn(&mut Random) -> f64,
    ) -> (Vec<Sampled>, Vec<[f64; 3]>, f64) {
        let (mut pixels, mut truths, mut missed) = (Vec::new(), Vec::new(), 0.0);
        for (y, x) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (y, x))) {
            let (mut mean, mut half, mut truth) = (0.5, 0.0, 0.5);
            if x % 3 == 1 && y % 3 == 1 {
                let (share, contrast) = (share(random), 0.2 + 0.6 * random.unit());
                let whole = share * f64::from(samples);
                // Stratified: as many samples meet it as can, and one more by luck.
                let hits = whole.floor() + f64::from(u8::from(random.unit() < whole.fract()));
                (mean, truth) = (0.5 - contrast * hits / f64::from(samples), 0.5 - contrast * share);
                if samples > 1 {
                    half = (hits % 2.0) * contrast / f64::from(samples);
                }
                if hits == 0.0 {
                    missed += (mean - truth) * (mean - truth);
                }
            }
            pixels.push(Sampled {
                mean: [mean as f32; 3],
                half_difference: [half as f32; 3],
                deviation: 0.0,
                lost: 0.0,
            });
            truths.push([truth; 3]);
        }
        (pixels, truths, missed / f64::from(SIDE * SIDE))
    }

    fn unseen(pixels: &[Sampled], truths: &[[f64; 3]], samples: u32) -> (Unseen, usize) {
        let around = stands_out(pixels, SIDE, samples).into_iter();
        let found = candidates(around, SIDE, samples, samples.min(2), 5);
        let further = found.iter().map(|candidate| truths[candidate.index]);
        (Unseen::of(pixels, SIDE, samples, &found, further), found.len())
    }

    /// What those that met a feature say of those that have missed theirs, at 90 %: with few samples, where most have, and with more.
    #[test]
    fn what_is_missed_follows_from_what_is_met() {
        const RUNS: u32 = 40;
        for samples in [1, 2, 4, 16] {
            let mut random = Random::new(u64::from(samples));
            let (mut held, mut sum, mut truth) = (0, 0.0, 0.0);
            for _ in 0..RUNS {
                let (pixels, truths, missed) = picture(samples, &mut random);
                let (unseen, _) = unseen(&pixels, &truths, samples);
                let found = unseen.squares(u64::from(SIDE * SIDE), 0.9);
                held += u32::from(missed <= found.upper);
                (sum, truth) = (sum + found.value, truth + missed);
                assert!(found.upper < 4.0 * missed, "{samples}: {found:?}, in fact {missed:.2e}");
            }
            assert!(held >= RUNS * 9 / 10 - 4, "{samples}: {held} of {RUNS}");
            // What further samples are off by is added, so it is a little more.
            assert!((0.9..1.6).contains(&(sum / truth)), "{samples}: {:.2}", sum / truth);
        }
    }

    /// Features that are alike, and most of which are met: few pixels have missed theirs, by luck.
    #[test]
    fn margins_hold_where_most_are_met() {
        const RUNS: u32 = 40;
        for chance in [0.3, 0.7, 0.9] {
            let mut random = Random::new(11);
            let held = (0..RUNS).filter(|_| {
                let (pixels, truths, missed) = picture_of(4, &mut random, |_| 0.25 * chance);
                let (unseen, _) = unseen(&pixels, &truths, 4);
                missed <= unseen.squares(u64::from(SIDE * SIDE), 0.9).upper
            });
            let held = held.count() as u32;
            assert!(held >= RUNS * 9 / 10 - 4, "{chance}: {held} of {RUNS}");
        }
    }

    /// Where more pixels stand out than can be looked at, those that are stand for the others.
    #[test]
    fn some_stand_for_all() {
        let mut random = Random::new(7);
        let (pixels, truths, _) = picture(4, &mut random);
        let around = stands_out(&pixels, SIDE, 4);
        let out = around.iter().filter(|around| is_out(**around, 2)).count();
        let all = candidates(around.iter().copied(), SIDE, 4, 2, 5);
        assert!(all.iter().map(|candidate| candidate.place.samples).sum::<u32>() <= SIDE * SIDE * 3 / 2);
        let stood_for: f64 = all.iter().map(|candidate| candidate.weight).sum();
        assert!(all.len() < out && (stood_for / out as f64 - 1.0).abs() < 0.3, "{stood_for} for {out}");
        let (unseen, looked_at) = unseen(&pixels, &truths, 4);
        assert_eq!((unseen.met.len(), unseen.is_empty()), (looked_at, false));
        // None stands out before ground that is as uneven.
        assert!(candidates(std::iter::repeat_n([0.1, 0.2], 100), 10, 1, 1, 5).is_empty());
    }

    #[test]
    fn more_first_samples_leave_less() {
        let mut random = Random::new(9);
        let (pixels, truths, _) = picture(4, &mut random);
        let (four, _) = unseen(&pixels, &truths, 4);
        let total = u64::from(SIDE * SIDE);
        let left = |unseen: &Unseen| unseen.squares(total, 0.9).value;
        assert_eq!(left(&four.with_times(1)), left(&four));
        let sixteen = four.with_times(4);
        let (pixels, truths, _) = picture(16, &mut random);
        let (found, _) = unseen(&pixels, &truths, 16);
        let ratio = left(&sixteen) / left(&found);
        assert!((0.5..2.5).contains(&ratio), "{ratio}");
        assert!(left(&sixteen) < 0.6 * left(&four) && four.greatest() < 0.3);
        assert!(
            four.missed_above(0.0) > four.missed_above(0.05) && four.missed_above(four.greatest()) == 0.0
        );
        // Even ground stops at any deviation.
        assert_eq!(four.at(0.0).met.len(), four.met.len());
        let mut found = vec![[0.5f32; 3]; pixels.len()];
        four.put_missed(&mut found, 0.5, 3);
        let put = found.iter().filter(|pixel| pixel[0] < 0.5).count() as f64;
        let missed = four.missed_above(0.0);
        assert!(put > 0.7 * missed && put < 1.1 * missed, "{put} of {missed}");
    }
}
