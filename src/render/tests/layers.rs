//! What lies behind each pixel.

use std::path::Path;

use exr::prelude::{AnyChannel, FlatSamples, ReadChannels as _, ReadLayers as _};

use super::invariance::{settings, still_life};
use super::*;
use crate::render::layers::{Layers, layers};

fn layers_of(mesh: &Mesh, scene: &Scene, settings: &RenderSettings) -> Layers {
    let plan = mesh.plan(scene, settings);
    let mut stage = Stage::new(scene, &mesh.materials, &plan, settings);
    open_textures(&mut stage, scene);
    let mut query =
        Naive { mesh: Arc::new(mesh.clone()), counters: TraceCounters::default(), rays_left: u64::MAX };
    layers(&stage, &MemoryBudget::new(Bytes::mib(16)), &mut query, &mut |_| Control::Continue).unwrap()
}

#[test]
fn a_layer_says_what_the_middle_of_the_pixel_meets() {
    // Wound so that its front looks away: the normal is that of the side that is seen.
    let mesh = Mesh::new([matt(0.25), matt(0.5)])
        .sheet(0, [-9.0, -9.0, -1.0], [18.0, 0.0, 0.0], [0.0, 18.0, 0.0])
        .sheet(1, [0.0, -9.0, 0.0], [0.0, 18.0, 0.0], [9.0, 0.0, 0.0]);
    let found = layers_of(&mesh, &Scene::new(straight_camera()), &RenderSettings::new(4, 2));
    assert_eq!((found.width(), found.height(), found.pixels().len()), (4, 2, 8));
    let [left, right] = [0, 3].map(|x| found.pixels()[x].unwrap());
    assert_eq!((left.depth, left.material, left.albedo), (6.0, MaterialId(0), [0.25; 3]));
    assert_eq!((right.depth, right.material, right.albedo), (5.0, MaterialId(1), [0.5; 3]));
    assert_eq!((left.normal, right.normal), ([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]));
    assert!(left.triangle.0 < 2 && (2..4).contains(&right.triangle.0));
    let nothing =
        layers_of(&Mesh::new([matt(0.5)]), &Scene::new(straight_camera()), &RenderSettings::new(2, 2));
    assert!(nothing.pixels().iter().all(Option::is_none));
}

/// The channels of a file that was written.
fn read_back(path: &Path) -> Vec<AnyChannel<FlatSamples>> {
    exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_file(path)
        .unwrap()
        .layer_data
        .channel_data
        .list
        .into_iter()
        .collect()
}

#[test]
fn layers_are_written_and_read_back() {
    let (mesh, scene) = still_life();
    let picture = render(&mesh, &scene, &settings());
    let found = layers_of(&mesh, &scene, &settings());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layers.exr");
    found.write(&picture.film, &path).unwrap();
    let channels = read_back(&path);
    assert_eq!(channels.len(), 13);
    let samples = |name: &str| {
        &channels.iter().find(|channel| channel.name.eq(name)).unwrap_or_else(|| panic!("{name}")).sample_data
    };
    let FlatSamples::F32(red) = samples("R") else { panic!("not floats") };
    assert!(red.iter().zip(picture.film.pixels()).all(|(red, pixel)| *red == pixel[0]));
    let FlatSamples::F32(depth) = samples("Z") else { panic!("not floats") };
    let FlatSamples::U32(triangle) = samples("triangle.low") else { panic!("not whole") };
    let FlatSamples::U32(material) = samples("material") else { panic!("not whole") };
    for (index, pixel) in found.pixels().iter().enumerate() {
        match pixel {
            Some(pixel) => {
                assert_eq!(depth[index], pixel.depth);
                assert_eq!(u64::from(triangle[index]), pixel.triangle.0);
                assert_eq!(material[index], u32::from(pixel.material.0));
            }
            None => assert_eq!(
                (depth[index], triangle[index], material[index]),
                (f32::INFINITY, u32::MAX, u32::MAX)
            ),
        }
    }
    assert!(found.write(&picture.film, &folder.path().join("layers.png")).is_err());
    let small = render(&mesh, &scene, &RenderSettings::new(3, 3));
    assert!(matches!(found.write(&small.film, &path), Err(RenderError::Setting { .. })));
}

#[test]
fn a_film_with_statistics_adds_its_samples() {
    let (mesh, scene) = still_life();
    let settings = RenderSettings { keep_statistics: true, samples_per_pixel: 4, ..settings() };
    let picture = render(&mesh, &scene, &settings);
    let found = layers_of(&mesh, &scene, &settings);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layers.exr");
    found.write(&picture.film, &path).unwrap();
    let channels = read_back(&path);
    assert_eq!(channels.len(), 15);
    let samples = channels.iter().find(|channel| channel.name.eq("samples")).unwrap();
    let FlatSamples::U32(samples) = &samples.sample_data else { panic!("not whole") };
    assert!(samples.iter().all(|count| *count == 4));
}

#[test]
fn layers_see_pictures_and_holes() {
    use super::effects::{pictures, with_images};
    use crate::model::{ImageMap, MaterialImages};
    let disc = MaterialImages { diffuse: Some(ImageMap::new("disc")), ..MaterialImages::default() };
    let mesh = Mesh::new([with_images(matt(0.5), disc), matt(0.25)])
        .card(0, [-1.0, -1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0], 1.0)
        .sheet(1, [-1.0, -1.0, -1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]);
    let scene = Scene::new(straight_camera()).with_textures(pictures());
    let found = layers_of(&mesh, &scene, &RenderSettings::new(16, 16));
    let [corner, middle] = [0, 8 * 16 + 8].map(|index| found.pixels()[index].unwrap());
    assert_eq!((corner.material, corner.depth, corner.albedo), (MaterialId(1), 6.0, [0.25; 3]));
    assert_eq!((middle.material, middle.depth), (MaterialId(0), 5.0));
    // 160 of 255 in sRGB, halved.
    assert!((middle.albedo[1] - 0.5 * 0.3515).abs() < 0.005, "{:?}", middle.albedo);
}
