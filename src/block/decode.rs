//! Bytes to triangles. Everything here treats the bytes as untrusted (I5).

use super::check::{BlockCheck, Fault, checksum};
use super::codec::{self, Codec};
use super::data::{BlockData, BlockLimits};
use super::header::{BLOCK_HEADER_BYTES, Header, payload_bytes_max};
use super::{ids, indices, materials, vertices};
use crate::error::BlockError;
use crate::geom::Precision;
use crate::units::Bytes;

/// Memory of the decoder, reused from block to block. One per thread.
#[derive(Clone, Debug)]
pub struct DecodeScratch {
    payload: Vec<u8>,
    columns: Vec<u32>,
}

impl DecodeScratch {
    /// Memory for blocks inside `limits`.
    pub fn with_limits(limits: BlockLimits) -> DecodeScratch {
        DecodeScratch {
            payload: vec![0; payload_bytes_max(limits)],
            columns: vec![0; 3 * limits.vertex_count_max()],
        }
    }

    /// What [`DecodeScratch::with_limits`] allocates, for the memory budget (I1).
    pub fn bytes_for(limits: BlockLimits) -> Bytes {
        Bytes((payload_bytes_max(limits) + 12 * limits.vertex_count_max()) as u64)
    }
}

/// Decodes the stored bytes of one block into `data`, whose former contents are lost. Does not allocate if `scratch`
/// and `data` were made for `limits` (zstd allocates inside its C library).
///
/// # Errors
/// [`BlockError`] if the bytes are not exactly what `check` promises; `data` is empty then. Never panics, whatever the
/// bytes are.
pub fn decode(
    bytes: &[u8],
    check: &BlockCheck,
    precision: Precision,
    limits: BlockLimits,
    scratch: &mut DecodeScratch,
    data: &mut BlockData,
) -> Result<(), BlockError> {
    decode_parts(bytes, check, precision, limits, scratch, data).map_err(|fault| {
        data.clear();
        fault.of(check.block)
    })
}

fn decode_parts(
    bytes: &[u8],
    check: &BlockCheck,
    precision: Precision,
    limits: BlockLimits,
    scratch: &mut DecodeScratch,
    data: &mut BlockData,
) -> Result<(), Fault> {
    limits.validate().map_err(|reason| Fault(0, reason))?;
    if checksum(bytes) != check.checksum {
        return Err(Fault(0, "its checksum is wrong"));
    }
    let lattice = match precision {
        Precision::Float32 => None,
        Precision::Lattice(lattice) => Some(lattice),
    };
    let header = Header::parse(bytes, check, lattice.is_some(), limits)?;
    let layout = header.layout();
    let stored = &bytes[BLOCK_HEADER_BYTES..];
    let room = scratch.payload.get_mut(..header.payload_bytes);
    let room = room.ok_or(Fault(20, "it is larger than the memory that was set aside"))?;
    let payload: &[u8] = if header.codec == Codec::Raw && stored.len() == room.len() {
        stored
    } else {
        codec::decompress(header.codec, stored, room, BLOCK_HEADER_BYTES)?;
        room
    };
    let columns = scratch.columns.get_mut(..3 * header.vertex_count);
    let columns = columns.ok_or(Fault(10, "it is larger than the memory that was set aside"))?;

    // Offsets of damage in the payload are known in the stored bytes only if these are not compressed.
    let at = |start: usize| {
        let raw = header.codec == Codec::Raw;
        move |Fault(offset, reason)| Fault(BLOCK_HEADER_BYTES + if raw { start + offset } else { 0 }, reason)
    };
    // `resize` on a vector that keeps its old contents writes only what is new: nothing for the usual full block.
    data.vertices.resize(header.vertex_count, [0.0; 3]);
    data.triangles.resize(header.triangle_count, [0; 3]);
    data.ids.resize(header.triangle_count, 0);
    data.materials.resize(header.triangle_count, 0);
    data.vertices_wide.resize(if header.wide { header.vertex_count } else { 0 }, [0.0; 3]);
    data.base = match lattice {
        None => {
            let decoded = vertices::decode_floats(&header, &layout, payload, columns, &mut data.vertices);
            decoded.map_err(at(0))?;
            [0.0; 3]
        }
        Some(lattice) if header.wide => {
            let (near, wide) = (&mut data.vertices, &mut data.vertices_wide);
            vertices::decode_wide(&header, &layout, payload, lattice, near, wide).map_err(at(0))?
        }
        Some(lattice) => {
            let vertices = &mut data.vertices;
            vertices::decode_lattice(&header, &layout, payload, lattice, columns, vertices).map_err(at(0))?
        }
    };
    let codes = &payload[layout.codes..layout.index_escapes];
    let escapes = &payload[layout.index_escapes..layout.ids];
    indices::decode(codes, escapes, header.vertex_count, &mut data.triangles).map_err(at(layout.codes))?;
    let planes = &payload[layout.ids..layout.id_escapes];
    let escapes = &payload[layout.id_escapes..layout.materials];
    ids::decode(header.id_base, header.id_width, planes, escapes, &mut data.ids).map_err(at(layout.ids))?;
    let runs = &payload[layout.materials..layout.end];
    materials::decode(runs, check.material_range, &mut data.materials).map_err(at(layout.materials))
}
