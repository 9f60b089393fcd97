//! Meshes in memory, compiled, and compiled files read back whole.

#![allow(dead_code)]

use std::path::{Path, PathBuf};

use outcrop::MemoryBudget;
use outcrop::block::{BlockData, DecodeScratch};
use outcrop::compile::{CompileOptions, CompileReport, Compiler, Control, Progress};
use outcrop::error::CompileError;
use outcrop::geom::{Aabb, Precision};
use outcrop::import::{MeshSink, VertexBatch};
use outcrop::model::{MaterialRecord, Model, ModelReader, SubBoxes};
use outcrop::units::{BlockId, Bytes, MaterialId};

/// Vertices in the number type of their source.
#[derive(Clone, Debug)]
pub enum Vertices {
    Float32(Vec<[f32; 3]>),
    Float64(Vec<[f64; 3]>),
}

/// A mesh and how it comes.
#[derive(Clone, Debug)]
pub struct Mesh {
    pub vertices: Vertices,
    pub triangles: Vec<[u32; 3]>,
    pub materials: Vec<u16>,
    /// What the materials are; default ones beyond the end.
    pub records: Vec<MaterialRecord>,
    /// Whether `vertices_complete` is called before the faces.
    pub complete_first: bool,
    /// Triangles per call of the sink.
    pub batch: usize,
}

impl Mesh {
    pub fn new(vertices: Vertices, triangles: Vec<[u32; 3]>) -> Mesh {
        let materials = vec![0; triangles.len()];
        Mesh { vertices, triangles, materials, records: Vec::new(), complete_first: true, batch: 1000 }
    }

    pub fn vertex(&self, index: u32) -> [f64; 3] {
        match &self.vertices {
            Vertices::Float32(vertices) => vertices[index as usize].map(f64::from),
            Vertices::Float64(vertices) => vertices[index as usize],
        }
    }

    pub fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|vertex| self.vertex(vertex))
    }

    pub fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        for material in 0..=self.materials.iter().max().copied().unwrap_or(0) {
            sink.material(self.records.get(usize::from(material)).cloned().unwrap_or_default())?;
        }
        match &self.vertices {
            Vertices::Float32(vertices) => {
                vertices.chunks(777).try_for_each(|batch| sink.vertices(VertexBatch::Float32(batch)))?;
            }
            Vertices::Float64(vertices) => {
                vertices.chunks(777).try_for_each(|batch| sink.vertices(VertexBatch::Float64(batch)))?;
            }
        }
        if self.complete_first {
            sink.vertices_complete()?;
        }
        sink.progress(1, Some(2))?;
        let mut start = 0;
        for run in self.materials.chunk_by(|a, b| a == b) {
            for batch in self.triangles[start..start + run.len()].chunks(self.batch) {
                sink.triangles(batch, MaterialId(run[0]))?;
            }
            start += run.len();
        }
        Ok(())
    }

    /// The mesh that a shape emits.
    pub fn of(shape: &dyn outcrop::procedural::Shape) -> Mesh {
        let mut buffer = outcrop::import::MeshBuffer::new();
        shape.emit(&mut buffer).unwrap();
        let vertices = if buffer.float32_count == buffer.vertices.len() {
            Vertices::Float32(buffer.vertices.iter().map(|vertex| vertex.map(|x| x as f32)).collect())
        } else {
            Vertices::Float64(buffer.vertices)
        };
        let materials = buffer.triangle_materials.iter().map(|material| material.0).collect();
        Mesh { materials, ..Mesh::new(vertices, buffer.triangles) }
    }
}

/// A directory of its own, removed with its contents at the end.
pub struct Place(tempfile::TempDir);

impl Place {
    pub fn new() -> Place {
        Place(tempfile::tempdir().unwrap())
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    pub fn output(&self) -> PathBuf {
        self.0.path().join("model.outcrop")
    }

    /// Names of the files in it.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }
}

pub fn compile_with(
    mesh: &Mesh,
    options: &CompileOptions,
    budget: Bytes,
    output: &Path,
    progress: &mut dyn FnMut(Progress) -> Control,
) -> Result<CompileReport, CompileError> {
    let budget = MemoryBudget::new(budget);
    let result = (|| {
        let mut compiler = Compiler::new(output, options.clone(), &budget, progress)?;
        mesh.emit(&mut compiler)?;
        compiler.finish()
    })();
    assert_eq!(budget.used(), Bytes(0), "all of the budget is given back");
    result
}

/// Compiles and returns the file's bytes too.
pub fn compile(mesh: &Mesh, options: &CompileOptions, budget: Bytes) -> (CompileReport, Vec<u8>) {
    let place = Place::new();
    let report =
        compile_with(mesh, options, budget, &place.output(), &mut |_| Control::Continue).expect("compiles");
    assert_eq!(place.files(), ["model.outcrop"], "nothing but the result is left");
    let bytes = std::fs::read(place.output()).unwrap();
    assert_eq!(report.file_bytes, bytes.len() as u64);
    (report, bytes)
}

/// A triangle of a compiled file.
#[derive(Clone, Debug, PartialEq)]
pub struct Stored {
    pub corners: [[f64; 3]; 3],
    pub material: u16,
}

/// A compiled file's triangles by id, after checking all that the directory says about its blocks.
pub fn read_back(bytes: &[u8]) -> (Model, Vec<Option<Stored>>) {
    let model = ModelReader::parse(bytes).expect("opens");
    let mut triangles: Vec<Option<Stored>> = Vec::new();
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let mut data = BlockData::with_limits(model.limits);
    let mut total = 0;
    for (index, entry) in model.blocks.iter().enumerate() {
        let stored = &bytes[entry.offset as usize..][..entry.stored_bytes as usize];
        model.decode_block(BlockId(index as u32), stored, &mut scratch, &mut data).expect("decodes");
        let wide = !data.vertices_wide.is_empty();
        assert!(model.limits.fits(data.vertices.len(), data.triangles.len(), wide));
        assert!(data.ids.is_sorted_by(|a, b| a < b));
        let sub_boxes: Vec<Aabb> = SubBoxes(entry.sub_boxes).decode(&entry.bounds).collect();
        let mut bounds = Aabb::EMPTY;
        let (mut low, mut high) = (u16::MAX, 0);
        let mut next_new = 0;
        for (triangle, corners) in data.triangles.iter().enumerate() {
            for corner in corners {
                assert!(*corner <= next_new, "vertices come in first-use order");
                next_new = next_new.max(corner + 1);
            }
            // Not by `position`, which adds the base and so loses the sign of zero.
            let corners = corners.map(|corner| match model.precision {
                Precision::Float32 => data.vertices[usize::from(corner)].map(f64::from),
                Precision::Lattice(_) => data.position(usize::from(corner)),
            });
            let mut own = Aabb::EMPTY;
            corners.into_iter().for_each(|corner| own.grow(corner));
            bounds.merge(&own);
            assert!(sub_boxes.iter().any(|part| part.contains(&own)), "each triangle lies in a sub-box");
            let material = data.materials[triangle];
            (low, high) = (low.min(material), high.max(material));
            let id = data.ids[triangle] as usize;
            if triangles.len() <= id {
                triangles.resize(id + 1, None);
            }
            let before = triangles[id].replace(Stored { corners, material });
            assert_eq!(before, None, "triangle {id} is in two blocks");
            total += 1;
        }
        assert_eq!((bounds, [low, high]), (entry.bounds, entry.material_range));
    }
    assert_eq!(model.triangle_count, total);
    (model, triangles)
}

/// That a compiled file holds every triangle of a mesh, bit for bit.
pub fn assert_same(mesh: &Mesh, bytes: &[u8]) {
    let (_, stored) = read_back(bytes);
    assert_eq!(stored.len(), mesh.triangles.len());
    for (index, stored) in stored.iter().enumerate() {
        let stored = stored.as_ref().unwrap_or_else(|| panic!("triangle {index} is missing"));
        let expected = mesh.corners(index);
        assert_eq!(stored.corners.map(|c| c.map(f64::to_bits)), expected.map(|c| c.map(f64::to_bits)));
        assert_eq!(stored.material, mesh.materials[index]);
    }
}
