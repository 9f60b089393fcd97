//! The smallest possible compiler: blocks in source order, everything in memory.

use std::collections::HashMap;

use crate::block::{BlockInput, BlockLimits, Codec, EncodeScratch, VertexInput, encode, is_wide};
use crate::error::CompileError;
use crate::geom::{Aabb, Precision};
use crate::model::{MaterialRecord, ModelWriter, NewBlock, SourceRecord, SubBoxes};

/// Compiles triangles to the bytes of a compiled file, for [`crate::source::MemorySource`]. Triangle `i` gets id `i`
/// and material 0; blocks hold consecutive triangles, as many as fit. With `Precision::Float32` coordinates are
/// rounded to f32, otherwise to the lattice.
///
/// # Errors
/// [`CompileError`] if there are no triangles, a coordinate is not finite or out of range, or the limits or the codec
/// cannot be used.
pub fn memory_model(
    triangles: &[[[f64; 3]; 3]],
    limits: BlockLimits,
    codec: Codec,
    precision: Precision,
) -> Result<Vec<u8>, CompileError> {
    let mut writer = ModelWriter::new(precision, limits)?;
    let mut scratch = EncodeScratch::with_limits(limits);
    let (mut file, mut stored) = (vec![0; crate::model::HEADER_BYTES], Vec::new());
    let mut start = 0;
    while start < triangles.len() {
        let piece = Piece::cut(&triangles[start..], start as u64, limits, precision)?;
        let count = piece.triangles.len();
        let ids: Vec<u64> = (start as u64..).take(count).collect();
        let vertices = match precision {
            Precision::Float32 => VertexInput::Float32(&piece.floats),
            Precision::Lattice(_) => VertexInput::Lattice(&piece.lattice),
        };
        let input =
            BlockInput { vertices, triangles: &piece.triangles, ids: &ids, materials: &vec![0; count] };
        encode(&input, precision, limits, codec, &mut scratch, &mut stored)?;
        let bounds = union(&piece.boxes);
        let parts: Vec<Aabb> = piece.boxes.chunks(count.div_ceil(8)).map(union).collect();
        writer.push(&NewBlock {
            stored: &stored,
            triangle_count: count as u32,
            vertex_count: vertices.count() as u32,
            bounds,
            sub_boxes: SubBoxes::quantize(&bounds, &parts),
            material_range: [0, 0],
        })?;
        file.extend_from_slice(&stored);
        start += count;
    }
    let sealed = writer.seal(&[MaterialRecord::default()], SourceRecord::default(), None)?;
    file[..sealed.header.len()].copy_from_slice(&sealed.header);
    file.extend_from_slice(&sealed.tail);
    Ok(file)
}

fn union(boxes: &[Aabb]) -> Aabb {
    boxes.iter().fold(Aabb::EMPTY, |mut union, part| {
        union.merge(part);
        union
    })
}

/// The vertices of one block while it grows.
#[derive(Default)]
struct Piece {
    known: HashMap<[u64; 3], u16>,
    floats: Vec<[f32; 3]>,
    lattice: Vec<[i64; 3]>,
    /// Least and greatest lattice coordinates.
    range: Option<[[i64; 3]; 2]>,
    triangles: Vec<[u16; 3]>,
    boxes: Vec<Aabb>,
}

impl Piece {
    /// As many of the first triangles as fit into one block.
    fn cut(
        triangles: &[[[f64; 3]; 3]],
        first_id: u64,
        limits: BlockLimits,
        precision: Precision,
    ) -> Result<Piece, CompileError> {
        let mut piece = Piece::default();
        for (corners, id) in triangles.iter().zip(first_id..) {
            let wide = match precision {
                Precision::Float32 => false,
                Precision::Lattice(lattice) => {
                    let mut range = piece.range;
                    for corner in corners {
                        let coordinates = corner.map(|x| lattice.quantize(x).unwrap_or(0));
                        range = range.map_or(Some([coordinates; 2]), |[min, max]| {
                            let least = [0, 1, 2].map(|axis| coordinates[axis].min(min[axis]));
                            Some([least, [0, 1, 2].map(|axis| coordinates[axis].max(max[axis]))])
                        });
                    }
                    piece.range = range;
                    range.is_some_and(|range| is_wide(lattice, &range))
                }
            };
            // A triangle that shares no vertex adds three; stopping before it needs no way back.
            let vertex_count = piece.known.len() + 3;
            if !limits.fits(vertex_count, piece.triangles.len() + 1, wide) {
                break;
            }
            let mut bounds = Aabb::EMPTY;
            let mut indices = [0; 3];
            for (index, corner) in indices.iter_mut().zip(corners) {
                *index = piece
                    .vertex(*corner, precision, &mut bounds)
                    .ok_or(CompileError::NotFinite { triangle: id })?;
            }
            piece.triangles.push(indices);
            piece.boxes.push(bounds);
        }
        Ok(piece)
    }

    fn vertex(&mut self, corner: [f64; 3], precision: Precision, bounds: &mut Aabb) -> Option<u16> {
        let (mut key, mut position) = ([0; 3], [0.0; 3]);
        let (mut float, mut coordinates) = ([0.0; 3], [0; 3]);
        for axis in 0..3 {
            match precision {
                Precision::Float32 => {
                    float[axis] = corner[axis] as f32;
                    key[axis] = u64::from(float[axis].to_bits());
                    position[axis] = f64::from(float[axis]);
                }
                Precision::Lattice(lattice) => {
                    coordinates[axis] = lattice.quantize(corner[axis])?;
                    key[axis] = coordinates[axis] as u64;
                    position[axis] = lattice.position(coordinates[axis]);
                }
            }
        }
        if position.iter().any(|x| !x.is_finite()) {
            return None;
        }
        bounds.grow(position);
        // Blocks have fewer than 65,536 vertices.
        let next = self.known.len() as u16;
        let index = *self.known.entry(key).or_insert(next);
        if index == next {
            match precision {
                Precision::Float32 => self.floats.push(float),
                Precision::Lattice(_) => self.lattice.push(coordinates),
            }
        }
        Some(index)
    }
}
