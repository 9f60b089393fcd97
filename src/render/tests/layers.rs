//! What lies behind each pixel.

use std::path::Path;

use exr::prelude::{AnyChannel, FlatSamples, ReadChannels as _, ReadLayers as _};

use super::invariance::{settings, still_life};
use super::*;
use crate::render::AdaptiveSampling;
use crate::render::layers::{LayerPixel, Layers, layers};

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

fn samples<'c>(channels: &'c [AnyChannel<FlatSamples>], name: &str) -> &'c FlatSamples {
    let channel = channels.iter().find(|channel| channel.name.eq(name));
    &channel.unwrap_or_else(|| panic!("there is no {name}")).sample_data
}

fn floats(channels: &[AnyChannel<FlatSamples>], name: &str) -> Vec<f32> {
    let FlatSamples::F32(values) = samples(channels, name) else { panic!("{name} is not of floats") };
    values.clone()
}

fn integers(channels: &[AnyChannel<FlatSamples>], name: &str) -> Vec<u32> {
    let FlatSamples::U32(values) = samples(channels, name) else { panic!("{name} is not of integers") };
    values.clone()
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
    for channel in 0..3 {
        let colour = floats(&channels, ["R", "G", "B"][channel]);
        assert!(colour.iter().zip(picture.film.pixels()).all(|(read, pixel)| *read == pixel[channel]));
    }
    type Of = dyn Fn(&LayerPixel) -> f32;
    let real: [(&str, f32, &Of); 7] = [
        ("Z", f32::INFINITY, &|pixel| pixel.depth),
        ("N.X", 0.0, &|pixel| pixel.normal[0]),
        ("N.Y", 0.0, &|pixel| pixel.normal[1]),
        ("N.Z", 0.0, &|pixel| pixel.normal[2]),
        ("albedo.R", 0.0, &|pixel| pixel.albedo[0]),
        ("albedo.G", 0.0, &|pixel| pixel.albedo[1]),
        ("albedo.B", 0.0, &|pixel| pixel.albedo[2]),
    ];
    for (name, missing, value) in real {
        let expected: Vec<f32> =
            found.pixels().iter().map(|pixel| pixel.as_ref().map_or(missing, value)).collect();
        assert_eq!(floats(&channels, name), expected, "{name}");
    }
    let whole = |value: &dyn Fn(&LayerPixel) -> u32| -> Vec<u32> {
        found.pixels().iter().map(|pixel| pixel.as_ref().map_or(u32::MAX, value)).collect()
    };
    assert_eq!(integers(&channels, "triangle.low"), whole(&|pixel| pixel.triangle.0 as u32));
    assert_eq!(integers(&channels, "triangle.high"), whole(&|_| 0));
    assert_eq!(integers(&channels, "material"), whole(&|pixel| u32::from(pixel.material.0)));
    // The scene has all that layers can tell apart: nothing, several materials, normals along each axis.
    let hits: Vec<_> = found.pixels().iter().flatten().collect();
    assert!(hits.len() < found.pixels().len());
    assert!((0..4).all(|material| hits.iter().any(|pixel| pixel.material == MaterialId(material))));
    assert!((0..3).all(|axis| hits.iter().any(|pixel| pixel.normal[axis] != 0.0)));
    assert!(found.write(&picture.film, folder.path().join("layers.png")).is_err());
    let small = render(&mesh, &scene, &RenderSettings::new(3, 3));
    assert!(matches!(found.write(&small.film, &path), Err(RenderError::Setting { .. })));
}

#[test]
fn a_film_with_statistics_and_costs_adds_them() {
    let (mesh, scene) = still_life();
    // Not every pixel gets the same.
    let adaptive = AdaptiveSampling { samples_min: 2, error: 0.02, confidence: 0.9 };
    let with = RenderSettings {
        keep_statistics: true,
        samples_per_pixel: 8,
        adaptive: Some(adaptive),
        ..settings()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("layers.exr");
    for keep_costs in [false, true] {
        let with = RenderSettings { keep_costs, ..with };
        let picture = render(&mesh, &scene, &with);
        layers_of(&mesh, &scene, &with).write(&picture.film, &path).unwrap();
        let channels = read_back(&path);
        assert_eq!(channels.len(), if keep_costs { 17 } else { 15 });
        let statistics = picture.film.statistics().unwrap();
        let counts: Vec<u32> = statistics.iter().map(|pixel| pixel.samples).collect();
        assert_eq!(integers(&channels, "samples"), counts);
        assert!(counts.contains(&2) && counts.contains(&8));
        let deviations: Vec<f32> = statistics.iter().map(|pixel| pixel.deviation).collect();
        assert_eq!(floats(&channels, "deviation"), deviations);
        assert!(deviations.iter().any(|deviation| *deviation > 0.0));
        if let Some(costs) = picture.film.costs() {
            let [boxes, triangles]: [Vec<u32>; 2] = [
                costs.iter().map(|cost| cost.box_tests).collect(),
                costs.iter().map(|cost| cost.triangle_tests).collect(),
            ];
            assert_eq!(integers(&channels, "cost.boxes"), boxes);
            assert_eq!(integers(&channels, "cost.triangles"), triangles);
            assert!(boxes.iter().max() > boxes.iter().min());
        }
    }
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
