//! A mesh in memory, as in-core tracers want it.

use std::path::Path;

use outcrop::error::{CompileError, ImportError};
use outcrop::import::{ImportOptions, MeshSink, VertexBatch, import_file};
use outcrop::model::MaterialRecord;
use outcrop::units::MaterialId;

/// Triangles in source order with f32 positions; f64 ones are rounded.
#[derive(Default)]
pub struct Mesh {
    pub vertices: Vec<[f32; 3]>,
    pub triangles: Vec<[u32; 3]>,
    pub triangle_materials: Vec<MaterialId>,
    pub materials: Vec<MaterialRecord>,
}

impl Mesh {
    /// Reads a model file with outcrop's importer.
    pub fn read(path: &Path) -> Result<Mesh, ImportError> {
        let mut mesh = Mesh::default();
        import_file(path, &ImportOptions::default(), &mut mesh)?;
        Ok(mesh)
    }

    pub fn corners(&self, triangle: u32) -> [[f32; 3]; 3] {
        self.triangles[triangle as usize].map(|vertex| self.vertices[vertex as usize])
    }
}

impl MeshSink for Mesh {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = u16::try_from(self.materials.len())
            .map_err(|_| CompileError::Limit { reason: "more than 65,536 materials".into() })?;
        self.materials.push(material);
        Ok(MaterialId(id))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        match batch {
            VertexBatch::Float32(positions) => self.vertices.extend_from_slice(positions),
            VertexBatch::Float64(positions) | VertexBatch::Float32Text(positions) => {
                self.vertices.extend(positions.iter().map(|position| position.map(|x| x as f32)));
            }
        }
        Ok(())
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        Ok(())
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        let position = usize::try_from(vertex).ok().and_then(|index| self.vertices.get(index));
        position
            .map(|position| position.map(f64::from))
            .ok_or_else(|| CompileError::Limit { reason: format!("vertex {vertex} has not come yet") })
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        self.triangles.extend_from_slice(triangles);
        self.triangle_materials.resize(self.triangles.len(), material);
        Ok(())
    }
}
