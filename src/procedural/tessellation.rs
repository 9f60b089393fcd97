//! Cutting each triangle of a coarse mesh into many, with no T-junctions.

use std::collections::HashMap;

use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::units::MaterialId;

/// Vertices or triangles per call of the sink.
pub(super) const BATCH: usize = 4096;

/// How finely each coarse triangle is cut: its edges into `segments` parts each, after it was cut in three at its
/// centroid if `at_centroid`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tessellation {
    segments: u32,
    at_centroid: bool,
}

impl Tessellation {
    /// Cut into 48: the standard of the gears family.
    pub const STANDARD: Tessellation = Tessellation { segments: 4, at_centroid: true };

    /// Cut into `count` triangles each: 1, 4, 9, 16 ... (squares) or 3, 12, 27, 48 ... (three times a square).
    ///
    /// # Errors
    /// [`CompileError::Limit`] for other numbers and those above 3,145,728.
    pub fn new(count: u32) -> Result<Tessellation, CompileError> {
        let root = |x: u32| (1..=1024).find(|s| s * s == x);
        if let Some(segments) = root(count) {
            return Ok(Tessellation { segments, at_centroid: false });
        }
        if count.is_multiple_of(3)
            && let Some(segments) = root(count / 3)
        {
            return Ok(Tessellation { segments, at_centroid: true });
        }
        Err(CompileError::Limit {
            reason: format!(
                "a triangle cannot be cut into {count} like ones: choose a square (1, 4, 9, 16 ...) or three times a square (3, 12, 27, 48, 75 ...)"
            ),
        })
    }

    /// Fine triangles per coarse one.
    pub fn triangles_per_face(self) -> u32 {
        self.segments * self.segments * if self.at_centroid { 3 } else { 1 }
    }

    /// Parts into which each coarse edge is cut.
    pub fn segments(self) -> u32 {
        self.segments
    }

    /// All weights of one fine vertex add up to this.
    fn denominator(self) -> u32 {
        self.segments * if self.at_centroid { 3 } else { 1 }
    }
}

/// A fine vertex as a convex combination of three coarse ones, in units of 1 / denominator.
#[derive(Clone, Copy)]
struct FineVertex {
    corners: [u32; 3],
    weights: [u32; 3],
}

/// The fine mesh of one coarse mesh as pure topology, to be used with many sets of coarse positions.
///
/// A fine vertex on a coarse edge is one vertex for both faces of the edge, so a closed coarse mesh stays closed.
/// Vertices are numbered in the order in which the triangles use them.
pub(super) struct Pattern {
    denominator: f64,
    vertices: Vec<FineVertex>,
    triangles: Vec<[u32; 3]>,
}

impl Pattern {
    /// Cuts a coarse mesh.
    pub fn new(coarse: &[[u32; 3]], tessellation: Tessellation) -> Pattern {
        let mut builder = Builder { numbers: HashMap::new(), vertices: Vec::new(), triangles: Vec::new() };
        let segments = tessellation.segments;
        for &corners in coarse {
            if tessellation.at_centroid {
                for side in 0..3 {
                    // The child (a, b, centroid): its third weight counts for all three corners alike.
                    let [a, b, c] = [0, 1, 2].map(|i| corners[(side + i) % 3]);
                    builder.grid(segments, |[i, j, l]| FineVertex {
                        corners: [a, b, c],
                        weights: [3 * i + l, 3 * j + l, l],
                    });
                }
            } else {
                builder.grid(segments, |weights| FineVertex { corners, weights });
            }
        }
        Pattern {
            denominator: f64::from(tessellation.denominator()),
            vertices: builder.vertices,
            triangles: builder.triangles,
        }
    }

    /// Fine vertices.
    pub fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// Sends the fine mesh in f32 for the given coarse positions; `first_vertex` vertices were sent before.
    ///
    /// Coarse coordinates are f32, so sums of weighted ones are exact in f64 and a plane that is parallel to an
    /// axis stays exactly flat.
    pub fn emit(
        &self,
        positions: &[[f32; 3]],
        first_vertex: u32,
        material: MaterialId,
        sink: &mut dyn MeshSink,
    ) -> Result<(), CompileError> {
        let position = |corner: u32| positions[corner as usize].map(f64::from);
        let mut vertices = Vec::with_capacity(BATCH);
        for chunk in self.vertices.chunks(BATCH) {
            vertices.clear();
            vertices.extend(chunk.iter().map(|vertex| self.combine(vertex, position).map(|x| x as f32)));
            sink.vertices(VertexBatch::Float32(&vertices))?;
        }
        self.emit_triangles(first_vertex, material, sink)
    }

    /// Sends the fine mesh in f64; `bend` moves each fine vertex from its place on the flat coarse face.
    pub fn emit_bent(
        &self,
        positions: &[[f64; 3]],
        bend: impl Fn([f64; 3]) -> [f64; 3],
        material: MaterialId,
        sink: &mut dyn MeshSink,
    ) -> Result<(), CompileError> {
        let position = |corner: u32| positions[corner as usize];
        let mut vertices = Vec::with_capacity(BATCH);
        for chunk in self.vertices.chunks(BATCH) {
            vertices.clear();
            vertices.extend(chunk.iter().map(|vertex| bend(self.combine(vertex, position))));
            sink.vertices(VertexBatch::Float64(&vertices))?;
        }
        self.emit_triangles(0, material, sink)
    }

    fn emit_triangles(
        &self,
        first_vertex: u32,
        material: MaterialId,
        sink: &mut dyn MeshSink,
    ) -> Result<(), CompileError> {
        let mut triangles = Vec::with_capacity(BATCH);
        for chunk in self.triangles.chunks(BATCH) {
            triangles.clear();
            triangles.extend(chunk.iter().map(|triangle| triangle.map(|vertex| first_vertex + vertex)));
            sink.triangles(&triangles, material)?;
        }
        Ok(())
    }

    fn combine(&self, vertex: &FineVertex, position: impl Fn(u32) -> [f64; 3]) -> [f64; 3] {
        let corners = vertex.corners.map(position);
        let weights = vertex.weights.map(f64::from);
        [0, 1, 2].map(|axis| {
            let sum: f64 = (0..3).map(|i| weights[i] * corners[i][axis]).sum();
            sum / self.denominator
        })
    }
}

/// Numbers fine vertices by what they are made of, so that neighbours find each other's.
struct Builder {
    numbers: HashMap<[(u32, u32); 3], u32>,
    vertices: Vec<FineVertex>,
    triangles: Vec<[u32; 3]>,
}

impl Builder {
    /// Cuts one triangle into `segments` squared; `make` turns weights that add up to `segments` into a vertex.
    fn grid(&mut self, segments: u32, make: impl Fn([u32; 3]) -> FineVertex) {
        let at = |i: u32, j: u32| make([segments - i - j, i, j]);
        for j in 0..segments {
            for i in 0..segments - j {
                let up = [at(i, j), at(i + 1, j), at(i, j + 1)].map(|vertex| self.number(vertex));
                self.triangles.push(up);
                if i + j + 1 < segments {
                    let down =
                        [at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)].map(|vertex| self.number(vertex));
                    self.triangles.push(down);
                }
            }
        }
    }

    fn number(&mut self, vertex: FineVertex) -> u32 {
        let mut key = [0, 1, 2].map(|i| (vertex.corners[i], vertex.weights[i]));
        for part in &mut key {
            if part.1 == 0 {
                *part = (u32::MAX, 0);
            }
        }
        key.sort_unstable();
        let Builder { numbers, vertices, .. } = self;
        *numbers.entry(key).or_insert_with(|| {
            vertices.push(vertex);
            (vertices.len() - 1) as u32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_that_can_and_cannot_be_had() {
        for count in [1, 3, 4, 9, 12, 16, 27, 48, 768] {
            assert_eq!(Tessellation::new(count).unwrap().triangles_per_face(), count);
        }
        for count in [0, 2, 5, 6, 47, 49 * 2, u32::MAX] {
            assert!(Tessellation::new(count).is_err(), "{count}");
        }
        assert_eq!(Tessellation::new(48).unwrap(), Tessellation::STANDARD);
    }

    #[test]
    fn neighbours_share_the_vertices_of_their_edge() {
        let quad = [[0, 1, 2], [0, 2, 3]];
        // Euler: a disk of F triangles whose border has B edges has (F + B) / 2 + 1 vertices.
        for (count, border) in [(1, 4), (4, 8), (48, 16), (75, 20)] {
            let pattern = Pattern::new(&quad, Tessellation::new(count).unwrap());
            assert_eq!(pattern.triangles.len(), 2 * count as usize);
            assert_eq!(pattern.vertex_count(), (2 * count as usize + border) / 2 + 1);
        }
    }
}
