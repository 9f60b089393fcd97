//! Sampled effects against formulas: energy, areas, form factors, and two ways to the same light.

use std::f64::consts::PI;

use glam::DVec3;

use super::effects::panel;
use super::*;
use crate::render::PathEnd;
use crate::scene::{Environment, Finish, Light, LightShape};

fn exact(samples_per_pixel: u32) -> RenderSettings {
    RenderSettings { contribution_bound: 0.0, samples_per_pixel, ..RenderSettings::new(1, 1) }
}

/// The ground at y = 0.
fn ground(mesh: Mesh, material: u16) -> Mesh {
    mesh.sheet(material, [-50.0, 0.0, -50.0], [0.0, 0.0, 100.0], [100.0, 0.0, 0.0])
}

/// Looks down on the origin from the height `y`; one pixel covers a speck.
fn from_above(y: f64) -> Camera {
    Camera::orthographic([0.0, y, 0.0], [0.0; 3], [0.0, 0.0, 1.0], 1e-6).unwrap()
}

#[test]
fn areas_light_as_their_formulas_say() {
    // Irradiance over pi L at the origin, with the normal up.
    let (h, r) = (2.0, 0.75);
    let disc = LightShape::Disc { center: [0.0, h, 0.0], normal: [0.0, -1.0, 0.0], radius: r };
    let slant = [0.8, 1.2, -0.5];
    let distance_squared: f64 = slant.iter().map(|x| x * x).sum();
    let sphere = LightShape::Sphere { center: slant, radius: r };
    let (a, b) = (1.1, 0.7);
    let rectangle = LightShape::Rectangle { corner: [0.0, h, 0.0], edges: [[a, 0.0, 0.0], [0.0, 0.0, b]] };
    // A corner above the point: J. Howell, "A Catalog of Radiation Heat Transfer Configuration Factors", B-4.
    let (x, y) = (a / h, b / h);
    let corner = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
    for (shape, expected) in [
        (disc, r * r / (r * r + h * h)),
        (sphere, r * r / distance_squared * slant[1] / distance_squared.sqrt()),
        (rectangle, (corner(x, y) + corner(y, x)) / (2.0 * PI)),
    ] {
        let mesh = ground(Mesh::new([matt(0.5)]), 0);
        // Not through the light itself.
        let scene = Scene::new(from_above(0.2)).with_light(Light::area(shape, [4.0; 3]));
        let (colour, picture) = one_pixel(&mesh, &scene, &exact(1 << 12));
        assert_close(colour, [0.5 * 4.0 * expected; 3], 2e-3);
        assert_eq!(picture.totals.effects.area_light_samples, 1 << 12);
        // With interreflection half of it is found by bounces, and the sum stays.
        let (colour, picture) = one_pixel(&mesh, &scene.clone().with_interreflection(), &exact(1 << 12));
        assert_close(colour, [0.5 * 4.0 * expected; 3], 8e-3);
        assert!(picture.totals.effects.light_crossings > 10);
    }
}

#[test]
fn a_light_is_seen_from_its_lit_side_and_hides_nothing() {
    let disc = |normal| LightShape::Disc { center: [0.0, 1.0, 0.0], normal, radius: 0.5 };
    let glow = MaterialRecord { emission: [0.25; 3], ..matt(0.0) };
    let mesh = ground(Mesh::new([glow, mirror(0.5)]), 0);
    let look = |mesh: &Mesh, normal| {
        let scene = Scene::new(from_above(2.0)).with_light(Light::area(disc(normal), [3.0; 3]));
        one_pixel(mesh, &scene, &exact(1)).0
    };
    assert_eq!(look(&mesh, [0.0, 1.0, 0.0]), [3.25; 3]);
    assert_eq!(look(&mesh, [0.0, -1.0, 0.0]), [0.25; 3]);
    // From behind it is seen in a mirror below.
    let mirrored = ground(Mesh::new([mirror(0.5)]), 0);
    assert_eq!(look(&mirrored, [0.0, -1.0, 0.0]), [1.5; 3]);
}

#[test]
fn soft_shadows_darken_by_the_share_of_the_light_that_is_hidden() {
    // A half plane hides half of a disc straight above.
    let disc = LightShape::Disc { center: [0.0, 2.0, 0.0], normal: [0.0, -1.0, 0.0], radius: 0.5 };
    let mesh =
        ground(Mesh::new([matt(1.0)]), 0).sheet(0, [0.0, 1.0, -9.0], [0.0, 0.0, 18.0], [9.0, 0.0, 0.0]);
    let scene = Scene::new(from_above(0.5)).with_light(Light::area(disc, [1.0; 3]));
    let (colour, _) = one_pixel(&mesh, &scene, &exact(1 << 12));
    assert_close(colour, [0.5 * 0.25 / 4.25; 3], 5e-4);
}

/// White bodies in a white world are invisible.
#[test]
fn white_furnace() {
    let camera = Camera::pinhole([3.0, 2.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 30.0).unwrap();
    let cube = |record: MaterialRecord| Mesh::new([record]).cuboid(0, [-0.8; 3], [0.8, 0.7, 0.6]);
    let settings = RenderSettings { samples_per_pixel: 256, ..RenderSettings::new(4, 4) };
    let furnace = |record: MaterialRecord, roughness: f32, is_sampled: bool| {
        let scene = Scene::new(camera).with_interreflection().with_finish("", Finish::rough(roughness));
        let scene = if is_sampled {
            scene.with_environment(Environment::Constant([1.0; 3]))
        } else {
            scene.with_background([1.0; 3])
        };
        let settings = RenderSettings { contribution_bound: 1e-5, ..settings };
        render(&cube(record), &scene, &settings)
            .film
            .pixels()
            .iter()
            .map(|pixel| pixel[0])
            .collect::<Vec<_>>()
    };
    for is_sampled in [false, true] {
        // A convex matt body: every way to the world is free.
        for pixel in furnace(matt(1.0), 0.0, is_sampled) {
            assert!((pixel - 1.0).abs() < 1e-5, "{pixel}");
        }
        // Rough mirrors and glass lose what meets a second facet, and gain nothing.
        for (record, roughness, least) in [
            (mirror(1.0), 0.2, 0.97),
            (mirror(1.0), 0.9, 0.5),
            (clear(1.5), 0.3, 0.85),
            (clear(1.5), 0.0, 0.999),
        ] {
            let pixels = furnace(record, roughness, is_sampled);
            let mean = pixels.iter().sum::<f32>() / pixels.len() as f32;
            assert!(
                mean <= 1.0 + 1e-4 + 0.03 * roughness && mean > least,
                "{roughness} {is_sampled}: {mean}"
            );
        }
    }
}

/// A closed room of reflectance `rho` that glows everywhere with `e` shows `e / (1 - rho)` everywhere.
#[test]
fn a_closed_room_sums_its_geometric_series() {
    let inside = Camera::pinhole([0.1, 0.2, 0.3], [1.0, 0.5, 0.2], [0.0, 1.0, 0.0], 60.0).unwrap();
    let room = |rho: f32| {
        Mesh::new([MaterialRecord { emission: [0.25; 3], ..matt(rho) }]).cuboid(0, [-1.0; 3], [1.0, 1.5, 2.0])
    };
    // Light that gets out would come back as darkness.
    let scene = Scene::new(inside).with_interreflection();
    let settings = |path_end| RenderSettings {
        path_end,
        contribution_bound: 1e-3,
        samples_per_pixel: 4,
        ..RenderSettings::new(6, 6)
    };
    let picture = render(&room(0.75), &scene, &settings(PathEnd::Cut));
    for pixel in picture.film.pixels() {
        // Cut once per path, by at most the bound.
        assert!((0.998..=1.000_001).contains(&pixel[0]), "{pixel:?}");
    }
    let effects = picture.totals.effects;
    assert_eq!(effects.contribution_cuts, effects.samples, "{effects:?}");
    // Roulette loses nothing on average, even with a coarse bound.
    let coarse =
        RenderSettings { contribution_bound: 0.3, samples_per_pixel: 64, ..settings(PathEnd::Roulette) };
    let picture = render(&room(0.75), &scene, &coarse);
    let mean = picture.film.pixels().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() / 36.0;
    assert!((mean - 1.0).abs() < 0.02, "{mean}");
    assert!(picture.totals.effects.roulette_ends > 0 && picture.totals.effects.contribution_cuts == 0);
}

/// A second scene for roulette: light that comes through glass, off a mirror, from a lamp and a sky, where lamps are asked by roulette too.
/// Means of pictures from seeds that know nothing of each other, with a coarse bound and with none.
#[test]
fn roulette_keeps_the_mean_where_paths_branch() {
    let mesh = ground(Mesh::new([matt(0.6), clear(1.5), mirror(0.7)]), 0)
        .cuboid(1, [-0.9, 0.1, -0.6], [-0.1, 0.9, 0.2])
        .cuboid(2, [0.2, 0.0, -0.8], [0.9, 0.8, 0.1]);
    let camera = Camera::pinhole([1.5, 1.8, 2.8], [0.0, 0.3, 0.0], [0.0, 1.0, 0.0], 35.0).unwrap();
    let scene = Scene::new(camera)
        .with_interreflection()
        .with_environment(Environment::Constant([0.3; 3]))
        .with_light(panel());
    let estimate = |contribution_bound: f64, path_end: PathEnd| {
        const SEEDS: u64 = 24;
        let settings = RenderSettings {
            contribution_bound,
            path_end,
            samples_per_pixel: 64,
            work_budget: 1 << 12,
            ..RenderSettings::new(6, 6)
        };
        let pictures: Vec<Picture> =
            (0..SEEDS).map(|seed| render(&mesh, &scene, &RenderSettings { seed, ..settings })).collect();
        let means: Vec<f64> = pictures
            .iter()
            .map(|picture| picture.film.pixels().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() / 36.0)
            .collect();
        let mean = means.iter().sum::<f64>() / SEEDS as f64;
        let squares: f64 = means.iter().map(|x| (x - mean) * (x - mean)).sum();
        let effects = pictures[0].totals.effects;
        (mean, (squares / (SEEDS * (SEEDS - 1)) as f64).sqrt(), effects)
    };
    // What faint paths of a bound of 1e-4 carry is less than a thousandth of what there is.
    let (whole, whole_error, _) = estimate(1e-4, PathEnd::Cut);
    let (roulette, roulette_error, effects) = estimate(0.5, PathEnd::Roulette);
    let error = whole_error.hypot(roulette_error);
    assert!(
        error < 0.005 * whole,
        "too noisy to tell: {whole} +- {whole_error}, {roulette} +- {roulette_error}"
    );
    assert!(
        (whole - roulette).abs() < 4.0 * error,
        "{whole} +- {whole_error}, {roulette} +- {roulette_error}"
    );
    assert!(effects.roulette_ends > 0 && effects.contribution_cuts == 0, "{effects:?}");
    // The same bound without roulette shows, so this can fail.
    let (cut, cut_error, _) = estimate(0.5, PathEnd::Cut);
    assert!(whole - cut > 8.0 * error.hypot(cut_error), "{whole} {cut} +- {cut_error}");
}

/// The same lamp as geometry that glows, found by bounces only, and as an area light, found by samples and bounces.
#[test]
fn a_glowing_sheet_and_an_area_light_give_the_same_light() {
    let lamp = MaterialRecord { emission: [2.0, 1.8, 1.5], ..matt(0.0) };
    let rough = |roughness| Finish::rough(roughness);
    let chrome = || MaterialRecord { name: "chrome".to_string(), ..mirror(0.8) };
    let frosted = || MaterialRecord { name: "frosted".to_string(), ..clear(1.4) };
    for (record, finish) in [(matt(0.6), None), (chrome(), Some(rough(0.6))), (frosted(), Some(rough(0.6)))] {
        let body = |mesh: Mesh| ground(mesh, 0).cuboid(1, [-0.6, 0.3, -0.6], [0.5, 0.9, 0.4]);
        let camera = Camera::pinhole([2.0, 2.0, 2.5], [0.0, 0.4, 0.0], [0.0, 1.0, 0.0], 30.0).unwrap();
        let mut scene = Scene::new(camera).with_interreflection();
        if let Some(finish) = finish {
            scene = scene.with_finish(record.name.clone(), finish);
        }
        let settings = RenderSettings {
            samples_per_pixel: 1 << 9,
            contribution_bound: 1e-3,
            path_end: PathEnd::Roulette,
            ..RenderSettings::new(3, 3)
        };
        let sampled_mesh = body(Mesh::new([matt(0.5), record.clone()]));
        let sampled_scene = scene.clone().with_light(panel());
        let glowing_mesh = body(Mesh::new([matt(0.5), record.clone(), lamp.clone()])).sheet(
            2,
            [-1.0, 3.0, -1.0],
            [2.0, 0.0, 0.0],
            [0.0, 0.0, 2.0],
        );
        // Mean and its standard error, from seeds that know nothing of each other.
        let estimate = |mesh: &Mesh, scene: &Scene| {
            const SEEDS: u64 = 12;
            let means: Vec<f64> = (0..SEEDS)
                .map(|seed| {
                    let film = render(mesh, scene, &RenderSettings { seed, ..settings }).film;
                    film.pixels().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() / 9.0
                })
                .collect();
            let mean = means.iter().sum::<f64>() / SEEDS as f64;
            let squares: f64 = means.iter().map(|x| (x - mean) * (x - mean)).sum();
            (mean, (squares / (SEEDS * (SEEDS - 1)) as f64).sqrt())
        };
        let (a, a_error) = estimate(&sampled_mesh, &sampled_scene);
        let (b, b_error) = estimate(&glowing_mesh, &scene);
        let name = &record.name;
        let error = a_error.hypot(b_error);
        assert!(error < 0.02 * a, "{name:?}: too noisy to tell: {a} +- {a_error}, {b} +- {b_error}");
        assert!((a - b).abs() < 4.0 * error, "{name:?}: sampled {a} +- {a_error}, found {b} +- {b_error}");
        let sampled = render(&sampled_mesh, &sampled_scene, &settings);
        let found = render(&glowing_mesh, &scene, &settings);
        assert!(
            sampled.totals.effects.area_light_samples > 0 && found.totals.effects.area_light_samples == 0
        );
    }
}

#[test]
fn a_constant_environment_lights_a_plane_as_much_as_its_background() {
    let mesh = ground(Mesh::new([matt(0.5)]), 0);
    let scene = Scene::new(from_above(1.0)).with_environment(Environment::Constant([0.8; 3]));
    assert_close(one_pixel(&mesh, &scene, &exact(1)).0, [0.4; 3], 1e-6);
    // A wall hides half of it, and with bounces gives some back.
    let walled = mesh.sheet(0, [0.0, 0.0, -99.0], [0.0, 99.0, 0.0], [0.0, 0.0, 198.0]);
    let beside = Camera::orthographic([1e-3, 1.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 0.0, 1.0], 1e-6).unwrap();
    let scene = scene.with_camera(beside);
    assert_close(one_pixel(&walled, &scene, &exact(1 << 10)).0, [0.2; 3], 3e-3);
}

/// A Cornell box without its blocks: mean radiance of the floor and a wall against a radiosity solution with form factors
/// by Lambert's formula, which shares nothing with the renderer.
#[test]
fn an_empty_cornell_box_agrees_with_radiosity() {
    let reflectances = [0.7, 0.6, 0.2, 0.5, 0.4, 0.3];
    let emitted = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0];
    let expected = radiosity(&reflectances, &emitted, 10);
    let mut mesh = Mesh::new(
        reflectances
            .iter()
            .zip(emitted)
            .map(|(rho, e)| MaterialRecord { emission: [e; 3], ..matt(*rho as f32) }),
    );
    // Floor, ceiling, left, right, back, front of the unit cube; both sides of a sheet are lit.
    for (material, (corner, a, b)) in WALLS.iter().enumerate() {
        mesh = mesh.sheet(material as u16, *corner, *a, *b);
    }
    for (wall, forward, up) in
        [(0, [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]), (2, [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0])]
    {
        let eye = [0.5; 3];
        let at = [0, 1, 2].map(|axis| eye[axis] + forward[axis]);
        // The whole wall, seen with parallel rays from within.
        let camera = Camera::orthographic(eye, at, up, 1.0).unwrap();
        let settings = RenderSettings {
            samples_per_pixel: 512,
            filter: crate::render::Filter::Box,
            contribution_bound: 1e-4,
            ..RenderSettings::new(6, 6)
        };
        let picture = render(&mesh, &Scene::new(camera).with_interreflection(), &settings);
        let mean = picture.film.pixels().iter().map(|pixel| f64::from(pixel[0])).sum::<f64>() / 36.0;
        assert!((mean / expected[wall] - 1.0).abs() < 0.01, "wall {wall}: {mean}, not {}", expected[wall]);
    }
}

type Wall = ([f64; 3], [f64; 3], [f64; 3]);

const WALLS: [Wall; 6] = [
    ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]),
    ([0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
    ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
    ([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
    ([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]),
];

/// Mean radiance of each wall, from patches `side` to an edge. The form factor from the middle of a patch to another is
/// Lambert's formula for polygons, exact.
fn radiosity(reflectances: &[f64; 6], emitted: &[f32; 6], side: usize) -> [f64; 6] {
    let per_wall = side * side;
    let at = |wall: usize, s: f64, t: f64| {
        let (corner, a, b) = WALLS[wall];
        DVec3::from_array([0, 1, 2].map(|axis| corner[axis] + s * a[axis] + t * b[axis]))
    };
    // Wall, middle, inward normal, corners.
    let patches: Vec<(usize, DVec3, DVec3, [DVec3; 4])> = (0..6 * per_wall)
        .map(|index| {
            let (wall, i, j) = (index / per_wall, (index % side) as f64, (index / side % side) as f64);
            let place = |di: f64, dj: f64| at(wall, (i + di) / side as f64, (j + dj) / side as f64);
            let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(di, dj)| place(di, dj));
            let normal = (corners[1] - corners[0]).cross(corners[3] - corners[0]).normalize();
            let inward = if normal.dot(DVec3::splat(0.5) - corners[0]) > 0.0 { normal } else { -normal };
            (wall, place(0.5, 0.5), inward, corners)
        })
        .collect();
    let factors: Vec<Vec<f64>> = patches
        .iter()
        .map(|(wall, from, normal, _)| {
            let factor = |corners: &[DVec3; 4]| {
                let sum: f64 = (0..4)
                    .map(|k| {
                        let (p, q) = (corners[k] - *from, corners[(k + 1) % 4] - *from);
                        let cross = p.cross(q);
                        cross.length().atan2(p.dot(q)) * cross.normalize_or_zero().dot(*normal)
                    })
                    .sum();
                sum.abs() / (2.0 * PI)
            };
            let row: Vec<f64> = patches
                .iter()
                .map(|(other, _, _, corners)| if wall == other { 0.0 } else { factor(corners) })
                .collect();
            let total: f64 = row.iter().sum();
            assert!((total - 1.0).abs() < 1e-9, "the room is closed: {total}");
            row
        })
        .collect();
    let mut radiance = vec![0.0; patches.len()];
    for _ in 0..60 {
        radiance = factors
            .iter()
            .zip(&patches)
            .map(|(row, (wall, ..))| {
                let received: f64 =
                    row.iter().zip(&radiance).map(|(factor, radiance)| factor * radiance).sum();
                f64::from(emitted[*wall]) + reflectances[*wall] * received
            })
            .collect();
    }
    let mut means = [0.0; 6];
    for ((wall, ..), radiance) in patches.iter().zip(radiance) {
        means[*wall] += radiance / per_wall as f64;
    }
    means
}
