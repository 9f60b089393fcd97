//! Many closed rings, tilted at random.

use super::random::{Random, cross, perpendicular};
use super::shape::{Shape, plain_material};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::units::MaterialId;

/// `per_edge`^3 tori on a cubic grid inside -1 ..= 1, each turned at random and with a seeded fine roughness, in f32.
///
/// Each torus has 2 x `around` x `across` triangles and is closed. Memory holds one torus. Material 0 is plain grey.
#[derive(Clone, Copy, Debug)]
pub struct TorusField {
    per_edge: u32,
    around: u32,
    across: u32,
    seed: u64,
}

impl TorusField {
    /// `around` vertices along each ring, `across` around its tube.
    ///
    /// # Errors
    /// [`CompileError::Limit`] if `per_edge` is 0, `around` or `across` is below 3, or the vertices cannot be numbered
    /// with 32 bits.
    pub fn new(per_edge: u32, around: u32, across: u32, seed: u64) -> Result<TorusField, CompileError> {
        let vertices = u64::from(per_edge)
            .checked_pow(3)
            .and_then(|count| count.checked_mul(u64::from(around)))
            .and_then(|count| count.checked_mul(u64::from(across)))
            .filter(|&count| count <= u64::from(u32::MAX));
        if per_edge == 0 || around < 3 || across < 3 || vertices.is_none() {
            return Err(CompileError::Limit {
                reason: format!(
                    "{per_edge}^3 tori of {around} x {across} vertices cannot be made: choose at least 1, 3 and 3, and at most 4,294,967,295 vertices in all"
                ),
            });
        }
        Ok(TorusField { per_edge, around, across, seed })
    }

    fn torus(&self, cell: [u32; 3], random: &mut Random) -> Vec<[f32; 3]> {
        let size = 1.0 / f64::from(self.per_edge);
        let center = cell.map(|k| (2.0 * f64::from(k) + 1.0) * size - 1.0);
        let axis = random.direction();
        let right = perpendicular(axis);
        let up = cross(axis, right);
        let turn = |k: u32, count: u32| libm::sincos(std::f64::consts::TAU * f64::from(k) / f64::from(count));
        let mut vertices = Vec::with_capacity((self.around * self.across) as usize);
        for i in 0..self.around {
            let (sin, cos) = turn(i, self.around);
            let outward = [0, 1, 2].map(|k| cos * right[k] + sin * up[k]);
            for j in 0..self.across {
                let (height, out) = turn(j, self.across);
                // The tube reaches 0.6 + 0.25 x 1.02 of the cell's half edge: tori of neighbours never touch.
                let tube = 0.25 * (1.0 + 0.02 * random.signed());
                vertices.push([0, 1, 2].map(|k| {
                    let offset = (0.6 + tube * out) * outward[k] + tube * height * axis[k];
                    (center[k] + size * offset) as f32
                }));
            }
        }
        vertices
    }

    fn triangles(&self, first_vertex: u32) -> Vec<[u32; 3]> {
        let at = |i: u32, j: u32| first_vertex + (i % self.around) * self.across + j % self.across;
        let mut triangles = Vec::with_capacity(2 * (self.around * self.across) as usize);
        for i in 0..self.around {
            for j in 0..self.across {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        triangles
    }
}

impl Shape for TorusField {
    fn vertex_count(&self) -> u64 {
        u64::from(self.per_edge).pow(3) * u64::from(self.around) * u64::from(self.across)
    }

    fn triangle_count(&self) -> u64 {
        2 * self.vertex_count()
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        sink.material(plain_material())?;
        let mut random = Random::new(self.seed);
        let mut first_vertex = 0;
        for k in 0..self.per_edge {
            for j in 0..self.per_edge {
                for i in 0..self.per_edge {
                    sink.vertices(VertexBatch::Float32(&self.torus([i, j, k], &mut random)))?;
                    sink.triangles(&self.triangles(first_vertex), MaterialId(0))?;
                    // The last sum may be 2^32 and is not used.
                    first_vertex = first_vertex.wrapping_add(self.around * self.across);
                }
            }
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
    fn closed_inside_the_cube_and_deterministic() {
        let make = |seed| {
            let mut mesh = MeshBuffer::new();
            TorusField::new(2, 12, 8, seed).unwrap().emit(&mut mesh).unwrap();
            mesh
        };
        let mesh = make(3);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (8 * 96, 16 * 96));
        assert_eq!(open_edges(&mesh.triangles), 0);
        assert!(mesh.vertices.iter().flatten().all(|x| x.abs() <= 1.0));
        let volume: f64 = (0..mesh.triangles.len())
            .map(|triangle| {
                let [a, b, c] = mesh.corners(triangle);
                let n = cross(b, c);
                (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6.0
            })
            .sum();
        assert!(volume > 0.0, "seen counter-clockwise from outside");
        assert!(mesh == make(3));
        assert!(mesh != make(4));
    }

    #[test]
    fn sizes_that_cannot_be_made() {
        for (per_edge, around, across) in [(0, 3, 3), (1, 2, 3), (1, 3, 2), (2000, 3, 3), (u32::MAX, 9, 9)] {
            assert!(TorusField::new(per_edge, around, across, 0).is_err());
        }
    }
}
