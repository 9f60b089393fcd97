//! Binary little-endian PLY.

use std::path::Path;

use super::mtl::mtl_text;
use super::out::{Out, keeps_no_vertices};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::model::MaterialRecord;
use crate::procedural::Shape;
use crate::units::MaterialId;

/// Writes `shape` as binary little-endian PLY to `path`: `float x, y, z` (`double` for shapes in f64), then
/// `list uchar int vertex_indices`.
///
/// PLY has no standard for materials. `with_materials` writes them as MTL beside the file, names that file in a
/// comment `mtllib NAME.mtl`, and gives each face a property `ushort material_index` that counts in its order.
///
/// Two passes over the shape; memory does not depend on its size.
///
/// # Errors
/// [`CompileError::Write`] if a file cannot be written; [`CompileError::Limit`] if a vertex index does not fit the
/// format's `int`. The files are left as far as they came.
pub fn write_ply(
    shape: &dyn Shape,
    path: impl AsRef<Path>,
    with_materials: bool,
) -> Result<(), CompileError> {
    let path = path.as_ref();
    if shape.vertex_count() > i32::MAX as u64 {
        return Err(CompileError::Limit {
            reason: "PLY numbers vertices with 31 bits: choose a smaller model".to_string(),
        });
    }
    let mtl_path = path.with_extension("mtl");
    let mut out = Out::create(path)?;
    out.write(header(shape, with_materials.then_some(mtl_path.as_path())).as_bytes())?;
    let mut sink =
        PlySink { out, bytes: Vec::new(), materials: Vec::new(), pass: Pass::Vertices, with_materials };
    shape.emit(&mut sink)?;
    sink.pass = Pass::Faces;
    sink.materials.clear();
    shape.emit(&mut sink)?;
    if with_materials {
        let mut mtl = Out::create(&mtl_path)?;
        mtl.write(mtl_text(&sink.materials).as_bytes())?;
        mtl.finish()?;
    }
    sink.out.finish()
}

fn header(shape: &dyn Shape, mtl: Option<&Path>) -> String {
    let (vertices, faces) = (shape.vertex_count(), shape.triangle_count());
    let number = if shape.is_double() { "double" } else { "float" };
    let mut text = "ply\nformat binary_little_endian 1.0\n".to_string();
    if let Some(name) = mtl.and_then(Path::file_name) {
        text += &format!("comment mtllib {}\n", name.to_string_lossy());
    }
    text += &format!("element vertex {vertices}\n");
    for axis in ["x", "y", "z"] {
        text += &format!("property {number} {axis}\n");
    }
    text += &format!("element face {faces}\nproperty list uchar int vertex_indices\n");
    if mtl.is_some() {
        text += "property ushort material_index\n";
    }
    text + "end_header\n"
}

#[derive(PartialEq)]
enum Pass {
    Vertices,
    Faces,
}

struct PlySink {
    out: Out,
    /// Scratch for the bytes of one batch.
    bytes: Vec<u8>,
    materials: Vec<MaterialRecord>,
    pass: Pass,
    with_materials: bool,
}

impl PlySink {
    fn flush(&mut self) -> Result<(), CompileError> {
        let written = self.out.write(&self.bytes);
        self.bytes.clear();
        written
    }
}

impl MeshSink for PlySink {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = MaterialId(self.materials.len() as u16);
        self.materials.push(material);
        Ok(id)
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        if self.pass == Pass::Faces {
            return Ok(());
        }
        match batch {
            VertexBatch::Float32(batch) => {
                self.bytes.extend(batch.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
            }
            VertexBatch::Float64(batch) | VertexBatch::Float32Text(batch) => {
                self.bytes.extend(batch.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
            }
        }
        self.flush()
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        Ok(())
    }

    fn position(&mut self, _vertex: u64) -> Result<[f64; 3], CompileError> {
        Err(keeps_no_vertices())
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        if self.pass == Pass::Vertices {
            return Ok(());
        }
        for [a, b, c] in triangles {
            self.bytes.push(3);
            for vertex in [a, b, c] {
                self.bytes.extend_from_slice(&vertex.to_le_bytes());
            }
            if self.with_materials {
                self.bytes.extend_from_slice(&material.0.to_le_bytes());
            }
        }
        self.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::Gears;

    #[test]
    fn file_length_follows_from_the_counts() {
        let folder = tempfile::tempdir().unwrap();
        let gears = Gears::new(1).unwrap();
        for (with_materials, face_bytes) in [(false, 13), (true, 15)] {
            let path = folder.path().join("gears.ply");
            write_ply(&gears, &path, with_materials).unwrap();
            let bytes = std::fs::read(&path).unwrap();
            let body = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
            assert_eq!(
                (bytes.len() - body) as u64,
                12 * gears.vertex_count() + face_bytes * gears.triangle_count()
            );
            assert_eq!(path.with_extension("mtl").exists(), with_materials);
        }
    }
}
