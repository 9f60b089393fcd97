//! Vertices in the form in which the file will hold them, looked up in whatever form they are kept.
//!
//! All choices are made once per batch of triangles and not per vertex: [`VertexStore::serve`] picks the code for one kind of
//! store and one form.

use bytemuck::Pod;

use super::pages::{Pages, ResidentPages};
use super::point::{OUTSIDE, Point};
use super::vertices::VertexStore;
use crate::error::CompileError;
use crate::geom::Lattice;

/// What is wrong with a triangle that the file cannot hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// A coordinate is NaN or infinite.
    NotFinite,
    /// The chosen precision cannot hold it.
    OutOfRange,
}

/// Looks vertices up.
pub(super) trait Lookup {
    /// `[f32; 3]` or `[i64; 3]`.
    type Point: Point;

    /// The vertex, or a point that is not valid if the vertex is not finite or out of range.
    fn get(&mut self, vertex: u32) -> Result<Self::Point, CompileError>;

    /// [`Lookup::get`] for the corners of a triangle.
    #[inline(always)]
    fn get_three(&mut self, [a, b, c]: [u32; 3]) -> Result<[Self::Point; 3], CompileError> {
        Ok([self.get(a)?, self.get(b)?, self.get(c)?])
    }

    /// What is wrong with a triangle that has a point that is not valid.
    fn fault(&mut self, triangle: [u32; 3]) -> Result<Fault, CompileError>;
}

/// Something to be done with a lookup of any kind.
pub(super) trait Work<P: Point> {
    type Output;
    fn run<L: Lookup<Point = P>>(self, lookup: &mut L) -> Self::Output;
}

/// How the file will hold vertices.
pub(super) trait Form: Copy + Send + 'static {
    type Point: Point;
    /// Whether it is made of the exact vertex where that is kept beside a rounded one.
    const FROM_EXACT: bool;
    fn form<V: Vertex>(&self, vertex: V) -> Self::Point;
}

/// In f32, as they came or rounded.
#[derive(Clone, Copy, Debug)]
pub(super) struct AsFloat32;

impl Form for AsFloat32 {
    type Point = [f32; 3];
    const FROM_EXACT: bool = false;

    #[inline]
    fn form<V: Vertex>(&self, vertex: V) -> [f32; 3] {
        vertex.narrow()
    }
}

/// On a lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct AsLattice {
    lattice: Lattice,
    scale: f64,
}

impl AsLattice {
    pub(super) fn new(lattice: Lattice) -> AsLattice {
        AsLattice { lattice, scale: 1.0 / lattice.step() }
    }

    /// [`Lattice::quantize`], with `OUTSIDE` for `None`.
    #[inline]
    fn quantize(&self, x: f64) -> i64 {
        // In this range sums with the constant have a unit in the last place of 1, so they round as wanted: ties to even.
        // Scaling by a power of two is exact unless it underflows, and then the result is 0 all the same.
        const UNIT_ULP: f64 = (3_u64 << 51) as f64;
        let scaled = x * self.scale;
        if scaled.abs() < (1_u64 << 51) as f64 {
            return ((scaled + UNIT_ULP) - UNIT_ULP) as i64;
        }
        self.lattice.quantize(x).unwrap_or(OUTSIDE)
    }
}

impl Form for AsLattice {
    type Point = [i64; 3];
    const FROM_EXACT: bool = true;

    #[inline]
    fn form<V: Vertex>(&self, vertex: V) -> [i64; 3] {
        let [x, y, z] = vertex.wide();
        [self.quantize(x), self.quantize(y), self.quantize(z)]
    }
}

/// A vertex as it is kept.
pub(super) trait Vertex: Pod {
    /// In f32, rounded if need be.
    fn narrow(self) -> [f32; 3];
    /// As it is.
    fn wide(self) -> [f64; 3];
    /// Whether the source had it finite.
    fn is_finite(self) -> bool;
}

impl Vertex for [f32; 3] {
    #[inline]
    fn narrow(self) -> [f32; 3] {
        self
    }

    #[inline]
    fn wide(self) -> [f64; 3] {
        [f64::from(self[0]), f64::from(self[1]), f64::from(self[2])]
    }

    fn is_finite(self) -> bool {
        self.iter().all(|x| x.is_finite())
    }
}

/// Rounded, with the distance of the move.
impl Vertex for [f32; 4] {
    #[inline]
    fn narrow(self) -> [f32; 3] {
        [self[0], self[1], self[2]]
    }

    #[inline]
    fn wide(self) -> [f64; 3] {
        self.narrow().wide()
    }

    fn is_finite(self) -> bool {
        !self[3].is_nan()
    }
}

impl Vertex for [f64; 3] {
    #[inline]
    fn narrow(self) -> [f32; 3] {
        [self[0] as f32, self[1] as f32, self[2] as f32]
    }

    #[inline]
    fn wide(self) -> [f64; 3] {
        self
    }

    fn is_finite(self) -> bool {
        self.iter().all(|x| x.is_finite())
    }
}

/// Pages that may have to be fetched.
struct Fetching<'a, T, F>(&'a mut Pages<T>, &'a F);

impl<T: Vertex, F: Form> Lookup for Fetching<'_, T, F> {
    type Point = F::Point;

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<F::Point, CompileError> {
        Ok(self.1.form(self.0.get(vertex)?))
    }

    fn fault(&mut self, triangle: [u32; 3]) -> Result<Fault, CompileError> {
        for vertex in triangle {
            if !self.0.get(vertex)?.is_finite() {
                return Ok(Fault::NotFinite);
            }
        }
        Ok(Fault::OutOfRange)
    }
}

/// Pages that are all in memory.
struct Resident<'a, T, F>(ResidentPages<'a, T>, &'a F);

impl<T: Vertex, F: Form> Lookup for Resident<'_, T, F> {
    type Point = F::Point;

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<F::Point, CompileError> {
        Ok(self.1.form(self.0.get(vertex)))
    }

    #[inline(always)]
    fn get_three(&mut self, triangle: [u32; 3]) -> Result<[F::Point; 3], CompileError> {
        let [a, b, c] = self.0.get_three(triangle);
        Ok([self.1.form(a), self.1.form(b), self.1.form(c)])
    }

    fn fault(&mut self, triangle: [u32; 3]) -> Result<Fault, CompileError> {
        let is_finite = triangle.iter().all(|vertex| self.0.get(*vertex).is_finite());
        Ok(if is_finite { Fault::OutOfRange } else { Fault::NotFinite })
    }
}

impl VertexStore {
    /// Does `work` with a lookup in this store.
    pub(super) fn serve<F: Form, W: Work<F::Point>>(&mut self, form: &F, work: W) -> W::Output {
        if self.is_resident() {
            return self.serve_resident(form, work);
        }
        match self {
            VertexStore::Float32 { pages, .. } => work.run(&mut Fetching(pages, form)),
            VertexStore::Rounded { exact: Some(exact), .. } if F::FROM_EXACT => {
                work.run(&mut Fetching(exact, form))
            }
            VertexStore::Rounded { rounded, .. } => work.run(&mut Fetching(rounded, form)),
            VertexStore::Exact(pages) => work.run(&mut Fetching(pages, form)),
        }
    }

    /// The same for a store that is resident, which several threads may read at once.
    pub(super) fn serve_resident<F: Form, W: Work<F::Point>>(&self, form: &F, work: W) -> W::Output {
        match self {
            VertexStore::Float32 { pages, .. } => work.run(&mut Resident(pages.resident(), form)),
            VertexStore::Rounded { exact: Some(exact), .. } if F::FROM_EXACT => {
                work.run(&mut Resident(exact.resident(), form))
            }
            VertexStore::Rounded { rounded, .. } => work.run(&mut Resident(rounded.resident(), form)),
            VertexStore::Exact(pages) => work.run(&mut Resident(pages.resident(), form)),
        }
    }
}
