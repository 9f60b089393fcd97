//! Where in a pixel the samples lie: stratified for any count, a pure function of seed, pixel and sample (I2).

use serde::{Deserialize, Serialize};

/// How samples are spread around a pixel. Each sample belongs to one pixel: the filter acts through where samples
/// fall, not by adding one sample to several pixels, so no work is repeated at tile borders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Filter {
    /// Evenly over the pixel.
    Box,
    /// With a density that falls linearly from the pixel's middle to zero one pixel away: softer edges, less
    /// aliasing.
    #[default]
    Tent,
    /// A Gaussian of standard deviation one half pixel, cut off a pixel and a half away: softest, for pictures that will
    /// move or be scaled.
    Gaussian,
}

/// What a random number is for; part of its key.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Purpose {
    PixelX = 1,
    PixelY = 2,
}

/// A counter-based random number: the same for the same key, whatever was drawn before.
pub(crate) fn hash(seed: u64, pixel: u64, sample: u32, vertex: u32, purpose: Purpose) -> u64 {
    // Three rounds of the SplitMix64 finaliser (Steele, Lea and Flood 2014) over the parts of the key.
    let mut state = mix(seed ^ 0x9e37_79b9_7f4a_7c15);
    state = mix(state ^ pixel.wrapping_mul(0xd134_2543_de82_ef95));
    mix(state
        ^ (u64::from(sample) << 32 | u64::from(vertex)).wrapping_mul(0xaf25_1af3_b0f0_25b5)
        ^ purpose as u64)
}

/// Stirs 64 bits.
pub(crate) fn mix(mut x: u64) -> u64 {
    x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// The middle of a pixel.
pub(crate) const MIDDLE: [f64; 2] = [0.5, 0.5];

/// Where sample `sample` of `count` of a pixel lies, in pixels from the pixel's upper left corner. A single sample
/// lies in the middle. The first `2^k` samples of a pixel fall one into each elementary rectangle of area `2^-k`
/// (before the filter's warp): Sobol's first two dimensions with hash-based Owen scrambling (Burley 2020).
#[inline]
pub(crate) fn pixel_offset(seed: u64, pixel: u64, sample: u32, count: u32, filter: Filter) -> [f64; 2] {
    if count == 1 { MIDDLE } else { spread(seed, pixel, sample, filter) }
}

/// [`pixel_offset`] of one of several samples.
fn spread(seed: u64, pixel: u64, sample: u32, filter: Filter) -> [f64; 2] {
    let scramble = |purpose, bits| {
        // The key names the pixel, not the sample: one scramble per pixel keeps its samples stratified.
        let seed = hash(seed, pixel, 0, 0, purpose) as u32;
        f64::from(owen_scramble(bits, seed)) * (1.0 / 4_294_967_296.0)
    };
    let x = scramble(Purpose::PixelX, sample.reverse_bits());
    let y = scramble(Purpose::PixelY, sobol_second(sample));
    match filter {
        Filter::Box => [x, y],
        Filter::Tent => [0.5 + tent(x), 0.5 + tent(y)],
        Filter::Gaussian => gaussian(x, y).map(|offset| 0.5 + offset),
    }
}

/// The second dimension of Sobol's sequence: its matrix is Pascal's triangle modulo 2.
pub(super) fn sobol_second(index: u32) -> u32 {
    let mut result = 0;
    let mut column: u32 = 1 << 31;
    let mut rest = index;
    while rest != 0 {
        if rest & 1 == 1 {
            result ^= column;
        }
        column ^= column >> 1;
        rest >>= 1;
    }
    result
}

/// Owen scrambling of a 32-bit fraction by the hash of Laine and Karras (constants of Vegdahl).
pub(super) fn owen_scramble(bits: u32, seed: u32) -> u32 {
    let mut x = bits.reverse_bits();
    x ^= x.wrapping_mul(0x3d20_adea);
    x = x.wrapping_add(seed);
    x = x.wrapping_mul(seed >> 16 | 1);
    x ^= x.wrapping_mul(0x0552_6c56);
    x ^= x.wrapping_mul(0x53a2_2864);
    x.reverse_bits()
}

/// Maps 0 .. 1 to -1 .. 1 with tent density; square roots only, so the same on every machine.
fn tent(u: f64) -> f64 {
    if u < 0.5 { (2.0 * u).sqrt() - 1.0 } else { 1.0 - (2.0 - 2.0 * u).sqrt() }
}

/// Maps the unit square to a round Gaussian, cut off: the radius by inverting its distribution (Box and Muller 1958).
fn gaussian(u: f64, v: f64) -> [f64; 2] {
    const DEVIATION: f64 = 0.5;
    const RADIUS: f64 = 1.5;
    let inside = 1.0 - libm::exp(-0.5 * (RADIUS / DEVIATION) * (RADIUS / DEVIATION));
    let radius = DEVIATION * (-2.0 * libm::log1p(-u * inside)).sqrt();
    let (sin, cos) = libm::sincos(std::f64::consts::TAU * v);
    [radius * cos, radius * sin]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_of_two_fill_every_elementary_rectangle() {
        for pixel in [0, 1, 77_777] {
            for (count, columns) in [(16u32, 16u32), (16, 4), (16, 2), (16, 1), (64, 8), (4, 2)] {
                let rows = count / columns;
                let mut seen = vec![0; count as usize];
                for sample in 0..count {
                    let [x, y] = pixel_offset(5, pixel, sample, count, Filter::Box);
                    assert!((0.0..1.0).contains(&x) && (0.0..1.0).contains(&y));
                    let (column, row) = ((x * f64::from(columns)) as u32, (y * f64::from(rows)) as u32);
                    seen[(row * columns + column) as usize] += 1;
                }
                assert!(seen.iter().all(|hits| *hits == 1), "{count} samples in {columns} columns: {seen:?}");
            }
        }
    }

    #[test]
    fn one_sample_is_the_middle_and_pixels_differ() {
        assert_eq!(pixel_offset(1, 2, 0, 1, Filter::Tent), [0.5, 0.5]);
        let offsets = |pixel| [0, 1, 2].map(|sample| pixel_offset(1, pixel, sample, 3, Filter::Box));
        assert_ne!(offsets(1), offsets(2));
        assert_ne!(offsets(1), [0, 1, 2].map(|sample| pixel_offset(2, 1, sample, 3, Filter::Box)));
    }

    #[test]
    fn the_tent_has_its_mean_and_variance() {
        let count = 1 << 14;
        let (mut sum, mut squares) = (0.0, 0.0);
        for sample in 0..count {
            let [x, y] = pixel_offset(3, 9, sample, count, Filter::Tent);
            assert!((-0.5..=1.5).contains(&x) && (-0.5..=1.5).contains(&y));
            sum += x - 0.5;
            squares += (y - 0.5) * (y - 0.5);
        }
        assert!((sum / f64::from(count)).abs() < 1e-4);
        // A tent on -1 .. 1 has variance 1/6.
        assert!((squares / f64::from(count) - 1.0 / 6.0).abs() < 1e-4);
    }

    #[test]
    fn the_gaussian_has_its_mean_variance_and_end() {
        let count = 1 << 14;
        let (mut sum, mut squares) = (0.0, 0.0);
        for sample in 0..count {
            let [x, y] = pixel_offset(3, 9, sample, count, Filter::Gaussian).map(|at| at - 0.5);
            assert!(x * x + y * y <= 1.5 * 1.5 + 1e-12);
            sum += x + y;
            squares += x * x + y * y;
        }
        assert!((sum / f64::from(count)).abs() < 1e-3);
        // The mean of r^2 of a Gaussian cut at r^2 = 2 d^2 a, that is 2 d^2 (1 - a e^-a / (1 - e^-a)).
        let a: f64 = 4.5;
        let expected = 0.5 * (1.0 - a * libm::exp(-a) / (1.0 - libm::exp(-a)));
        assert!((squares / f64::from(count) - expected).abs() < 1e-3, "{}", squares / f64::from(count));
    }

    #[test]
    fn the_hash_depends_on_every_part_of_its_key() {
        let base = hash(1, 2, 3, 4, Purpose::PixelX);
        for other in [
            hash(0, 2, 3, 4, Purpose::PixelX),
            hash(1, 0, 3, 4, Purpose::PixelX),
            hash(1, 2, 0, 4, Purpose::PixelX),
            hash(1, 2, 3, 0, Purpose::PixelX),
            hash(1, 2, 3, 4, Purpose::PixelY),
        ] {
            assert!((base ^ other).count_ones() > 10);
        }
    }
}
