//! A closed sphere of triangles of about one size, anywhere in space.

use super::shape::{Shape, plain_material};
use super::tessellation::{Pattern, Tessellation};
use crate::error::CompileError;
use crate::import::MeshSink;
use crate::units::MaterialId;

/// An icosahedron with every edge halved `subdivisions` times and every vertex moved to the sphere, in f64.
///
/// 20 x 4^`subdivisions` triangles, 10 x 4^`subdivisions` + 2 vertices; closed, seen counter-clockwise from outside.
/// Material 0 is plain grey.
#[derive(Clone, Copy, Debug)]
pub struct Icosphere {
    radius: f64,
    translation: [f64; 3],
    tessellation: Tessellation,
}

impl Icosphere {
    /// A sphere about `translation`.
    ///
    /// # Errors
    /// [`CompileError::Limit`] for more than 10 subdivisions (20,971,520 triangles).
    pub fn new(radius: f64, translation: [f64; 3], subdivisions: u32) -> Result<Icosphere, CompileError> {
        if subdivisions > 10 {
            return Err(CompileError::Limit {
                reason: format!(
                    "{subdivisions} subdivisions of an icosphere are too many: choose 10 at most"
                ),
            });
        }
        Ok(Icosphere { radius, translation, tessellation: Tessellation::new(1 << (2 * subdivisions))? })
    }
}

impl Shape for Icosphere {
    fn vertex_count(&self) -> u64 {
        self.triangle_count() / 2 + 2
    }

    fn triangle_count(&self) -> u64 {
        20 * u64::from(self.tessellation.triangles_per_face())
    }

    fn is_double(&self) -> bool {
        true
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        let Icosphere { radius, translation, tessellation } = *self;
        sink.material(plain_material())?;
        let to_sphere = |p: [f64; 3]| {
            let scale = radius / p.iter().map(|x| x * x).sum::<f64>().sqrt();
            [0, 1, 2].map(|axis| translation[axis] + scale * p[axis])
        };
        Pattern::new(&ICOSAHEDRON, tessellation).emit_bent(&corners(), to_sphere, MaterialId(0), sink)?;
        sink.vertices_complete()
    }
}

/// The twelve corners: cyclic permutations of (0, +-1, +-golden ratio).
fn corners() -> [[f64; 3]; 12] {
    let golden = 0.5 + 1.25f64.sqrt();
    std::array::from_fn(|corner| {
        let (axis, one, long) = (corner / 4, corner % 2, corner / 2 % 2);
        let mut p = [0.0; 3];
        p[(axis + 1) % 3] = if one == 0 { -1.0 } else { 1.0 };
        p[(axis + 2) % 3] = if long == 0 { -golden } else { golden };
        p
    })
}

const ICOSAHEDRON: [[u32; 3]; 20] = [
    [0, 4, 1],
    [0, 1, 6],
    [0, 8, 4],
    [0, 6, 9],
    [0, 9, 8],
    [1, 4, 10],
    [1, 11, 6],
    [1, 10, 11],
    [2, 3, 5],
    [2, 7, 3],
    [2, 5, 8],
    [2, 9, 7],
    [2, 8, 9],
    [3, 10, 5],
    [3, 7, 11],
    [3, 11, 10],
    [4, 8, 5],
    [4, 5, 10],
    [6, 7, 9],
    [6, 11, 7],
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::MeshBuffer;
    use crate::procedural::open_edges;

    #[test]
    fn closed_with_exact_counts_and_every_vertex_on_the_sphere() {
        for (subdivisions, translation) in [(0, [0.0; 3]), (1, [1e7, -1e7, 1e7]), (4, [0.0, 1e4, 0.0])] {
            let sphere = Icosphere::new(1000.0, translation, subdivisions).unwrap();
            let mut mesh = MeshBuffer::new();
            sphere.emit(&mut mesh).unwrap();
            assert_eq!(mesh.triangles.len(), 20 << (2 * subdivisions));
            assert_eq!(mesh.triangles.len() as u64, sphere.triangle_count());
            assert_eq!(mesh.vertices.len() as u64, sphere.vertex_count());
            assert_eq!(open_edges(&mesh.triangles), 0);
            for vertex in &mesh.vertices {
                let square: f64 = vertex.iter().zip(&translation).map(|(x, t)| (x - t) * (x - t)).sum();
                assert!((square.sqrt() - 1000.0).abs() < 1e-8);
            }
            let [a, b, c] = mesh.corners(0).map(|p| [0, 1, 2].map(|axis| p[axis] - translation[axis]));
            let normal = super::super::random::cross(
                [b[0] - a[0], b[1] - a[1], b[2] - a[2]],
                [c[0] - a[0], c[1] - a[1], c[2] - a[2]],
            );
            assert!(normal.iter().zip(&a).map(|(n, p)| n * p).sum::<f64>() > 0.0, "seen from outside");
        }
        assert!(Icosphere::new(1.0, [0.0; 3], 11).is_err());
    }
}
