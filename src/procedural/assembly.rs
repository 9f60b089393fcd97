//! Several shapes in one model, each scaled and moved.

use super::Shape;
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::model::MaterialRecord;
use crate::units::MaterialId;

/// Shapes one after the other, in f64. Materials and triangles keep their order within each shape.
#[derive(Default)]
pub struct Assembly {
    parts: Vec<Part>,
}

struct Part {
    shape: Box<dyn Shape>,
    scale: f64,
    translation: [f64; 3],
}

impl Assembly {
    /// Nothing yet.
    pub fn new() -> Assembly {
        Assembly::default()
    }

    /// Adds a shape, its points multiplied by `scale` and then moved by `translation`.
    #[must_use]
    pub fn with(mut self, shape: impl Shape + 'static, scale: f64, translation: [f64; 3]) -> Assembly {
        self.parts.push(Part { shape: Box::new(shape), scale, translation });
        self
    }
}

impl Shape for Assembly {
    fn vertex_count(&self) -> u64 {
        self.parts.iter().map(|part| part.shape.vertex_count()).sum()
    }

    fn triangle_count(&self) -> u64 {
        self.parts.iter().map(|part| part.shape.triangle_count()).sum()
    }

    fn is_double(&self) -> bool {
        true
    }

    /// # Errors
    /// Those of the sink, and [`CompileError::Limit`] if the vertices cannot be numbered with 32 bits.
    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        if self.vertex_count() > u64::from(u32::MAX) {
            let reason = "the vertices of these parts cannot be numbered with 32 bits: leave some out";
            return Err(CompileError::Limit { reason: reason.to_string() });
        }
        let mut first_vertex = 0;
        for part in &self.parts {
            let mut placed = Placed {
                part,
                sink,
                first_vertex,
                materials: Vec::new(),
                vertices: Vec::new(),
                triangles: Vec::new(),
            };
            part.shape.emit(&mut placed)?;
            first_vertex += part.shape.vertex_count() as u32;
        }
        sink.vertices_complete()
    }
}

/// Receives a part as if it were the only one.
struct Placed<'a> {
    part: &'a Part,
    sink: &'a mut dyn MeshSink,
    first_vertex: u32,
    /// What the part's materials are called in the whole.
    materials: Vec<MaterialId>,
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl MeshSink for Placed<'_> {
    fn material(&mut self, material: MaterialRecord) -> Result<MaterialId, CompileError> {
        self.materials.push(self.sink.material(material)?);
        // As many as the sink accepted, so at most 65,536.
        Ok(MaterialId((self.materials.len() - 1) as u16))
    }

    fn vertices(&mut self, batch: VertexBatch<'_>) -> Result<(), CompileError> {
        let Part { scale, translation, .. } = *self.part;
        let place = |p: [f64; 3]| [0, 1, 2].map(|axis| scale * p[axis] + translation[axis]);
        self.vertices.clear();
        match batch {
            VertexBatch::Float32(positions) => {
                self.vertices.extend(positions.iter().map(|position| place(position.map(f64::from))));
            }
            VertexBatch::Float64(positions) | VertexBatch::Float32Text(positions) => {
                self.vertices.extend(positions.iter().map(|position| place(*position)));
            }
        }
        self.sink.vertices(VertexBatch::Float64(&self.vertices))
    }

    fn vertices_complete(&mut self) -> Result<(), CompileError> {
        // Those of the next part are still to come.
        Ok(())
    }

    fn position(&mut self, vertex: u64) -> Result<[f64; 3], CompileError> {
        let Part { scale, translation, .. } = *self.part;
        let placed = self.sink.position(u64::from(self.first_vertex) + vertex)?;
        Ok([0, 1, 2].map(|axis| (placed[axis] - translation[axis]) / scale))
    }

    fn triangles(&mut self, triangles: &[[u32; 3]], material: MaterialId) -> Result<(), CompileError> {
        let first = self.first_vertex;
        self.triangles.clear();
        self.triangles.extend(triangles.iter().map(|triangle| triangle.map(|vertex| first + vertex)));
        let material = self.materials.get(usize::from(material.0)).copied().unwrap_or(material);
        self.sink.triangles(&self.triangles, material)
    }

    fn progress(&mut self, consumed_bytes: u64, total_bytes: Option<u64>) -> Result<(), CompileError> {
        self.sink.progress(consumed_bytes, total_bytes)
    }
}

impl std::fmt::Debug for Assembly {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Assembly").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::MeshBuffer;
    use crate::procedural::{GlassStack, Icosphere, open_edges};

    #[test]
    fn parts_are_their_shapes_placed() {
        let stack = GlassStack::new(3, 0.5, 0.1, 1.5).unwrap();
        let sphere = Icosphere::new(2.0, [0.0; 3], 2).unwrap();
        let whole = Assembly::new().with(stack, 0.25, [1.0, 2.0, 3.0]).with(sphere, 1.0, [1e6, 0.0, 0.0]);
        let mut mesh = MeshBuffer::new();
        whole.emit(&mut mesh).unwrap();
        assert!(mesh.vertices_complete && mesh.materials.len() == 3);
        assert_eq!(mesh.vertices.len() as u64, whole.vertex_count());
        assert_eq!(mesh.triangles.len() as u64, whole.triangle_count());
        let mut alone = MeshBuffer::new();
        stack.emit(&mut alone).unwrap();
        for triangle in 0..alone.triangles.len() {
            let expected =
                alone.corners(triangle).map(|p| [0.25 * p[0] + 1.0, 0.25 * p[1] + 2.0, 0.25 * p[2] + 3.0]);
            assert_eq!(mesh.corners(triangle), expected);
            assert_eq!(mesh.triangle_materials[triangle], alone.triangle_materials[triangle]);
        }
        let far = alone.triangles.len()..mesh.triangles.len();
        assert_eq!(open_edges(&mesh.triangles[far.clone()]), 0);
        for triangle in far {
            assert_eq!(mesh.triangle_materials[triangle], MaterialId(2));
            assert!(mesh.corners(triangle).iter().all(|p| (p[0] - 1e6).abs() < 2.1));
        }
    }
}
