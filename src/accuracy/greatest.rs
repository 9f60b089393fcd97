//! The greatest of many errors, of each of which its deviation is known.
//!
//! The chance that any error is above a limit is at most the sum of the chances of each (Bonferroni). Pixels whose deviation is well below
//! the greatest add next to nothing to it, so that the limit is lower than if all had that: by a sixth where one pixel in fifty is near it.

/// Steps by which deviations are told apart, to each factor of two: they are rounded up.
const STEPS: f64 = 48.0;
/// Deviations below this part of the greatest have no chance: `erfc` is 0 there wherever it is not near 1 for the greatest.
const LEAST: f64 = 1.0 / 16.0;
/// Channels, and sides on which each may be off.
const SIDES: f64 = 6.0;

use super::unseen::Unseen;

/// How many pixels have which deviation.
pub(super) struct Deviations {
    /// Of each step below the greatest, from it down.
    counts: Vec<f64>,
    greatest: f64,
}

impl Deviations {
    pub fn new(deviations: impl Iterator<Item = f64> + Clone) -> Deviations {
        let greatest = deviations.clone().fold(0.0, f64::max);
        let mut counts = vec![0.0; (STEPS * -LEAST.log2()) as usize + 1];
        if greatest > 0.0 && greatest.is_finite() {
            for deviation in deviations.filter(|deviation| *deviation >= LEAST * greatest) {
                // Rounded up, so down in steps from the greatest.
                counts[(STEPS * libm::log2(greatest / deviation)) as usize] += 1.0;
            }
        }
        Deviations { counts, greatest }
    }

    /// A limit that no error is above but with the probability `chance`, if each of these pixels stands for `share` of those of the
    /// picture, and none has a deviation above `most`, nor has it missed what is `unseen`. With `most` far below the greatest it is too low, as small deviations were
    /// left out: good for aiming only.
    pub fn limit(&self, chance: f64, share: f64, most: f64, unseen: &Unseen) -> f64 {
        if self.greatest.is_infinite() || self.greatest == 0.0 && unseen.is_empty() {
            return self.greatest;
        }
        let deviation = |step: usize| (self.greatest * libm::exp2(-(step as f64) / STEPS)).min(most);
        let above = |limit: f64| {
            let of = |(step, count): (usize, &f64)| {
                let over = limit / deviation(step);
                count * 0.5 * libm::erfc(over * std::f64::consts::FRAC_1_SQRT_2)
            };
            let counted = self.counts.iter().enumerate().filter(|(_, count)| **count > 0.0);
            SIDES * share * counted.map(of).sum::<f64>() + unseen.missed_above(limit)
        };
        // From none to 40 deviations, beyond which there is nothing.
        let (mut low, mut high) = (0.0, (40.0 * deviation(0)).max(unseen.greatest()));
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if above(middle) > chance { low = middle } else { high = middle }
        }
        high
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;
    use crate::render::normal_quantile;

    #[test]
    fn equal_deviations_have_the_quantile_of_each_shared_among_them() {
        for (count, chance) in [(1usize, 0.05), (1000, 0.05), (4000, 0.01)] {
            let found = Deviations::new(std::iter::repeat_n(0.02, count)).limit(
                chance,
                1.0,
                f64::INFINITY,
                &Unseen::default(),
            );
            let expected = 0.02 * normal_quantile(1.0 - chance / (SIDES * count as f64));
            assert!((found / expected - 1.0).abs() < 1e-4, "{found}, not {expected}");
            // A part stands for all.
            let part = Deviations::new(std::iter::repeat_n(0.02, count)).limit(
                chance,
                2.0,
                f64::INFINITY,
                &Unseen::default(),
            );
            let all = Deviations::new(std::iter::repeat_n(0.02, 2 * count)).limit(
                chance,
                1.0,
                f64::INFINITY,
                &Unseen::default(),
            );
            assert!((part / all - 1.0).abs() < 1e-6 && part > found);
        }
        assert_eq!(
            Deviations::new([0.0; 3].into_iter()).limit(0.05, 1.0, f64::INFINITY, &Unseen::default()),
            0.0
        );
    }

    /// A few pixels that are wide and many that are not: of 400 pictures as many are above the limit as is said, or fewer.
    #[test]
    fn the_limit_holds_as_often_as_it_says() {
        let deviation =
            |pixel: u32| if pixel.is_multiple_of(50) { 0.03 } else { 0.001 * f64::from(1 + pixel % 20) };
        let deviations = Deviations::new((0..3000).map(deviation));
        let (limit, plain) = (
            deviations.limit(0.1, 1.0, f64::INFINITY, &Unseen::default()),
            0.03 * normal_quantile(1.0 - 0.1 / (SIDES * 3000.0)),
        );
        assert!(limit < 0.85 * plain, "{limit} instead of {plain}");
        let mut random = Random::new(5);
        let mut normal = move || {
            let radius = (-2.0 * (1.0 - random.unit()).ln()).sqrt();
            radius * (std::f64::consts::TAU * random.unit()).cos()
        };
        let above = (0..400)
            .filter(|_| (0..3000).any(|pixel| (0..3).any(|_| (deviation(pixel) * normal()).abs() > limit)))
            .count();
        assert!((20..=40 + 12).contains(&above), "{above} of 400");
    }
}
