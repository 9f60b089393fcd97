//! Colours against formulas.

use super::*;
use crate::scene::{Falloff, Light};

const WIDE: f64 = 100.0;

/// A large sheet in the plane z = `z` that faces the straight camera.
fn wall(mesh: Mesh, material: u16, z: f64) -> Mesh {
    mesh.sheet(material, [-WIDE, -WIDE, z], [2.0 * WIDE, 0.0, 0.0], [0.0, 2.0 * WIDE, 0.0])
}

fn exact() -> RenderSettings {
    RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(1, 1) }
}

#[test]
fn nothing_but_background() {
    let scene = Scene::new(straight_camera()).with_background([1.0, 0.5, 0.25]);
    let picture = render(&Mesh::new([matt(0.5)]), &scene, &RenderSettings::new(70, 33));
    assert!(picture.film.is_complete());
    assert!(picture.film.pixels().iter().all(|pixel| *pixel == [1.0, 0.5, 0.25]));
    let effects = picture.totals.effects;
    assert_eq!((effects.samples, effects.primary_rays, effects.rays()), (2310, 2310, 2310));
}

#[test]
fn lambert_and_highlight_follow_their_formulas() {
    let material = MaterialRecord {
        diffuse: [0.5, 0.25, 0.0],
        specular: [0.0, 0.5, 0.5],
        shininess: 10.0,
        ..MaterialRecord::default()
    };
    let mesh = wall(Mesh::new([material]), 0, 0.0);
    // 60 degrees off the normal; the half vector lies at 30 degrees.
    let (sin, cos) = (libm::sin(1.0471975511965976), 0.5);
    let highlight = 0.5 * libm::pow(libm::cos(0.5235987755982988), 10.0);
    let expected = [0.5 * cos * 2.0, (0.25 * cos + highlight) * 1.0, highlight * 0.5];
    let sun = Light::directional([sin, 0.0, -cos], [2.0, 1.0, 0.5]);
    let scene = Scene::new(straight_camera()).with_light(sun);
    assert_close(one_pixel(&mesh, &scene, &exact()).0, expected, 1e-6);
    // The same from a point without falloff, wherever it is along the way.
    let lamp = Light::point([-8.0 * sin, 0.0, 8.0 * cos], [2.0, 1.0, 0.5]);
    let scene = Scene::new(straight_camera()).with_light(lamp);
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert_close(colour, expected, 1e-6);
    assert_eq!(picture.totals.effects.shadow_rays, 1);
    // And weakened by distance squared.
    let lamp = Light::Point {
        position: [-8.0 * sin, 0.0, 8.0 * cos],
        intensity: [128.0, 64.0, 32.0],
        falloff: Falloff::InverseSquare { radius: 0.1 },
    };
    let scene = Scene::new(straight_camera()).with_light(lamp);
    assert_close(one_pixel(&mesh, &scene, &exact()).0, expected, 1e-6);
}

#[test]
fn ambient_and_emission_need_no_lamp() {
    let material =
        MaterialRecord { diffuse: [0.5; 3], emission: [0.0, 1.0, 0.0], ..MaterialRecord::default() };
    let mesh = wall(Mesh::new([material]), 0, 0.0);
    let scene = Scene::new(straight_camera()).with_ambient([0.5, 0.5, 0.0]);
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert_eq!(colour, [0.25, 1.25, 0.0]);
    assert_eq!(picture.totals.effects.rays(), 1);
}

#[test]
fn a_lamp_behind_the_surface_makes_no_ray() {
    let mesh = wall(Mesh::new([matt(0.5)]), 0, 0.0);
    let scene = Scene::new(straight_camera()).with_light(Light::directional([0.0, 0.0, 1.0], [1.0; 3]));
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert_eq!(colour, [0.0; 3]);
    assert_eq!(picture.totals.effects.shadow_rays, 0);
}

#[test]
fn both_sides_of_a_sheet_are_lit() {
    // The same sheet wound the other way round.
    let mesh = Mesh::new([matt(0.5)]).sheet(0, [-9.0, -9.0, 0.0], [0.0, 18.0, 0.0], [18.0, 0.0, 0.0]);
    let scene = Scene::new(straight_camera()).with_light(Light::directional([0.0, 0.0, -1.0], [1.0; 3]));
    assert_eq!(one_pixel(&mesh, &scene, &exact()).0, [0.5; 3]);
}

#[test]
fn shadows_fall_and_can_be_switched_off() {
    let mesh = wall(Mesh::new([matt(0.5)]), 0, 0.0);
    let lamp = Light::point([3.0, 0.0, 3.0], [1.0; 3]);
    let scene = Scene::new(straight_camera()).with_light(lamp);
    let lit = one_pixel(&mesh, &scene, &exact()).0;
    assert!(lit[0] > 0.3);
    let hidden = mesh.clone().cuboid(0, [1.0, -1.0, 1.0], [2.0, 1.0, 2.0]);
    assert_eq!(one_pixel(&hidden, &scene, &exact()).0, [0.0; 3]);
    // What stands behind the lamp casts no shadow.
    let beyond = mesh.cuboid(0, [3.5, -1.0, 3.5], [4.0, 1.0, 4.0]);
    assert_eq!(one_pixel(&beyond, &scene, &exact()).0, lit);
    let off = RenderSettings {
        switched_off: crate::scene::EffectSet::EMPTY.with(crate::scene::Effect::Shadows),
        ..exact()
    };
    let (colour, picture) = one_pixel(&hidden, &scene, &off);
    assert_eq!(colour, lit);
    assert_eq!(picture.totals.effects.shadow_rays, 0);
}

#[test]
fn light_through_veils_is_filtered_once_per_crossing() {
    let veil = MaterialRecord { opacity: 0.25, ..matt(0.0) };
    let smoke = MaterialRecord { transmission: [1.0, 0.5, 0.25], ..clear(1.0) };
    let mesh = wall(Mesh::new([matt(1.0), veil, smoke]), 0, 0.0);
    let sun = Light::directional([0.0, -0.6, -0.8], [1.0; 3]);
    let scene = Scene::new(straight_camera()).with_light(sun);
    let sheet = |mesh: Mesh, z: f64| {
        // Spanned so that the ray from the pixel's middle to the sun meets the diagonal that its two triangles
        // share, away from the camera's own ray.
        let middle = 0.75 * z;
        mesh.sheet(1, [-0.5, middle - 0.5, z], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    };
    let once = sheet(mesh.clone(), 2.0);
    assert_close(one_pixel(&once, &scene, &exact()).0, [0.8 * 0.75; 3], 1e-6);
    let twice = sheet(once, 3.0);
    assert_close(one_pixel(&twice, &scene, &exact()).0, [0.8 * 0.5625; 3], 1e-6);
    // Through a box of clear smoke the light loses by the length inside: 1 / 0.8 high, slanted.
    let smoky = mesh.clone().cuboid(2, [-1.0, 0.5, 1.0], [1.0, 9.0, 2.0]);
    let expected = [1.0, 0.5, 0.25].map(|share: f64| 0.8 * libm::pow(share, 1.25));
    let (colour, picture) = one_pixel(&smoky, &scene, &exact());
    assert_close(colour, expected, 1e-6);
    // Entering, leaving, through.
    assert_eq!(picture.totals.effects.shadow_segments, 3);
    // An opaque wall behind the glass still hides the sun, and the glass is not walked for it.
    let hidden = smoky.cuboid(0, [-1.0, 2.0, 3.0], [1.0, 4.0, 4.0]);
    let (colour, picture) = one_pixel(&hidden, &scene, &exact());
    assert_eq!(colour, [0.0; 3]);
    assert_eq!(picture.totals.effects.shadow_segments, 0);
}

#[test]
fn two_veils_that_touch_count_twice() {
    // Two sheets in the same plane but different materials share vertices; each takes its part.
    let veil = || MaterialRecord { opacity: 0.5, ..matt(0.0) };
    let mesh = wall(Mesh::new([matt(1.0), veil(), veil()]), 0, 0.0);
    let scene = Scene::new(straight_camera()).with_light(Light::directional([0.0, -0.6, -0.8], [1.0; 3]));
    let doubled = mesh.sheet(1, [-1.0, 0.5, 2.0], [2.5, 0.0, 0.0], [0.0, 2.0, 0.0]).sheet(
        2,
        [-1.0, 0.5, 2.0],
        [2.5, 0.0, 0.0],
        [0.0, 2.0, 0.0],
    );
    assert_close(one_pixel(&doubled, &scene, &exact()).0, [0.8 * 0.25; 3], 1e-6);
}

#[test]
fn a_slab_absorbs_by_beer_and_lambert() {
    let smoke = MaterialRecord { transmission: [1.0, 0.5, 0.1], ..clear(1.0) };
    let mesh = Mesh::new([smoke]).cuboid(0, [-3.0, -3.0, -2.5], [3.0, 3.0, 0.0]);
    let scene = Scene::new(straight_camera()).with_background([1.0, 1.0, 2.0]);
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert_close(colour, [1.0, libm::pow(0.5, 2.5), 2.0 * libm::pow(0.1, 2.5)], 1e-6);
    let effects = picture.totals.effects;
    // Index 1: straight through, and nothing is reflected.
    assert_eq!((effects.transmission_rays, effects.reflection_rays), (2, 0));
}

#[test]
fn opacity_weighs_surface_against_what_is_behind() {
    let veil = MaterialRecord { opacity: 0.25, ..matt(0.8) };
    let mesh = wall(Mesh::new([veil]), 0, 0.0);
    let scene = Scene::new(straight_camera())
        .with_background([1.0, 0.0, 0.0])
        .with_light(Light::directional([0.0, 0.0, -1.0], [1.0; 3]));
    assert_close(one_pixel(&mesh, &scene, &exact()).0, [0.75 + 0.2, 0.2, 0.2], 1e-6);
}
