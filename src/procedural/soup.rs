//! Triangles without order.

use super::random::Random;
use super::shape::{Shape, plain_material};
use super::tessellation::BATCH;
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::units::MaterialId;

/// `count` unconnected random triangles with corners within `size` of random points of the cube -1 ..= 1, in f32.
/// Three vertices each. Material 0 is plain grey.
#[derive(Clone, Copy, Debug)]
pub struct Soup {
    count: u32,
    size: f64,
    seed: u64,
}

impl Soup {
    /// `count` triangles.
    ///
    /// # Errors
    /// [`CompileError::Limit`] for more than 1,431,655,765 triangles (vertices are numbered with 32 bits).
    pub fn new(count: u32, size: f64, seed: u64) -> Result<Soup, CompileError> {
        if count > u32::MAX / 3 {
            return Err(CompileError::Limit {
                reason: format!("{count} unconnected triangles are too many"),
            });
        }
        Ok(Soup { count, size, seed })
    }
}

impl Shape for Soup {
    fn vertex_count(&self) -> u64 {
        3 * u64::from(self.count)
    }

    fn triangle_count(&self) -> u64 {
        u64::from(self.count)
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        sink.material(plain_material())?;
        let mut random = Random::new(self.seed);
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for first in (0..self.count).step_by(BATCH) {
            vertices.clear();
            triangles.clear();
            for triangle in first..self.count.min(first.saturating_add(BATCH as u32)) {
                let middle = random.in_cube();
                for _ in 0..3 {
                    let offset = random.in_cube();
                    vertices.push([0, 1, 2].map(|k| (middle[k] + self.size * offset[k]) as f32));
                }
                triangles.push([0, 1, 2].map(|corner| 3 * triangle + corner));
            }
            sink.vertices(VertexBatch::Float32(&vertices))?;
            sink.triangles(&triangles, MaterialId(0))?;
        }
        sink.vertices_complete()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::MeshBuffer;

    #[test]
    fn counts_range_and_determinism() {
        let make = |seed| {
            let mut mesh = MeshBuffer::new();
            Soup::new(5000, 0.01, seed).unwrap().emit(&mut mesh).unwrap();
            mesh
        };
        let mesh = make(1);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (15_000, 5000));
        assert!(mesh.vertices.iter().flatten().all(|x| x.abs() <= 1.01 + 1e-6));
        assert!(mesh == make(1));
        assert!(mesh != make(2));
        assert!(Soup::new(u32::MAX, 1.0, 1).is_err());
    }
}
