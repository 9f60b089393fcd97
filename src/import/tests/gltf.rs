//! glTF: both containers, every way to name triangles, transforms, materials, and what is refused.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::Folder;
use crate::error::ImportError;
use crate::import::gltf::decode_json;
use crate::import::{ImportOptions, ImportReport, MeshBuffer, import_file};
use crate::model::{ImageMap, MaterialRecord};
use crate::procedural::random::Random;

type Outcome = Result<(MeshBuffer, ImportReport), ImportError>;

impl Folder {
    fn import(&self, name: &str, bytes: impl AsRef<[u8]>) -> Outcome {
        let mut mesh = MeshBuffer::new();
        let report = import_file(self.write(name, bytes), &ImportOptions::default(), &mut mesh)?;
        super::check(&mesh, &report);
        Ok((mesh, report))
    }
}

/// A document and the bytes of its only buffer.
#[derive(Clone)]
struct Sample {
    document: Value,
    buffer: Vec<u8>,
}

const SQUARE: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

/// A square of two triangles with 16-bit indices, 2 bytes behind its positions.
fn square() -> Sample {
    let mut buffer: Vec<u8> = SQUARE.iter().flatten().flat_map(|number| number.to_le_bytes()).collect();
    buffer.extend([7, 7]);
    buffer.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|index| index.to_le_bytes()));
    let document = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "accessors": [
            {
                "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
                "min": [0.0, 0.0, 0.0], "max": [1.0, 1.0, 0.0]
            },
            { "bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR" }
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 50, "byteLength": 12 }
        ],
        "buffers": [{ "byteLength": 62 }]
    });
    Sample { document, buffer }
}

/// That with its first material, which may show the only picture.
fn square_with_picture() -> Sample {
    let mut sample = square();
    sample.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    sample.document["images"] = json!([{ "uri": "a.png" }]);
    sample.document["textures"] = json!([{ "source": 0 }]);
    sample
}

impl Sample {
    /// With the buffer in the document.
    fn text(&self) -> String {
        let mut document = self.document.clone();
        let data = STANDARD.encode(&self.buffer);
        document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{data}"));
        document.to_string()
    }

    /// With the buffer behind the document.
    fn binary(&self) -> Vec<u8> {
        let mut text = self.document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut chunk = self.buffer.clone();
        chunk.resize(chunk.len().next_multiple_of(4), 0);
        let total = 12 + 8 + text.len() + 8 + chunk.len();
        let mut bytes = b"glTF".to_vec();
        let number = |bytes: &mut Vec<u8>, number: usize| bytes.extend((number as u32).to_le_bytes());
        number(&mut bytes, 2);
        number(&mut bytes, total);
        number(&mut bytes, text.len());
        bytes.extend(b"JSON");
        bytes.extend(text);
        number(&mut bytes, chunk.len());
        bytes.extend(b"BIN\0");
        bytes.extend(chunk);
        bytes
    }

    fn import(&self) -> Outcome {
        Folder::new().import("model.glb", self.binary())
    }

    /// The same document with one part changed.
    fn with(&self, place: &str, value: Value) -> Sample {
        let mut changed = self.clone();
        *changed.document.pointer_mut(place).unwrap() = value;
        changed
    }

    /// The corners of all triangles.
    fn corners(&self) -> Vec<[[f64; 3]; 3]> {
        let (mesh, _) = self.import().unwrap();
        (0..mesh.triangles.len()).map(|triangle| mesh.corners(triangle)).collect()
    }
}

#[test]
fn other_versions_are_refused() {
    let of = |asset: Value| square().with("/asset", asset).import();
    for asset in [
        json!({ "version": "2.0" }),
        json!({ "version": "2.3" }),
        json!({ "version": "2.3", "minVersion": "2.0" }),
    ] {
        assert_eq!(of(asset.clone()).unwrap().0.triangles.len(), 2, "{asset}");
    }
    for (asset, expected) in [
        (json!({ "version": "1.0" }), "its version is \"1.0\"; version 2.0 is read"),
        (json!({ "version": "3" }), "its version is \"3\"; version 2.0 is read"),
        (json!({ "version": "2.3", "minVersion": "2.3" }), "its minVersion is \"2.3\"; version 2.0 is read"),
    ] {
        let Err(error) = of(asset.clone()) else { panic!("{asset} was read") };
        assert!(error.to_string().ends_with(expected), "{error}");
    }
}

/// The square with a bit of everything that is looked at.
fn rich() -> Sample {
    let mut sample = square();
    let document = &mut sample.document;
    document["nodes"] = json!([
        { "mesh": 0, "camera": 0, "children": [1], "scale": [2, 1, 1] },
        { "camera": 1, "extensions": { "KHR_lights_punctual": { "light": 0 } }, "translation": [0, 0, 1] }
    ]);
    document["meshes"][0]["primitives"][0]["material"] = json!(0);
    document["materials"] = json!([{
        "alphaMode": "MASK", "emissiveFactor": [1, 0.5, 0], "emissiveTexture": { "index": 0 }, "pbrMetallicRoughness": {
            "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 0 }, "roughnessFactor": 0.5 }
    }]);
    document["textures"] = json!([{ "source": 0, "sampler": 0 }]);
    document["samplers"] = json!([{ "wrapS": 33071, "wrapT": 10497 }]);
    document["images"] = json!([{ "uri": "x.png" }]);
    document["cameras"] = json!([
        { "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.1 } },
        { "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 3, "zfar": 10, "znear": 0.1 } }
    ]);
    document["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    document["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "spot", "spot": { "innerConeAngle": 0.25, "outerConeAngle": 0.5 } }
    ] } });
    sample
}

/// Where an error is, and why.
fn refused(outcome: Outcome) -> (String, String) {
    match outcome {
        Err(ImportError::Element { element, reason, .. }) => (element, reason),
        other => panic!("{other:?}"),
    }
}

#[test]
fn both_containers_and_a_file_beside_give_the_same_mesh() {
    let folder = Folder::new();
    let sample = square();
    let (mesh, report) = sample.import().unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    let [a, b, c, d] = SQUARE.map(|at| at.map(f64::from));
    assert_eq!([mesh.corners(0), mesh.corners(1)], [[a, b, c], [a, c, d]]);
    assert_eq!((report.vertices, report.triangles, report.warning_count), (4, 2, 0));
    let mut beside = sample.document.clone();
    beside["buffers"][0]["uri"] = json!("the%20buffer.bin");
    folder.write("the buffer.bin", &sample.buffer);
    for (name, bytes) in [
        ("text.gltf", sample.text().into_bytes()),
        ("beside.gltf", beside.to_string().into_bytes()),
        ("named-wrongly.gltf", sample.binary()),
    ] {
        let (other, _) = folder.import(name, bytes).unwrap();
        assert_eq!(other.triangles, mesh.triangles, "{name}");
    }
}

#[test]
fn strips_fans_and_meshes_without_indices_are_triangles() {
    let sample = square();
    let [a, b, c, d] = SQUARE.map(|at| at.map(f64::from));
    let order = |mode: u32| {
        let mut sample = sample.clone();
        sample.document["meshes"][0]["primitives"][0] =
            json!({ "attributes": { "POSITION": 0 }, "mode": mode });
        sample.corners()
    };
    // Three corners make a triangle; the fourth is alone.
    assert_eq!(order(4), [[a, b, c]]);
    assert_eq!(order(5), [[a, b, c], [c, b, d]]);
    assert_eq!(order(6), [[a, b, c], [a, c, d]]);
    // Points and lines have no triangles.
    assert_eq!(order(0), [[[0.0; 3]; 3]; 0]);
    assert_eq!(order(1), [[[0.0; 3]; 3]; 0]);
    let mut short = sample.clone();
    short.document["meshes"][0]["primitives"][0] = json!({ "attributes": { "POSITION": 0 } });
    assert_eq!(short.import().unwrap().1.degenerate_faces, 1, "the corner that is left over");
}

#[test]
fn narrow_and_interleaved_numbers_are_read() {
    let mut sample = square();
    // Bytes as indices, with a view that goes on behind them.
    sample.buffer.splice(50..62, [0, 1, 2, 0, 2, 3, 9, 9, 9, 9, 9, 9]);
    assert_eq!(sample.with("/accessors/1/componentType", json!(5121)).corners(), square().corners());
    // Positions with other numbers between them.
    let mut interleaved = square();
    let spread = SQUARE.iter().flat_map(|at| at.iter().chain(&[5.0f32, 6.0]).flat_map(|x| x.to_le_bytes()));
    let indices = interleaved.buffer.split_off(50);
    interleaved.buffer = spread.chain(indices).collect();
    interleaved.document["bufferViews"] = json!([
        // The last element ends where its numbers do.
        { "buffer": 0, "byteLength": 72, "byteStride": 20 },
        { "buffer": 0, "byteOffset": 80, "byteLength": 12 }
    ]);
    interleaved.document["buffers"][0]["byteLength"] = json!(92);
    assert_eq!(interleaved.corners(), square().corners());
}

#[test]
fn nodes_move_what_they_place_and_mirrors_keep_sides() {
    let mut sample = square();
    sample.document["scenes"][0]["nodes"] = json!([0, 2]);
    // A quarter turn about z, then twice the size, then away; a child that mirrors in x; and one by its matrix.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    sample.document["nodes"] = json!([
        { "mesh": 0, "children": [1], "rotation": [0.0, 0.0, half, half], "scale": [2.0, 2.0, 2.0],
          "translation": [10.0, 0.0, 0.0] },
        { "mesh": 0, "scale": [-1.0, 1.0, 1.0] },
        { "mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0.5, 0.25, 4, 1] }
    ]);
    let corners = sample.corners();
    assert_eq!(corners.len(), 6);
    let near = |found: [[f64; 3]; 3], wanted: [[f64; 3]; 3]| {
        let off = found.iter().flatten().zip(wanted.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-6, "{found:?} instead of {wanted:?}");
    };
    near(corners[0], [[10.0, 0.0, 0.0], [10.0, 2.0, 0.0], [8.0, 2.0, 0.0]]);
    // Mirrored, and turned around so that it faces as before.
    near(corners[2], [[10.0, 0.0, 0.0], [8.0, -2.0, 0.0], [10.0, -2.0, 0.0]]);
    assert_eq!(corners[4], [[0.5, 0.25, 4.0], [1.5, 0.25, 4.0], [1.5, 1.25, 4.0]]);
    for [a, b, c] in corners {
        let (u, v) = ([b[0] - a[0], b[1] - a[1]], [c[0] - a[0], c[1] - a[1]]);
        assert!(u[0] * v[1] - u[1] * v[0] > 0.0, "all face up");
    }
}

#[test]
fn materials_become_those_of_mtl() {
    let mut sample = square();
    sample.document["meshes"][0]["primitives"][0]["material"] = json!(2);
    sample.document["extensionsUsed"] = json!(["KHR_materials_transmission", "KHR_materials_ior"]);
    sample.document["materials"] = json!([
        { "name": "unused" },
        { "name": "gold", "pbrMetallicRoughness": {
            "baseColorFactor": [1.0, 0.75, 0.25, 1.0], "metallicFactor": 1.0, "roughnessFactor": 0.1 } },
        { "name": "glass", "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.0 },
          "emissiveFactor": [0.5, 0.0, 0.0],
          "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1.0 },
                          "KHR_materials_ior": { "ior": 1.25 } } }
    ]);
    let (mesh, report) = sample.import().unwrap();
    // Only what is used is there.
    let [glass] = mesh.materials.as_slice() else { panic!("{:?}", mesh.materials) };
    assert_eq!((glass.name.as_str(), glass.opacity, glass.refractive_index), ("glass", 0.0, 1.25));
    // The base colour is for what is not transmitted, which is nothing.
    assert_eq!((glass.diffuse, glass.emission, glass.metalness), ([1.0; 3], [0.5, 0.0, 0.0], 0.0));
    assert!((glass.specular[0] - (0.25f32 / 2.25).powi(2)).abs() < 1e-7 && !glass.mirror);
    assert_eq!(report.materials, 1);
    let (mesh, _) = sample.with("/meshes/0/primitives/0/material", json!(1)).import().unwrap();
    let gold = &mesh.materials[0];
    assert_eq!(
        (gold.metalness, gold.diffuse, gold.mirror, gold.opacity),
        (1.0, [1.0, 0.75, 0.25], false, 1.0)
    );
    assert!((gold.specular[0] - 0.04).abs() < 1e-7 && gold.exponent_by_roughness);
    assert_eq!((gold.roughness, glass.roughness), (0.1, 0.0));
    // What is in between is as much of a metal as the file says.
    let rough = |metallic: f32, roughness: f32| {
        let mut sample = sample.with("/materials/2/pbrMetallicRoughness/metallicFactor", json!(metallic));
        sample.document["materials"][2]["pbrMetallicRoughness"]["roughnessFactor"] = json!(roughness);
        let record = sample.import().unwrap().0.materials.remove(0);
        assert_eq!(record.shininess, MaterialRecord::exponent_of(record.roughness));
        (record.metalness, record.roughness)
    };
    assert_eq!([rough(1.0, 0.5), rough(0.75, 1.0)], [(1.0, 0.5), (0.75, 1.0)]);
    assert_eq!(rough(0.25, 0.5), (0.25, 0.5));
    // Beyond what the format allows.
    assert_eq!([rough(1.0, 7.0), rough(7.0, -1.0)], [(1.0, 1.0), (1.0, 0.0)]);
}

#[test]
fn attributes_and_pictures_go_along() {
    let mut sample = square();
    let uvs = [[0.0f32, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let normals = [[0.0f32, 0.0, 1.0], [0.0, 0.0, 2.0], [1.0, 0.0, 1.0], [0.0, 0.0, 1.0]];
    sample.buffer.extend([0; 2]);
    sample.buffer.extend(uvs.iter().flatten().chain(normals.iter().flatten()).flat_map(|x| x.to_le_bytes()));
    let document = &mut sample.document;
    document["buffers"][0]["byteLength"] = json!(64 + 32 + 48);
    document["bufferViews"].as_array_mut().unwrap().extend([
        json!({ "buffer": 0, "byteOffset": 64, "byteLength": 32 }),
        json!({ "buffer": 0, "byteOffset": 96, "byteLength": 48 }),
    ]);
    document["accessors"].as_array_mut().unwrap().extend([
        json!({ "bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2" }),
        json!({ "bufferView": 3, "componentType": 5126, "count": 4, "type": "VEC3" }),
    ]);
    let primitive = &mut document["meshes"][0]["primitives"][0];
    primitive["attributes"] = json!({ "POSITION": 0, "TEXCOORD_0": 2, "NORMAL": 3 });
    primitive["material"] = json!(0);
    // Placed twice, once with x turned over and half as wide.
    document["scenes"][0]["nodes"] = json!([0, 1]);
    document["nodes"] = json!([{ "mesh": 0 }, { "mesh": 0, "scale": [-0.5, 1, 1] }]);
    document["images"] = json!([{ "uri": "a%20picture.png" }, { "bufferView": 1, "mimeType": "image/png" }]);
    document["samplers"] = json!([{ "wrapS": 33071, "wrapT": 33071 }]);
    document["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 1 }]);
    document["materials"] = json!([{
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "metallicFactor": 0 },
        "normalTexture": { "index": 1 }
    }]);

    let folder = Folder::new();
    let path = folder.write("x.glb", sample.binary());
    let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
    let report = import_file(&path, &ImportOptions::default(), &mut mesh).unwrap();
    super::check(&mesh, &report);
    assert_eq!(mesh.triangle_uvs, [[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]);
    assert_eq!(mesh.triangle_normals, mesh.triangle_uvs);
    assert_eq!(mesh.uvs[..4], uvs.map(|[u, v]| [u, 1.0 - v]));
    assert_eq!(mesh.normals[1], [0.0, 0.0, 1.0]);
    let slope = |[x, _, z]: [f32; 3]| x / z;
    // Half as wide, the surface is twice as steep, and to the other side.
    assert!((slope(mesh.normals[2]) - 1.0).abs() < 1e-6 && (slope(mesh.normals[6]) + 2.0).abs() < 1e-6);
    let images = mesh.materials[0].images.as_ref().unwrap();
    let picture = images.diffuse.as_ref().unwrap();
    assert_eq!((picture.path.as_str(), picture.clamp), ("a picture.png", true));
    // A picture inside the file is named by its place there.
    let (file, place) = ImageMap::file_of(&images.normal.as_ref().unwrap().path);
    let place = place.unwrap();
    assert_eq!(file, "x.glb");
    assert_eq!(sample.binary()[place.start as usize..place.end as usize], sample.buffer[50..62]);
    assert!(images.specular.is_none());
    assert_eq!(report.warning_count, 0, "{:?}", report.warnings);
    // In a buffer that is base64 in the document, by the place of that text, with its escapes if it has any.
    let text = sample.text().replace("a%20picture.png", "data:image/png;base64,iVBORw");
    let escaped = text.replace('/', r"\/").replace('A', r"\u0041").replace('{', "{ \n");
    for document in [&text, &escaped] {
        let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
        let path = folder.write("x.gltf", document);
        let report = import_file(&path, &ImportOptions::default(), &mut mesh).unwrap();
        assert_eq!(report.warning_count, 0, "{:?}", report.warnings);
        let images = mesh.materials[0].images.as_ref().unwrap();
        let (rest, part) = ImageMap::file_of(&images.normal.as_ref().unwrap().path);
        let (file, place) = ImageMap::text_of(rest);
        let place = place.unwrap();
        assert_eq!((file, part), ("x.gltf", Some(50..62)));
        let found = decode_json(&document.as_bytes()[place.start as usize..place.end as usize]);
        assert_eq!(found.as_deref(), Some(&sample.buffer[..]));
        let (file, place) = ImageMap::text_of(&images.diffuse.as_ref().unwrap().path);
        let place = place.unwrap();
        assert_eq!((file, &document[place.start as usize..place.end as usize]), ("x.gltf", "iVBORw"));
    }
    // Data that is not in base64 is left out.
    let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
    let path = folder.write("x.gltf", text.replace("image/png;base64,", "image/png,"));
    let report = import_file(&path, &ImportOptions::default(), &mut mesh).unwrap();
    assert!(mesh.materials[0].images.as_ref().unwrap().diffuse.is_none());
    assert_eq!(report.warning_count, 1, "{:?}", report.warnings);

    // A sink that has no use for them gets none, and the report says so.
    let (mesh, report) = folder.import("y.glb", sample.binary()).unwrap();
    assert!(mesh.uvs.is_empty() && mesh.triangle_normals.is_empty());
    assert_eq!((report.ignored.normals, report.ignored.texture_coordinates), (8, 8));

    // One image for roughness and metalness, and one for what glows; where the factor is 0 none is named.
    let named = |factors: [f32; 3]| {
        let [metallic, roughness, glow] = factors;
        let mut sample = sample.clone();
        sample.document["materials"] = json!([{
            "pbrMetallicRoughness": {
                "metallicRoughnessTexture": { "index": 0 }, "metallicFactor": metallic, "roughnessFactor": roughness
            },
            "emissiveTexture": { "index": 1 }, "emissiveFactor": [0, glow, 0]
        }]);
        let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
        let path = folder.write("v.glb", sample.binary());
        let report = import_file(&path, &ImportOptions::default(), &mut mesh).unwrap();
        assert_eq!(report.warning_count, 0, "{:?}", report.warnings);
        let images = mesh.materials[0].images.take().unwrap_or_default();
        let is_part = images.emission.as_ref().is_some_and(|map| map.path.starts_with("v.glb#bytes="));
        assert_eq!(is_part, glow > 0.0);
        (images.metalness.map(|map| map.path), images.roughness.map(|map| map.path))
    };
    let picture = || Some("a picture.png".to_string());
    assert_eq!(named([1.0, 0.5, 1.0]), (picture(), picture()));
    assert_eq!(named([0.0, 0.5, 0.0]), (None, picture()));
    assert_eq!(named([0.25, 0.0, 0.0]), (picture(), None));
    assert_eq!(named([0.0, 0.0, 1.0]), (None, None));

    let short = sample.with("/accessors/2/count", json!(3));
    let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
    let outcome = import_file(folder.write("z.glb", short.binary()), &ImportOptions::default(), &mut mesh);
    assert!(refused(outcome.map(|report| (mesh, report))).1.contains("3 elements beside 4"));
}

#[test]
fn what_is_not_supported_says_where() {
    let sample = square();
    let reason = |place: &str, value: Value| refused(sample.with(place, value).import());
    let mut parents = sample.clone();
    parents.document["nodes"] = json!([{ "mesh": 0, "children": [1] }, { "children": [0] }]);
    let (element, reason_text) = refused(parents.import());
    assert_eq!((element.as_str(), reason_text.as_str()), ("nodes[0]", "it has more than one parent"));
    let (element, text) = reason("/accessors/1/count", json!(7));
    assert!(
        element == "meshes[0].primitives[0].indices" && text.contains("past the end"),
        "{element}: {text}"
    );
    let (element, _) = reason("/meshes/0/primitives/0/indices", json!(9));
    assert!(element.contains("indices"), "{element}");
    let (element, text) = reason("/buffers/0/byteLength", json!(4000));
    assert!(element == "buffers[0]" && text.contains("4000"), "{element}: {text}");
    let mut far = sample.clone();
    far.buffer[50] = 4;
    let (element, text) = refused(far.import());
    assert!(element == "meshes[0].primitives[0]" && text.contains("vertex 4 of 4"), "{element}: {text}");
    let mut packed = sample.clone();
    packed.document["meshes"][0]["primitives"][0]["extensions"] = json!({ "KHR_draco_mesh_compression": {} });
    assert!(refused(packed.import()).1.contains("KHR_draco_mesh_compression"));
    let mut required = sample.clone();
    required.document["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    assert!(refused(required.import()).0.contains("extensionsRequired"));
    let mut sparse = sample.clone();
    sparse.document["accessors"][0]["sparse"] = json!({
        "count": 1,
        "indices": { "bufferView": 1, "componentType": 5123 },
        "values": { "bufferView": 0 }
    });
    assert!(refused(sparse.import()).1.contains("sparse"));
    for (place, value, element) in [
        (
            "/meshes/0/primitives/0/attributes/POSITION",
            json!(7),
            "meshes[0].primitives[0].attributes.POSITION",
        ),
        ("/images/0", json!({}), "images[0]"),
        ("/cameras/0/type", json!("orthographic"), "cameras[0]"),
        (
            "/extensions/KHR_lights_punctual/lights/0",
            json!({ "type": "spot" }),
            "extensions.KHR_lights_punctual.lights[0]",
        ),
    ] {
        assert_eq!(refused(rich().with(place, value).import()).0, element);
    }
    for uri in ["https://example.org/x.bin", "/etc/hostname", "data:;base64,%%%"] {
        let mut elsewhere = sample.clone();
        elsewhere.document["buffers"][0]["uri"] = json!(uri);
        let (element, _) = refused(elsewhere.import());
        assert_eq!(element, "buffers[0]", "{uri}");
    }
    let mut absent = sample.clone();
    absent.document["buffers"][0]["uri"] = json!("absent.bin");
    assert!(matches!(absent.import(), Err(ImportError::Io { path, .. }) if path.ends_with("absent.bin")));
    let mut first = sample.binary();
    first[4] = 1;
    assert!(matches!(Folder::new().import("x.glb", first), Err(ImportError::Byte { offset: 4, .. })));
}

/// Opening a pipe waits until somebody writes to it.
#[cfg(unix)]
#[test]
fn a_buffer_that_is_a_pipe_is_refused() {
    let folder = Folder::new();
    let pipe = folder.0.path().join("pipe.bin");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let mut sample = square();
    sample.document["buffers"][0]["uri"] = json!("pipe.bin");
    let path = folder.write("model.gltf", sample.document.to_string());
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let _ = sender.send(import_file(path, &ImportOptions::default(), &mut MeshBuffer::new()));
    });
    let outcome = receiver.recv_timeout(std::time::Duration::from_secs(20)).expect("it waits for the pipe");
    assert!(matches!(outcome, Err(ImportError::Io { path, .. }) if path == pipe));
}

/// Every truncation and many changed bytes: a typed error or a mesh whose triangles name its vertices, never a panic.
#[test]
fn damaged_files_do_no_harm() {
    let folder = Folder::new();
    let rich = rich();
    let samples = [("x.glb", rich.binary()), ("x.gltf", rich.text().into_bytes())];
    let mut random = Random::new(1);
    for (name, whole) in samples {
        for length in 0..whole.len() {
            assert!(folder.import(name, &whole[..length]).is_err(), "{name} cut to {length}");
        }
        let digits: Vec<usize> = (0..whole.len()).filter(|at| whole[*at].is_ascii_digit()).collect();
        let mut survived = [0; 2];
        for run in 0..6000 {
            let mut damaged = whole.clone();
            for _ in 0..1 + random.below(3) {
                // Any bit; or another number, which leaves a document that can be read.
                if run % 2 == 0 {
                    let at = random.below(damaged.len());
                    damaged[at] ^= 1 << random.below(8);
                } else {
                    damaged[digits[random.below(digits.len())]] = b'0' + random.below(10) as u8;
                }
            }
            let path = folder.write(name, damaged);
            let mut mesh = MeshBuffer { keep_attributes: run % 3 == 0, ..MeshBuffer::new() };
            if let Ok(report) = import_file(&path, &ImportOptions::default(), &mut mesh) {
                super::check(&mesh, &report);
                survived[0] += 1;
            }
            survived[1] += u32::from(crate::scene::GltfView::read(&path).is_ok());
        }
        assert!(survived.iter().all(|survived| (1..6000).contains(survived)), "{survived:?}");
    }
}

/// Files with quantized positions have to require the extension (its specification says so).
#[test]
fn files_that_require_quantization_are_read() {
    let mut sample = square();
    // Shorts, four for each position: the last is padding.
    let shorts = SQUARE.iter().flat_map(|[x, y, z]| [*x as i16, *y as i16, *z as i16, 99]);
    let bytes: Vec<u8> = shorts.flat_map(|number| number.to_le_bytes()).collect();
    sample.buffer.splice(..48, [bytes, vec![0; 16]].concat());
    let document = &mut sample.document;
    document["accessors"][0]["componentType"] = json!(5122);
    document["bufferViews"][0] = json!({ "buffer": 0, "byteLength": 32, "byteStride": 8 });
    for key in ["extensionsUsed", "extensionsRequired"] {
        document[key] = json!(["KHR_mesh_quantization"]);
    }
    assert_eq!(sample.corners(), square().corners());
}

#[test]
fn normal_pictures_are_as_strong_as_the_file_says() {
    let mut sample = square_with_picture();
    sample.document["materials"] = json!([{ "normalTexture": { "index": 0, "scale": 0.25 } }]);
    let (mesh, _) = sample.import().unwrap();
    let images = mesh.materials[0].images.as_ref().unwrap();
    assert_eq!(images.normal.as_ref().unwrap().strength, 0.25);
}

#[test]
fn texture_transforms_move_and_scale_pictures() {
    let mut sample = square_with_picture();
    sample.document["extensionsUsed"] = json!(["KHR_texture_transform"]);
    let with = |transform: Value| {
        let extensions = json!({ "KHR_texture_transform": transform });
        let mut sample = sample.clone();
        sample.document["materials"] = json!([{
            "pbrMetallicRoughness": { "baseColorTexture": { "index": 0, "extensions": extensions } },
            "normalTexture": { "index": 0, "extensions": extensions }
        }]);
        let (mesh, report) = sample.import().unwrap();
        let images = mesh.materials[0].images.clone();
        (images, report.warnings.iter().map(|warning| warning.text.clone()).collect::<Vec<_>>())
    };
    let (images, warnings) = with(json!({ "offset": [0.5, 0.25], "scale": [2, 4] }));
    assert_eq!(warnings, [""; 0]);
    let images = images.unwrap();
    for map in [images.diffuse.as_ref().unwrap(), images.normal.as_ref().unwrap()] {
        // Down is up here: where glTF has v' = 4 v + 1/4, 1 - v goes to 1 - v'.
        assert_eq!((map.scale, map.offset), ([2.0, 4.0], [0.5, -3.25]));
    }
    // Turned ones and those of other coordinates are left out, and that is said.
    for transform in [json!({ "rotation": 0.5 }), json!({ "texCoord": 1 }), json!({ "scale": [1e300, 1] })] {
        let (images, warnings) = with(transform.clone());
        assert!(images.is_none() && warnings.len() == 1, "{transform}: {warnings:?}");
    }
}

#[test]
fn colours_of_materials_are_not_negative() {
    let mut sample = square();
    sample.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    sample.document["materials"] = json!([{
        "pbrMetallicRoughness": { "baseColorFactor": [-2, 0.5, 0.25, 1] }, "emissiveFactor": [-1, 0, 0]
    }]);
    let (mesh, _) = sample.import().unwrap();
    assert_eq!((mesh.materials[0].diffuse, mesh.materials[0].emission), ([0.0, 0.5, 0.25], [0.0; 3]));
}

#[test]
fn refractive_indices_are_0_or_at_least_1() {
    let mut sample = square();
    sample.document["meshes"][0]["primitives"][0]["material"] = json!(0);
    sample.document["extensionsUsed"] = json!(["KHR_materials_ior", "KHR_materials_transmission"]);
    let mut with = |ior: f64| {
        sample.document["materials"] = json!([{ "extensions": {
            "KHR_materials_ior": { "ior": ior }, "KHR_materials_transmission": { "transmissionFactor": 1 }
        } }]);
        sample.import()
    };
    // All light is reflected by what has 0.
    let (mesh, _) = with(0.0).unwrap();
    assert_eq!((mesh.materials[0].refractive_index, mesh.materials[0].specular), (1.0, [1.0; 3]));
    for ior in [0.5, -0.5, -3.0] {
        let (mesh, report) = with(ior).unwrap();
        assert_eq!(mesh.materials[0].refractive_index, 1.5);
        assert!(report.warnings.iter().any(|warning| warning.text.contains("ior")), "{report:?}");
    }
}
