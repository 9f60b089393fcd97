//! Ray trees: mirrors, glass, depth, budgets.

use super::*;
use crate::scene::Light;

fn exact() -> RenderSettings {
    RenderSettings { contribution_bound: 0.0, ..RenderSettings::new(1, 1) }
}

#[test]
fn a_mirror_shows_what_stands_beside() {
    // A mirror at 45 degrees sends the camera's ray up to a glowing ceiling.
    let lamp = MaterialRecord { emission: [0.2, 0.4, 0.6], ..matt(0.0) };
    let mesh = Mesh::new([mirror(0.5), lamp])
        .sheet(0, [-5.0, -5.0, -5.0], [0.0, 10.0, -10.0], [10.0, 0.0, 0.0])
        .sheet(1, [-50.0, 20.0, -50.0], [100.0, 0.0, 0.0], [0.0, 0.0, 100.0]);
    let scene = Scene::new(straight_camera());
    let (colour, picture) = one_pixel(&mesh, &scene, &exact());
    assert_close(colour, [0.1, 0.2, 0.3], 1e-7);
    assert_eq!(picture.totals.effects.reflection_rays, 1);
}

#[test]
fn a_corridor_of_mirrors_weakens_by_its_reflectance() {
    // Straight along the corridor of two facing mirrors, bound off: exactly as many reflections as the budget has.
    let mesh = corridor(0.5);
    let scene = Scene::new(straight_camera()).with_light(Light::directional([0.0, 0.0, -1.0], [1.0; 3]));
    let settings = RenderSettings { work_budget: 40, ..exact() };
    let (_, picture) = one_pixel(&mesh, &scene, &settings);
    assert_eq!(picture.totals.effects.reflection_rays, 39);
    assert_eq!(picture.totals.effects.work_cuts, 1);
    // With a bound the path ends when 0.5^n times the radiance bound falls below it: 0.5 / (1 - 0.5) = 1 from highlights.
    let settings = RenderSettings { contribution_bound: 1e-3, ..exact() };
    let (_, picture) = one_pixel(&mesh, &scene, &settings);
    let effects = picture.totals.effects;
    assert_eq!((effects.reflection_rays, effects.work_cuts), (9, 0));
    assert!(effects.contribution_cuts > 0);
}

/// Two facing mirrors, one before and one behind the straight camera.
fn corridor(reflectance: f32) -> Mesh {
    Mesh::new([MaterialRecord { shininess: 50.0, ..mirror(reflectance) }])
        .sheet(0, [-9.0, -9.0, 0.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0])
        .sheet(0, [-9.0, -9.0, 10.0], [0.0, 18.0, 0.0], [18.0, 0.0, 0.0])
}

#[test]
fn a_lossless_chain_of_a_hundred_thousand_mirrors_needs_no_stack() {
    let render = || {
        let settings = RenderSettings { work_budget: 100_001, batch_samples: 1, ..exact() };
        // Something must shine, or the bound proves at once that mirrors of darkness are dark.
        let mut mesh = corridor(1.0);
        mesh.materials[0].emission = [1e-6; 3];
        let (colour, picture) = one_pixel(&mesh, &Scene::new(straight_camera()), &settings);
        assert_eq!(picture.totals.effects.reflection_rays, 100_000);
        assert_eq!(picture.totals.effects.work_cuts, 1);
        assert_close(colour, [0.100001; 3], 1e-7);
    };
    std::thread::Builder::new().stack_size(64 << 10).spawn(render).unwrap().join().unwrap();
}

#[test]
fn a_mirror_room_without_light_is_not_walked() {
    let settings = RenderSettings { contribution_bound: 1e-6, ..RenderSettings::new(1, 1) };
    let (colour, picture) = one_pixel(&corridor(1.0), &Scene::new(straight_camera()), &settings);
    assert_eq!((colour, picture.totals.effects.rays()), ([0.0; 3], 1));
}

/// Glass bodies before a background of 1 must show 1 everywhere: R + T = 1 at every surface.
#[test]
fn clear_glass_in_a_white_furnace_is_invisible() {
    let mesh = Mesh::new([clear(1.5), clear(2.4)]).cuboid(0, [-0.8, -0.8, -0.8], [0.5, 0.5, 0.5]).cuboid(
        1,
        [-0.3, 0.6, -2.0],
        [0.9, 0.9, 2.0],
    );
    let camera = Camera::pinhole([3.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 30.0).unwrap();
    let scene = Scene::new(camera).with_background([1.0; 3]);
    let settings =
        RenderSettings { contribution_bound: 1e-4, work_budget: 1 << 20, ..RenderSettings::new(16, 16) };
    let picture = render(&mesh, &scene, &settings);
    let effects = picture.totals.effects;
    assert!(effects.transmission_rays > 300 && effects.reflection_rays > 300, "{effects:?}");
    for pixel in picture.film.pixels() {
        // Each cut takes at most the bound; a sample here cuts a few hundred rays at the very most.
        assert!((0.97..=1.000_001).contains(&pixel[0]), "{pixel:?}");
    }
    assert_eq!(effects.work_cuts, 0, "{effects:?}");
    let total: f64 = picture.film.pixels().iter().map(|pixel| 1.0 - f64::from(pixel[0])).sum();
    assert!(total <= effects.contribution_cuts as f64 * settings.contribution_bound + 1e-3);
}

#[test]
fn a_glass_slab_reflects_by_fresnel() {
    // Face on: the front reflects R, and the two faces together reflect 2R / (1 + R).
    let lamp = MaterialRecord { emission: [1.0; 3], ..matt(0.0) };
    let mesh = Mesh::new([clear(1.5), lamp]).cuboid(0, [-9.0, -9.0, -1.0], [9.0, 9.0, 0.0]).sheet(
        1,
        [-9.0, -9.0, -4.0],
        [18.0, 0.0, 0.0],
        [0.0, 18.0, 0.0],
    );
    let r = 0.04;
    let settings = RenderSettings { contribution_bound: 1e-9, work_budget: 1 << 16, ..exact() };
    let (colour, _) = one_pixel(&mesh, &Scene::new(straight_camera()), &settings);
    assert_close(colour, [1.0 - 2.0 * r / (1.0 + r); 3], 1e-6);
}

#[test]
fn inside_glass_beyond_the_critical_angle_everything_is_reflected() {
    // The camera stands in a long glass block and looks at its upper face 30 degrees from grazing.
    let lamp = MaterialRecord { emission: [0.5; 3], ..matt(0.0) };
    let mesh = Mesh::new([clear(1.5), lamp])
        .cuboid(0, [-100.0, -1.0, -100.0], [100.0, 1.0, 100.0])
        .sheet(1, [-500.0, 50.0, -500.0], [1000.0, 0.0, 0.0], [0.0, 0.0, 1000.0])
        .sheet(1, [20.0, -1.0, -100.0], [0.0, 2.0, 0.0], [0.0, 0.0, 200.0]);
    let camera =
        Camera::orthographic([0.0; 3], [0.866_025_403_784, 0.5, 0.0], [0.0, 1.0, 0.0], 1e-3).unwrap();
    let (colour, picture) = one_pixel(&mesh, &Scene::new(camera), &exact());
    assert_eq!(colour, [0.5; 3]);
    let effects = picture.totals.effects;
    assert_eq!(effects.transmission_rays, 0, "{effects:?}");
    // Up and down every 2 units of height, tan 30 degrees: 20 units across.
    assert_eq!(effects.reflection_rays, 6);
}

#[test]
fn budgets_are_divided_and_every_cut_is_counted() {
    let mesh = Mesh::new([clear(1.5)]).cuboid(0, [-9.0, -9.0, -1.0], [9.0, 9.0, 0.0]).cuboid(
        0,
        [-9.0, -9.0, -3.0],
        [9.0, 9.0, -2.0],
    );
    let camera = Camera::pinhole([1.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 30.0).unwrap();
    let scene = Scene::new(camera).with_background([1.0; 3]);
    for work_budget in [1, 2, 3, 4, 7, 64, 1000] {
        let settings = RenderSettings { work_budget, ..exact() };
        let (colour, picture) = one_pixel(&mesh, &scene, &settings);
        let effects = picture.totals.effects;
        assert!(effects.rays() <= work_budget, "{work_budget}: {effects:?}");
        assert!(effects.work_cuts > 0);
        assert!(
            colour[0] <= 1.0 + 1e-6 && (work_budget < 64 || colour[0] > 0.9),
            "{work_budget}: {colour:?}"
        );
    }
}
