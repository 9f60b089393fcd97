//! Wavefront OBJ with MTL.

use std::io::Write;
use std::path::Path;

use super::mtl::mtl_text;
use super::out::{Out, keeps_no_vertices};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::model::MaterialRecord;
use crate::procedural::Shape;
use crate::units::MaterialId;

/// Writes `shape` as OBJ to `path` and its materials beside it, with the extension `mtl`.
///
/// Coordinates are the shortest decimals that read back as the same numbers. One pass; memory does not depend on
/// the shape's size.
///
/// # Errors
/// [`CompileError::Write`] if a file cannot be written; the files are left as far as they came.
pub fn write_obj(shape: &dyn Shape, path: impl AsRef<Path>) -> Result<(), CompileError> {
    let path = path.as_ref();
    let mtl_path = path.with_extension("mtl");
    let mut sink =
        ObjSink { out: Out::create(path)?, text: Vec::new(), materials: Vec::new(), current: None };
    let mtl_name = mtl_path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    sink.out.write(format!("mtllib {mtl_name}\n").as_bytes())?;
    shape.emit(&mut sink)?;
    let mut mtl = Out::create(&mtl_path)?;
    mtl.write(mtl_text(&sink.materials).as_bytes())?;
    mtl.finish()?;
    sink.out.finish()
}

struct ObjSink {
    out: Out,
    /// Scratch for the text of one batch.
    text: Vec<u8>,
    materials: Vec<MaterialRecord>,
    current: Option<MaterialId>,
}

impl ObjSink {
    fn vertex(&mut self, coordinates: [impl std::fmt::Display; 3]) {
        let [x, y, z] = coordinates;
        writeln!(self.text, "v {x} {y} {z}").expect("a Vec takes any bytes");
    }

    fn flush(&mut self) -> Result<(), CompileError> {
        let written = self.out.write(&self.text);
        self.text.clear();
        written
    }
}

impl MeshSink for ObjSink {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = MaterialId(self.materials.len() as u16);
        self.materials.push(material);
        Ok(id)
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        match batch {
            VertexBatch::Float32(batch) => batch.iter().for_each(|v| self.vertex(*v)),
            VertexBatch::Float64(batch) | VertexBatch::Float32Text(batch) => {
                batch.iter().for_each(|v| self.vertex(*v))
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
        if self.current != Some(material)
            && let Some(record) = self.materials.get(usize::from(material.0))
        {
            self.current = Some(material);
            writeln!(self.text, "usemtl {}", record.name).expect("a Vec takes any bytes");
        }
        for triangle in triangles {
            self.text.push(b'f');
            for &vertex in triangle {
                self.text.push(b' ');
                // OBJ counts from 1.
                push_decimal(&mut self.text, u64::from(vertex) + 1);
            }
            self.text.push(b'\n');
        }
        self.flush()
    }
}

/// Appends `number` in decimal; several times faster than going through `fmt`, and faces are most of the file.
fn push_decimal(text: &mut Vec<u8>, mut number: u64) {
    let mut digits = [0u8; 20];
    let mut start = digits.len();
    loop {
        start -= 1;
        digits[start] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            break;
        }
    }
    text.extend_from_slice(&digits[start..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::Gears;

    #[test]
    fn decimals() {
        for number in [0, 7, 10, 4_294_967_296, u64::MAX] {
            let mut text = Vec::new();
            push_decimal(&mut text, number);
            assert_eq!(text, number.to_string().into_bytes());
        }
    }

    #[test]
    fn gears_text_has_every_vertex_face_and_material() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gears.obj");
        let gears = Gears::new(1).unwrap();
        write_obj(&gears, &path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines = |start: &str| text.lines().filter(|line| line.starts_with(start)).count() as u64;
        assert_eq!(lines("v "), gears.vertex_count());
        assert_eq!(lines("f "), gears.triangle_count());
        assert_eq!(text.lines().next(), Some("mtllib gears.mtl"));
        assert_eq!(lines("usemtl"), 2);
        let mtl = std::fs::read_to_string(path.with_extension("mtl")).unwrap();
        assert_eq!(mtl.lines().filter(|line| line.starts_with("newmtl")).count(), 14);
    }

    #[test]
    fn a_file_that_cannot_be_written_is_named() {
        let error = write_obj(&Gears::new(1).unwrap(), Path::new("/no such folder/x.obj")).unwrap_err();
        assert!(error.to_string().contains("/no such folder/x.obj"), "{error}");
    }
}
