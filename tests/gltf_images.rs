//! Images of roughness, metalness and emission in model files: the picture is, to the bit, that of the numbers that their texels stand for.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use outcrop::compile::{CompileOptions, Control, Threads, compile_file};
use outcrop::error::TextureError;
use outcrop::octree::OctreeOptions;
use outcrop::render::{EffectCounters, RenderSettings, RenderedImage, Renderer};
use outcrop::scene::{Camera, Effect, EffectSet, Light, LightShape, Scene};
use outcrop::source::DiskSource;
use outcrop::texture::Textures;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use serde_json::{Value, json};

/// A floor and, behind it, a wall with texture coordinates.
const VERTICES: [[f32; 3]; 6] = [
    [-4.0, 0.0, 4.0],
    [4.0, 0.0, 4.0],
    [4.0, 0.0, -2.0],
    [-4.0, 0.0, -2.0],
    [4.0, 3.0, -2.0],
    [-4.0, 3.0, -2.0],
];
const UVS: [[f32; 2]; 6] = [[0.0, 1.0], [1.0, 1.0], [1.0, 1.0], [0.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
const FLOOR: [u32; 6] = [0, 1, 2, 0, 2, 3];
const WALL: [u32; 6] = [3, 2, 4, 3, 4, 5];

/// The number that a byte of an image stands for.
fn share(byte: u8) -> f32 {
    (f64::from(byte) / 255.0) as f32
}

/// A PNG of `side` x `side` texels.
fn png_bytes(side: u32, texel: impl Fn(u32, u32) -> [u8; 3]) -> Vec<u8> {
    let texels: Vec<u8> = (0..side * side).flat_map(|at| texel(at % side, at / side)).collect();
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, side, side);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&texels).unwrap();
    bytes
}

/// How an image is part of a model.
#[derive(Clone, Copy, Debug)]
enum Embedding {
    DataUri,
    Chunk,
}

/// Writes the model with this wall; textures 0 and 1 are `images`.
fn write(folder: &Path, wall: &Value, images: &[Vec<u8>], embedding: Embedding) -> PathBuf {
    let mut buffer: Vec<u8> = VERTICES.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    buffer.extend(UVS.iter().flatten().flat_map(|x| x.to_le_bytes()));
    buffer.extend([FLOOR, WALL].iter().flatten().flat_map(|index| index.to_le_bytes()));
    let mut views = vec![
        json!({ "buffer": 0, "byteLength": 72 }),
        json!({ "buffer": 0, "byteOffset": 72, "byteLength": 48 }),
        json!({ "buffer": 0, "byteOffset": 120, "byteLength": 48 }),
    ];
    let named: Vec<Value> = images
        .iter()
        .map(|image| match embedding {
            Embedding::DataUri => {
                json!({ "uri": format!("data:image/png;base64,{}", STANDARD.encode(image)) })
            }
            Embedding::Chunk => {
                views.push(json!({ "buffer": 0, "byteOffset": buffer.len(), "byteLength": image.len() }));
                buffer.extend(image);
                buffer.resize(buffer.len().next_multiple_of(4), 0);
                json!({ "bufferView": views.len() - 1, "mimeType": "image/png" })
            }
        })
        .collect();
    let indices = |part: usize| json!({ "bufferView": 2, "byteOffset": 24 * part, "componentType": 5125, "count": 6, "type": "SCALAR" });
    let primitive = |part: usize| json!({ "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": part + 2, "material": part });
    let mut document = json!({
        "asset": { "version": "2.0" },
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [primitive(0), primitive(1)] }],
        "materials": [{ "pbrMetallicRoughness": { "baseColorFactor": [0.75, 0.25, 0.125, 1], "metallicFactor": 0 } }, wall],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 6, "type": "VEC3", "min": [-4, 0, -2], "max": [4, 3, 4] },
            { "bufferView": 1, "componentType": 5126, "count": 6, "type": "VEC2" },
            indices(0), indices(1)
        ],
        "bufferViews": views,
        "buffers": [{ "byteLength": buffer.len() }]
    });
    if !named.is_empty() {
        document["textures"] = (0..named.len()).map(|source| json!({ "source": source })).collect();
        document["images"] = json!(named);
    }
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut bytes = b"glTF".to_vec();
    for number in [2, 12 + 8 + text.len() + 8 + buffer.len(), text.len()] {
        bytes.extend((number as u32).to_le_bytes());
    }
    bytes.extend(b"JSON");
    bytes.extend(text);
    bytes.extend((buffer.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(buffer);
    let path = folder.join("x.glb");
    std::fs::write(&path, bytes).unwrap();
    path
}

fn scene() -> Scene {
    let camera = Camera::pinhole([0.5, 2.0, 9.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0], 40.0).unwrap();
    let lamp = LightShape::Sphere { center: [1.0, 4.0, 1.0], radius: 0.5 };
    Scene::new(camera)
        .with_background([0.25, 0.5, 0.75])
        .with_light(Light::directional([-1.0, -2.0, -0.75], [0.75; 3]))
        .with_light(Light::area(lamp, [3.0; 3]))
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 2, ..RenderSettings::new(48, 32) }
}

/// The picture of a model file, or what is wrong with its images.
fn picture(model: &Path, scene: &Scene, settings: &RenderSettings) -> Result<RenderedImage, TextureError> {
    let (budget, output) = (MemoryBudget::new(Bytes::mib(128)), model.with_extension("outcrop"));
    compile_file(model, &output, &CompileOptions::default(), &budget, &mut |_| Control::Continue).unwrap();
    let source = Arc::new(DiskSource::open(&output).unwrap());
    let materials = &source.model().materials;
    let scene = match Textures::named_by(materials).is_empty() {
        true => scene.clone(),
        false => {
            let tiles = model.with_extension("tiles");
            let folder = model.parent().unwrap();
            scene.clone().with_textures(Textures::open(materials, folder, &tiles, &budget)?)
        }
    };
    let set_aside = budget.reserve(Bytes::mib(48), "the picture").unwrap();
    let source: Arc<dyn BlockSource> = source;
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    drop(set_aside);
    let renderer = Renderer::new(&octree, &scene, settings, &budget).unwrap();
    Ok(renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap())
}

fn bits(image: &RenderedImage) -> Vec<u32> {
    let film = &image.film;
    (0..film.height()).flat_map(|y| film.row(y).iter().flatten().map(|x| x.to_bits())).collect()
}

/// What was done, reads of pictures apart.
fn work(image: &RenderedImage) -> EffectCounters {
    EffectCounters { finish_reads: 0, texture_reads: 0, attribute_lookups: 0, ..image.report.effects }
}

#[test]
fn images_of_one_texel_look_as_factors() {
    for embedding in [Embedding::DataUri, Embedding::Chunk] {
        for [roughness, metalness] in [[128u8, 255u8], [51, 0], [90, 102], [0, 255]] {
            let folder = tempfile::tempdir().unwrap();
            let base = [1.0, 0.75, 0.25, 1.0];
            let factors = json!({
                "pbrMetallicRoughness": {
                    "baseColorFactor": base, "metallicFactor": share(metalness), "roughnessFactor": share(roughness)
                },
                "emissiveFactor": [0.25, 0.0, 0.5]
            });
            let by_factors = picture(&write(folder.path(), &factors, &[], embedding), &scene(), &settings());
            let by_factors = by_factors.unwrap();
            // As most files are: factors of 1 by default, and what counts in the image.
            let textured = json!({
                "pbrMetallicRoughness": { "baseColorFactor": base, "metallicRoughnessTexture": { "index": 0 } },
                "emissiveFactor": [0.25, 1.0, 0.5], "emissiveTexture": { "index": 1 }
            });
            let images =
                [png_bytes(1, |_, _| [200, roughness, metalness]), png_bytes(3, |_, _| [255, 0, 255])];
            let model = write(folder.path(), &textured, &images, embedding);
            let exact = RenderSettings { contribution_bound: 0.0, ..settings() };
            let by_images = picture(&model, &scene(), &settings()).unwrap();
            let plan = &by_images.report.plan;
            assert!(plan.has(Effect::FinishMaps) && plan.has(Effect::Textures), "{}", plan.explain());
            assert!(!by_factors.report.plan.has(Effect::FinishMaps));
            assert_eq!(plan.has(Effect::GlossyReflection), metalness > 0 && roughness > 0);
            assert_eq!(bits(&by_images), bits(&by_factors), "{embedding:?} {roughness} {metalness}");
            assert_eq!(work(&by_images), work(&by_factors));
            assert!(by_images.report.effects.finish_reads > 100);
            let forced = RenderSettings { forced: EffectSet::ALL, ..settings() };
            assert_eq!(bits(&picture(&model, &scene(), &forced).unwrap()), bits(&by_images));
            let uncut = picture(&model, &scene(), &exact).unwrap();
            assert_eq!(uncut.report.effects.contribution_cuts, 0);
        }
    }
}

/// Left half rough metal, right half paint, as two walls of factors are.
#[test]
fn each_texel_is_a_material_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let wall = json!({ "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 } } });
    let halves = png_bytes(256, |x, _| if x < 128 { [0, 128, 255] } else { [0, 200, 0] });
    let model = write(folder.path(), &wall, &[halves], Embedding::DataUri);
    let settings = RenderSettings { contribution_bound: 0.0, samples_per_pixel: 1, ..settings() };
    let both = picture(&model, &scene(), &settings).unwrap();
    let of = |metalness: f32, roughness: u8| {
        let factors = json!({ "pbrMetallicRoughness": {
            "metallicFactor": metalness, "roughnessFactor": share(roughness) } });
        picture(&write(folder.path(), &factors, &[], Embedding::DataUri), &scene(), &settings).unwrap()
    };
    let (metal, paint) = (of(1.0, 128), of(0.0, 200));
    let (mut metals, mut paints) = (0, 0);
    for y in 0..32 {
        for x in 0..48 {
            let [both, metal, paint] = [&both, &metal, &paint].map(|image| image.film.row(y)[x as usize]);
            if metal != paint {
                metals += u32::from(both == metal);
                paints += u32::from(both == paint);
            }
        }
    }
    assert!(metals > 100 && paints > 100, "{metals} {paints}");
    // All but where the two run into each other: in the middle, and at both ends, as the picture repeats.
    let wall = bits(&metal).chunks(3).zip(bits(&paint).chunks(3)).filter(|(a, b)| a != b).count() as u32;
    assert!(wall - metals - paints < wall / 6, "{wall} {metals} {paints}");
    assert!(both.report.effects.glossy_rays < metal.report.effects.glossy_rays * 2 / 3);
}

/// Grey images beside a library of MTL.
#[test]
fn images_of_mtl_look_as_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    for (name, grey) in [("pr.png", 128u8), ("pm.png", 102), ("white.png", 255)] {
        std::fs::write(place.join(name), png_bytes(2, |_, _| [grey; 3])).unwrap();
    }
    let model = |wall: String| {
        let mut text = "mtllib x.mtl\n".to_string();
        for ([x, y, z], [u, v]) in VERTICES.iter().zip(UVS) {
            text += &format!("v {x} {y} {z}\nvt {u} {v}\n");
        }
        for (name, corners) in [("floor", FLOOR), ("wall", WALL)] {
            text += &format!("usemtl {name}\n");
            for corners in corners.as_chunks::<3>().0 {
                let [a, b, c] = corners.map(|corner| corner + 1);
                text += &format!("f {a}/{a} {b}/{b} {c}/{c}\n");
            }
        }
        let library =
            format!("newmtl floor\nKd .75 .25 .125\nnewmtl wall\nKd 1 .75 .25\nKs .1\nNs 20\n{wall}");
        std::fs::write(place.join("x.mtl"), library).unwrap();
        std::fs::write(place.join("x.obj"), text).unwrap();
        place.join("x.obj")
    };
    let numbers = format!("Pr {}\nPm {}\nKe .25 .5 .125\n", share(128), share(102));
    let by_numbers = picture(&model(numbers), &scene(), &settings()).unwrap();
    let images = "map_Pr pr.png\nmap_Pm pm.png\nKe .25 .5 .125\nmap_Ke white.png\n".to_string();
    let by_images = picture(&model(images), &scene(), &settings()).unwrap();
    assert_eq!(bits(&by_numbers), bits(&by_images));
    assert_eq!(work(&by_numbers), work(&by_images));
    assert!(by_images.report.effects.finish_reads > 100 && by_images.report.effects.glossy_rays > 100);
}

/// A damaged image of roughness, or of what glows, is an error that names the file, as one of colours is; a changed one is read again.
#[test]
fn damaged_images_are_told() {
    let wall = json!({
        "pbrMetallicRoughness": { "metallicRoughnessTexture": { "index": 0 } },
        "emissiveFactor": [1, 1, 1], "emissiveTexture": { "index": 1 }
    });
    let good = png_bytes(8, |x, y| [10 * x as u8, 20 * y as u8 + 9, 128]);
    for embedding in [Embedding::DataUri, Embedding::Chunk] {
        for damaged in 0..2 {
            for damage in [|bytes: &mut Vec<u8>| bytes.truncate(40), |bytes: &mut Vec<u8>| bytes[50] ^= 255] {
                let folder = tempfile::tempdir().unwrap();
                let mut images = [good.clone(), good.clone()];
                damage(&mut images[damaged]);
                let model = write(folder.path(), &wall, &images, embedding);
                let error = picture(&model, &scene(), &settings()).map(drop).unwrap_err();
                assert!(
                    matches!(&error, TextureError::Image { path, .. } if path.ends_with("x.glb")),
                    "{embedding:?} {damaged}: {error:?}"
                );
                let model = write(folder.path(), &wall, &[good.clone(), good.clone()], embedding);
                picture(&model, &scene(), &settings()).unwrap();
            }
        }
    }
}
