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

/// What a shape says, in a form that needs no branch: corner = lane + (met - distance), each term under a mask.
#[derive(Clone, Copy)]
struct Shape {
    /// Shift to the lane of each corner; lane 3 (zero) if it is not from the triangle before.
    shift: [u8; 3],
    /// New vertices and named vertices before each corner, and in the whole triangle.
    new_before: [u8; 4],
    named_before: [u8; 4],
    /// All ones where the corner is new or named.
    relative: [u32; 3],
    /// All ones where the corner is named.
    named: [u32; 3],
    /// Lane 3 of the [`Parents`] of its first new vertex.
    opposite: u8,
}

const SHAPES: [Shape; SHAPE_COUNT] = {
    let empty = Shape {
        shift: [48; 3],
        new_before: [0; 4],
        named_before: [0; 4],
        relative: [0; 3],
        named: [0; 3],
        opposite: 0,
    };
    let mut shapes = [empty; SHAPE_COUNT];
    let mut code = 0;
    while code < SHAPE_COUNT {
        let sources = [(code / 25) as u8, (code / 5 % 5) as u8, (code % 5) as u8];
        let shape = &mut shapes[code];
        let mut corner = 0;
        while corner < 3 {
            let source = sources[corner];
            let (new, named) = (source == NEW, source == NAMED);
            shape.new_before[corner + 1] = shape.new_before[corner] + new as u8;
            shape.named_before[corner + 1] = shape.named_before[corner] + named as u8;
            if new || named {
                shape.relative[corner] = u32::MAX;
            } else {
                shape.shift[corner] = 16 * (source - 1);
            }
            if named {
                shape.named[corner] = u32::MAX;
            }
            // One new vertex across the edge between two other corners of the triangle before: 1 + 2 + 3 = 6.
            let (a, b) = (sources[(corner + 1) % 3], sources[(corner + 2) % 3]);
            let shared = a != b && a != NEW && a != NAMED && b != NEW && b != NAMED;
            if new && shared {
                shape.opposite = 6 - a - b;
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
        shapes.clear();
        named.clear();
        far.clear();
        parents.clear();
        parents.resize(vertex_count + 1, Parents::default());
        *predicted = 0;
        let mut before = [0; 3];
        let mut met = 0u32;
        for triangle in triangles {
            let met_before = met;
            let mut code = 0;
            for index in *triangle {
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
                    if distance < u32::from(FAR) {
                        named.push(distance as u8);
                    } else {
                        named.push(FAR as u8);
                        far.push(u16::try_from(distance).map_err(|_| NOT_IN_ORDER)?);
                    }
                    NAMED
                };
                code = code * SOURCES + source;
            }
            shapes.push(code);
            let opposite = SHAPES[usize::from(code)].opposite;
            if opposite != 0 {
                parents[met_before as usize] = Parents(lanes(before) | u64::from(opposite) << 48);
                *predicted += 1;
            }
            before = *triangle;
        }
        if met as usize != vertex_count {
            return Err(NOT_IN_ORDER);
        }
        parents.truncate(vertex_count);
        Ok(())
    }
}

const NOT_IN_ORDER: EncodeError = EncodeError::Invalid("its vertices are not in first-use order");

/// Turns the bytes of the named corners and the far distances (all low bytes, then all high bytes) into distances.
/// `distances` has room for three more, which are set to zero.
fn expand(named: &[u8], far: &[u8], distances: &mut [u16]) -> Result<(), Fault> {
    let (places, slack) = distances.split_at_mut(named.len());
    slack[..3].fill(0);
    for (distance, byte) in places.iter_mut().zip(named) {
        *distance = u16::from(*byte);
    }
    if far.is_empty() && !named.contains(&(FAR as u8)) {
        return Ok(());
    }
    let (low, high) = far.split_at(far.len() / 2);
    let mut far = low.iter().zip(high).map(|(low, high)| u16::from_le_bytes([*low, *high]));
    for (at, distance) in places.iter_mut().enumerate().filter(|(_, distance)| **distance == FAR) {
        *distance = far.next().ok_or(Fault(at, "a far distance is missing"))?;
    }
    if far.next().is_some() { Err(Fault(named.len(), "a far distance is left over")) } else { Ok(()) }
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
/// `distances` is scratch for `3 * shapes + 3` numbers. Errors carry offsets into the shapes.
pub(super) fn decode(
    streams: &Streams<'_>,
    predicted: usize,
    distances: &mut [u16],
    triangles: &mut [[u16; 3]],
    parents: &mut [Parents],
) -> Result<(), Fault> {
    let vertex_count = parents.len() as u32 - 1;
    expand(streams.named, streams.far, distances)?;
    parents.fill(Parents::default());
    let mut before: Lanes = 0;
    let (mut met, mut named, mut hits) = (0u32, 0usize, 0usize);
    let mut highest = 0u32;
    for (triangle, code) in triangles.iter_mut().zip(streams.shapes) {
        let Some(shape) = SHAPES.get(usize::from(*code)) else {
            return Err(Fault(0, "a triangle has an unknown shape"));
        };
        // At most three named corners for each triangle: inside the scratch.
        let distances = &distances[named..named + 3];
        let mut corners = [0u32; 3];
        for (corner, index) in corners.iter_mut().enumerate() {
            let distance =
                (u32::from(distances[usize::from(shape.named_before[corner])]) + 1) & shape.named[corner];
            // A distance beyond the first vertex wraps to a large number and fails the test below.
            let relative = (met + u32::from(shape.new_before[corner])).wrapping_sub(distance);
            *index = u32::from((before >> shape.shift[corner]) as u16) + (relative & shape.relative[corner]);
        }
        highest = highest.max(corners[0]).max(corners[1]).max(corners[2]);
        // Triangles without a new vertex write too; the next one writes over it.
        let parent = parents.get_mut(met as usize).ok_or(Fault(0, "it names more vertices than it has"))?;
        *parent =
            if shape.opposite == 0 { Parents(0) } else { Parents(before | u64::from(shape.opposite) << 48) };
        hits += usize::from(shape.opposite != 0);
        met += u32::from(shape.new_before[3]);
        named += usize::from(shape.named_before[3]);
        *triangle = corners.map(|index| index as u16);
        before = lanes(*triangle);
    }
    if highest >= vertex_count {
        Err(Fault(0, "an index is out of range"))
    } else if met != vertex_count || named != streams.named.len() || hits != predicted {
        Err(Fault(0, "its triangles do not use what its header counts"))
    } else {
        Ok(())
    }
}
