//! Bytes to triangles. Everything here treats the bytes as untrusted (I5).

use super::check::{BlockCheck, Fault, checksum};
use super::codec::{self, Codec};
use super::data::{BlockData, BlockLimits};
use super::header::{BLOCK_HEADER_BYTES, Header, payload_bytes_max};
use super::shapes::{self, DISTANCES_SLACK, Parents, Streams};
use super::vertices::Stored;
use super::zstd_codec::ZstdDecoder;
use super::{ids, materials};
use crate::error::BlockError;
use crate::geom::Precision;
use crate::units::Bytes;

/// Memory of the decoder, reused from block to block. One per thread.
pub struct DecodeScratch {
    payload: Vec<u8>,
    columns: Vec<u32>,
    distances: Vec<u16>,
    parents: Vec<Parents>,
    zstd: ZstdDecoder,
}

impl DecodeScratch {
    /// Memory for blocks inside `limits`.
    pub fn with_limits(limits: BlockLimits) -> DecodeScratch {
        DecodeScratch {
            payload: vec![0; payload_bytes_max(limits)],
            columns: vec![0; 3 * limits.vertex_count_max()],
            distances: vec![0; 3 * limits.triangle_count_max() + DISTANCES_SLACK],
            parents: vec![Parents::default(); limits.vertex_count_max() + 1],
            zstd: ZstdDecoder::default(),
        }
    }

    /// What it allocates, for the memory budget (I1). All at once, but for the state of zstd, which comes with the first
    /// block that needs it.
    pub fn bytes_needed(limits: BlockLimits) -> Bytes {
        let per_vertex = 3 * size_of::<u32>() + size_of::<Parents>();
        let per_triangle = 3 * size_of::<u16>();
        let vertices = per_vertex * limits.vertex_count_max() + size_of::<Parents>();
        let triangles = per_triangle * limits.triangle_count_max() + DISTANCES_SLACK * size_of::<u16>();
        Bytes((payload_bytes_max(limits) + vertices + triangles + ZstdDecoder::BYTES) as u64)
    }
}

/// Decodes the stored bytes of one block into `data`, whose former contents are lost. Does not allocate if `scratch`
/// and `data` were made for `limits`.
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
    let DecodeScratch { payload: room, columns, distances, parents, zstd } = scratch;
    let enough = room.len() >= header.payload_bytes
        && columns.len() >= 3 * header.vertex_count
        && distances.len() >= 3 * header.triangle_count + DISTANCES_SLACK
        && parents.len() > header.vertex_count;
    if !enough {
        return Err(Fault(0, "it is larger than the memory that was set aside"));
    }
    let room = &mut room[..header.payload_bytes];
    let columns = &mut columns[..3 * header.vertex_count];
    let parents = &mut parents[..=header.vertex_count];
    let payload: &[u8] = if header.codec == Codec::Raw && stored.len() == room.len() {
        stored
    } else {
        codec::decompress(header.codec, stored, room, zstd, BLOCK_HEADER_BYTES)?;
        room
    };

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

    let streams = Streams {
        shapes: &payload[layout.shapes..layout.named],
        named: &payload[layout.named..layout.far],
        far: &payload[layout.far..layout.planes[0][0]],
    };
    shapes::decode(&streams, header.predicted, distances, &mut data.triangles, parents)
        .map_err(at(layout.shapes))?;
    let stored =
        Stored { header: &header, layout: &layout, payload, parents: &parents[..header.vertex_count] };
    data.base = match lattice {
        None => stored.decode_floats(columns, &mut data.vertices).map(|()| [0.0; 3]),
        Some(lattice) if header.wide => {
            stored.decode_wide(lattice, &mut data.vertices, &mut data.vertices_wide)
        }
        Some(lattice) => stored.decode_lattice(lattice, columns, &mut data.vertices),
    }
    .map_err(at(layout.planes[0][0]))?;
    let gaps = &payload[layout.gaps..layout.lengths];
    let lengths = &payload[layout.lengths..layout.materials];
    ids::decode(header.id_base, header.gap_width, gaps, lengths, &mut data.ids).map_err(at(layout.gaps))?;
    let runs = &payload[layout.materials..layout.end];
    materials::decode(runs, check.material_range, &mut data.materials).map_err(at(layout.materials))
}

impl std::fmt::Debug for DecodeScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DecodeScratch").finish_non_exhaustive()
    }
}
