//! Lobes that directions are sampled by: rough mirrors, rough glass, diffuse bounces.

use std::f64::consts::{PI, TAU};

use glam::DVec3;

use crate::render::frosted::refraction;
use crate::render::ggx::{Lobe, sample_facet};
use crate::render::glossy::reflection;
use crate::render::interreflection::bounce;
use crate::render::random::{Dimension, SampleKey, VertexId};
use crate::render::refraction::split;
use crate::scene::{cosine_direction, to_frame};

fn view(degrees: f64) -> DVec3 {
    let (sin, cos) = libm::sincos(degrees.to_radians());
    DVec3::new(0.6 * sin, -0.8 * sin, cos)
}

/// Pairs that are independent, as a chi-square test needs: one sequence each.
fn independent(index: u32) -> [f64; 2] {
    SampleKey::new(3, u64::from(index), 0).pair(VertexId::CAMERA, Dimension::Microfacet)
}

const ROWS: usize = 12;
const COLUMNS: usize = 16;

/// The cell of the sphere that a direction falls into.
fn cell(direction: DVec3) -> usize {
    let row = (libm::acos(direction.z.clamp(-1.0, 1.0)) / PI * ROWS as f64) as usize;
    let turn = libm::atan2(direction.y, direction.x) / TAU + 0.5;
    row.min(ROWS - 1) * COLUMNS + ((turn * COLUMNS as f64) as usize).min(COLUMNS - 1)
}

/// Compares counts of sampled directions with the integrals of `density` over the cells: the statistic over its standard
/// deviation, which is near a standard normal if they agree. Directions that were not made count as a cell of their own.
fn chi_square(
    samples: u32,
    sample: impl Fn([f64; 2]) -> Option<DVec3>,
    density: impl Fn(DVec3) -> f64,
) -> f64 {
    const FINE: usize = 64;
    let mut counts = vec![0.0; ROWS * COLUMNS + 1];
    for index in 0..samples {
        counts[sample(independent(index)).map_or(ROWS * COLUMNS, cell)] += 1.0;
    }
    let mut expected = vec![0.0; ROWS * COLUMNS + 1];
    let (rows, columns) = (ROWS * FINE, COLUMNS * FINE);
    for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
        let (radius, z) = libm::sincos((row as f64 + 0.5) / rows as f64 * PI);
        let angle = ((column as f64 + 0.5) / columns as f64 - 0.5) * TAU;
        let (sin, cos) = libm::sincos(angle);
        let solid_angle = radius * PI * TAU / (rows * columns) as f64;
        let direction = DVec3::new(radius * cos, radius * sin, z);
        expected[cell(direction)] += density(direction) * solid_angle * f64::from(samples);
    }
    expected[ROWS * COLUMNS] = f64::from(samples) - expected.iter().sum::<f64>();
    assert!(expected[ROWS * COLUMNS] > -1e-2 * f64::from(samples), "the density integrates to more than 1");
    let (mut statistic, mut cells, mut rest) = (0.0, 0.0, [0.0; 2]);
    for (count, expected) in counts.iter().zip(&expected) {
        // Cells with few hits go together.
        if *expected < 8.0 {
            rest = [rest[0] + count, rest[1] + expected];
            continue;
        }
        statistic += (count - expected) * (count - expected) / expected;
        cells += 1.0;
    }
    if rest[1] > 8.0 {
        statistic += (rest[0] - rest[1]) * (rest[0] - rest[1]) / rest[1];
    }
    // Wilson and Hilferty's normal approximation.
    let freedom: f64 = cells - 1.0;
    let spread = 2.0 / (9.0 * freedom);
    (libm::cbrt(statistic / freedom) - (1.0 - spread)) / spread.sqrt()
}

#[test]
fn reflected_and_refracted_directions_have_their_densities() {
    for alpha in [0.3, 0.7, 1.0] {
        for degrees in [0.0, 40.0, 75.0] {
            let view = view(degrees);
            let deviation = chi_square(
                40_000,
                |point| {
                    let facet = sample_facet(DVec3::Z, view, alpha, point);
                    Some(facet * (2.0 * view.dot(facet)) - view).filter(|direction| direction.z > 0.0)
                },
                |direction| {
                    reflection(DVec3::Z, view, alpha, direction, None).map_or(0.0, |lobe| lobe.density)
                },
            );
            assert!(deviation < 4.0, "reflection {alpha} {degrees}: {deviation}");
            for eta in [1.0 / 1.5, 1.3] {
                let deviation = chi_square(
                    40_000,
                    |point| {
                        let facet = sample_facet(DVec3::Z, view, alpha, point);
                        split(-view, facet, eta).refracted.filter(|direction| direction.z < 0.0)
                    },
                    |direction| {
                        refraction(DVec3::Z, view, alpha, direction, eta).map_or(0.0, |lobe| lobe.density)
                    },
                );
                assert!(deviation < 4.0, "refraction {alpha} {degrees} {eta}: {deviation}");
            }
        }
    }
}

#[test]
fn a_wrong_density_fails_the_chi_square_test() {
    let deviation = chi_square(
        40_000,
        |point| Some(to_frame(DVec3::Z, cosine_direction(point))),
        |direction| direction.z.max(0.0).powi(2) * 1.5 / PI,
    );
    assert!(deviation > 20.0, "{deviation}");
}

#[test]
fn diffuse_bounces_have_their_density() {
    let normal = DVec3::new(0.36, -0.48, 0.8);
    let deviation = chi_square(
        60_000,
        |point| bounce(normal, point).map(|(direction, _)| direction),
        |direction| normal.dot(direction).max(0.0) / PI,
    );
    assert!(deviation < 4.0, "{deviation}");
}

#[test]
fn reflection_is_reciprocal_and_sends_on_no_more_than_it_gets() {
    for alpha in [0.05, 0.3, 0.8] {
        for (a, b) in [(10.0, 50.0), (70.0, 20.0), (85.0, 80.0)] {
            let (a, b) = (
                view(a),
                DVec3::new(-0.8, 0.6, 0.0) * view(b).length() * libm::sin(f64::to_radians(b))
                    + DVec3::Z * libm::cos(f64::to_radians(b)),
            );
            // f = weight * density / cos.
            let f = |view: DVec3, direction: DVec3| {
                let lobe = reflection(DVec3::Z, view, alpha, direction, None).unwrap();
                lobe.weight * lobe.density / direction.z
            };
            assert!((f(a, b) / f(b, a) - 1.0).abs() < 1e-9, "{alpha}");
        }
        for degrees in [0.0, 45.0, 80.0] {
            let view = view(degrees);
            let mut sum = 0.0;
            for index in 0..4096 {
                let facet = sample_facet(DVec3::Z, view, alpha, independent(index));
                let direction = facet * (2.0 * view.dot(facet)) - view;
                let weight =
                    reflection(DVec3::Z, view, alpha, direction, None).map_or(0.0, |lobe| lobe.weight);
                assert!((0.0..=1.0).contains(&weight));
                sum += weight;
            }
            assert!(sum / 4096.0 > 0.4, "{alpha} {degrees}: {}", sum / 4096.0);
        }
    }
}

/// Light through a rough border and back along the same way. `f / eta^2` is symmetric (Veach 1997, section 5.2), and the
/// convention here leaves the square out on the way in and on the way out: `eta^2 f(view, direction) = f(direction, view)`.
#[test]
fn refraction_is_reciprocal_up_to_the_index() {
    let (alpha, eta) = (0.4, 1.0 / 1.5);
    let mut pairs = 0;
    for degrees in [5.0, 30.0, 60.0] {
        let view = view(degrees);
        for index in 0..64 {
            let facet = sample_facet(DVec3::Z, view, alpha, independent(index));
            let refracted = split(-view, facet, eta).refracted;
            let Some(direction) = refracted.filter(|direction| direction.z < -0.05) else { continue };
            let forth = refraction(DVec3::Z, view, alpha, direction, eta).unwrap();
            let back = refraction(DVec3::NEG_Z, direction, alpha, view, 1.0 / eta).unwrap();
            let f = |lobe: Lobe, cos: f64| (1.0 - lobe.reflectance) * lobe.weight * lobe.density / cos;
            let (a, b) = (f(forth, -direction.z), f(back, view.z));
            assert!((a * eta * eta / b - 1.0).abs() < 1e-6, "{a} {b}");
            pairs += 1;
        }
    }
    assert!(pairs > 150, "{pairs}");
}

#[test]
fn a_nearly_smooth_surface_is_nearly_a_mirror() {
    let view = view(35.0);
    for index in 0..100 {
        let facet = sample_facet(DVec3::Z, view, 1e-3, independent(index));
        assert!(facet.z > 0.999, "{facet}");
        let lobe = reflection(DVec3::Z, view, 1e-3, facet * (2.0 * view.dot(facet)) - view, Some(1.0 / 1.5))
            .unwrap();
        assert!(lobe.weight > 0.999);
        assert!((lobe.reflectance - split(-view, DVec3::Z, 1.0 / 1.5).reflectance).abs() < 1e-3);
    }
}
