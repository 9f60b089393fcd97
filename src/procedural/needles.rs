//! Slivers: triangles that naive tests get wrong.

use super::random::{Random, cross, perpendicular};
use super::shape::{Shape, plain_material};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::units::MaterialId;

/// Closed needles at random places and directions inside about -2 ..= 2, in f32: each two tips and a three-cornered
/// waist, 6 triangles, 5 vertices, length 1 and thickness `thickness`. Material 0 is plain grey.
#[derive(Clone, Copy, Debug)]
pub struct Needles {
    count: u32,
    thickness: f64,
    seed: u64,
}

impl Needles {
    /// `count` needles.
    ///
    /// # Errors
    /// [`CompileError::Limit`] for more than 858,993,459 needles (vertices are numbered with 32 bits).
    pub fn new(count: u32, thickness: f64, seed: u64) -> Result<Needles, CompileError> {
        if count > u32::MAX / 5 {
            return Err(CompileError::Limit { reason: format!("{count} needles are too many") });
        }
        Ok(Needles { count, thickness, seed })
    }
}

impl Shape for Needles {
    fn vertex_count(&self) -> u64 {
        5 * u64::from(self.count)
    }

    fn triangle_count(&self) -> u64 {
        6 * u64::from(self.count)
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        sink.material(plain_material())?;
        let mut random = Random::new(self.seed);
        for needle in 0..self.count {
            let middle = random.in_cube();
            let along = random.direction();
            let right = perpendicular(along);
            let up = cross(along, right);
            let at = |a: f64, r: f64, u: f64| {
                [0, 1, 2].map(|k| (middle[k] + a * along[k] + r * right[k] + u * up[k]) as f32)
            };
            let w = 0.5 * self.thickness;
            let corners = [
                at(-0.5, 0.0, 0.0),
                at(0.5, 0.0, 0.0),
                at(0.0, w, 0.0),
                at(0.0, -0.5 * w, 0.75f64.sqrt() * w),
                at(0.0, -0.5 * w, -0.75f64.sqrt() * w),
            ];
            sink.vertices(VertexBatch::Float32(&corners))?;
            let faces = [[2, 3, 1], [3, 4, 1], [4, 2, 1], [3, 2, 0], [4, 3, 0], [2, 4, 0]];
            sink.triangles(&faces.map(|face| face.map(|corner| 5 * needle + corner)), MaterialId(0))?;
        }
        sink.vertices_complete()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::MeshBuffer;
    use crate::procedural::open_edges;

    #[test]
    fn closed_thin_and_deterministic() {
        let make = |seed| {
            let mut mesh = MeshBuffer::new();
            Needles::new(50, 1e-4, seed).unwrap().emit(&mut mesh).unwrap();
            mesh
        };
        let mesh = make(1);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (250, 300));
        assert_eq!(open_edges(&mesh.triangles[0..300]), 0);
        assert!(mesh.vertices.iter().flatten().all(|x| x.abs() <= 2.0));
        let length = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        for triangle in 0..300 {
            let [a, b, c] = mesh.corners(triangle);
            assert!(length(a, b) < 1.1e-4 && length(b, c) > 0.49);
        }
        assert!(mesh == make(1));
        assert!(mesh != make(2));
        assert!(Needles::new(u32::MAX, 1.0, 0).is_err());
    }
}
