//! How far one picture is from another, as one number.

use super::flip;

/// A distance of pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Metric {
    /// Root of the mean square of the difference over all pixels and channels of linear radiance, in the unit of the lights.
    Rmse,
    /// Greatest difference in any channel of any pixel, of linear radiance.
    Max,
    /// Mean of FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020) at 67 pixels per degree, 0
    /// to 1: what somebody sees who flips between the pictures on a display that shows radiance 0 to 1.
    Flip,
}

impl Metric {
    /// All metrics.
    pub const ALL: [Metric; 3] = [Metric::Rmse, Metric::Max, Metric::Flip];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Metric::Rmse => "RMSE",
            Metric::Max => "max",
            Metric::Flip => "FLIP",
        }
    }

    /// The distance of `test` from `reference`, pictures of linear RGB with rows of `width` pixels.
    ///
    /// # Panics
    /// If the pictures are empty, not equally large, or no whole number of rows.
    pub fn distance(self, reference: &[[f32; 3]], test: &[[f32; 3]], width: u32) -> f64 {
        assert!(!reference.is_empty() && reference.len() == test.len(), "the pictures differ in size");
        let differences = || {
            reference
                .iter()
                .flatten()
                .zip(test.iter().flatten())
                .map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs())
        };
        match self {
            Metric::Rmse => (differences().map(|x| x * x).sum::<f64>() / (3 * reference.len()) as f64).sqrt(),
            Metric::Max => differences().fold(0.0, f64::max),
            Metric::Flip => mean(&flip::error_map(reference, test, width as usize)),
        }
    }
}

/// FLIP for each pixel, 0 to 1, in the order of the pictures; see [`Metric::Flip`].
///
/// # Panics
/// As for [`Metric::distance`].
pub fn flip_map(reference: &[[f32; 3]], test: &[[f32; 3]], width: u32) -> Vec<f64> {
    flip::error_map(reference, test, width as usize)
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_of_small_pictures() {
        let reference = [[0.0f32, 0.5, 1.0], [0.25, 0.25, 0.25]];
        let test = [[0.5f32, 0.5, 1.0], [0.25, 0.25, 0.5]];
        let rmse = ((0.25f64 + 0.0625) / 6.0).sqrt();
        assert!((Metric::Rmse.distance(&reference, &test, 2) - rmse).abs() < 1e-15);
        assert_eq!(Metric::Max.distance(&reference, &test, 1), 0.5);
        for metric in Metric::ALL {
            assert_eq!(metric.distance(&reference, &reference, 2), 0.0);
            assert!(metric.distance(&reference, &test, 2) > 0.0);
        }
        // Green against blue is the farthest there is.
        let far = Metric::Flip.distance(&[[0.0, 1.0, 0.0]], &[[0.0, 0.0, 1.0]], 1);
        assert!((far - 1.0).abs() < 1e-5, "{far}");
    }
}
