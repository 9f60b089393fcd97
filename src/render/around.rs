//! The first samples of a pixel beside those of its eight neighbours.

use glam::DVec3;

/// The first samples of a pixel, or the means of blocks of them, per channel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FirstSamples {
    pub least: DVec3,
    pub greatest: DVec3,
    pub mean: DVec3,
    pub blocks: u32,
}

/// A mean that lies outside by more than so many times what one sample brings there has more of them.
const SINGLE: f64 = 1.4;

/// What they say beside those of the neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Around {
    /// How far samples lie apart, the pixel's own and those of its neighbours, per channel.
    pub contrast: DVec3,
    /// How far the pixel's mean lies outside of the range of the neighbours' means, if a single one of its samples or blocks brings it there:
    /// root mean square over the channels. Else 0.
    pub stands_out: f32,
    /// How far samples of the neighbours lie apart, in the channel where that is most.
    pub surround: f32,
}

impl Around {
    /// Of a pixel that nobody has looked around from.
    pub const NOTHING: Around = Around { contrast: DVec3::ZERO, stands_out: 0.0, surround: 0.0 };
}

/// Looks around from the pixel at `[x, y]`; `first` gives the first samples of each. Pixels at the border have fewer neighbours.
pub(crate) fn look_around(
    [width, height]: [usize; 2],
    [x, y]: [usize; 2],
    first: impl Fn(usize, usize) -> FirstSamples,
) -> Around {
    let nothing = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let ([mut least, mut greatest], [mut low, mut high]) = (nothing, nothing);
    for row in y.saturating_sub(1)..height.min(y + 2) {
        for column in x.saturating_sub(1)..width.min(x + 2) {
            if [column, row] != [x, y] {
                let beside = first(column, row);
                (least, greatest) = (least.min(beside.least), greatest.max(beside.greatest));
                (low, high) = (low.min(beside.mean), high.max(beside.mean));
            }
        }
    }
    let own = first(x, y);
    let contrast = greatest.max(own.greatest) - least.min(own.least);
    if least.x > greatest.x {
        // A picture of one pixel.
        return Around { contrast, ..Around::NOTHING };
    }
    let outside = own.mean - own.mean.clamp(low, high);
    // What a single one brings, at most: it is as far outside, but for its share.
    let single = (own.greatest - high).max(low - own.least).max(DVec3::ZERO) / f64::from(own.blocks);
    let is_single = outside.length_squared() <= SINGLE * SINGLE * single.length_squared();
    let stands_out = if is_single { (outside.length_squared() / 3.0).sqrt() as f32 } else { 0.0 };
    Around { contrast, stands_out, surround: (greatest - least).max_element() as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_held_against_its_neighbours() {
        let first = |x: usize, y: usize| {
            let mean = DVec3::new(0.1 * x as f64, 0.0, if [x, y] == [1, 1] { 0.9 } else { 0.3 });
            FirstSamples { least: mean - 0.05, greatest: mean + 0.05, mean, blocks: 1 }
        };
        let found = look_around([4, 3], [1, 1], first);
        assert!((found.contrast - DVec3::new(0.3, 0.1, 0.7)).length() < 1e-12);
        assert!((f64::from(found.stands_out) - 0.6 / 3f64.sqrt()).abs() < 1e-6);
        assert!((found.surround - 0.3).abs() < 1e-6);
        // In a corner, beside it.
        let found = look_around([4, 3], [0, 0], first);
        assert!((found.contrast - DVec3::new(0.2, 0.1, 0.7)).length() < 1e-12);
        assert!((f64::from(found.stands_out) - 0.0).abs() < 1e-6 && (found.surround - 0.7).abs() < 1e-6);
        // Two of two samples are no single one.
        let both = |x, y| FirstSamples { blocks: 2, ..first(x, y) };
        assert_eq!(look_around([4, 3], [1, 1], both).stands_out, 0.0);
        let alone = look_around([1, 1], [0, 0], first);
        assert_eq!(Around { contrast: DVec3::ZERO, ..alone }, Around::NOTHING);
    }
}
