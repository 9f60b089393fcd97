//! The vertices of the source, in their own precision, within the budget.

use super::pages::Pages;
use super::spill::SpillPlace;
use crate::error::CompileError;
use crate::geom::Lattice;
use crate::import::VertexBatch;

/// Vertices as they came.
#[derive(Debug)]
pub(super) enum VertexStore {
    /// Every vertex came as f32.
    Float32(Pages<[f32; 3]>),
    /// Some came as f64.
    Float64 {
        /// Rounded to f32, and how far that moved the vertex (rounded up), so that the choice of precision and a `Float32` file need only this half.
        rounded: Pages<[f32; 4]>,
        /// As they came. Only read if the choice falls on a lattice.
        exact: Pages<[f64; 3]>,
        /// Largest finite move.
        move_max: f32,
    },
}

impl VertexStore {
    pub(super) fn new(place: SpillPlace, headroom: u64) -> VertexStore {
        VertexStore::Float32(Pages::new(place, headroom))
    }

    pub(super) fn len(&self) -> usize {
        match self {
            VertexStore::Float32(pages) => pages.len(),
            VertexStore::Float64 { rounded, .. } => rounded.len(),
        }
    }

    /// No vertex is moved further by rounding to f32 (those that f32 cannot hold aside).
    pub(super) fn move_max(&self) -> f64 {
        match self {
            VertexStore::Float32(_) => 0.0,
            VertexStore::Float64 { move_max, .. } => f64::from(*move_max),
        }
    }

    pub(super) fn spill_bytes(&self) -> u64 {
        match self {
            VertexStore::Float32(pages) => pages.spill_bytes(),
            VertexStore::Float64 { rounded, exact, .. } => rounded.spill_bytes() + exact.spill_bytes(),
        }
    }

    pub(super) fn extend(
        &mut self,
        batch: VertexBatch<'_>,
        place: &SpillPlace,
        headroom: u64,
    ) -> Result<(), CompileError> {
        if let (VertexStore::Float32(narrow), VertexBatch::Float64(_)) = (&mut *self, batch) {
            // The f64 half goes first to the spill when memory runs short: it leaves room for a rounded half of the same length.
            let mut rounded = Pages::new(place.clone(), headroom);
            let mut exact = Pages::new(place.clone(), headroom);
            for index in 0..narrow.len() as u32 {
                let vertex = narrow.get(index)?;
                rounded.extend(&[vertex], |[x, y, z]| [x, y, z, 0.0])?;
                exact.extend(&[vertex], |vertex| vertex.map(f64::from))?;
            }
            *self = VertexStore::Float64 { rounded, exact, move_max: 0.0 };
        }
        match (self, batch) {
            (VertexStore::Float32(pages), VertexBatch::Float32(items)) => {
                pages.extend(items, |vertex| vertex)
            }
            (VertexStore::Float64 { rounded, exact, .. }, VertexBatch::Float32(items)) => {
                rounded.extend(items, |[x, y, z]| [x, y, z, 0.0])?;
                exact.extend(items, |vertex| vertex.map(f64::from))
            }
            (VertexStore::Float64 { rounded, exact, move_max }, VertexBatch::Float64(items)) => {
                rounded.extend(items, |vertex| {
                    let rounded = round(vertex);
                    if rounded[3] > *move_max && rounded[3].is_finite() {
                        *move_max = rounded[3];
                    }
                    rounded
                })?;
                exact.extend(items, |vertex| vertex)
            }
            (VertexStore::Float32(_), VertexBatch::Float64(_)) => {
                unreachable!("the store was widened above")
            }
        }
    }

    /// The exact position of a vertex below `len`.
    pub(super) fn position(&mut self, vertex: u32) -> Result<[f64; 3], CompileError> {
        match self {
            VertexStore::Float32(pages) => Ok(pages.get(vertex)?.map(f64::from)),
            VertexStore::Float64 { exact, .. } => exact.get(vertex),
        }
    }
}

/// A vertex in f32, and an upper bound of the distance that rounding moved it (infinite if f32 cannot hold it).
fn round(vertex: [f64; 3]) -> [f32; 4] {
    let [x, y, z] = vertex.map(|x| x as f32);
    let rounded = [x, y, z];
    let square: f64 = (0..3).map(|axis| (vertex[axis] - f64::from(rounded[axis])).powi(2)).sum();
    // The relative error of the sum, the root and the rounding to f32 is far below 2^-22.
    let moved = (square.sqrt() * (1.0 + f64::from(f32::EPSILON))) as f32;
    // A square that underflows belongs to a move below 1e-154, which an f32 shows as its least step.
    let moved = if moved == 0.0 && vertex != rounded.map(f64::from) { f32::MIN_POSITIVE } else { moved };
    [x, y, z, if moved.is_nan() { f32::INFINITY } else { moved }]
}

/// Looks vertices up in the form in which the file will hold them.
pub(super) trait Lookup {
    /// `[f32; 3]` or `[i64; 3]`.
    type Point: super::point::Point;

    /// The vertex, or a point that is not valid if the vertex is not finite or out of range.
    fn get(&mut self, vertex: u32) -> Result<Self::Point, CompileError>;
}

/// f32 vertices as they are.
pub(super) struct Narrow<'a>(pub(super) &'a mut Pages<[f32; 3]>);

impl Lookup for Narrow<'_> {
    type Point = [f32; 3];

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<[f32; 3], CompileError> {
        self.0.get(vertex)
    }
}

/// f64 vertices rounded to f32.
pub(super) struct Rounded<'a>(pub(super) &'a mut Pages<[f32; 4]>);

impl Lookup for Rounded<'_> {
    type Point = [f32; 3];

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<[f32; 3], CompileError> {
        let [x, y, z, _] = self.0.get(vertex)?;
        Ok([x, y, z])
    }
}

/// Exact vertices put on a lattice.
pub(super) struct OnLattice<'a> {
    pub(super) store: &'a mut VertexStore,
    pub(super) lattice: Lattice,
}

impl Lookup for OnLattice<'_> {
    type Point = [i64; 3];

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<[i64; 3], CompileError> {
        let position = self.store.position(vertex)?;
        Ok(position.map(|x| self.lattice.quantize(x).unwrap_or(super::point::OUTSIDE)))
    }
}
