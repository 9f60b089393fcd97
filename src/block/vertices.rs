//! Vertex filters: differences from a predicted vertex per axis, zigzag, byte planes of the least width.
//!
//! `Float32` vertices are treated as their bits, so the filter is lossless for every float. Lattice vertices are
//! offsets from the block's least coordinate per axis; a block of 2^24 steps and more, or whose offsets are not
//! normal f32 numbers, is *wide* and goes through 64-bit arithmetic.

use super::Fault;
use super::header::{Header, Layout};
use super::planes::{gather, merge, split, unzigzag, unzigzag_wide, width_of, zigzag, zigzag_wide};
use crate::geom::Lattice;

/// Offsets below this many steps are exact in f32.
const NARROW_MAX: u64 = 1 << 24;

/// The exponents for which every offset below [`NARROW_MAX`] is zero or a normal f32.
fn has_narrow(lattice: Lattice) -> bool {
    (-126..=103).contains(&lattice.exponent)
}

/// Whether a block of these lattice vertices would be wide: decoded to f64 and counted with 24 bytes per vertex.
pub fn is_wide(lattice: Lattice, vertices: &[[i64; 3]]) -> bool {
    !has_narrow(lattice)
        || (0..3).any(|axis| {
            let (min, max) = range(vertices, axis);
            max.wrapping_sub(min) as u64 >= NARROW_MAX
        })
}

fn range(vertices: &[[i64; 3]], axis: usize) -> (i64, i64) {
    vertices
        .iter()
        .fold((i64::MAX, i64::MIN), |(min, max), vertex| (min.min(vertex[axis]), max.max(vertex[axis])))
}

/// What the encoder found out about the vertices, for the header.
pub(super) struct Encoded {
    pub widths: [u8; 3],
    pub base: [u64; 3],
}

/// Appends the planes of `Float32` vertices (at least one, all finite).
pub(super) fn encode_floats(vertices: &[[f32; 3]], column: &mut Vec<u32>, out: &mut Vec<u8>) -> Encoded {
    let base = vertices[0].map(|x| u64::from(x.to_bits()));
    let mut widths = [0; 3];
    for axis in 0..3 {
        let values = vertices.iter().map(|vertex| vertex[axis].to_bits());
        widths[axis] = encode_axis(values, base[axis] as u32, column, out);
    }
    Encoded { widths, base }
}

/// Appends the planes of narrow lattice vertices (at least one).
pub(super) fn encode_lattice(vertices: &[[i64; 3]], column: &mut Vec<u32>, out: &mut Vec<u8>) -> Encoded {
    let mut widths = [0; 3];
    let mut base = [0; 3];
    for axis in 0..3 {
        let (min, _) = range(vertices, axis);
        let values = vertices.iter().map(|vertex| (vertex[axis] - min) as u32);
        widths[axis] = encode_axis(values, 0, column, out);
        base[axis] = min as u64;
    }
    Encoded { widths, base }
}

fn encode_axis(
    values: impl Iterator<Item = u32>,
    first: u32,
    column: &mut Vec<u32>,
    out: &mut Vec<u8>,
) -> u8 {
    let mut before = first;
    let mut bits = 0;
    column.clear();
    column.extend(values.map(|value| {
        let code = zigzag(value.wrapping_sub(before));
        before = value;
        bits |= code;
        code
    }));
    let width = width_of(u64::from(bits));
    split(column, width, out);
    width
}

/// Appends the planes of wide lattice vertices (at least one).
pub(super) fn encode_wide(vertices: &[[i64; 3]], out: &mut Vec<u8>) -> Encoded {
    let mut widths = [0; 3];
    let mut base = [0; 3];
    for axis in 0..3 {
        let (min, _) = range(vertices, axis);
        let codes = || {
            let mut before = 0;
            vertices.iter().map(move |vertex| {
                let value = vertex[axis].wrapping_sub(min) as u64;
                let code = zigzag_wide(value.wrapping_sub(before));
                before = value;
                code
            })
        };
        let width = width_of(codes().fold(0, |bits, code| bits | code));
        for plane in 0..width {
            out.extend(codes().map(|code| (code >> (8 * plane)) as u8));
        }
        widths[axis] = width;
        base[axis] = min as u64;
    }
    Encoded { widths, base }
}

/// The least coordinate per axis of a lattice block, as positions.
fn lattice_base(header: &Header, lattice: Lattice) -> Result<[f64; 3], Fault> {
    let base = header.base.map(|base| base as i64);
    if base.iter().any(|coordinate| coordinate.unsigned_abs() > Lattice::COORDINATE_MAX as u64) {
        return Err(Fault(0, "its base is outside the lattice"));
    }
    Ok(base.map(|coordinate| lattice.position(coordinate)))
}

/// Puts the differences of one predictor back together and hands every value to `emit(vertex, values)`.
#[inline(always)]
fn sum_up(
    header: &Header,
    layout: &Layout,
    payload: &[u8],
    columns: &mut [u32],
    first: [u32; 3],
    mut emit: impl FnMut(usize, [u32; 3]),
) {
    let count = header.vertex_count;
    let (x, rest) = columns[..3 * count].split_at_mut(count);
    let (y, z) = rest.split_at_mut(count);
    for (axis, column) in [&mut *x, &mut *y, &mut *z].into_iter().enumerate() {
        let width = header.widths[axis];
        merge(&payload[layout.axes[axis]..][..count * usize::from(width)], width, column);
    }
    let mut sum = first;
    for (vertex, ((x, y), z)) in x.iter().zip(y.iter()).zip(z.iter()).enumerate() {
        for (sum, code) in sum.iter_mut().zip([*x, *y, *z]) {
            *sum = sum.wrapping_add(unzigzag(code));
        }
        emit(vertex, sum);
    }
}

/// Fills `vertices` of a `Float32` block.
pub(super) fn decode_floats(
    header: &Header,
    layout: &Layout,
    payload: &[u8],
    columns: &mut [u32],
    vertices: &mut [[f32; 3]],
) -> Result<(), Fault> {
    const EXPONENT: u32 = 0x7f80_0000;
    if header.base.iter().any(|base| *base > u64::from(u32::MAX)) {
        return Err(Fault(0, "its base is not a float"));
    }
    let mut finite = true;
    let first = header.base.map(|base| base as u32);
    sum_up(header, layout, payload, columns, first, |vertex, bits| {
        finite &= bits.iter().all(|bits| bits & EXPONENT != EXPONENT);
        vertices[vertex] = bits.map(f32::from_bits);
    });
    if finite { Ok(()) } else { Err(Fault(0, "a coordinate is not finite")) }
}

/// Fills `vertices` of a narrow lattice block and returns its base.
pub(super) fn decode_lattice(
    header: &Header,
    layout: &Layout,
    payload: &[u8],
    lattice: Lattice,
    columns: &mut [u32],
    vertices: &mut [[f32; 3]],
) -> Result<[f64; 3], Fault> {
    if !has_narrow(lattice) {
        return Err(Fault(0, "its offsets are not exact in f32"));
    }
    let base = lattice_base(header, lattice)?;
    // Exact: a power of two in the normal range of f32.
    let step = lattice.step() as f32;
    let mut bits = 0;
    sum_up(header, layout, payload, columns, [0; 3], |vertex, offsets| {
        bits |= offsets[0] | offsets[1] | offsets[2];
        vertices[vertex] = offsets.map(|offset| offset as i32 as f32 * step);
    });
    // Base and offset together stay within COORDINATE_MAX + 2^24, exact in f64.
    if u64::from(bits) < NARROW_MAX { Ok(base) } else { Err(Fault(0, "an offset is out of range")) }
}

/// Fills `vertices` and `wide` of a wide lattice block and returns its base.
pub(super) fn decode_wide(
    header: &Header,
    layout: &Layout,
    payload: &[u8],
    lattice: Lattice,
    vertices: &mut [[f32; 3]],
    wide: &mut [[f64; 3]],
) -> Result<[f64; 3], Fault> {
    let base = lattice_base(header, lattice)?;
    let count = header.vertex_count;
    for axis in 0..3 {
        let planes = &payload[layout.axes[axis]..][..count * usize::from(header.widths[axis])];
        let mut offset = 0u64;
        for vertex in 0..count {
            let code = gather(planes, header.widths[axis], count, vertex);
            offset = offset.wrapping_add(unzigzag_wide(code));
            let coordinate = (header.base[axis] as i64).wrapping_add(offset as i64);
            if offset > 2 * Lattice::COORDINATE_MAX as u64 || coordinate > Lattice::COORDINATE_MAX {
                return Err(Fault(0, "an offset is out of range"));
            }
            wide[vertex][axis] = lattice.position(coordinate);
            // The offset is below 2^53 and the step a power of two: exact in f64, so rounded once.
            let nearest = (offset as f64 * lattice.step()) as f32;
            vertices[vertex][axis] = nearest.min(f32::MAX);
        }
    }
    Ok(base)
}
