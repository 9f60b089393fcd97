//! Nested dielectrics: coincident and overlapping bodies, with every body left as often as it was entered.

use super::*;
use crate::scene::{Effect, Finish};

fn exact() -> RenderSettings {
    RenderSettings { contribution_bound: 1e-7, work_budget: 1 << 14, ..RenderSettings::new(1, 1) }
}

fn named(name: &str, record: MaterialRecord) -> MaterialRecord {
    MaterialRecord { name: name.to_string(), ..record }
}

fn glass() -> MaterialRecord {
    named("glass", clear(1.5))
}

fn water() -> MaterialRecord {
    named("water", MaterialRecord { transmission: [1.0, 0.5, 0.25], ..clear(1.25) })
}

fn ranked(camera: Camera) -> Scene {
    Scene::new(camera)
        .with_background([1.0; 3])
        .with_finish("glass", Finish::nested(2))
        .with_finish("water", Finish::nested(1))
}

/// Share of light through a stack of plane borders with these reflectances and transmittances of the layers between, with
/// all reflections between them, by adding layers from behind.
fn through(reflectances: &[f64], layers: &[f64]) -> (f64, f64) {
    let (mut t, mut r) = (1.0 - reflectances[0], reflectances[0]);
    let mut r_back = reflectances[0];
    for (next, layer) in reflectances[1..].iter().zip(layers) {
        // What is there so far, a layer, and the next border.
        let between = 1.0 - r_back * next * layer * layer;
        let all_through = t * layer * (1.0 - next) / between;
        r += t * t * layer * layer * next / between;
        r_back = next + (1.0 - next) * (1.0 - next) * layer * layer * r_back / between;
        t = all_through;
    }
    (t, r)
}

fn fresnel(a: f64, b: f64) -> f64 {
    ((a - b) / (a + b)) * ((a - b) / (a + b))
}

const WIDE: f64 = 9.0;

fn slab(mesh: Mesh, material: u16, from: f64, to: f64) -> Mesh {
    mesh.cuboid(material, [-WIDE, -WIDE, from], [WIDE, WIDE, to])
}

/// The same slab with its front and back cut along the other diagonal and off the middle.
fn slab_cut_otherwise(mesh: Mesh, material: u16, from: f64, to: f64) -> Mesh {
    let mut mesh = slab(mesh, material, from, to);
    let count = mesh.triangles.len();
    for (vertices, _) in &mut mesh.triangles[count - 12..] {
        for vertex in vertices.iter_mut() {
            vertex[0] *= if vertex[1] > 0.0 { 0.75 } else { 1.25 };
        }
    }
    mesh
}

#[test]
fn coincident_faces_are_one_border() {
    // Glass 0 .. -1, water -1 .. -2, glass -2 .. -3, a lamp behind: face on, so Fresnel's equations are simple.
    let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
    for cut_otherwise in [false, true] {
        let mut mesh = Mesh::new([glass(), water(), lamp.clone()]);
        mesh = slab(mesh, 0, -1.0, 0.0);
        mesh =
            if cut_otherwise { slab_cut_otherwise(mesh, 1, -2.0, -1.0) } else { slab(mesh, 1, -2.0, -1.0) };
        mesh = slab(mesh, 0, -3.0, -2.0).sheet(
            2,
            [-WIDE, -WIDE, -5.0],
            [2.0 * WIDE, 0.0, 0.0],
            [0.0, 2.0 * WIDE, 0.0],
        );
        let scene = ranked(straight_camera()).with_background([0.0; 3]);
        let (colour, picture) = one_pixel(&mesh, &scene, &exact());
        let borders = [fresnel(1.0, 1.5), fresnel(1.5, 1.25), fresnel(1.25, 1.5), fresnel(1.5, 1.0)];
        let expected = [1.0, 0.5, 0.25].map(|share| through(&borders, &[1.0, share, 1.0]).0);
        assert_close(colour, expected, 1e-5);
        assert_eq!(picture.totals.effects.medium_overflows, 0);
        assert_eq!(picture.totals.effects.passed_surfaces, 0);
        // Without priorities there is a gap of air at each border.
        let plain = Scene::new(straight_camera());
        let (colour, picture) = one_pixel(&mesh, &plain, &exact());
        assert!((f64::from(colour[0]) - expected[0]).abs() > 0.01, "{colour:?}");
        assert_eq!(picture.totals.effects.medium_rays, 0);
    }
}

#[test]
fn an_overlap_belongs_to_the_body_of_higher_priority() {
    let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
    let scene = ranked(straight_camera()).with_background([0.0; 3]);
    let with_water = |from: f64, to: f64| {
        let mesh = Mesh::new([glass(), water(), lamp.clone()]);
        let mesh = slab(slab(slab(mesh, 0, -1.0, 0.0), 1, from, to), 0, -3.0, -2.0);
        let mesh = mesh.sheet(2, [-WIDE, -WIDE, -5.0], [2.0 * WIDE, 0.0, 0.0], [0.0, 2.0 * WIDE, 0.0]);
        one_pixel(&mesh, &scene, &exact())
    };
    let (touching, _) = with_water(-2.0, -1.0);
    // The water reaches into the glass on both sides: its surfaces there are no borders.
    let (overlapping, picture) = with_water(-2.25, -0.5);
    // Cuts take a little more or less with one more ray on the way.
    assert_close(overlapping, touching.map(f64::from), 2e-5);
    assert!(picture.totals.effects.passed_surfaces > 2, "{:?}", picture.totals.effects);
    // And all the way through the glass: the water comes out in front.
    let (_, picture) = with_water(-2.25, 0.5);
    assert!(picture.totals.effects.passed_surfaces > 0);
}

#[test]
fn equal_bodies_that_touch_or_overlap_look_like_one() {
    let camera = Camera::pinhole([3.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 20.0).unwrap();
    let scene = ranked(camera).with_background([0.2, 0.5, 0.9]);
    let twin = named("water", clear(1.5));
    let settings = RenderSettings { width: 8, height: 8, ..exact() };
    let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
    let mesh = || {
        Mesh::new([glass(), twin.clone(), lamp.clone()]).sheet(
            2,
            [-9.0, -3.0, -9.0],
            [0.0, 0.0, 18.0],
            [9.0, 0.0, 0.0],
        )
    };
    let one = render(&mesh().cuboid(0, [-1.0; 3], [1.0; 3]), &scene, &settings);
    for meeting in [0.0, 0.3] {
        let two =
            mesh().cuboid(0, [-1.0; 3], [meeting, 1.0, 1.0]).cuboid(1, [0.0, -1.0, -1.0], [1.0, 1.0, 1.0]);
        let two = render(&two, &scene, &settings);
        assert!(two.totals.effects.medium_rays > 0);
        for (a, b) in one.film.pixels().iter().zip(two.film.pixels()) {
            assert_close(*b, a.map(f64::from), 1e-4);
        }
    }
}

/// Before a background of 1 clear bodies are invisible however they overlap, unless light is lost at a border.
#[test]
fn nested_glass_in_a_white_furnace_is_invisible() {
    let camera = Camera::pinhole([3.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 30.0).unwrap();
    let clear_water = named("water", clear(1.33));
    let mesh = Mesh::new([glass(), clear_water])
        .cuboid(0, [-0.8; 3], [0.5, 0.5, 0.5])
        .cuboid(1, [-0.3, 0.5, -2.0], [0.9, 0.9, 2.0])
        .cuboid(1, [-0.5, -0.5, -0.5], [0.2, 0.3, 0.9])
        .cuboid(0, [0.5, -0.4, -0.6], [1.0, 0.5, 0.5]);
    let settings =
        RenderSettings { contribution_bound: 1e-4, work_budget: 1 << 20, ..RenderSettings::new(16, 16) };
    let picture = render(&mesh, &ranked(camera), &settings);
    let effects = picture.totals.effects;
    assert!(effects.passed_surfaces > 50 && effects.work_cuts == 0, "{effects:?}");
    let missing: f64 = picture.film.pixels().iter().map(|pixel| 1.0 - f64::from(pixel[0])).sum();
    assert!(missing <= effects.contribution_cuts as f64 * settings.contribution_bound + 1e-3, "{missing}");
    for pixel in picture.film.pixels() {
        assert!((0.97..=1.000_001).contains(&pixel[0]), "{pixel:?}");
    }
}

#[test]
fn a_camera_inside_a_body_knows_where_it_is_once_it_leaves() {
    let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
    let mesh = slab(Mesh::new([glass(), water(), lamp]), 1, -1.0, 9.0).sheet(
        2,
        [-WIDE, -WIDE, -5.0],
        [2.0 * WIDE, 0.0, 0.0],
        [0.0, 2.0 * WIDE, 0.0],
    );
    let (colour, _) = one_pixel(&mesh, &ranked(straight_camera()).with_background([0.0; 3]), &exact());
    // Through 6 units of water, then out of it; reflections come back from its other end at z = 9.
    let r = fresnel(1.25, 1.0);
    let absorbed = 0.5f64.powi(6);
    let back = 0.5f64.powi(20);
    let expected = absorbed * (1.0 - r) / (1.0 - r * r * back);
    assert!((f64::from(colour[1]) - expected).abs() < 1e-6, "{colour:?} {expected}");
}

#[test]
fn paint_on_glass_is_seen() {
    let paint = MaterialRecord { emission: [0.0, 1.0, 0.0], ..matt(0.0) };
    for glass_first in [false, true] {
        let mut mesh = Mesh::new([glass(), water(), paint.clone()]);
        let sheet = |mesh: Mesh| mesh.sheet(2, [-5.0, -5.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0]);
        mesh = if glass_first { sheet(slab(mesh, 0, -1.0, 0.0)) } else { slab(sheet(mesh), 0, -1.0, 0.0) };
        assert_eq!(one_pixel(&mesh, &ranked(straight_camera()), &exact()).0, [0.0, 1.0, 0.0]);
    }
}

#[test]
fn too_many_bodies_are_counted() {
    let mut mesh = Mesh::new([glass(), water()]);
    for shell in 0..13 {
        let half = 1.0 - 0.05 * f64::from(shell);
        mesh = mesh.cuboid(0, [-half; 3], [half; 3]);
    }
    let scene = ranked(straight_camera());
    let plan = EffectPlan::of_materials(&scene, &mesh.materials, &exact().effect_options());
    assert!(plan.has(Effect::NestedMedia));
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert!(picture.totals.effects.medium_overflows > 0);
    assert!((0.9..=1.001).contains(&colour[0]), "{colour:?}");
}
