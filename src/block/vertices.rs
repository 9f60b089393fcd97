//! Vertex filter: difference from a predicted position per axis, zigzag, byte planes of the least width.
//!
//! A vertex across an edge of the triangle before is predicted as the fourth corner of a parallelogram, any other as
//! the vertex before it. The two kinds are stored apart: the differences of the first are short on smooth or flat
//! parts, and among the others they would make the high planes look random.
//!
//! `Float32` positions are predicted with f32 arithmetic, and the difference is one of their bits: lossless for every
//! float. Lattice positions are offsets from the block's least coordinate per axis; a block of 2^24 steps and more,
//! or whose offsets are not normal f32 numbers, is *wide* and goes through 64-bit arithmetic.
//!
//! Parallelogram prediction: Touma and Gotsman, "Triangle Mesh Compression", Graphics Interface 1998.

use super::Fault;
use super::header::{Header, Layout};
use super::planes::{gather, merge, split, width_of};
use super::shapes::Parents;
use crate::geom::Lattice;

/// Offsets below this many steps are exact in f32.
const NARROW_MAX: u64 = 1 << 24;

/// The exponents for which every offset below [`NARROW_MAX`] is zero or a normal f32.
fn has_narrow(lattice: Lattice) -> bool {
    (-126..=103).contains(&lattice.exponent)
}

/// Whether a block of these lattice vertices would be wide: decoded to f64 and counted with 24 bytes per vertex.
pub fn is_wide(lattice: Lattice, vertices: &[[i64; 3]]) -> bool {
    let (min, max) = range(vertices);
    !has_narrow(lattice) || (0..3).any(|axis| max[axis].wrapping_sub(min[axis]) as u64 >= NARROW_MAX)
}

fn range(vertices: &[[i64; 3]]) -> ([i64; 3], [i64; 3]) {
    vertices.iter().fold(([i64::MAX; 3], [i64::MIN; 3]), |(min, max), vertex| {
        ([0, 1, 2].map(|axis| min[axis].min(vertex[axis])), [0, 1, 2].map(|axis| max[axis].max(vertex[axis])))
    })
}

/// One coordinate, with the arithmetic in which it is predicted.
trait Coordinate: Copy {
    /// A difference after zigzag: small differences of both signs are small numbers.
    type Code: Copy;

    /// The fourth corner across the edge `a b` from `c`. Any value will do, but always the same one.
    fn parallelogram(a: Self, b: Self, c: Self) -> Self;

    /// The difference between this coordinate and an expected one.
    fn code(self, expected: Self) -> Self::Code;

    /// Undoes [`Coordinate::code`].
    fn decode(code: Self::Code, expected: Self) -> Self;
}

macro_rules! integer_coordinate {
    ($word:ty, $signed:ty) => {
        impl Coordinate for $word {
            type Code = $word;

            #[inline(always)]
            fn parallelogram(a: $word, b: $word, c: $word) -> $word {
                a.wrapping_add(b).wrapping_sub(c)
            }

            #[inline(always)]
            fn code(self, expected: $word) -> $word {
                let difference = self.wrapping_sub(expected);
                (difference << 1) ^ ((difference as $signed) >> (<$signed>::BITS - 1)) as $word
            }

            #[inline(always)]
            fn decode(code: $word, expected: $word) -> $word {
                expected.wrapping_add((code >> 1) ^ (code & 1).wrapping_neg())
            }
        }
    };
}
integer_coordinate!(u32, i32);
integer_coordinate!(u64, i64);

impl Coordinate for f32 {
    type Code = u32;

    #[inline(always)]
    fn parallelogram(a: f32, b: f32, c: f32) -> f32 {
        // From finite coordinates the sum may become infinite but never NaN, whose bits would not be defined. Where
        // damaged bytes make a NaN, the block is refused whatever follows from it.
        (a + b) - c
    }

    #[inline(always)]
    fn code(self, expected: f32) -> u32 {
        self.to_bits().code(expected.to_bits())
    }

    #[inline(always)]
    fn decode(code: u32, expected: f32) -> f32 {
        f32::from_bits(u32::decode(code, expected.to_bits()))
    }
}

/// Hands the differences of all vertices to `put(predicted, codes)` in their order.
#[inline(always)]
fn differences<C: Coordinate>(
    parents: &[Parents],
    first: [C; 3],
    position: impl Fn(usize) -> [C; 3],
    mut put: impl FnMut(bool, [C::Code; 3]),
) {
    let mut before = first;
    for (vertex, parents) in parents.iter().enumerate() {
        let actual = position(vertex);
        let across = parents.parallelogram();
        let expected = match across {
            Some(edge) => {
                let [a, b, c] = edge.map(&position);
                [0, 1, 2].map(|axis| C::parallelogram(a[axis], b[axis], c[axis]))
            }
            None => before,
        };
        put(across.is_some(), [0, 1, 2].map(|axis| actual[axis].code(expected[axis])));
        before = actual;
    }
}

/// Undoes [`differences`]: `codes(index)` has those of the predicted vertices first.
#[inline(always)]
fn positions<C: Coordinate>(
    parents: &[Parents],
    predicted: usize,
    first: [C; 3],
    codes: impl Fn(usize) -> [C::Code; 3],
    vertices: &mut [[C; 3]],
) {
    let (mut next_predicted, mut next_other) = (0, predicted);
    let mut before = first;
    for (vertex, parents) in parents.iter().enumerate() {
        let code;
        let expected = match parents.parallelogram() {
            Some(edge) => {
                code = codes(next_predicted);
                next_predicted += 1;
                let [a, b, c] = edge.map(|parent| vertices[parent]);
                [0, 1, 2].map(|axis| C::parallelogram(a[axis], b[axis], c[axis]))
            }
            None => {
                code = codes(next_other);
                next_other += 1;
                before
            }
        };
        before = [0, 1, 2].map(|axis| C::decode(code[axis], expected[axis]));
        vertices[vertex] = before;
    }
}

/// What the encoder found out about the vertices, for the header.
pub(super) struct Encoded {
    pub widths: [[u8; 3]; 2],
    pub base: [u64; 3],
}

/// Columns of differences, one for each axis: those of the predicted vertices, then those of the others.
#[derive(Default)]
pub(super) struct Columns([Vec<u32>; 3]);

/// Appends the planes of narrow positions. `predicted` of the `parents` are parallelograms.
#[inline(always)]
fn encode_narrow<C: Coordinate<Code = u32>>(
    (parents, predicted): (&[Parents], usize),
    first: [C; 3],
    position: impl Fn(usize) -> [C; 3],
    columns: &mut Columns,
    out: &mut Vec<u8>,
) -> [[u8; 3]; 2] {
    for column in &mut columns.0 {
        column.resize(parents.len(), 0);
    }
    let [x, y, z] = &mut columns.0;
    let (x, y, z) = (&mut x[..parents.len()], &mut y[..parents.len()], &mut z[..parents.len()]);
    let (mut next_predicted, mut next_other) = (0, predicted);
    differences(parents, first, position, |is_predicted, codes| {
        let index = if is_predicted { next_predicted } else { next_other };
        next_predicted += usize::from(is_predicted);
        next_other += usize::from(!is_predicted);
        [x[index], y[index], z[index]] = codes;
    });
    let mut widths = [[0; 3]; 2];
    for (kind, widths) in widths.iter_mut().enumerate() {
        for (column, width) in columns.0.iter().zip(widths) {
            let (predicted, others) = column.split_at(predicted);
            let column = if kind == 0 { predicted } else { others };
            *width = width_of(u64::from(column.iter().fold(0, |bits, code| bits | code)));
            split(column, *width, out);
        }
    }
    widths
}

/// Appends the planes of `Float32` vertices (at least one, all finite).
pub(super) fn encode_floats(
    vertices: &[[f32; 3]],
    parents: (&[Parents], usize),
    columns: &mut Columns,
    out: &mut Vec<u8>,
) -> Encoded {
    let base = vertices[0].map(|x| u64::from(x.to_bits()));
    let widths = encode_narrow(parents, vertices[0], |vertex| vertices[vertex], columns, out);
    Encoded { widths, base }
}

/// Appends the planes of narrow lattice vertices (at least one).
pub(super) fn encode_lattice(
    vertices: &[[i64; 3]],
    parents: (&[Parents], usize),
    columns: &mut Columns,
    out: &mut Vec<u8>,
) -> Encoded {
    let (min, _) = range(vertices);
    let position = |vertex: usize| [0, 1, 2].map(|axis| (vertices[vertex][axis] - min[axis]) as u32);
    let widths = encode_narrow(parents, [0; 3], position, columns, out);
    Encoded { widths, base: min.map(|x| x as u64) }
}

/// Appends the planes of wide lattice vertices (at least one). Rare, so it walks the vertices once for each plane.
pub(super) fn encode_wide(vertices: &[[i64; 3]], parents: &[Parents], out: &mut Vec<u8>) -> Encoded {
    let (min, _) = range(vertices);
    let position =
        |vertex: usize| [0, 1, 2].map(|axis| vertices[vertex][axis].wrapping_sub(min[axis]) as u64);
    let mut used = [[0; 3]; 2];
    differences(parents, [0; 3], position, |is_predicted, codes| {
        for axis in 0..3 {
            used[usize::from(!is_predicted)][axis] |= codes[axis];
        }
    });
    let widths = used.map(|used| used.map(width_of));
    for (kind, widths) in [(true, widths[0]), (false, widths[1])] {
        for (axis, width) in widths.into_iter().enumerate() {
            for plane in 0..width {
                differences(parents, [0; 3], position, |is_predicted, codes| {
                    if is_predicted == kind {
                        out.push((codes[axis] >> (8 * plane)) as u8);
                    }
                });
            }
        }
    }
    Encoded { widths, base: min.map(|x| x as u64) }
}

/// What the decoders share.
pub(super) struct Stored<'a> {
    pub header: &'a Header,
    pub layout: &'a Layout,
    pub payload: &'a [u8],
    pub parents: &'a [Parents],
}

impl Stored<'_> {
    /// Planes of one kind (0 is predicted, 1 is other) and axis, and their width.
    fn planes(&self, kind: usize, axis: usize) -> (&[u8], u8) {
        let width = self.header.widths[kind][axis];
        let length = usize::from(width) * self.header.kind_count(kind);
        (&self.payload[self.layout.planes[kind][axis]..][..length], width)
    }

    /// Fills `vertices` with narrow positions.
    fn positions<C: Coordinate<Code = u32>>(
        &self,
        first: [C; 3],
        columns: &mut [u32],
        vertices: &mut [[C; 3]],
    ) {
        let (count, predicted) = (self.header.vertex_count, self.header.predicted);
        let (x, rest) = columns.split_at_mut(count);
        let (y, z) = rest.split_at_mut(count);
        for (axis, column) in [&mut *x, &mut *y, &mut *z].into_iter().enumerate() {
            for (kind, column) in <[_; 2]>::from(column.split_at_mut(predicted)).into_iter().enumerate() {
                let (planes, width) = self.planes(kind, axis);
                merge(planes, width, column);
            }
        }
        positions(self.parents, predicted, first, |index| [x[index], y[index], z[index]], vertices);
    }

    /// The least coordinate per axis of a lattice block, as positions.
    fn lattice_base(&self, lattice: Lattice) -> Result<[f64; 3], Fault> {
        let base = self.header.base.map(|base| base as i64);
        if base.iter().any(|coordinate| coordinate.unsigned_abs() > Lattice::COORDINATE_MAX as u64) {
            return Err(Fault(0, "its base is outside the lattice"));
        }
        Ok(base.map(|coordinate| lattice.position(coordinate)))
    }

    /// Fills `vertices` of a `Float32` block. `columns` is scratch for three numbers for each vertex.
    pub fn decode_floats(&self, columns: &mut [u32], vertices: &mut [[f32; 3]]) -> Result<(), Fault> {
        if self.header.base.iter().any(|base| *base > u64::from(u32::MAX)) {
            return Err(Fault(0, "its base is not a float"));
        }
        let first = self.header.base.map(|base| f32::from_bits(base as u32));
        self.positions(first, columns, vertices);
        if vertices.as_flattened().iter().fold(true, |finite, x| finite & x.is_finite()) {
            Ok(())
        } else {
            Err(Fault(0, "a coordinate is not finite"))
        }
    }

    /// Fills `vertices` of a narrow lattice block and returns its base. `columns` as for floats.
    pub fn decode_lattice(
        &self,
        lattice: Lattice,
        columns: &mut [u32],
        vertices: &mut [[f32; 3]],
    ) -> Result<[f64; 3], Fault> {
        if !has_narrow(lattice) {
            return Err(Fault(0, "its offsets are not exact in f32"));
        }
        let base = self.lattice_base(lattice)?;
        let words: &mut [[u32; 3]] = bytemuck::cast_slice_mut(vertices);
        self.positions([0; 3], columns, words);
        // Exact: a power of two in the normal range of f32.
        let step = lattice.step() as f32;
        let mut used = 0;
        for word in words.as_flattened_mut() {
            used |= *word;
            *word = (*word as i32 as f32 * step).to_bits();
        }
        // Base and offset together stay within COORDINATE_MAX + 2^24, exact in f64.
        if u64::from(used) < NARROW_MAX { Ok(base) } else { Err(Fault(0, "an offset is out of range")) }
    }

    /// Fills `vertices` and `wide` of a wide lattice block and returns its base.
    pub fn decode_wide(
        &self,
        lattice: Lattice,
        vertices: &mut [[f32; 3]],
        wide: &mut [[f64; 3]],
    ) -> Result<[f64; 3], Fault> {
        let base = self.lattice_base(lattice)?;
        let codes = |index: usize| {
            let (kind, index) = match index.checked_sub(self.header.predicted) {
                None => (0, index),
                Some(other) => (1, other),
            };
            [0, 1, 2].map(|axis| {
                let (planes, width) = self.planes(kind, axis);
                gather(planes, width, self.header.kind_count(kind), index)
            })
        };
        let words: &mut [[u64; 3]] = bytemuck::cast_slice_mut(wide);
        positions(self.parents, self.header.predicted, [0; 3], codes, words);
        for (vertex, words) in vertices.iter_mut().zip(words) {
            for axis in 0..3 {
                let offset = words[axis];
                let coordinate = (self.header.base[axis] as i64).wrapping_add(offset as i64);
                if offset > 2 * Lattice::COORDINATE_MAX as u64 || coordinate > Lattice::COORDINATE_MAX {
                    return Err(Fault(0, "an offset is out of range"));
                }
                // The offset is at most 2^53 and the step a power of two: exact in f64, so rounded once.
                vertex[axis] = ((offset as f64 * lattice.step()) as f32).min(f32::MAX);
                words[axis] = lattice.position(coordinate).to_bits();
            }
        }
        Ok(base)
    }
}
