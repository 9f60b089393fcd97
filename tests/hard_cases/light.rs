//! Long chains of mirrors, the critical angle, and light that must neither vanish nor appear.

use std::sync::Arc;

use outcrop::BlockSource;
use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Threads};
use outcrop::geom::{Ray, offset_origin};
use outcrop::model::MaterialRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{CUBOID_FACES, Icosphere, cuboid_corners};
use outcrop::render::{Control, RenderSettings, RenderedImage, Renderer};
use outcrop::scene::{Camera, Scene};
use outcrop::source::MemorySource;
use outcrop::units::Bytes;

use crate::cases::{along, minus, unit};
use crate::compiling::{Mesh, Vertices, compile};
use crate::everywhere::open;

fn mirror(emission: f32) -> MaterialRecord {
    MaterialRecord {
        diffuse: [0.0; 3],
        specular: [1.0; 3],
        emission: [emission; 3],
        mirror: true,
        ..MaterialRecord::default()
    }
}

fn glass(refractive_index: f32) -> MaterialRecord {
    MaterialRecord { diffuse: [0.0; 3], opacity: 0.0, refractive_index, ..MaterialRecord::default() }
}

fn compiled(mesh: Mesh, record: MaterialRecord) -> Arc<dyn BlockSource> {
    let mesh = Mesh { records: vec![record], ..mesh };
    let options = CompileOptions { block_bytes: 4 << 10, ..Default::default() };
    Arc::new(MemorySource::new(compile(&mesh, &options, Bytes::mib(64)).1).unwrap())
}

/// A box from -1 to 1 on each axis, scaled and moved; faces seen from outside.
fn cuboid(half: [f64; 3], center: [f64; 3]) -> Mesh {
    let corners = cuboid_corners(minus(center, half), along(center, 1.0, half));
    Mesh::new(Vertices::Float64(corners.to_vec()), CUBOID_FACES.to_vec())
}

fn render(source: &Arc<dyn BlockSource>, scene: &Scene, settings: &RenderSettings) -> RenderedImage {
    let octree = open(source, OctreeOptions::default());
    let renderer = Renderer::new(&octree, scene, settings, &MemoryBudget::new(Bytes::mib(64))).unwrap();
    renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap()
}

const N: [f64; 3] = [2.0, 3.0, 6.0];
const U: [f64; 3] = [3.0, -6.0, 2.0];
const V: [f64; 3] = [6.0, 2.0, -3.0];

/// Two parallel mirrors, slanted in space, in the planes `p . N / 49 = 0` and `= 1`; all coordinates are integers.
fn corridor() -> Mesh {
    let at = |n: u32, u: u32, v: u32| {
        let p = along([0.0; 3], f64::from(n), N);
        let p = along(p, f64::from(u) * 8.0 - 8.0, U);
        along(p, if v == 0 { -1.0 } else { 1.0 }, V).map(|x| x as f32)
    };
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for n in 0..2 {
        for u in 0..128u32 {
            let first = vertices.len() as u32;
            vertices.extend([at(n, u, 0), at(n, u + 1, 0), at(n, u + 1, 1), at(n, u, 1)]);
            triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    Mesh::new(Vertices::Float32(vertices), triangles)
}

#[test]
fn a_corridor_of_1e6_mirror_bounces() {
    let octree = open(&compiled(corridor(), mirror(0.0)), OctreeOptions::default());
    let mut tracer = octree.tracer().unwrap();
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let slope = 1.0 / 1024.0;
    let mut ray = Ray::new(along([0.0; 3], 0.5, N), unit(along(N, slope, U)));
    const BOUNCES: u32 = 1_000_000;
    let mut last = [0.0; 3];
    for bounce in 0..BOUNCES {
        let hit = tracer.closest_hit(&ray).unwrap().unwrap_or_else(|| panic!("lost at bounce {bounce}"));
        let normal = unit(hit.normal());
        let direction = unit(along(ray.direction, -2.0 * dot(ray.direction, normal), normal));
        let side = along([0.0; 3], -dot(ray.direction, normal), normal);
        last = hit.position();
        let origin = offset_origin(last, hit.position_error(), hit.normal(), side);
        ray = Ray::new(origin, direction);
    }
    // By unfolding: half a width to the first hit, one more to each other; the last one lies in the plane 0 or 1.
    let across = if BOUNCES.is_multiple_of(2) { 0.0 } else { 1.0 };
    let expected = along(along([0.0; 3], across, N), (f64::from(BOUNCES) - 0.5) * slope, U);
    let off = minus(last, expected);
    let widths = dot(off, off).sqrt() / 7.0;
    println!("{BOUNCES} bounces: {widths:.2e} widths off");
    assert!(widths < 1e-3, "{widths}");
}

/// A chain of `depth` mirrors on a thread with a stack of 2 MiB.
fn chain(depth: u64) {
    let emission = 2f32.powi(-20);
    let body = move || {
        let source = compiled(corridor(), mirror(emission));
        let eye = along([0.0; 3], 0.5, N);
        let camera = Camera::orthographic(eye, along(eye, 1.0, N), U, 0.5).unwrap();
        let settings =
            RenderSettings { work_budget: depth, contribution_bound: 0.0, ..RenderSettings::new(1, 1) };
        let image = render(&source, &Scene::new(camera), &settings);
        let effects = image.report.effects;
        assert_eq!((effects.reflection_rays, effects.work_cuts), (depth - 1, 1));
        let colour = f64::from(image.film.pixel(0, 0)[0]);
        let expected = depth as f64 * f64::from(emission);
        assert!((colour - expected).abs() <= 1e-6 * expected, "{colour}, not {expected}");
    };
    std::thread::Builder::new().stack_size(2 << 20).spawn(body).unwrap().join().unwrap();
}

#[test]
fn ray_depth_of_1e6_on_a_2_mib_stack() {
    chain(1_000_000);
}

#[test]
#[ignore = "ten million bounces: a minute"]
fn ray_depth_of_1e7_on_a_2_mib_stack() {
    chain(10_000_000);
}

#[test]
fn a_closed_lossless_box_keeps_its_light() {
    for translation in [0.0, 1e6] {
        let center = [translation, -translation, translation];
        let source = compiled(cuboid([1.0, 0.75, 1.25], center), mirror(0.001));
        let eye = along(center, 0.1, [1.0, 2.0, -1.0]);
        let camera = Camera::pinhole(eye, along(eye, 1.0, [0.3, 0.2, 1.0]), [0.0, 1.0, 0.0], 100.0).unwrap();
        // What gets out floods the pixel.
        let scene = Scene::new(camera).with_background([1000.0; 3]);
        let depth = 2000;
        let settings =
            RenderSettings { work_budget: depth, contribution_bound: 0.0, ..RenderSettings::new(12, 12) };
        let image = render(&source, &scene, &settings);
        assert_eq!(image.report.effects.reflection_rays, 144 * (depth - 1), "a path ended early: a leak");
        for pixel in image.film.pixels() {
            assert!((f64::from(pixel[0]) - 2.0).abs() < 1e-5, "{pixel:?}");
        }
    }
}

#[test]
fn reflected_and_refracted_light_add_up() {
    // Glass before a background of 1 is invisible. Each cut takes at most the bound away.
    for translation in [0.0, 1e6] {
        let center = [translation; 3];
        let sphere = Mesh::of(&Icosphere::new(1.0, center, 3).unwrap());
        for (mesh, index) in [(sphere, 1.5), (cuboid([0.8, 0.6, 0.7], center), 1.3)] {
            let source = compiled(mesh, glass(index));
            let eye = along(center, 1.0, [3.0, 2.0, 5.0]);
            let camera = Camera::pinhole(eye, center, [0.0, 1.0, 0.0], 20.0).unwrap();
            let scene = Scene::new(camera).with_background([1.0; 3]);
            let settings = RenderSettings {
                contribution_bound: 1e-4,
                work_budget: 1 << 20,
                ..RenderSettings::new(16, 16)
            };
            let image = render(&source, &scene, &settings);
            let effects = image.report.effects;
            assert!(effects.transmission_rays > 100 && effects.work_cuts == 0, "{effects:?}");
            let missing: f64 = image.film.pixels().iter().map(|pixel| 1.0 - f64::from(pixel[0])).sum();
            let cut = effects.contribution_cuts as f64 * settings.contribution_bound;
            assert!(missing <= cut + 256.0 * 1e-6, "{missing} is missing, {cut} was cut");
            for pixel in image.film.pixels() {
                assert!(pixel[0] <= 1.0 + 1e-6, "{pixel:?}");
            }
        }
    }
}

#[test]
fn critical_angle_within_1e_7() {
    for translation in [0.0, 1e6] {
        let center = [translation; 3];
        let source = compiled(cuboid([100.0, 1.0, 100.0], center), glass(1.5));
        let critical = (1.0f64 / 1.5).asin();
        for (angle, refracted) in [(critical - 1e-7, 1), (critical + 1e-7, 0)] {
            let direction = [angle.sin(), angle.cos(), 0.0];
            // The camera's own rounding of its direction must stay below the angle in question.
            let camera = Camera::orthographic(
                along(center, 0.25, [1.0, 0.0, 1.0]),
                along(along(center, 0.25, [1.0, 0.0, 1.0]), 1.0, direction),
                [0.0, 0.0, 1.0],
                1e-6,
            )
            .unwrap();
            let scene = Scene::new(camera).with_background([1.0; 3]);
            // The ray, and room for both that may leave its first hit.
            let settings =
                RenderSettings { work_budget: 3, contribution_bound: 0.0, ..RenderSettings::new(1, 1) };
            let effects = render(&source, &scene, &settings).report.effects;
            assert_eq!(effects.transmission_rays, refracted, "at {angle} about {translation}: {effects:?}");
        }
    }
}
