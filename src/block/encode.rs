//! Triangles to bytes.

use super::codec::{self, Codec, CodecScratch};
use super::data::{BlockInput, BlockLimits, VertexInput};
use super::header::{BLOCK_HEADER_BYTES, Header, payload_bytes_max};
use super::ids::Runs;
use super::materials;
use super::shapes::{Connectivity, Parents};
use super::vertices::{self, Columns};
use crate::error::EncodeError;
use crate::geom::{Lattice, Precision};
use crate::units::Bytes;

/// Memory of the encoder, reused from block to block. One per thread.
pub struct EncodeScratch {
    payload: Vec<u8>,
    connectivity: Connectivity,
    columns: Columns,
    runs: Runs,
    codec: CodecScratch,
}

impl EncodeScratch {
    /// Memory for blocks inside `limits`. The rest grows with the first blocks, up to [`EncodeScratch::bytes_needed`].
    pub fn with_limits(limits: BlockLimits) -> EncodeScratch {
        EncodeScratch {
            payload: Vec::with_capacity(payload_bytes_max(limits)),
            connectivity: Connectivity::default(),
            columns: Columns::default(),
            runs: Runs::default(),
            codec: CodecScratch::new(),
        }
    }

    /// At most what it allocates, with the output of one block, for the memory budget (I1). The compressors of LZO and
    /// zstd take up to another MiB at their first block.
    pub fn bytes_needed(limits: BlockLimits) -> Bytes {
        let payload = payload_bytes_max(limits);
        let stored = BLOCK_HEADER_BYTES + lz4_flex::block::get_maximum_output_size(payload);
        // Vectors double as they grow, so each may hold twice what it needs.
        let per_vertex = 2 * 3 * size_of::<u32>() + size_of::<Parents>();
        let per_triangle = 1 + 3 + 3 * 2 + 8 + 2;
        let scratch =
            2 * (per_vertex * limits.vertex_count_max() + per_triangle * limits.triangle_count_max());
        Bytes((payload + stored + scratch + (16 << 10)) as u64)
    }
}

/// Encodes one block into `out` (cleared first). Lossless and a function of its arguments alone: the scratch and the
/// blocks before do not show in the bytes. A payload that `codec` does not shorten is stored raw.
///
/// # Errors
/// [`EncodeError`] if the input is not a valid block (counts that do not match, an index out of range, vertices not in first-use order,
/// ids that do not ascend, a coordinate that is not finite or outside the lattice), does not fit `limits`, or the codec is not in this
/// build.
pub fn encode(
    input: &BlockInput<'_>,
    precision: Precision,
    limits: BlockLimits,
    codec: Codec,
    scratch: &mut EncodeScratch,
    out: &mut Vec<u8>,
) -> Result<(), EncodeError> {
    let wide = validate(input, precision, limits)?;
    let EncodeScratch { payload, connectivity, columns, runs, codec: codec_scratch } = scratch;
    connectivity.encode(input.triangles, input.vertices.count())?;
    if !runs.collect(input.ids) {
        return Err(EncodeError::Invalid("its ids do not ascend"));
    }

    payload.clear();
    payload.extend_from_slice(&connectivity.shapes);
    payload.extend_from_slice(&connectivity.named);
    payload.extend(connectivity.far.iter().map(|distance| *distance as u8));
    payload.extend(connectivity.far.iter().map(|distance| (*distance >> 8) as u8));
    let parents = &connectivity.parents;
    let encoded = match input.vertices {
        VertexInput::Float32(floats) => {
            vertices::encode_floats(floats, (parents, connectivity.predicted), columns, payload)
        }
        VertexInput::Lattice(coordinates) if wide => vertices::encode_wide(coordinates, parents, payload),
        VertexInput::Lattice(coordinates) => {
            vertices::encode_lattice(coordinates, (parents, connectivity.predicted), columns, payload)
        }
    };
    let gap_width = runs.put(payload);
    let material_runs = materials::encode(input.materials, payload);

    let mut header = Header {
        codec,
        lattice: matches!(precision, Precision::Lattice(_)),
        wide,
        widths: encoded.widths,
        gap_width,
        triangle_count: input.triangles.len(),
        vertex_count: input.vertices.count(),
        predicted: connectivity.predicted,
        named: connectivity.named.len(),
        far: connectivity.far.len(),
        id_runs: runs.count(),
        material_runs,
        payload_bytes: payload.len(),
        id_base: input.ids[0],
        base: encoded.base,
    };
    debug_assert_eq!(header.layout().end, payload.len());
    out.clear();
    out.extend_from_slice(&[0; BLOCK_HEADER_BYTES]);
    if !codec::compress(codec, payload, codec_scratch, out)? {
        header.codec = Codec::Raw;
        out.extend_from_slice(payload);
    }
    out[..BLOCK_HEADER_BYTES].copy_from_slice(&header.to_bytes());
    Ok(())
}

/// Checks the input and says whether it is wide. The orders of vertices and ids are checked where they are encoded.
fn validate(input: &BlockInput<'_>, precision: Precision, limits: BlockLimits) -> Result<bool, EncodeError> {
    let require = |holds: bool, reason| if holds { Ok(()) } else { Err(EncodeError::Invalid(reason)) };
    limits.validate().map_err(EncodeError::Invalid)?;
    let (vertex_count, triangle_count) = (input.vertices.count(), input.triangles.len());
    require(triangle_count >= 1 && vertex_count >= 1, "it is empty")?;
    require(
        input.ids.len() == triangle_count && input.materials.len() == triangle_count,
        "it has not one id and one material for each triangle",
    )?;
    let highest = input.triangles.as_flattened().iter().fold(0, |highest, index| (*index).max(highest));
    require(usize::from(highest) < vertex_count, "an index is out of range")?;
    let wide = match (input.vertices, precision) {
        (VertexInput::Float32(vertices), Precision::Float32) => {
            let finite = vertices.as_flattened().iter().fold(true, |finite, x| finite & x.is_finite());
            require(finite, "a coordinate is not finite")?;
            false
        }
        (VertexInput::Lattice(vertices), Precision::Lattice(lattice)) => {
            let inside = |x: &i64| x.unsigned_abs() <= Lattice::COORDINATE_MAX as u64;
            require(vertices.as_flattened().iter().all(inside), "a coordinate is outside the lattice")?;
            vertices::is_wide(lattice, vertices)
        }
        _ => return Err(EncodeError::Invalid("its vertices are not in the precision of the file")),
    };
    if !limits.fits(vertex_count, triangle_count, wide) {
        return Err(EncodeError::TooLarge {
            vertex_count,
            triangle_count,
            wide,
            limit: limits.block_bytes_max,
        });
    }
    Ok(wide)
}

impl std::fmt::Debug for EncodeScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("EncodeScratch").finish_non_exhaustive()
    }
}
