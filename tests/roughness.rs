//! Roughness from files: a material that is rough in its file looks, to the bit, as one that a scene makes as rough.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use outcrop::compile::{CompileOptions, Control, LazyModel, LazyOptions, Threads, compile_file};
use outcrop::octree::OctreeOptions;
use outcrop::render::{RenderSettings, RenderedImage, Renderer};
use outcrop::scene::{Camera, Effect, Finish, Light, LightShape, Scene};
use outcrop::source::DiskSource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

/// A floor of chequers and, behind it, a wall of the material `wall`; corners are numbered from 0.
const VERTICES: [[f32; 3]; 8] = [
    [-4.0, 0.0, 4.0],
    [0.0, 0.0, 4.0],
    [0.0, 0.0, -2.0],
    [-4.0, 0.0, -2.0],
    [4.0, 0.0, 4.0],
    [4.0, 0.0, -2.0],
    [4.0, 3.0, -2.0],
    [-4.0, 3.0, -2.0],
];
const LEFT: [u32; 6] = [0, 1, 2, 0, 2, 3];
const RIGHT: [u32; 6] = [1, 4, 5, 1, 5, 2];
const WALL: [u32; 6] = [3, 5, 6, 3, 6, 7];

fn scene() -> Scene {
    let camera = Camera::pinhole([0.5, 2.0, 9.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 40.0).unwrap();
    let lamp = LightShape::Sphere { center: [1.0, 4.0, 1.0], radius: 0.5 };
    Scene::new(camera)
        .with_background([0.25, 0.5, 0.75])
        .with_light(Light::directional([-1.0, -2.0, -0.75], [0.75; 3]))
        .with_light(Light::area(lamp, [3.0; 3]))
}

/// The picture of a model file.
fn picture(model: &Path, scene: &Scene) -> RenderedImage {
    let (budget, output) = (MemoryBudget::new(Bytes::mib(128)), model.with_extension("outcrop"));
    compile_file(model, &output, &CompileOptions::default(), &budget, &mut |_| Control::Continue).unwrap();
    picture_of(Arc::new(DiskSource::open(&output).unwrap()), scene, &budget)
}

/// [`picture`], of a model that is compiled as rays reach it.
fn lazy_picture(model: &Path, scene: &Scene) -> RenderedImage {
    let (budget, output) = (MemoryBudget::new(Bytes::mib(128)), model.with_extension("lazy"));
    let model = LazyModel::open(model, &output, &LazyOptions::default(), &budget, &mut |_| Control::Continue)
        .unwrap();
    picture_of(Arc::new(model), scene, &budget)
}

fn picture_of(source: Arc<dyn BlockSource>, scene: &Scene, budget: &MemoryBudget) -> RenderedImage {
    let set_aside = budget.reserve(Bytes::mib(32), "the picture").unwrap();
    let octree = LazyOctree::open(source, budget, OctreeOptions::default()).unwrap();
    drop(set_aside);
    let settings = RenderSettings { samples_per_pixel: 4, ..RenderSettings::new(64, 48) };
    Renderer::new(&octree, scene, &settings, budget)
        .unwrap()
        .render(&Threads::One, &mut |_| Control::Continue)
        .unwrap()
}

fn bits(image: &RenderedImage) -> Vec<u32> {
    let film = &image.film;
    (0..film.height()).flat_map(|y| film.row(y).iter().flatten().map(|x| x.to_bits())).collect()
}

/// Writes the model with a wall that is as rough as said, in one of the formats.
type Write = fn(&Path, Option<f32>) -> PathBuf;

fn gltf(folder: &Path, roughness: Option<f32>, wall: serde_json::Value) -> PathBuf {
    use serde_json::json;
    let mut buffer: Vec<u8> = VERTICES.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    buffer.extend([LEFT, RIGHT, WALL].iter().flatten().flat_map(|index| index.to_le_bytes()));
    std::fs::write(folder.join("buffer.bin"), &buffer).unwrap();
    let indices = |part: usize| json!({ "bufferView": 1, "byteOffset": 24 * part, "componentType": 5125, "count": 6, "type": "SCALAR" });
    let primitive =
        |part: usize| json!({ "attributes": { "POSITION": 0 }, "indices": part + 1, "material": part });
    let matt = |color: [f32; 4]| json!({ "pbrMetallicRoughness": { "baseColorFactor": color, "metallicFactor": 0 } });
    let mut wall = wall;
    wall["name"] = json!("wall");
    wall["pbrMetallicRoughness"]["roughnessFactor"] = json!(roughness.unwrap_or(0.0));
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_materials_transmission"],
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive(0), primitive(1), primitive(2)] }],
        "materials": [matt([0.75, 0.25, 0.125, 1.0]), matt([0.125, 0.5, 0.25, 1.0]), wall],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3", "min": [-4, 0, -2], "max": [4, 3, 4] },
            indices(0), indices(1), indices(2)
        ],
        "bufferViews": [{ "buffer": 0, "byteLength": 96 }, { "buffer": 0, "byteOffset": 96, "byteLength": 72 }],
        "buffers": [{ "byteLength": 168, "uri": "buffer.bin" }]
    });
    let path = folder.join("x.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    path
}

fn metal(folder: &Path, roughness: Option<f32>) -> PathBuf {
    let gold = serde_json::json!({ "pbrMetallicRoughness": { "baseColorFactor": [1.0, 0.75, 0.25, 1.0] } });
    gltf(folder, roughness, gold)
}

fn frosted(folder: &Path, roughness: Option<f32>) -> PathBuf {
    let glass = serde_json::json!({
        "pbrMetallicRoughness": { "metallicFactor": 0.0 },
        "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.75 } }
    });
    gltf(folder, roughness, glass)
}

/// Without a roughness there is no `Pr` in the library.
fn mtl(folder: &Path, roughness: Option<f32>) -> PathBuf {
    let rough = roughness.map_or(String::new(), |roughness| format!("Pr {roughness}\n"));
    let library = format!(
        "newmtl left\nKd .75 .25 .125\nnewmtl right\nKd .125 .5 .25\nnewmtl wall\nKd 0\nKs 1 .75 .25\nillum 3\n{rough}"
    );
    std::fs::write(folder.join("x.mtl"), library).unwrap();
    let mut text = "mtllib x.mtl\n".to_string();
    for [x, y, z] in VERTICES {
        text += &format!("v {x} {y} {z}\n");
    }
    for (name, corners) in [("left", LEFT), ("right", RIGHT), ("wall", WALL)] {
        text += &format!("usemtl {name}\n");
        for [a, b, c] in corners.as_chunks::<3>().0 {
            text += &format!("f {} {} {}\n", a + 1, b + 1, c + 1);
        }
    }
    let path = folder.join("x.obj");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn a_rough_file_looks_as_a_smooth_one_with_a_rough_finish() {
    let writers: [(&str, Write, Effect); 3] = [
        ("a metal of glTF", metal, Effect::GlossyReflection),
        ("glass of glTF", frosted, Effect::RoughRefraction),
        ("a mirror of MTL", mtl, Effect::GlossyReflection),
    ];
    for (name, write, effect) in writers {
        let folder = tempfile::tempdir().unwrap();
        let with = |finish: Finish| scene().with_finish("wall", finish);
        let smooth = picture(&write(folder.path(), None), &scene());
        let finished = picture(&write(folder.path(), None), &with(Finish::rough(0.5)));
        let rough = write(folder.path(), Some(0.5));
        let from_file = picture(&rough, &scene());
        assert!(
            !smooth.report.plan.has(effect) && from_file.report.plan.has(effect),
            "{name}: {}",
            from_file.report.plan.explain()
        );
        assert!(from_file.report.effects.glossy_rays + from_file.report.effects.frosted_rays > 100, "{name}");
        assert_eq!(bits(&from_file), bits(&finished), "{name}");
        assert_eq!(from_file.report.effects, finished.report.effects, "{name}");
        // From a working file, made and then opened again.
        for _ in 0..2 {
            assert_eq!(bits(&lazy_picture(&rough, &scene())), bits(&from_file), "{name}");
        }
        let apart = bits(&smooth).iter().zip(bits(&from_file)).filter(|(a, b)| **a != *b).count();
        assert!(apart > 1000, "{name}: {apart} channels differ from those of a smooth wall");

        // A scene overrides the file; a finish that says nothing of roughness does not.
        let other = picture(&rough, &with(Finish::rough(0.25)));
        assert_ne!(bits(&other), bits(&from_file), "{name}");
        let ranked = picture(&rough, &with(Finish { roughness: None, priority: None }));
        assert_eq!(bits(&ranked), bits(&from_file), "{name}");
        let polished = picture(&rough, &with(Finish::rough(0.0)));
        assert!(!polished.report.plan.has(effect), "{name}");
        let as_said = picture(&write(folder.path(), Some(0.25)), &scene());
        assert_eq!(bits(&as_said), bits(&other), "{name}");
    }
}
