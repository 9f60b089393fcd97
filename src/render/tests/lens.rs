//! The blur of a lens against the formula of thin lenses.

use super::*;
use crate::render::Filter;
use crate::scene::Lens;

/// Share of a disc of radius 1 that lies beyond a line at `x` from its middle.
fn segment(x: f64) -> f64 {
    let x = x.clamp(-1.0, 1.0);
    (x.acos() - x * (1.0 - x * x).sqrt()) / std::f64::consts::PI
}

/// An edge out of focus. A ray through the lens at `l` that meets the plane of focus, at distance `f`, at `x` is at
/// `x d / f + l (1 - d / f)` at distance `d`. So of the edge of a half plane there, a point at `x` of the plane of focus sees the
/// share of the lens beyond `x / (r |f - d| / d)`: a circle of confusion of that radius.
#[test]
fn an_edge_is_blurred_over_the_circle_of_confusion() {
    const SIZE: [u32; 2] = [64, 16];
    let (radius, focus, degrees) = (0.3, 4.0, 6.0f64);
    let lens = Lens { radius, focus_distance: focus };
    let camera = Camera::pinhole([0.0; 3], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], degrees).unwrap();
    let scene = Scene::new(camera.with_lens(lens).unwrap());
    // A pixel in the plane of focus.
    let pixel = 2.0 * focus * (degrees.to_radians() / 2.0).tan() / f64::from(SIZE[1]);
    for distance in [1.5, 2.5, 4.0, 9.0] {
        let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
        let half = Mesh::new([lamp]).sheet(0, [0.0, -99.0, -distance], [99.0, 0.0, 0.0], [0.0, 198.0, 0.0]);
        let settings = RenderSettings {
            samples_per_pixel: 512,
            filter: Filter::Box,
            ..RenderSettings::new(SIZE[0], SIZE[1])
        };
        let film = render(&half, &scene, &settings).film;
        // How far the columns are from what a circle of this radius gives.
        let distance_to = |circle: f64| {
            (0..SIZE[0])
                .map(|column| {
                    let found: f64 =
                        (0..SIZE[1]).map(|row| f64::from(film.pixel(column, row)[0])).sum::<f64>()
                            / f64::from(SIZE[1]);
                    const PARTS: u32 = 64;
                    let expected: f64 = (0..PARTS)
                        .map(|part| {
                            let at = f64::from(column) + (f64::from(part) + 0.5) / f64::from(PARTS);
                            segment(-(at - f64::from(SIZE[0]) / 2.0) * pixel / circle)
                        })
                        .sum::<f64>()
                        / f64::from(PARTS);
                    (found - expected).abs()
                })
                .fold(0.0, f64::max)
        };
        let circle = radius * (focus - distance).abs() / distance;
        // In focus the edge is sharp: any small circle will do.
        let found = distance_to(circle.max(1e-9));
        assert!(found < 0.012, "at {distance}: {found}");
        if circle > 0.0 {
            let wrong = [distance_to(0.8 * circle), distance_to(1.25 * circle)];
            assert!(wrong.into_iter().all(|wrong| wrong > 0.03), "at {distance}: {wrong:?} {found}");
        }
    }
}
