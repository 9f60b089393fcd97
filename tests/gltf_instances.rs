//! Meshes that a glTF file places more than once: by nodes or by `EXT_mesh_gpu_instancing`, written out or shared.

#![allow(clippy::unwrap_used, reason = "a test may panic")]

use std::path::{Path, PathBuf};
use std::sync::Arc;

use outcrop::compile::{CompileOptions, Control, Threads, compile_file, compile_file_with};
use outcrop::error::ImportError;
use outcrop::import::{
    GltfPart, ImportOptions, MeshBuffer, gltf_meshes, import_file, source_record, source_record_of,
};
use outcrop::instance::{GltfInstances, Instances};
use outcrop::octree::OctreeOptions;
use outcrop::render::{Film, RenderSettings, Renderer};
use outcrop::scene::{Camera, Light, Scene};
use outcrop::source::DiskSource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};
use serde_json::{Value, json};

/// Columns and rows of the ball's grid.
const GRID: [u32; 2] = [24, 12];
const BALL_TRIANGLES: u64 = (GRID[0] * GRID[1] * 2) as u64;

/// A document and the bytes of its only buffer, which is a file.
#[derive(Clone)]
struct Sample {
    document: Value,
    buffer: Vec<u8>,
}

impl Sample {
    /// A floor (mesh 0) and a ball of a glass and a brick half (mesh 1), which `places` lists as nodes. Its positions are multiples
    /// of `2^-10`.
    fn new(places: &[Value], with_normals: bool) -> Sample {
        let mut sample = Sample {
            document: json!({
                "asset": { "version": "2.0" },
                "scene": 0,
                "extensionsUsed": ["KHR_materials_transmission"],
                "accessors": [],
                "bufferViews": [],
                "materials": [
                    { "name": "floor", "pbrMetallicRoughness":
                        { "baseColorFactor": [0.5, 0.75, 0.25, 1.0], "metallicFactor": 0.0 } },
                    { "name": "glass", "pbrMetallicRoughness": { "metallicFactor": 0.0, "roughnessFactor": 0.0 },
                      "extensions": { "KHR_materials_transmission": { "transmissionFactor": 1.0 } } },
                    { "name": "brick", "pbrMetallicRoughness":
                        { "baseColorFactor": [0.75, 0.25, 0.125, 1.0], "metallicFactor": 0.0 } }
                ]
            }),
            buffer: Vec::new(),
        };
        let floor = [[-9.0f32, 0.0, 9.0], [9.0, 0.0, 9.0], [9.0, 0.0, -9.0], [-9.0, 0.0, -9.0]];
        let floor = sample.vectors(&floor);
        let floor_indices = sample.indices(&[0, 1, 2, 0, 2, 3]);
        let mut points = Vec::new();
        for row in 0..=GRID[1] {
            for column in 0..GRID[0] {
                let (polar, turn) = (
                    f64::from(row) / f64::from(GRID[1]) * std::f64::consts::PI,
                    f64::from(column) / f64::from(GRID[0]) * std::f64::consts::TAU,
                );
                let point = [polar.sin() * turn.cos(), polar.cos(), polar.sin() * turn.sin()];
                points.push(point.map(|x| (x * 1024.0).round() as f32 / 1024.0));
            }
        }
        let normals = points.clone();
        let positions = sample.vectors(&points);
        let mut attributes = json!({ "POSITION": positions });
        if with_normals {
            attributes["NORMAL"] = json!(sample.vectors(&normals));
        }
        let halves = [0..GRID[1] / 2, GRID[1] / 2..GRID[1]].map(|rows| {
            let quads = rows.flat_map(|row| (0..GRID[0]).map(move |column| [row, column]));
            let corners: Vec<u32> = quads
                .flat_map(|[row, column]| {
                    let next = (column + 1) % GRID[0];
                    let [a, b] = [row * GRID[0] + column, row * GRID[0] + next];
                    [a, b, a + GRID[0], b, b + GRID[0], a + GRID[0]]
                })
                .collect();
            sample.indices(&corners)
        });
        sample.document["meshes"] = json!([
            { "primitives": [{ "attributes": { "POSITION": floor }, "indices": floor_indices, "material": 0 }] },
            { "primitives": [
                { "attributes": attributes, "indices": halves[0], "material": 1 },
                { "attributes": attributes, "indices": halves[1], "material": 2 }
            ] }
        ]);
        let mut nodes = vec![json!({ "mesh": 0 })];
        nodes.extend_from_slice(places);
        sample.document["scenes"] = json!([{ "nodes": (0..nodes.len()).collect::<Vec<_>>() }]);
        sample.document["nodes"] = Value::Array(nodes);
        sample
    }

    fn accessor(&mut self, bytes: Vec<u8>, count: usize, kind: u32, shape: &str) -> usize {
        let (start, length) = (self.buffer.len(), bytes.len());
        self.buffer.extend(bytes);
        self.buffer.resize(self.buffer.len().next_multiple_of(4), 0);
        let views = self.document["bufferViews"].as_array_mut().unwrap();
        views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": length }));
        let view = views.len() - 1;
        let accessors = self.document["accessors"].as_array_mut().unwrap();
        accessors.push(json!({
            "bufferView": view, "componentType": kind, "count": count, "type": shape,
            // What positions must have; read by nobody.
            "min": [-9.0, -9.0, -9.0], "max": [9.0, 9.0, 9.0]
        }));
        accessors.len() - 1
    }

    fn vectors(&mut self, vectors: &[[f32; 3]]) -> usize {
        let bytes = vectors.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(bytes, vectors.len(), 5126, "VEC3")
    }

    fn indices(&mut self, indices: &[u32]) -> usize {
        let bytes = indices.iter().flat_map(|x| x.to_le_bytes()).collect();
        let accessor = self.accessor(bytes, indices.len(), 5125, "SCALAR");
        let accessor_object = self.document["accessors"][accessor].as_object_mut().unwrap();
        accessor_object.remove("min");
        accessor_object.remove("max");
        accessor
    }

    fn write(&self, folder: &Path) -> PathBuf {
        std::fs::write(folder.join("buffer.bin"), &self.buffer).unwrap();
        let mut document = self.document.clone();
        document["buffers"] = json!([{ "byteLength": self.buffer.len(), "uri": "buffer.bin" }]);
        let path = folder.join("scene.gltf");
        std::fs::write(&path, document.to_string()).unwrap();
        path
    }

    fn import(&self, part: GltfPart) -> Result<MeshBuffer, ImportError> {
        let folder = tempfile::tempdir().unwrap();
        let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
        let options = ImportOptions::default().with_gltf_part(part);
        import_file(self.write(folder.path()), &options, &mut mesh).map(|_| mesh)
    }
}

const BUDGET: Bytes = Bytes::mib(128);

fn scene() -> Scene {
    let camera = Camera::pinhole([1.0, 6.0, 14.0], [0.0, 1.5, 0.0], [0.0, 1.0, 0.0], 45.0).unwrap();
    Scene::new(camera)
        .with_background([0.25, 0.5, 0.75])
        .with_light(Light::directional([-1.0, -2.0, -0.75], [0.75; 3]))
        .with_light(Light::point([5.0, 7.0, 5.0], [0.25; 3]))
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 4, ..RenderSettings::new(96, 64) }
}

/// With each mesh written out wherever it is.
fn written_out(path: &Path) -> (Film, u64) {
    let (budget, output) = (MemoryBudget::new(BUDGET), path.with_extension("outcrop"));
    let go_on = &mut |_| Control::Continue;
    let report = compile_file(path, &output, &CompileOptions::default(), &budget, go_on).unwrap();
    let source: Arc<dyn BlockSource> = Arc::new(DiskSource::open(&output).unwrap());
    let set_aside = budget.reserve(Bytes::mib(32), "the picture").unwrap();
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    drop(set_aside);
    let renderer = Renderer::new(&octree, &scene(), &settings(), &budget).unwrap();
    (renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap().film, report.triangles)
}

/// With each mesh once, as far as it is placed more than once.
fn shared(path: &Path) -> (Film, u64) {
    let budget = MemoryBudget::new(BUDGET);
    let found = GltfInstances::read_for(path, 1).unwrap().unwrap();
    let mut triangles = 0;
    let sources: Vec<Arc<dyn BlockSource>> = found
        .parts
        .iter()
        .enumerate()
        .map(|(number, part)| {
            let output = path.with_extension(format!("{number}.outcrop"));
            let import = ImportOptions::default().with_gltf_part(part.clone());
            let go_on = &mut |_| Control::Continue;
            let options = CompileOptions::default();
            let report = compile_file_with(path, &import, &output, &options, &budget, go_on).unwrap();
            triangles += report.triangles;
            let source = DiskSource::open(&output).unwrap();
            assert_eq!(source.model().source, source_record_of(path, &import).unwrap());
            Arc::new(source) as Arc<dyn BlockSource>
        })
        .collect();
    let set_aside = budget.reserve(Bytes::mib(32), "the picture").unwrap();
    let options = OctreeOptions::default();
    let instances = Instances::open(&sources, found.instances, &budget, &options).unwrap();
    drop(set_aside);
    let renderer = Renderer::over_instances(&instances, &scene(), &settings(), &budget).unwrap();
    (renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap().film, triangles)
}

/// The largest difference of each pixel's channels.
fn differences(a: &Film, b: &Film) -> Vec<f32> {
    let rows = (0..a.height()).flat_map(|y| a.row(y).iter().zip(b.row(y)));
    rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)).collect()
}

#[test]
fn shared_meshes_look_like_written_out_ones_to_the_bit_where_nothing_is_rounded() {
    // Moved, mirrored, and twice the size: every coordinate is a number of f32.
    let places = [
        json!({ "mesh": 1, "translation": [0, 1.5, 0] }),
        json!({ "mesh": 1, "translation": [3, 1.25, 1], "scale": [-1, 1, 1] }),
        json!({ "mesh": 1, "translation": [-4, 2, -1], "scale": [2, 2, 2] }),
    ];
    let folder = tempfile::tempdir().unwrap();
    let path = Sample::new(&places, false).write(folder.path());
    let ((one, all), (other, few)) = (written_out(&path), shared(&path));
    assert_eq!((all, few), (2 + 3 * BALL_TRIANGLES, 2 + BALL_TRIANGLES));
    assert_eq!(differences(&one, &other).iter().filter(|difference| **difference != 0.0).count(), 0);
    let distinct: std::collections::BTreeSet<_> =
        (0..one.height()).flat_map(|y| one.row(y).iter().map(|pixel| pixel.map(f32::to_bits))).collect();
    assert!(distinct.len() > 500, "the picture shows something: {} colours", distinct.len());
}

#[test]
fn shared_meshes_that_turn_look_the_same_up_to_rounding() {
    let places = |angle: f64| {
        let (sin, cos) = (0.5 * angle).sin_cos();
        [
            json!({ "mesh": 1, "translation": [0.1, 1.3, 0], "rotation": [0, 0.6 * sin, 0.8 * sin, cos] }),
            json!({ "mesh": 1, "translation": [-3.3, 2, -1], "scale": [1.7, -1.3, 1.1] }),
        ]
    };
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let path = Sample::new(&places(0.7), true).write(folders[0].path());
    let ((one, _), (other, _)) = (written_out(&path), shared(&path));
    let apart = |a: &Film, b: &Film, least: f32| {
        differences(a, b).iter().filter(|difference| **difference > least).count()
    };
    // A sample in thousands may pass an edge on its other side.
    assert!(apart(&one, &other, 1e-3) <= 6, "{} pixels differ", apart(&one, &other, 1e-3));
    // Turned otherwise, it is another picture.
    let turned = shared(&Sample::new(&places(1.9), true).write(folders[1].path())).0;
    assert!(apart(&one, &turned, 1e-3) > 100, "{} pixels differ", apart(&one, &turned, 1e-3));
}

#[test]
fn parts_add_up_to_the_scene_and_have_records_of_their_own() {
    let places = [
        json!({ "mesh": 1, "translation": [0, 1, 0], "children": [3] }),
        json!({ "mesh": 1 }),
        // A child of the first ball, flat: it cannot be an instance of its mesh.
        json!({ "mesh": 0, "scale": [1, 0, 1] }),
    ];
    let mut sample = Sample::new(&places, true);
    sample.document["scenes"][0]["nodes"] = json!([0, 1, 2]);
    let scene = sample.import(GltfPart::Scene).unwrap();
    let ball = sample.import(GltfPart::Mesh(1)).unwrap();
    let rest = sample.import(GltfPart::Without([1].into())).unwrap();
    assert_eq!(ball.triangles.len() as u64, BALL_TRIANGLES);
    assert_eq!(rest.triangles.len(), 4);
    assert_eq!(scene.triangles.len(), 4 + 2 * ball.triangles.len());
    // In its own space, as the file has it: the second time it is placed there.
    assert_eq!(ball.float32_count, ball.vertices.len());
    let names = |mesh: &MeshBuffer| mesh.materials.iter().map(|m| m.name.clone()).collect::<Vec<_>>();
    assert_eq!(
        (names(&ball), names(&rest)),
        (vec!["glass".into(), "brick".into()], vec!["floor".to_string()])
    );

    let folder = tempfile::tempdir().unwrap();
    let path = sample.write(folder.path());
    let meshes = gltf_meshes(&path).unwrap();
    let counts: Vec<_> = meshes.iter().map(|m| (m.number, m.triangles, m.places.len())).collect();
    assert_eq!(counts, [(0, 2, 2), (1, BALL_TRIANGLES, 2)]);
    assert_eq!(meshes[1].places[0].point([1.0, 2.0, 3.0]), [1.0, 3.0, 3.0]);
    let found = GltfInstances::read_for(&path, 1).unwrap().unwrap();
    assert_eq!(found.parts, [GltfPart::Without([1].into()), GltfPart::Mesh(1)]);
    assert_eq!(found.triangles_saved, BALL_TRIANGLES);
    assert_eq!(GltfInstances::read(&path).unwrap(), None, "it saves too little");
    let record = |part| source_record_of(&path, &ImportOptions::default().with_gltf_part(part)).unwrap();
    assert_eq!(record(GltfPart::Scene), source_record(&path).unwrap());
    let all = [GltfPart::Scene, GltfPart::Mesh(0), GltfPart::Mesh(1), GltfPart::Without([1].into())];
    let fingerprints: std::collections::BTreeSet<u64> =
        all.into_iter().map(|part| record(part).fingerprint).collect();
    assert_eq!(fingerprints.len(), 4);
}

/// A node that places the ball three times by the extension, and the three nodes that do the same.
fn copies() -> (Sample, Sample) {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let parent = json!({ "children": [2], "translation": [0, 0.5, 0], "scale": [1, 2, 1] });
    let mut by_extension = Sample::new(&[parent.clone(), json!({ "mesh": 1 })], true);
    let shifts = by_extension.vectors(&[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, -3.0]]);
    let scales = by_extension.vectors(&[[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [-1.0, 1.0, 1.0]]);
    // Normalized 16-bit integers; the second turns by a right angle about y, as nearly as they can.
    let most = i16::MAX;
    let turns = [[0, 0, 0, most], [0, 23_170, 0, 23_170], [0, 0, 0, most]];
    let bytes = turns.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let turns = by_extension.accessor(bytes, 3, 5122, "VEC4");
    by_extension.document["accessors"][turns]["normalized"] = json!(true);
    for key in ["min", "max"] {
        by_extension.document["accessors"][turns].as_object_mut().unwrap().remove(key);
    }
    by_extension.document["scenes"][0]["nodes"] = json!([0, 1]);
    by_extension.document["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    by_extension.document["nodes"][2]["extensions"] = json!({ "EXT_mesh_gpu_instancing": {
        "attributes": { "TRANSLATION": shifts, "ROTATION": turns, "SCALE": scales }
    } });
    let places = [
        json!({ "children": [2, 3, 4], "translation": [0, 0.5, 0], "scale": [1, 2, 1] }),
        json!({ "mesh": 1, "translation": [1, 0, 0] }),
        json!({ "mesh": 1, "translation": [0, 2, 0], "scale": [2, 2, 2], "rotation": [0, half, 0, half] }),
        json!({ "mesh": 1, "translation": [0, 0, -3], "scale": [-1, 1, 1] }),
    ];
    let mut by_nodes = Sample::new(&places, true);
    by_nodes.document["scenes"][0]["nodes"] = json!([0, 1]);
    (by_extension, by_nodes)
}

#[test]
fn copies_of_the_extension_are_those_of_nodes() {
    let (by_extension, by_nodes) = copies();
    let [one, other] = [&by_extension, &by_nodes].map(|sample| sample.import(GltfPart::Scene).unwrap());
    assert_eq!(one.triangles, other.triangles);
    assert_eq!(one.vertices.len(), other.vertices.len());
    let far = one.vertices.iter().flatten().zip(other.vertices.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(far.fold(0.0, f64::max) < 1e-7);
    let folder = tempfile::tempdir().unwrap();
    let found = GltfInstances::read_for(by_extension.write(folder.path()), 1).unwrap().unwrap();
    assert_eq!((found.parts.len(), found.instances.len()), (2, 4));
    assert_eq!(by_extension.import(GltfPart::Mesh(1)).unwrap().triangles.len() as u64, BALL_TRIANGLES);
}

#[test]
fn senseless_copies_say_where() {
    let (sample, _) = copies();
    let name = "nodes[2].extensions.EXT_mesh_gpu_instancing";
    let attributes = "/nodes/2/extensions/EXT_mesh_gpu_instancing/attributes";
    let refused = |change: &dyn Fn(&mut Value)| {
        let mut changed = sample.clone();
        change(&mut changed.document);
        match changed.import(GltfPart::Scene) {
            Err(ImportError::Element { element, reason, .. }) => (element, reason),
            other => panic!("{:?}", other.map(|mesh| mesh.triangles.len())),
        }
    };
    let (element, _) = refused(&|d| d["nodes"][2]["extensions"]["EXT_mesh_gpu_instancing"] = json!({}));
    assert_eq!(element, name);
    let (element, reason) = refused(&|d| *d.pointer_mut(attributes).unwrap() = json!({ "_ID": 0 }));
    assert!(element == name && reason.contains("neither"), "{reason}");
    let (element, reason) = refused(&|d| d.pointer_mut(attributes).unwrap()["SCALE"] = json!(99));
    assert!(element.ends_with("SCALE") && reason.contains("no such accessor"), "{element}: {reason}");
    let (element, reason) = refused(&|d| d.pointer_mut(attributes).unwrap()["SCALE"] = json!(0));
    assert!(element.contains("attributes.") && reason.contains("one length"), "{element}: {reason}");
    let (_, reason) = refused(&|d| d.pointer_mut(attributes).unwrap()["COLOR"] = json!(5));
    assert!(reason.contains("no such attribute") || reason.contains("one length"), "{reason}");
    let (element, reason) = refused(&|d| {
        let scale = d.pointer(attributes).unwrap()["SCALE"].clone();
        d.pointer_mut(attributes).unwrap()["ROTATION"] = scale;
    });
    assert!(element.ends_with("ROTATION") && reason.contains("four"), "{element}: {reason}");
    // More than there are bytes for, and more than are read.
    for (count, text) in [(100_000, "past the end"), (u32::MAX, "more than 1048576")] {
        let (_, reason) = refused(&|d| {
            for attribute in ["TRANSLATION", "ROTATION", "SCALE"] {
                let accessor = d.pointer(attributes).unwrap()[attribute].as_u64().unwrap() as usize;
                d["accessors"][accessor]["count"] = json!(count);
            }
        });
        assert!(reason.contains(text), "{reason}");
    }
}

/// Any other number in the document, or a shorter buffer: an error, or a mesh whose triangles name its vertices.
#[test]
fn damaged_copies_do_no_harm() {
    let (sample, _) = copies();
    let folder = tempfile::tempdir().unwrap();
    let path = sample.write(folder.path());
    let text = std::fs::read(&path).unwrap();
    // The part about nodes, where the places are.
    let digits: Vec<usize> = (0..text.len()).filter(|at| text[*at].is_ascii_digit()).collect();
    let mut state = 7u64;
    let mut random = |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut survived = 0;
    for run in 0..1500 {
        let mut damaged = text.clone();
        for _ in 0..1 + random(2) {
            damaged[digits[random(digits.len())]] = b'0' + random(10) as u8;
        }
        if run % 8 == 0 {
            let length = random(sample.buffer.len());
            std::fs::write(folder.path().join("buffer.bin"), &sample.buffer[..length]).unwrap();
        } else if run % 8 == 1 {
            std::fs::write(folder.path().join("buffer.bin"), &sample.buffer).unwrap();
        }
        std::fs::write(&path, damaged).unwrap();
        let listed = GltfInstances::read_for(&path, 1);
        let mut mesh = MeshBuffer::new();
        if import_file(&path, &ImportOptions::default(), &mut mesh).is_ok() {
            assert!(mesh.triangles.as_flattened().iter().all(|c| (*c as usize) < mesh.vertices.len()));
            assert!(listed.is_ok());
            survived += 1;
        }
    }
    assert!((1..1500).contains(&survived), "{survived}");
}
