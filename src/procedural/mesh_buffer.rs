//! A sink that keeps a small mesh in memory.

use std::collections::HashMap;
use std::ops::Range;

use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// A whole mesh in memory: for tests, benches and models that are known to be small.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshBuffer {
    /// Materials in the order of their ids.
    pub materials: Vec<MaterialRecord>,
    /// Positions; f32 ones are widened, which is exact.
    pub vertices: Vec<[f64; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Material of each triangle.
    pub triangle_materials: Vec<MaterialId>,
}

impl MeshBuffer {
    /// An empty mesh.
    pub fn new() -> MeshBuffer {
        MeshBuffer::default()
    }

    /// The corners of one triangle.
    ///
    /// # Panics
    /// If there is no such triangle.
    pub fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|vertex| self.vertices[vertex as usize])
    }

    /// How many directed edges of the given triangles are not met by exactly one edge in the opposite direction:
    /// 0 for surfaces that are closed, oriented and manifold along every edge.
    ///
    /// # Panics
    /// If the range ends past the last triangle.
    pub fn open_edges(&self, triangles: Range<usize>) -> usize {
        let mut edges: HashMap<[u32; 2], u32> = HashMap::new();
        for [a, b, c] in &self.triangles[triangles] {
            for edge in [[*a, *b], [*b, *c], [*c, *a]] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        edges.iter().filter(|&(&[a, b], &count)| count != 1 || edges.get(&[b, a]) != Some(&1)).count()
    }
}

impl MeshSink for MeshBuffer {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        let id = u16::try_from(self.materials.len())
            .map_err(|_| CompileError::Limit { reason: "more than 65,536 materials".to_string() })?;
        self.materials.push(material);
        Ok(MaterialId(id))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        match batch {
            VertexBatch::Float32(batch) => self.vertices.extend(batch.iter().map(|v| v.map(f64::from))),
            VertexBatch::Float64(batch) => self.vertices.extend_from_slice(batch),
        }
        Ok(())
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        Ok(())
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        usize::try_from(vertex)
            .ok()
            .and_then(|v| self.vertices.get(v))
            .copied()
            .ok_or_else(|| no_vertex(vertex))
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        let count = self.vertices.len();
        if let Some(&missing) = triangles.iter().flatten().find(|&&vertex| vertex as usize >= count) {
            return Err(no_vertex(missing.into()));
        }
        self.triangles.extend_from_slice(triangles);
        self.triangle_materials.resize(self.triangles.len(), material);
        Ok(())
    }
}

fn no_vertex(vertex: u64) -> CompileError {
    CompileError::Limit { reason: format!("vertex {vertex} is used before it is given") }
}
