//! The fixed header of a stored block. `docs/format.md` has the same table.

use super::codec::Codec;
use super::data::BlockLimits;
use super::{BlockCheck, Fault};

/// First byte of every block: 0xB0 plus the version of the block format.
pub(super) const BLOCK_MAGIC: u8 = 0xB1;

/// Bytes of the header.
pub const BLOCK_HEADER_BYTES: usize = 56;

const FLAG_WIDE: u8 = 1;
const FLAG_LATTICE: u8 = 2;

/// The header in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub codec: Codec,
    /// Vertices are lattice offsets.
    pub lattice: bool,
    /// Lattice offsets need more than f32.
    pub wide: bool,
    /// Byte planes per axis.
    pub widths: [u8; 3],
    /// Byte planes of the id differences; 0 if the ids are consecutive.
    pub id_width: u8,
    pub triangle_count: usize,
    pub vertex_count: usize,
    pub index_escapes: usize,
    pub id_escapes: usize,
    pub material_runs: usize,
    pub payload_bytes: usize,
    pub id_base: u64,
    /// `Float32`: the bits of the first vertex, widened. Lattice: the least coordinate per axis.
    pub base: [u64; 3],
}

/// Where each stream of the payload starts; the last number is where the payload ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub axes: [usize; 3],
    pub codes: usize,
    pub index_escapes: usize,
    pub ids: usize,
    pub id_escapes: usize,
    pub materials: usize,
    pub end: usize,
}

impl Header {
    pub fn layout(&self) -> Layout {
        // All counts are at most 65,535 and all widths at most 255, so nothing here overflows.
        let planes = self.widths.map(|width| usize::from(width) * self.vertex_count);
        let axes = [0, planes[0], planes[0] + planes[1]];
        let codes = axes[2] + planes[2];
        let index_escapes = codes + 3 * self.triangle_count;
        let ids = index_escapes + 2 * self.index_escapes;
        let id_escapes = ids + usize::from(self.id_width) * self.triangle_count.saturating_sub(1);
        let materials = id_escapes + 8 * self.id_escapes;
        Layout {
            axes,
            codes,
            index_escapes,
            ids,
            id_escapes,
            materials,
            end: materials + 4 * self.material_runs,
        }
    }

    /// Counts must fit 16 bits: the encoder has checked them against the limits.
    pub fn to_bytes(self) -> [u8; BLOCK_HEADER_BYTES] {
        let mut bytes = [0; BLOCK_HEADER_BYTES];
        bytes[0] = BLOCK_MAGIC;
        bytes[1] = self.codec.id();
        bytes[2] = if self.wide { FLAG_WIDE } else { 0 } | if self.lattice { FLAG_LATTICE } else { 0 };
        bytes[4..7].copy_from_slice(&self.widths);
        bytes[7] = self.id_width;
        let counts =
            [self.triangle_count, self.vertex_count, self.index_escapes, self.id_escapes, self.material_runs];
        for (place, count) in bytes[8..18].chunks_exact_mut(2).zip(counts) {
            debug_assert!(count <= usize::from(u16::MAX));
            place.copy_from_slice(&(count as u16).to_le_bytes());
        }
        bytes[20..24].copy_from_slice(&(self.payload_bytes as u32).to_le_bytes());
        bytes[24..32].copy_from_slice(&self.id_base.to_le_bytes());
        for (place, base) in bytes[32..].chunks_exact_mut(8).zip(self.base) {
            place.copy_from_slice(&base.to_le_bytes());
        }
        bytes
    }

    /// Reads a header and checks every count against the limits and the directory, before anything is sized by it.
    pub fn parse(
        bytes: &[u8],
        check: &BlockCheck,
        lattice: bool,
        limits: BlockLimits,
    ) -> Result<Header, Fault> {
        let Some(bytes) = bytes.first_chunk::<BLOCK_HEADER_BYTES>() else {
            return Err(Fault(bytes.len(), "it ends inside its header"));
        };
        let u16_at = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let u64_at = |at: usize| {
            let mut word = [0; 8];
            word.copy_from_slice(&bytes[at..at + 8]);
            u64::from_le_bytes(word)
        };
        let require = |holds: bool, at: usize, reason| if holds { Ok(()) } else { Err(Fault(at, reason)) };

        require(bytes[0] == BLOCK_MAGIC, 0, "it does not start with the block signature")?;
        let codec = Codec::from_id(bytes[1]).ok_or(Fault(1, "its codec is unknown"))?;
        require(bytes[2] & !(FLAG_WIDE | FLAG_LATTICE) == 0, 2, "a flag is unknown")?;
        let wide = bytes[2] & FLAG_WIDE != 0;
        require((bytes[2] & FLAG_LATTICE != 0) == lattice, 2, "its precision is not that of the file")?;
        require(lattice || !wide, 2, "floats cannot be wide")?;
        require(bytes[3] == 0, 3, "its vertex filter is unknown")?;
        let widths = [bytes[4], bytes[5], bytes[6]];
        let width_max = if wide { 8 } else { 4 };
        require(widths.iter().all(|width| *width <= width_max), 4, "a vertex is wider than it can be")?;
        let id_width = bytes[7];
        require(id_width <= 8, 7, "an id is wider than it can be")?;

        let triangle_count = u16_at(8);
        let vertex_count = u16_at(10);
        require(
            triangle_count == check.triangle_count as usize,
            8,
            "its triangle count is not that of the directory",
        )?;
        require(
            vertex_count == check.vertex_count as usize,
            10,
            "its vertex count is not that of the directory",
        )?;
        require(triangle_count >= 1 && vertex_count >= 1, 8, "it is empty")?;
        require(
            limits.fits(vertex_count, triangle_count, wide),
            8,
            "it is larger than the block size of the file",
        )?;
        let (index_escapes, id_escapes, material_runs) = (u16_at(12), u16_at(14), u16_at(16));
        require(index_escapes <= 3 * triangle_count, 12, "it has more far indices than indices")?;
        require(id_escapes < triangle_count, 14, "it has more far ids than ids")?;
        require(
            (1..=triangle_count).contains(&material_runs),
            16,
            "its material runs cannot cover its triangles",
        )?;
        require(u16_at(18) == 0, 18, "a reserved byte is not zero")?;
        let payload_bytes = u32::from_le_bytes([bytes[20], bytes[21], bytes[22], bytes[23]]) as usize;
        let header = Header {
            codec,
            lattice,
            wide,
            widths,
            id_width,
            triangle_count,
            vertex_count,
            index_escapes,
            id_escapes,
            material_runs,
            payload_bytes,
            id_base: u64_at(24),
            base: [u64_at(32), u64_at(40), u64_at(48)],
        };
        require(
            payload_bytes == header.layout().end,
            20,
            "its payload length does not follow from its counts",
        )?;
        Ok(header)
    }
}

/// Longest payload of any block inside `limits`: every vertex plane, index escape, id escape and material run.
pub(super) fn payload_bytes_max(limits: BlockLimits) -> usize {
    // Narrow planes take no more than the decoded vertices, and wide ones neither (8 * 3 = 24 bytes).
    let per_triangle = 3 + 6 + 8 + 8 + 4;
    limits.block_bytes_max as usize + limits.triangle_count_max() * per_triangle
}

/// Longest stored form of any block inside `limits`.
pub(crate) fn stored_bytes_max(limits: BlockLimits) -> usize {
    // A payload that does not shrink is stored raw.
    BLOCK_HEADER_BYTES + payload_bytes_max(limits)
}
