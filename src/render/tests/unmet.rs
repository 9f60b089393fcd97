//! Surfaces that no ray meets cost nothing (I6), and where only some rays meet them, which loop their batch took does not show (I2).

use super::effects::{finished, metal, pictures, with_images};
use super::*;
use crate::model::{ImageMap, MaterialImages};
use crate::render::stage::Loop;
use crate::scene::{Finish, Light};

/// A surface of each kind that the matt loop does not know, what the mesh of it looks like at a place, and the loop that serves it.
fn kinds() -> Vec<(MaterialRecord, bool, Loop)> {
    let images = MaterialImages { diffuse: Some(ImageMap::new("chequer")), ..MaterialImages::default() };
    let named = |record| MaterialRecord { name: "rough".to_string(), ..record };
    vec![
        (mirror(0.8), false, Loop::Whitted),
        (clear(1.5), false, Loop::Whitted),
        (named(mirror(0.8)), false, Loop::Sampled),
        (named(clear(1.5)), false, Loop::Sampled),
        (matt(0.6), true, Loop::Detailed),
        (with_images(matt(0.8), images), false, Loop::Detailed),
        (finished(metal(0.8), MaterialImages::default()), false, Loop::Detailed),
    ]
}

fn scene() -> Scene {
    Scene::new(Camera::pinhole([1.0, 1.5, 6.0], [0.0; 3], [0.0, 1.0, 0.0], 35.0).unwrap())
        .with_background([0.3, 0.4, 0.6])
        .with_ambient([0.05; 3])
        .with_light(Light::point([3.0, 4.0, 2.0], [0.7; 3]))
        .with_light(Light::directional([0.3, -1.0, -0.4], [0.5, 0.45, 0.4]))
        .with_finish("rough", Finish::rough(0.4))
        .with_textures(pictures())
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 2, work_budget: 40, tile_size: 16, ..RenderSettings::new(37, 29) }
}

/// Matt boxes, and a body of the material around `center`: a ball with normals, or a card with texture coordinates.
fn boxes_and(material: &MaterialRecord, is_smooth: bool, center: [f64; 3]) -> Mesh {
    let mut mesh = Mesh::new([matt(0.7), matt(0.4), material.clone()])
        .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
        .cuboid(1, [-1.5, -1.0, -2.0], [-0.5, 1.0, -1.0])
        .cuboid(1, [-0.3, -0.8, -0.5], [0.6, 0.4, 0.5]);
    if is_smooth {
        // On a page of its own: directories know no more than whether some triangle of a page has normals.
        while mesh.triangles.len() < PAGE_TRIANGLES {
            mesh = mesh.sheet(0, [40.0, 1.0, 200.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]);
        }
        return mesh.sphere(2, center, 0.6, 1, true);
    }
    let corner = [center[0] - 0.5, center[1] - 0.5, center[2]];
    mesh.card(2, corner, [1.0, 0.0, 0.2], [0.0, 1.0, 0.0], 2.0)
}

#[test]
fn what_no_ray_meets_costs_nothing() {
    let scene = scene();
    for (material, is_smooth, _) in kinds() {
        let (beside, behind) = ([1.5, 0.0, 0.5], [40.0, 1.0, 300.0]);
        let mesh = boxes_and(&material, is_smooth, behind);
        let mut without = mesh.clone();
        without.triangles.retain(|(_, material)| *material != 2);
        without.materials.truncate(2);
        without.attributes.clear();
        let (with, without) = (render(&mesh, &scene, &settings()), render(&without, &scene, &settings()));
        assert!(with.film.pixels() == without.film.pixels(), "{material:?}");
        assert_eq!(with.totals.effects, without.totals.effects, "{material:?}");
        assert_eq!(with.totals.trace.rays, without.totals.trace.rays, "{material:?}");
        // Where rays do meet it, it shows.
        let met = render(&boxes_and(&material, is_smooth, beside), &scene, &settings());
        assert!(met.film.pixels() != without.film.pixels(), "{material:?}");
        assert!(met.totals.effects != without.totals.effects, "{material:?}");
    }
}

#[test]
fn a_batch_takes_the_loop_that_its_hits_ask_for() {
    let scene = scene();
    for (material, is_smooth, serves) in kinds() {
        let mesh = boxes_and(&material, is_smooth, [1.5, 0.0, 0.5]);
        let settings = settings();
        let stage = Stage::new(&scene, &mesh.materials, &mesh.plan(&scene, &settings), &settings);
        assert_eq!((stage.least_loop, stage.path_loop), (Loop::Matt, serves), "{material:?}");
        let hit = |triangle: usize| {
            let (vertices, material) = mesh.triangles[triangle];
            let (triangle, material) = (TriangleId(triangle as u64), MaterialId(material));
            Some(Hit { t: 1.0, u: 0.25, v: 0.25, triangle, material, vertices })
        };
        let has_normals = |triangle: TriangleId| {
            mesh.attributes.get(triangle.0 as usize).is_some_and(|corners| corners.normals.is_some())
        };
        let last = mesh.triangles.len() - 1;
        assert_eq!(stage.loop_of_hits(&[None, hit(0), hit(9)], has_normals), Loop::Matt);
        assert_eq!(stage.loop_of_hits(&[None, hit(0), hit(last)], has_normals), serves);
        assert_eq!(stage.loop_of_hits(&[None, None], has_normals), Loop::Matt);
    }
}

#[test]
fn loops_of_batches_do_not_show() {
    let scene = scene();
    for (material, is_smooth, _) in kinds() {
        let mesh = boxes_and(&material, is_smooth, [1.5, 0.0, 0.5]);
        let reference = render(&mesh, &scene, &settings());
        // Single samples, of which most meet nothing but bricks; and all of them at once.
        for batch_samples in [1, 5, 1 << 16] {
            let varied = RenderSettings { batch_samples, tile_size: 64, keep_statistics: true, ..settings() };
            let picture = render(&mesh, &scene, &varied);
            assert!(picture.film.pixels() == reference.film.pixels(), "{material:?} {batch_samples}");
            assert_eq!(picture.totals.effects, reference.totals.effects, "{material:?} {batch_samples}");
        }
    }
}
