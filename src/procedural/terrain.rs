//! A seeded height field.

use super::random::Random;
use super::shape::{Shape, plain_material};
use crate::error::CompileError;
use crate::import::{MeshSink, VertexBatch};
use crate::units::MaterialId;

/// A landscape over the square -1 ..= 1 with heights along z of at most a quarter, in f32: `cells` x `cells`
/// squares of two triangles each, sent row by row (memory holds one row). Material 0 is plain grey.
#[derive(Clone, Copy, Debug)]
pub struct Terrain {
    cells: u32,
    seed: u64,
}

/// Levels of value noise, each at twice the frequency and half the height of the one before.
const OCTAVES: u32 = 7;

impl Terrain {
    /// The landscape of `seed`; the same seed gives the same landscape at any number of cells.
    ///
    /// # Errors
    /// [`CompileError::Limit`] if `cells` is 0 or above 65,534 (vertices are numbered with 32 bits).
    pub fn new(cells: u32, seed: u64) -> Result<Terrain, CompileError> {
        if cells == 0 || cells > 65_534 {
            return Err(CompileError::Limit {
                reason: format!("a terrain of {cells} cells per edge cannot be made: choose 1 to 65,534"),
            });
        }
        Ok(Terrain { cells, seed })
    }

    fn height(&self, x: f64, y: f64) -> f64 {
        let mut sum = 0.0;
        for octave in 0..OCTAVES {
            let frequency = f64::from(2u32 << octave);
            sum +=
                self.noise(octave, frequency * (x + 1.0), frequency * (y + 1.0)) / f64::from(1u32 << octave);
        }
        // The octaves add up to less than 2.
        sum / 8.0
    }

    /// Value noise in -1 ..= 1: random heights on the integer grid with a smooth blend between.
    fn noise(&self, octave: u32, x: f64, y: f64) -> f64 {
        let at = |i: f64, j: f64| {
            let place = (i as u64) << 32 | j as u64;
            let mut random = Random::new(self.seed ^ (u64::from(octave) << 56) ^ place);
            random.signed()
        };
        let blend = |a: f64, b: f64, t: f64| a + (b - a) * (t * t * (3.0 - 2.0 * t));
        let (i, j) = (x.floor(), y.floor());
        let low = blend(at(i, j), at(i + 1.0, j), x - i);
        let high = blend(at(i, j + 1.0), at(i + 1.0, j + 1.0), x - i);
        blend(low, high, y - j)
    }
}

impl Shape for Terrain {
    fn vertex_count(&self) -> u64 {
        u64::from(self.cells + 1).pow(2)
    }

    fn triangle_count(&self) -> u64 {
        2 * u64::from(self.cells).pow(2)
    }

    fn emit(&self, sink: &mut dyn MeshSink) -> Result<(), CompileError> {
        sink.material(plain_material())?;
        let width = self.cells + 1;
        let along = |k: u32| 2.0 * f64::from(k) / f64::from(self.cells) - 1.0;
        let mut vertices = Vec::with_capacity(width as usize);
        let mut triangles = Vec::with_capacity(2 * self.cells as usize);
        for j in 0..width {
            vertices.clear();
            vertices.extend((0..width).map(|i| {
                let (x, y) = (along(i), along(j));
                [x, y, self.height(x, y)].map(|x| x as f32)
            }));
            sink.vertices(VertexBatch::Float32(&vertices))?;
            let Some(below) = j.checked_sub(1) else { continue };
            triangles.clear();
            for i in 0..self.cells {
                let [a, b] = [below * width + i, below * width + i + 1];
                let [c, d] = [a + width, b + width];
                triangles.extend([[a, b, d], [a, d, c]]);
            }
            sink.triangles(&triangles, MaterialId(0))?;
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
    fn counts_border_heights_and_determinism() {
        let make = |cells, seed| {
            let mut mesh = MeshBuffer::new();
            Terrain::new(cells, seed).unwrap().emit(&mut mesh).unwrap();
            mesh
        };
        let mesh = make(33, 7);
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (34 * 34, 2 * 33 * 33));
        assert_eq!(open_edges(&mesh.triangles), 4 * 33);
        assert!(mesh.vertices.iter().all(|v| v[2].abs() <= 0.25));
        let spread = mesh.vertices.iter().map(|v| v[2]).fold(f64::MIN, f64::max);
        assert!(spread > 0.02, "{spread}");
        assert!(mesh == make(33, 7));
        assert!(mesh != make(33, 8));
        assert!(Terrain::new(0, 1).is_err() && Terrain::new(65_535, 1).is_err());
    }
}
