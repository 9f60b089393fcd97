//! A mesh in memory.

use super::sink::{CornerIndices, MeshSink, NO_INDEX, VertexBatch};
use crate::error::CompileError;
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Collects a mesh in memory: for small models, tests and benches. Its size is not bounded by any budget.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshBuffer {
    /// Every vertex; f32 ones are exact in f64.
    pub vertices: Vec<[f64; 3]>,
    /// Every triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Material of each triangle.
    pub triangle_materials: Vec<MaterialId>,
    /// Every material.
    pub materials: Vec<MaterialRecord>,
    /// Whether the source said that no vertex follows.
    pub vertices_complete: bool,
    /// How many of the vertices came as f32.
    pub float32_count: usize,
    /// How many of them came as text whose digits f32 keeps.
    pub float32_text_count: usize,
    /// Whether attributes are kept, too; false unless the caller sets it.
    pub keep_attributes: bool,
    /// Every texture coordinate.
    pub uvs: Vec<[f32; 2]>,
    /// Every normal.
    pub normals: Vec<[f32; 3]>,
    /// For each triangle the texture coordinates of its corners; empty if no triangle has any.
    pub triangle_uvs: Vec<[u32; 3]>,
    /// For each triangle the normals of its corners; empty if no triangle has any.
    pub triangle_normals: Vec<[u32; 3]>,
}

impl MeshBuffer {
    /// An empty mesh.
    pub fn new() -> MeshBuffer {
        MeshBuffer::default()
    }

    /// Positions of a triangle's corners.
    ///
    /// # Panics
    /// `triangle` is not less than `triangles.len()`.
    pub fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|vertex| self.vertices[vertex as usize])
    }
}

impl MeshSink for MeshBuffer {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = u16::try_from(self.materials.len()).map_err(|_| CompileError::Limit {
            reason: "more than 65,536 materials; merge some of them".into(),
        })?;
        self.materials.push(material);
        Ok(MaterialId(id))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        match batch {
            VertexBatch::Float32(positions) => {
                self.float32_count += positions.len();
                self.vertices.extend(positions.iter().map(|position| position.map(f64::from)));
            }
            VertexBatch::Float64(positions) => self.vertices.extend_from_slice(positions),
            VertexBatch::Float32Text(positions) => {
                self.float32_text_count += positions.len();
                self.vertices.extend_from_slice(positions);
            }
        }
        Ok(())
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        self.vertices_complete = true;
        Ok(())
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        let position = usize::try_from(vertex).ok().and_then(|index| self.vertices.get(index));
        position.copied().ok_or_else(|| CompileError::Limit {
            reason: format!("vertex {vertex} is asked for, but only {} have come", self.vertices.len()),
        })
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        let count = self.vertices.len();
        if let Some(bad) = triangles.iter().flatten().find(|vertex| **vertex as usize >= count) {
            return Err(CompileError::Limit {
                reason: format!("a triangle names vertex {bad}, but only {count} have come"),
            });
        }
        self.triangles.extend_from_slice(triangles);
        self.triangle_materials.resize(self.triangles.len(), material);
        for list in [&mut self.triangle_uvs, &mut self.triangle_normals] {
            if !list.is_empty() {
                list.resize(self.triangles.len(), [NO_INDEX; 3]);
            }
        }
        Ok(())
    }

    fn takes_attributes(&self) -> bool {
        self.keep_attributes
    }

    fn texture_coordinates(&mut self, batch: &[[f32; 2]]) -> Result<(), CompileError> {
        self.uvs.extend_from_slice(batch);
        Ok(())
    }

    fn normals(&mut self, batch: &[[f32; 3]]) -> Result<(), CompileError> {
        self.normals.extend_from_slice(batch);
        Ok(())
    }

    fn triangles_with_attributes(
        &mut self,
        triangles: &[[u32; 3]],
        corners: CornerIndices<'_>,
        material: MaterialId,
    ) -> Result<(), CompileError> {
        let first = self.triangles.len();
        self.triangles(triangles, material)?;
        let lists = [(&mut self.triangle_uvs, corners.uvs), (&mut self.triangle_normals, corners.normals)];
        for (list, corners) in lists {
            if let Some(corners) = corners {
                list.resize(first, [NO_INDEX; 3]);
                list.extend_from_slice(corners);
            }
        }
        Ok(())
    }
}
