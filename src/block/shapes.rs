//! Connectivity as one byte per triangle, its *shape*: where each corner comes from.
//!
//! A corner is the next new vertex (source 0), corner 0, 1 or 2 of the triangle before (sources 1 to 3), or a vertex met
//! earlier (source 4) whose distance below the number of vertices met so far is in a list of its own. The shape is the
//! three sources as a number in base 5. Meshes that were written row by row repeat their shapes, so that they compress to
//! almost nothing, and a new vertex across an edge of the triangle before gets a good prediction for free.

use super::Fault;
use crate::error::EncodeError;

const NEW: u8 = 0;
const NAMED: u8 = 4;
const SOURCES: u8 = 5;
const SHAPE_COUNT: usize = 125;

/// A distance byte of 255: the distance is in the list of far distances.
const FAR: u16 = 255;

/// Vertices of the triangle before as 16-bit lanes 0 to 2; lane 3 is zero.
type Lanes = u64;

const fn lanes(triangle: [u16; 3]) -> Lanes {
    triangle[0] as u64 | (triangle[1] as u64) << 16 | (triangle[2] as u64) << 32
}

/// How a new vertex is predicted: lanes 0 to 2 are the triangle before the one that brings the vertex; lane 3 is 0 for
/// "by the vertex before", or 1 to 3 for the lane that lies opposite the shared edge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Parents(u64);

impl Parents {
    /// The two ends of the shared edge and the vertex opposite, or `None`.
    #[inline(always)]
    pub fn parallelogram(self) -> Option<[usize; 3]> {
        let lane = |index: u64| usize::from((self.0 >> (16 * index)) as u16);
        match self.0 >> 48 {
            0 => None,
            1 => Some([lane(1), lane(2), lane(0)]),
            2 => Some([lane(0), lane(2), lane(1)]),
            _ => Some([lane(0), lane(1), lane(2)]),
        }
    }
}

/// What a shape says, in a form that needs no branch: masks and numbers over the lanes of a triangle, so that three
/// corners are found at once in one 64-bit word.
#[derive(Clone, Copy)]
struct Shape {
    /// Which lanes take the corner of the triangle before that lies 0, 1 or 2 lanes further on (in a circle of three).
    turned: [Lanes; 3],
    /// Which lanes take the distance that lies 0, 1 or 2 lanes before.
    moved: [Lanes; 3],
    /// Which lanes count down from the number of vertices met: new and named corners.
    relative: Lanes,
    /// New vertices before each corner.
    new_before: Lanes,
    /// New vertices in the triangle, in every lane.
    new: Lanes,
    /// Lane 3 of the [`Parents`] of its first new vertex.
    opposite: Lanes,
    named_count: usize,
}

const ALL_LANES: Lanes = lanes([1; 3]);

static SHAPES: [Shape; SHAPE_COUNT] = {
    let empty = Shape {
        turned: [0; 3],
        moved: [0; 3],
        relative: 0,
        new_before: 0,
        new: 0,
        opposite: 0,
        named_count: 0,
    };
    let mut shapes = [empty; SHAPE_COUNT];
    let mut code = 0;
    while code < SHAPE_COUNT {
        let sources = [(code / 25) as u8, (code / 5 % 5) as u8, (code % 5) as u8];
        let shape = &mut shapes[code];
        let mut corner = 0;
        while corner < 3 {
            let source = sources[corner];
            let lane = 0xffff << (16 * corner);
            shape.new_before |= (shape.new & 0xffff) << (16 * corner);
            match source {
                NEW => {
                    shape.relative |= lane;
                    shape.new += ALL_LANES;
                }
                NAMED => {
                    shape.relative |= lane;
                    shape.moved[corner - shape.named_count] |= lane;
                    shape.named_count += 1;
                }
                _ => shape.turned[(source as usize - 1 + 3 - corner) % 3] |= lane,
            }
            // One new vertex across the edge between two other corners of the triangle before: 1 + 2 + 3 = 6.
            let (a, b) = (sources[(corner + 1) % 3], sources[(corner + 2) % 3]);
            let shared = a != b && a != NEW && a != NAMED && b != NEW && b != NAMED;
            if source == NEW && shared {
                shape.opposite = (6 - a - b) as Lanes;
            }
            corner += 1;
        }
        code += 1;
    }
    shapes
};

/// The streams of the connectivity, and what they say about the vertices.
#[derive(Default)]
pub(super) struct Connectivity {
    /// A byte for each triangle.
    pub shapes: Vec<u8>,
    /// A byte for each named corner: distance less one, or [`FAR`].
    pub named: Vec<u8>,
    /// Distances less one that do not fit.
    pub far: Vec<u16>,
    /// How each vertex is predicted.
    pub parents: Vec<Parents>,
    /// How many of them by parallelogram.
    pub predicted: usize,
}

impl Connectivity {
    /// Takes in the triangles of one block.
    ///
    /// # Errors
    /// A vertex is used before one with a lower index, or not at all.
    pub fn encode(&mut self, triangles: &[[u16; 3]], vertex_count: usize) -> Result<(), EncodeError> {
        let Connectivity { shapes, named, far, parents, predicted } = self;
        shapes.resize(triangles.len(), 0);
        far.clear();
        parents.clear();
        // One more, for triangles behind the last new vertex.
        parents.resize(vertex_count + 1, Parents::default());
        *predicted = 0;
        named.clear();
        named.reserve(3 * triangles.len());
        let mut before = [0; 3];
        let mut met = 0u32;
        let mut in_order = true;
        for (shape, triangle) in shapes.iter_mut().zip(triangles) {
            let met_before = met as usize;
            let mut code = 0;
            for &index in triangle {
                let source = if u32::from(index) == met {
                    met += 1;
                    NEW
                } else if index == before[0] {
                    1
                } else if index == before[1] {
                    2
                } else if index == before[2] {
                    3
                } else {
                    // Wraps to a large number if the vertex is not in first-use order.
                    let distance = met.wrapping_sub(u32::from(index) + 1);
                    named.push(distance.min(FAR.into()) as u8);
                    if distance >= u32::from(FAR) {
                        in_order &= distance <= u32::from(u16::MAX);
                        far.push(distance as u16);
                    }
                    NAMED
                };
                code = code * SOURCES + source;
            }
            *shape = code;
            let opposite = SHAPES[usize::from(code)].opposite;
            if opposite != 0 {
                match parents.get_mut(met_before) {
                    Some(parents) => *parents = Parents(lanes(before) | opposite << 48),
                    None => in_order = false,
                }
                *predicted += 1;
            }
            before = *triangle;
        }
        if !in_order {
            return Err(NOT_IN_ORDER);
        }
        if met as usize != vertex_count {
            return Err(NOT_IN_ORDER);
        }
        parents.truncate(vertex_count);
        Ok(())
    }
}

const NOT_IN_ORDER: EncodeError = EncodeError::Invalid("its vertices are not in first-use order");

/// Distances are read four at a time.
pub(super) const DISTANCES_SLACK: usize = 4;

/// Turns the bytes of the named corners and the far distances (all low bytes, then all high bytes) into distances of
/// at most `vertex_count`. `distances` has room for [`DISTANCES_SLACK`] more, which are set to zero.
fn expand(named: &[u8], far: &[u8], vertex_count: u16, distances: &mut [u16]) -> Result<(), Fault> {
    let (places, slack) = distances.split_at_mut(named.len());
    slack[..DISTANCES_SLACK].fill(0);
    let mut largest = 0;
    for (distance, byte) in places.iter_mut().zip(named) {
        *distance = u16::from(*byte) + 1;
        largest = largest.max(*byte);
    }
    let mut far_count = 0;
    if u16::from(largest) == FAR {
        let (low, high) = far.split_at(far.len() / 2);
        let mut far = low.iter().zip(high).map(|(low, high)| u16::from_le_bytes([*low, *high]));
        for (at, distance) in places.iter_mut().enumerate().filter(|(_, distance)| **distance == FAR + 1) {
            let less_one = far.next().ok_or(Fault(at, "a far distance is missing"))?;
            if less_one >= vertex_count {
                return Err(Fault(at, "a distance is out of range"));
            }
            *distance = less_one + 1;
            far_count += 1;
        }
    }
    if 2 * far_count == far.len() { Ok(()) } else { Err(Fault(named.len(), "a far distance is left over")) }
}

/// The input of [`decode`].
pub(super) struct Streams<'a> {
    pub shapes: &'a [u8],
    pub named: &'a [u8],
    pub far: &'a [u8],
}

/// Fills `triangles` (one for each shape) and `parents` (one for each vertex, and one more). Every index is in range,
/// and every vertex of a parallelogram lies before the vertex that it predicts.
///
/// `distances` is scratch for `3 * shapes + DISTANCES_SLACK` numbers. There are fewer than 32,000 vertices. Errors carry
/// offsets into the shapes.
pub(super) fn decode(
    streams: &Streams<'_>,
    predicted: usize,
    distances: &mut [u16],
    triangles: &mut [[u16; 3]],
    parents: &mut [Parents],
) -> Result<(), Fault> {
    // Keeps a distance that is larger than it can be from borrowing from the next lane, and shows it afterwards. Indices
    // and distances are far below the sign bit.
    const SIGNS: Lanes = ALL_LANES << 15;
    let vertex_count = parents.len() - 1;
    expand(streams.named, streams.far, vertex_count as u16, distances)?;
    parents.fill(Parents::default());
    let mut before: Lanes = 0;
    let mut met = SIGNS;
    let (mut named, mut hits) = (0, 0);
    let mut negative = 0;
    for (triangle, code) in triangles.iter_mut().zip(streams.shapes) {
        let Some(shape) = SHAPES.get(usize::from(*code)) else {
            return Err(Fault(0, "a triangle has an unknown shape"));
        };
        // At most three named corners for each triangle: inside the scratch.
        let Some(&[a, b, c, _]) = distances[named..].first_chunk::<DISTANCES_SLACK>() else {
            return Err(Fault(0, "its triangles do not use what its header counts"));
        };
        let distances = lanes([a, b, c]);
        let distance = (distances & shape.moved[0])
            | (distances << 16 & shape.moved[1])
            | (distances << 32 & shape.moved[2]);
        let relative = met + shape.new_before - distance;
        negative |= !relative & shape.relative;
        let kept = (before & shape.turned[0])
            | ((before >> 16 | before << 32) & shape.turned[1])
            | ((before >> 32 | before << 16) & shape.turned[2]);
        let after = kept | (relative & shape.relative & !SIGNS);

        // Triangles without a new vertex write too; the next one writes over it.
        let parent = parents.get_mut((met & 0x7fff) as usize);
        *parent.ok_or(Fault(0, "it uses more vertices than it has"))? =
            Parents(before | shape.opposite << 48);
        hits += usize::from(shape.opposite != 0);
        met += shape.new;
        named += shape.named_count;
        *triangle = [after as u16, (after >> 16) as u16, (after >> 32) as u16];
        before = after;
    }
    if negative & SIGNS != 0 {
        Err(Fault(0, "an index is out of range"))
    } else if parents[0].parallelogram().is_some() {
        // The corners that it would be predicted from are itself: what was decoded before would show.
        Err(Fault(0, "its first vertex is predicted"))
    } else if (met & 0x7fff) as usize != vertex_count || named != streams.named.len() || hits != predicted {
        Err(Fault(0, "its triangles do not use what its header counts"))
    } else {
        Ok(())
    }
}
