//! FLIP: how much two pictures differ to somebody who flips between them.
//!
//! P. Andersson, J. Nilsson, T. Akenine-Möller, M. Oskarsson, K. Åström, M. D. Fairchild, "FLIP: A Difference Evaluator for
//! Alternating Images", HPG 2020, in its form for pictures of low dynamic range. Section numbers below are the paper's. In f64; the
//! tests hold it against values of the authors' own program.

use crate::simd::{AnyOperation, Simd, SimdLevel, dispatch};

/// Pixels per degree of the paper's viewing conditions (section 4.1): 0.7 m before a display 0.7 m and 3840 pixels wide.
pub(super) const PIXELS_PER_DEGREE: f64 = 0.7 * (3840.0 / 0.7) * (std::f64::consts::PI / 180.0);

/// White of D65.
const WHITE: [f64; 3] = [0.950428545, 1.0, 1.088900371];

/// A plane of numbers per channel, row by row.
type Plane = Vec<f64>;

/// The error map, 0 to 1 per pixel. Both pictures are linear RGB and are clamped to what a display shows, 0 to 1.
///
/// # Panics
/// If the pictures are not equally large or no whole number of rows.
pub(super) fn error_map(reference: &[[f32; 3]], test: &[[f32; 3]], width: usize) -> Vec<f64> {
    assert_eq!(reference.len(), test.len(), "the pictures differ in size");
    let [reference, test] = [reference, test].map(|pixels| Seen::of(pixels, width));
    let colour = colour_errors(&reference.colours, &test.colours);
    let [reference, test] = [reference, test].map(|picture| features(&picture.luminance, width));
    colour
        .into_iter()
        .zip(reference.into_iter().zip(test))
        .map(|(colour, ([edge_a, point_a], [edge_b, point_b]))| {
            error(colour, (edge_a - edge_b).abs().max((point_a - point_b).abs()))
        })
        .collect()
}

/// The least map that holds the error map whatever features the pictures share: with the features *of the difference* in place of the
/// difference of features, which is never greater, as strengths are lengths of vectors that filters without bias give.
///
/// Noise hides features under it, so that two pictures that are equally noisy differ less in their features than either
/// does from the truth. Their difference has what the noise has.
pub(super) fn error_map_bound(a: &Seen, b: &Seen) -> Vec<f64> {
    let difference: Plane = a.luminance.iter().zip(&b.luminance).map(|(a, b)| a - b).collect();
    let features = features(&difference, a.width);
    colour_errors(&a.colours, &b.colours)
        .into_iter()
        .zip(features)
        .map(|(colour, [edge, point])| error(colour, edge.max(point)))
        .collect()
}

/// Section 4.4: features make colour differences count more.
fn error(colour: f64, feature: f64) -> f64 {
    libm::pow(colour, 1.0 - (feature / std::f64::consts::SQRT_2).sqrt().min(1.0))
}

/// A picture as the eye sees it.
pub(super) struct Seen {
    /// What the eye resolves, as colours whose distances it judges.
    colours: Vec<[f64; 3]>,
    /// Luminance, 0 to 1, in which it looks for edges and points.
    luminance: Plane,
    width: usize,
}

impl Seen {
    /// Of linear RGB, which is clamped to what a display shows.
    ///
    /// # Panics
    /// If the picture is no whole number of rows.
    pub fn of(pixels: &[[f32; 3]], width: usize) -> Seen {
        assert!(width > 0 && pixels.len().is_multiple_of(width), "not a whole number of rows");
        let picture = Opponent::of(pixels, width);
        let colours = picture.filtered().into_iter().map(hunt_lab).collect();
        let [luminance, ..] = picture.channels;
        Seen { colours, luminance: luminance.into_iter().map(|y| (y + 16.0) / 116.0).collect(), width }
    }
}

/// A picture in YCxCz: luminance and two opponent colours.
struct Opponent {
    channels: [Plane; 3],
    width: usize,
}

impl Opponent {
    fn of(pixels: &[[f32; 3]], width: usize) -> Opponent {
        let mut channels = [(); 3].map(|()| Vec::with_capacity(pixels.len()));
        for pixel in pixels {
            let [x, y, z] = xyz(pixel.map(|channel| f64::from(channel).clamp(0.0, 1.0)));
            let [x, y, z] = [x / WHITE[0], y / WHITE[1], z / WHITE[2]];
            let colour = [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)];
            channels.iter_mut().zip(colour).for_each(|(plane, value)| plane.push(value));
        }
        Opponent { channels, width }
    }

    /// What the eye resolves (section 4.1.1), in linear RGB clamped to the display.
    fn filtered(&self) -> Vec<[f64; 3]> {
        // Weights and widths of Gaussians in degrees that fit the contrast sensitivity of each channel.
        const GAUSSIANS: [&[[f64; 2]]; 3] =
            [&[[1.0, 0.0047]], &[[1.0, 0.0053]], &[[34.1, 0.04], [13.5, 0.025]]];
        let planes: Vec<Plane> = self
            .channels
            .iter()
            .zip(GAUSSIANS)
            .map(|(plane, gaussians)| {
                let kernels: Vec<(f64, Vec<f64>)> =
                    gaussians.iter().map(|&[a, b]| sensitivity(a, b)).collect();
                let total: f64 = kernels.iter().map(|(weight, _)| weight).sum();
                let mut sum = vec![0.0; plane.len()];
                for (weight, kernel) in kernels {
                    let blurred = separable(plane, self.width, &kernel);
                    sum.iter_mut().zip(blurred).for_each(|(sum, value)| *sum += weight / total * value);
                }
                sum
            })
            .collect();
        let back = |y: f64, cx: f64, cz: f64| {
            let y = (y + 16.0) / 116.0;
            rgb([WHITE[0] * (y + cx / 500.0), WHITE[1] * y, WHITE[2] * (y - cz / 200.0)])
                .map(|channel| channel.clamp(0.0, 1.0))
        };
        (0..planes[0].len()).map(|pixel| back(planes[0][pixel], planes[1][pixel], planes[2][pixel])).collect()
    }
}

/// Strength of edges and of points (section 4.2) per pixel.
fn features(luminance: &[f64], width: usize) -> Vec<[f64; 2]> {
    // An edge detector as wide as the eye's, 0.082 degrees.
    let deviation = 0.5 * 0.082 * PIXELS_PER_DEGREE;
    let radius = (3.0 * deviation).ceil() as i32;
    let kernel = |value: &dyn Fn(f64) -> f64| -> Vec<f64> {
        (-radius..=radius)
            .map(|x| {
                let x = f64::from(x) / deviation;
                value(x) * libm::exp(-0.5 * x * x)
            })
            .collect()
    };
    let smooth = signed_parts_to_one(kernel(&|_| 1.0));
    let edge = signed_parts_to_one(kernel(&|x| -x));
    let point = signed_parts_to_one(kernel(&|x| x * x - 1.0));
    let filtered = |plane: &[f64], axis: Axis, kernel: &[f64]| filter(plane, width, axis, kernel);
    let rows = filtered(luminance, Axis::Rows, &smooth);
    let strength = |kernel: &[f64]| -> Plane {
        let across = filtered(&filtered(luminance, Axis::Rows, kernel), Axis::Columns, &smooth);
        let down = filtered(&rows, Axis::Columns, kernel);
        across.into_iter().zip(down).map(|(x, y)| (x * x + y * y).sqrt()).collect()
    };
    strength(&edge).into_iter().zip(strength(&point)).map(|(edge, point)| [edge, point]).collect()
}

/// The kernel, normalised, of one Gaussian `a sqrt(pi / b) exp(-pi^2 d^2 / b)` of the distance in degrees, and its weight: the sum
/// over the plane.
fn sensitivity(a: f64, b: f64) -> (f64, Vec<f64>) {
    use std::f64::consts::PI;
    // As wide as the widest of them asks for, like the authors' program.
    const WIDEST: f64 = 0.04;
    let radius = (3.0 * (WIDEST / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let kernel: Vec<f64> = (-radius..=radius)
        .map(|x| {
            let degrees = f64::from(x) / PIXELS_PER_DEGREE;
            libm::exp(-PI * PI * degrees * degrees / b)
        })
        .collect();
    let sum: f64 = kernel.iter().sum();
    (a * (PI / b).sqrt() * sum * sum, kernel.into_iter().map(|value| value / sum).collect())
}

/// Scales positive and negative values so that each sum up to 1 in magnitude.
fn signed_parts_to_one(kernel: Vec<f64>) -> Vec<f64> {
    let positive: f64 = kernel.iter().filter(|value| **value > 0.0).sum();
    let negative: f64 = -kernel.iter().filter(|value| **value < 0.0).sum::<f64>();
    kernel
        .into_iter()
        .map(|value| if value > 0.0 { value / positive } else { value / negative.max(f64::MIN_POSITIVE) })
        .collect()
}

/// Filters rows, then columns, with a kernel of odd length. The border is repeated outward.
fn separable(plane: &[f64], width: usize, kernel: &[f64]) -> Plane {
    let rows = filter(plane, width, Axis::Rows, kernel);
    filter(&rows, width, Axis::Columns, kernel)
}

/// What a filter runs along.
#[derive(Clone, Copy)]
enum Axis {
    Rows,
    Columns,
}

/// Filters along one axis. The border is repeated outward. Sums are the same bit for bit, whatever instructions there are.
fn filter(plane: &[f64], width: usize, axis: Axis, kernel: &[f64]) -> Plane {
    dispatch(SimdLevel::best(), Filter { plane, width, axis, kernel })
}

/// A filter along one axis, for the instructions that there are.
struct Filter<'f> {
    plane: &'f [f64],
    width: usize,
    axis: Axis,
    kernel: &'f [f64],
}

/// Sums at once: as many as stay in registers.
const SUMS: usize = 16;

impl AnyOperation for Filter<'_> {
    type Output = Plane;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> Plane {
        let Filter { plane, width, axis, kernel } = self;
        let height = plane.len() / width;
        let radius = kernel.len() / 2;
        let mut filtered = vec![0.0; plane.len()];
        let mut padded = vec![0.0; width + 2 * radius];
        for (y, out) in filtered.chunks_exact_mut(width).enumerate() {
            match axis {
                Axis::Rows => {
                    let row = &plane[y * width..][..width];
                    padded[..radius].fill(row[0]);
                    padded[radius..radius + width].copy_from_slice(row);
                    padded[radius + width..].fill(row[width - 1]);
                    weigh(out, kernel, |tap| &padded[tap..tap + width]);
                }
                Axis::Columns => weigh(out, kernel, |tap| {
                    let from = (y + tap).saturating_sub(radius).min(height - 1);
                    &plane[from * width..][..width]
                }),
            }
        }
        filtered
    }
}

/// The sum of rows, each with its weight: `row(tap)` is as long as `out`.
#[inline(always)]
fn weigh<'p>(out: &mut [f64], kernel: &[f64], row: impl Fn(usize) -> &'p [f64]) {
    let mut from = 0;
    while from < out.len() {
        let len = SUMS.min(out.len() - from);
        let mut sums = [0.0; SUMS];
        for (tap, weight) in kernel.iter().enumerate() {
            let values = &row(tap)[from..from + len];
            // A length that is known is one that stays in registers.
            if let Some(values) = values.first_chunk::<SUMS>() {
                for lane in 0..SUMS {
                    sums[lane] += weight * values[lane];
                }
            } else {
                sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        out[from..from + len].copy_from_slice(&sums[..len]);
        from += len;
    }
}

/// Differences of colours by [`hunt_lab`], 0 to 1 (section 4.1.2 and 4.1.3).
fn colour_errors(reference: &[[f64; 3]], test: &[[f64; 3]]) -> Vec<f64> {
    const EXPONENT: f64 = 0.7;
    // Differences up to this share of the greatest take up this share of the scale.
    const KNEE: f64 = 0.4;
    const AT_KNEE: f64 = 0.95;
    let greatest = libm::pow(hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])), EXPONENT);
    let knee = KNEE * greatest;
    reference
        .iter()
        .zip(test)
        .map(|(reference, test)| {
            let error = libm::pow(hyab(*reference, *test), EXPONENT);
            if error < knee {
                error / knee * AT_KNEE
            } else {
                AT_KNEE + (error - knee) / (greatest - knee) * (1.0 - AT_KNEE)
            }
        })
        .collect()
}

/// Distance of colours (Abasi, Amani Tehran and Fairchild 2020).
fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    let [l, x, y] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    l.abs() + (x * x + y * y).sqrt()
}

/// CIELAB of linear RGB, its chroma scaled with lightness (Hunt 1952).
fn hunt_lab(colour: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let curve = |value: f64| {
        if value > DELTA * DELTA * DELTA {
            cube_root(value)
        } else {
            value / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    };
    let [x, y, z] = xyz(colour);
    let [x, y, z] = [x / WHITE[0], y / WHITE[1], z / WHITE[2]].map(curve);
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// The cube root of a number above 2^-1022, off by less than 1e-14 of itself: a guess by the exponent, within a thirtieth (W. Kahan), and
/// two steps of Halley's, each of which leaves two thirds of the cube of what it was off by.
fn cube_root(value: f64) -> f64 {
    const GUESS: u32 = 715_094_163;
    let high = (value.to_bits() >> 32) as u32;
    let mut root = f64::from_bits(u64::from(high / 3 + GUESS) << 32);
    for _ in 0..2 {
        let cube = root * root * root;
        root *= (cube + 2.0 * value) / (2.0 * cube + value);
    }
    root
}

fn xyz([r, g, b]: [f64; 3]) -> [f64; 3] {
    [
        (10135552.0 * r + 8788810.0 * g + 4435075.0 * b) / 24577794.0,
        (2613072.0 * r + 8788810.0 * g + 887015.0 * b) / 12288897.0,
        (1425312.0 * r + 8788810.0 * g + 70074185.0 * b) / 73733382.0,
    ]
}

fn rgb([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        3.241003275 * x - 1.537398934 * y - 0.498615861 * z,
        -0.969224334 * x + 1.875930071 * y + 0.041554224 * z,
        0.055639423 * x - 0.204011202 * y + 1.057148933 * z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 48;
    const HEIGHT: usize = 40;

    /// Against a sum for each pixel, also where rows are shorter than the kernel or no multiple of what is summed at once.
    #[test]
    fn filters_are_what_a_naive_twin_gives() {
        let kernel: Vec<f64> = (0..21).map(|tap| f64::from(tap * tap % 13) - 5.5).collect();
        for (width, height) in [(1, 1), (1, 40), (5, 3), (15, 4), (16, 30), (17, 2), (32, 1), (50, 23)] {
            let plane: Vec<f64> =
                (0..width * height).map(|index| ((index * 37 % 101) as f64).sqrt()).collect();
            for axis in [Axis::Rows, Axis::Columns] {
                let at = |x: i64, y: i64| {
                    let clamp = |value: i64, size: usize| value.clamp(0, size as i64 - 1) as usize;
                    plane[clamp(y, height) * width + clamp(x, width)]
                };
                let sum = |index: usize| {
                    let (x, y) = ((index % width) as i64, (index / width) as i64);
                    (-10..).zip(&kernel).fold(0.0, |sum, (offset, weight)| {
                        sum + weight
                            * match axis {
                                Axis::Rows => at(x + offset, y),
                                Axis::Columns => at(x, y + offset),
                            }
                    })
                };
                let expected: Plane = (0..plane.len()).map(sum).collect();
                assert_eq!(filter(&plane, width, axis, &kernel), expected, "{width} x {height}");
            }
        }
    }

    fn picture(of: impl Fn(i64, i64) -> [f64; 3]) -> Vec<[f32; 3]> {
        let at = |index: usize| of((index % WIDTH) as i64, (index / WIDTH) as i64).map(|x| x as f32);
        (0..WIDTH * HEIGHT).map(at).collect()
    }

    fn pattern(x: i64, y: i64) -> [f64; 3] {
        let part = |value: i64, of: i64| (value % of) as f64 / (of - 1) as f64;
        [part(7 * x + 13 * y, 32), part(x * x + 3 * y, 29), part(x + y * y, 23)]
    }

    fn changed(x: i64, y: i64) -> [f64; 3] {
        let [r, g, b] = pattern(x, y);
        [if (x / 6 + y / 5) % 2 == 1 { r } else { 1.0 - r }, 0.75 * g, if x > 20 { b } else { 0.5 }]
    }

    fn edge(at: i64) -> impl Fn(i64, i64) -> [f64; 3] {
        move |x, y| if 3 * x + 2 * y < at { [1.0, 0.5, 0.25] } else { [0.1, 0.2, 0.6] }
    }

    /// Mean, maximum and two pixels as the authors' program gives them (`flip-evaluator` 1.7, which works in f32).
    #[test]
    fn agrees_with_the_authors_program() {
        let grey = |value: f64| move |_, _| [value; 3];
        let point = |x, y| if (x, y) == (20, 17) { [0.9, 0.8, 0.1] } else { [0.2; 3] };
        for (name, reference, test, expected) in [
            ("pattern", picture(pattern), picture(changed), [0.4636966, 0.9731992, 0.4377775, 0.9731992]),
            ("edge", picture(edge(100)), picture(edge(104)), [0.0936944, 0.5780635, 0.3539802, 0.0]),
            ("black and white", picture(grey(0.0)), picture(grey(1.0)), [0.9673883; 4]),
            ("green and blue", picture(|_, _| [0.0, 1.0, 0.0]), picture(|_, _| [0.0, 0.0, 1.0]), [1.0; 4]),
            ("nearly the same grey", picture(grey(0.5)), picture(|_, _| [0.51, 0.5, 0.49]), [0.0542402; 4]),
            ("a point", picture(grey(0.2)), picture(point), [0.0045781, 0.3641023, 0.3641023, 0.0]),
        ] {
            let map = error_map(&reference, &test, WIDTH);
            let mean = map.iter().sum::<f64>() / map.len() as f64;
            let max = map.iter().copied().fold(0.0, f64::max);
            let found = [mean, max, map[17 * WIDTH + 20], map[0]];
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 2e-5, "{name}: {found}, not {expected}");
            }
        }
    }

    #[test]
    fn cube_roots_are_those_of_the_library() {
        for step in 0..20_000 {
            let value = 1.3e-6 * libm::pow(1.001, f64::from(step));
            let (found, expected) = (cube_root(value), libm::cbrt(value));
            assert!((found / expected - 1.0).abs() < 1e-14, "{value}: {found}, not {expected}");
        }
    }

    #[test]
    fn equal_pictures_do_not_differ_and_order_does_not_matter() {
        let (a, b) = (picture(pattern), picture(changed));
        assert!(error_map(&a, &a, WIDTH).iter().all(|error| *error == 0.0));
        assert!(
            error_map(&a, &b, WIDTH).iter().zip(error_map(&b, &a, WIDTH)).all(|(x, y)| (x - y).abs() < 1e-12)
        );
        // A bound, a tight one where one of both has no features.
        let [seen_a, seen_b] = [&a, &b].map(|pixels| Seen::of(pixels, WIDTH));
        let bound = error_map_bound(&seen_a, &seen_b);
        assert!(error_map(&a, &b, WIDTH).iter().zip(&bound).all(|(error, bound)| *error <= bound + 1e-12));
        let flat = picture(|_, _| [0.3; 3]);
        let bound = error_map_bound(&Seen::of(&flat, WIDTH), &seen_b);
        assert!(
            error_map(&flat, &b, WIDTH).iter().zip(bound).all(|(error, bound)| (error - bound).abs() < 1e-9)
        );
        // What is beyond the display does not show.
        let bright = |factor: f32| a.iter().map(|pixel| pixel.map(|x| 1.0 + factor * x)).collect::<Vec<_>>();
        assert!(error_map(&bright(1.0), &bright(5.0), WIDTH).iter().all(|error| *error < 1e-12));
    }
}
