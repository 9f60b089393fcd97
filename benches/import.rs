//! Parse rates: bytes of PLY, OBJ and STL into a sink that keeps vertices and counts triangles. Files are made in memory and the counts are
//! checked.

use std::fmt::Write as _;
use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use outcrop::error::CompileError;
use outcrop::import::{ImportOptions, MeshSink, VertexBatch, read_obj, read_ply, read_stl};
use outcrop::model::MaterialRecord;
use outcrop::units::MaterialId;

/// Vertices along each side of the grid.
const SIDE: u32 = 400;

#[derive(Default)]
struct Counter {
    /// Polygons are cut by their positions, which the compiler looks up in memory or in its spill.
    vertices: Vec<[f64; 3]>,
    triangles: usize,
    corner_sum: u64,
}

impl MeshSink for Counter {
    fn material(&mut self, _: MaterialRecord) -> Result<MaterialId, CompileError> {
        Ok(MaterialId(0))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        match batch {
            VertexBatch::Float32(positions) => {
                self.vertices.extend(positions.iter().map(|position| position.map(f64::from)));
            }
            VertexBatch::Float64(positions) | VertexBatch::Float32Text(positions) => {
                self.vertices.extend_from_slice(positions);
            }
        }
        Ok(())
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        Ok(())
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        Ok(self.vertices[vertex as usize])
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], _: MaterialId) -> Result<(), CompileError> {
        self.triangles += triangles.len();
        self.corner_sum += triangles.iter().map(|triangle| u64::from(triangle[2])).sum::<u64>();
        Ok(())
    }
}

/// A wavy sheet.
fn position(vertex: u32) -> [f32; 3] {
    let [x, y] = [vertex % SIDE, vertex / SIDE].map(|i| i as f32 / SIDE as f32);
    [x, y, (x * 20.0).sin() * (y * 30.0).cos() * 0.05]
}

/// The cells of the sheet, counterclockwise.
fn cells() -> impl Iterator<Item = [u32; 4]> {
    let side = SIDE - 1;
    (0..side * side).map(move |cell| {
        let corner = cell / side * SIDE + cell % side;
        [corner, corner + 1, corner + SIDE + 1, corner + SIDE]
    })
}

fn triangles() -> impl Iterator<Item = [u32; 3]> {
    cells().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]])
}

fn ply_bytes() -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        SIDE * SIDE,
        triangles().count()
    )
    .into_bytes();
    (0..SIDE * SIDE).for_each(|vertex| bytes.extend(position(vertex).iter().flat_map(|x| x.to_le_bytes())));
    for triangle in triangles() {
        bytes.push(3);
        bytes.extend(triangle.iter().flat_map(|corner| corner.to_le_bytes()));
    }
    bytes
}

/// An OBJ file of triangles or of quads.
fn obj_bytes(quads: bool) -> Vec<u8> {
    let mut text = String::new();
    for vertex in 0..SIDE * SIDE {
        let [x, y, z] = position(vertex);
        writeln!(text, "v {x} {y} {z}").expect("a string takes everything");
    }
    if quads {
        for [a, b, c, d] in cells().map(|cell| cell.map(|corner| corner + 1)) {
            writeln!(text, "f {a} {b} {c} {d}").expect("a string takes everything");
        }
    } else {
        for [a, b, c] in triangles().map(|triangle| triangle.map(|corner| corner + 1)) {
            writeln!(text, "f {a} {b} {c}").expect("a string takes everything");
        }
    }
    text.into_bytes()
}

fn stl_bytes() -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend((triangles().count() as u32).to_le_bytes());
    for triangle in triangles() {
        bytes.extend([0; 12]);
        for corner in triangle {
            bytes.extend(position(corner).iter().flat_map(|x| x.to_le_bytes()));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

fn import(c: &mut Criterion) {
    let options = ImportOptions::default();
    let expected = triangles().count();
    let mut group = c.benchmark_group("import");
    group.sample_size(20);
    for (name, bytes) in [
        ("ply_binary", ply_bytes()),
        ("obj_triangles", obj_bytes(false)),
        ("obj_quads", obj_bytes(true)),
        ("stl_binary", stl_bytes()),
    ] {
        let read = |bytes: &[u8]| {
            let mut counter = Counter::default();
            let path = Path::new("bench");
            let report = match &name[..3] {
                "ply" => read_ply(bytes, path, &options, &mut counter),
                "obj" => read_obj(bytes, path, &options, &mut counter),
                _ => read_stl(bytes, path, &options, &mut counter),
            };
            assert_eq!(report.expect("the file is sound").fans, 0);
            counter
        };
        let counter = read(&bytes);
        assert_eq!(counter.triangles, expected);
        if name != "stl_binary" {
            assert_eq!(counter.vertices.len(), (SIDE * SIDE) as usize);
        }
        group.throughput(Throughput::Bytes(bytes.len() as u64));
        group.bench_function(name, |bencher| bencher.iter(|| read(black_box(&bytes)).corner_sum));
    }
    group.finish();
}

criterion_group!(benches, import);
criterion_main!(benches);
