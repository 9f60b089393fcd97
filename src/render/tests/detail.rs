//! What hits look like by the attributes of their corners: smooth normals.

use super::*;
use crate::render::Film;
use crate::scene::{Effect, EffectSet, Light};

/// From the front, with a lamp far to the left of the camera.
fn lit_from_the_side() -> Scene {
    let camera = Camera::orthographic([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 2.2).unwrap();
    Scene::new(camera).with_light(Light::directional([1.0, 0.0, -0.1], [1.0; 3]))
}

fn settings() -> RenderSettings {
    RenderSettings::new(64, 64)
}

/// What a perfect white sphere shows, pixel by pixel, where the ray meets the mesh inscribed to it too.
fn differences(film: &Film, toward: [f64; 3]) -> (f64, f64) {
    let toward = DVec3::from_array(toward).normalize();
    let (mut sum, mut worst, mut count) = (0.0, 0.0f64, 0);
    for y in 0..64 {
        for x in 0..64 {
            let [px, py] =
                [(f64::from(x) + 0.5) / 32.0 - 1.0, 1.0 - (f64::from(y) + 0.5) / 32.0].map(|p| p * 1.1);
            let r2 = px * px + py * py;
            // Not at the rim, where the mesh ends before the sphere.
            if r2 > 0.75 {
                continue;
            }
            let normal = DVec3::new(px, py, (1.0 - r2).sqrt());
            let error = (f64::from(film.pixel(x, y)[0]) - normal.dot(toward).max(0.0)).abs();
            sum += error;
            worst = worst.max(error);
            count += 1;
        }
    }
    (sum / f64::from(count), worst)
}

#[test]
fn a_coarse_smooth_sphere_is_shaded_like_a_sphere_also_where_light_ends() {
    let scene = lit_from_the_side();
    let film = |is_smooth, switched_off| {
        let mesh = Mesh::new([matt(1.0)]).sphere(0, [0.0; 3], 1.0, 2, is_smooth);
        let settings = RenderSettings { switched_off, contribution_bound: 0.0, ..settings() };
        render(&mesh, &scene, &settings).film
    };
    let toward = [-1.0, 0.0, 0.1];
    let (flat, _) = differences(&film(false, EffectSet::EMPTY), toward);
    let (smooth, worst) = differences(&film(true, EffectSet::EMPTY), toward);
    let (unshadowed, _) = differences(&film(true, EffectSet::EMPTY.with(Effect::Shadows)), toward);
    // The interpolated normal is that of the sphere but for the mesh's lesser depth; the shadow of the mesh on itself adds nothing: without
    // the lift it takes light from a broad band.
    assert!(flat > 0.03 && smooth < 0.02 && worst < 0.12, "{flat} {smooth} {worst}");
    assert!((smooth - unshadowed).abs() < 0.002, "{smooth} {unshadowed}");
}

#[test]
fn flat_normals_change_no_bit() {
    // Normals that are those of the triangles are what there is without any.
    let corners = [
        [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]],
        [[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]],
    ];
    let mesh = |attributes: CornerAttributes| {
        corners.iter().fold(Mesh::new([matt(0.8)]), |mesh, corners| mesh.triangle(0, *corners, attributes))
    };
    let scene = Scene::new(Camera::pinhole([0.5, 0.2, 3.0], [0.0; 3], [0.0, 1.0, 0.0], 50.0).unwrap())
        .with_light(Light::point([1.0, 2.0, 2.0], [1.0; 3]));
    let with = CornerAttributes { normals: Some([[0.0, 0.0, 1.0]; 3]), uvs: None };
    let [plain, smooth] =
        [CornerAttributes::default(), with].map(|attributes| render(&mesh(attributes), &scene, &settings()));
    assert_eq!(plain.totals.effects.attribute_lookups, 0);
    assert!(smooth.totals.effects.smooth_hits > 500);
    assert!(plain.film.pixels() == smooth.film.pixels());
}

#[test]
fn normals_from_behind_and_across_never_give_more_than_the_light() {
    // Every normal that a file can hold: no pixel is brighter than a facing surface, none is NaN.
    let scene = lit_from_the_side()
        .with_light(Light::directional([0.0, 0.0, -1.0], [0.5; 3]))
        .with_interreflection()
        .with_background([0.2; 3]);
    let directions =
        [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 1e-9], [0.6, 0.0, -0.8], [0.0; 3]];
    for a in directions {
        for b in directions {
            let attributes = CornerAttributes { normals: Some([a, b, a]), uvs: None };
            for material in [matt(0.5), mirror(0.9), clear(1.5)] {
                let mesh = Mesh::new([material]).triangle(
                    0,
                    [[-1.0, -1.0, 0.0], [1.0, -1.0, 0.3], [0.0, 1.0, 0.0]],
                    attributes,
                );
                let film = render(&mesh, &scene, &RenderSettings::new(16, 16)).film;
                for pixel in film.pixels() {
                    assert!(pixel.iter().all(|x| (0.0..1.6).contains(x)), "{a:?} {b:?}: {pixel:?}");
                }
            }
        }
    }
}
