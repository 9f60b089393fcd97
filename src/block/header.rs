//! The fixed header of a stored block. `docs/format.md` has the same table.

use super::codec::Codec;
use super::data::BlockLimits;
use super::{BlockCheck, Fault};

/// First byte of every block: 0xB0 plus the version of the block format.
pub(super) const BLOCK_MAGIC: u8 = 0xB1;

/// Bytes of the header.
pub const BLOCK_HEADER_BYTES: usize = 64;

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
    /// Byte planes per axis of the vertices predicted by parallelogram, then of the others.
    pub widths: [[u8; 3]; 2],
    /// Byte planes of the gaps between runs of ids.
    pub gap_width: u8,
    pub triangle_count: usize,
    pub vertex_count: usize,
    /// Vertices predicted by parallelogram.
    pub predicted: usize,
    /// Corners that name a vertex by its distance.
    pub named: usize,
    /// Distances that take two bytes more.
    pub far: usize,
    pub id_runs: usize,
    pub material_runs: usize,
    pub payload_bytes: usize,
    pub id_base: u64,
    /// `Float32`: the bits of the first vertex, widened. Lattice: the least coordinate per axis.
    pub base: [u64; 3],
}

/// Where each stream of the payload starts; `end` is where the payload ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub shapes: usize,
    pub named: usize,
    pub far: usize,
    /// By kind (predicted, other) and axis.
    pub planes: [[usize; 3]; 2],
    pub gaps: usize,
    pub lengths: usize,
    pub materials: usize,
    pub end: usize,
}

impl Header {
    /// Vertices that are predicted by parallelogram (kind 0) or not (kind 1).
    pub fn kind_count(&self, kind: usize) -> usize {
        if kind == 0 { self.predicted } else { self.vertex_count - self.predicted }
    }

    pub fn layout(&self) -> Layout {
        // All counts are at most 65,535 and all widths at most 255, so nothing here overflows.
        let mut at = 0;
        let mut next = |bytes: usize| {
            let start = at;
            at += bytes;
            start
        };
        let shapes = next(self.triangle_count);
        let named = next(self.named);
        let far = next(2 * self.far);
        let planes = [0, 1]
            .map(|kind| self.widths[kind].map(|width| next(usize::from(width) * self.kind_count(kind))));
        let gaps = next(usize::from(self.gap_width) * (self.id_runs - 1));
        let lengths = next(2 * self.id_runs);
        let materials = next(4 * self.material_runs);
        let end = next(0);
        Layout { shapes, named, far, planes, gaps, lengths, materials, end }
    }

    /// Counts must fit 16 bits: the encoder has checked them against the limits.
    pub fn to_bytes(self) -> [u8; BLOCK_HEADER_BYTES] {
        let mut bytes = [0; BLOCK_HEADER_BYTES];
        bytes[0] = BLOCK_MAGIC;
        bytes[1] = self.codec.id();
        bytes[2] = if self.wide { FLAG_WIDE } else { 0 } | if self.lattice { FLAG_LATTICE } else { 0 };
        bytes[3] = self.gap_width;
        bytes[4..10].copy_from_slice(self.widths.as_flattened());
        let counts = [
            self.triangle_count,
            self.vertex_count,
            self.predicted,
            self.named,
            self.far,
            self.id_runs,
            self.material_runs,
        ];
        for (place, count) in bytes[10..24].chunks_exact_mut(2).zip(counts) {
            debug_assert!(count <= usize::from(u16::MAX));
            place.copy_from_slice(&(count as u16).to_le_bytes());
        }
        bytes[24..28].copy_from_slice(&(self.payload_bytes as u32).to_le_bytes());
        bytes[32..40].copy_from_slice(&self.id_base.to_le_bytes());
        for (place, base) in bytes[40..].chunks_exact_mut(8).zip(self.base) {
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
        let gap_width = bytes[3];
        require(gap_width <= 8, 3, "an id is wider than it can be")?;
        let widths = [[bytes[4], bytes[5], bytes[6]], [bytes[7], bytes[8], bytes[9]]];
        let width_max = if wide { 8 } else { 4 };
        let narrow = widths.as_flattened().iter().all(|width| *width <= width_max);
        require(narrow, 4, "a vertex is wider than it can be")?;

        let (triangle_count, vertex_count) = (u16_at(10), u16_at(12));
        let same = triangle_count == check.triangle_count as usize;
        require(same, 10, "its triangle count is not that of the directory")?;
        let same = vertex_count == check.vertex_count as usize;
        require(same, 12, "its vertex count is not that of the directory")?;
        require(triangle_count >= 1 && vertex_count >= 1, 10, "it is empty")?;
        let fits = limits.fits(vertex_count, triangle_count, wide);
        require(fits, 10, "it is larger than the block size of the file")?;
        let [predicted, named, far, id_runs, material_runs] = [14, 16, 18, 20, 22].map(u16_at);
        require(predicted < vertex_count, 14, "it predicts more vertices than it has")?;
        require(named <= 3 * triangle_count, 16, "it names more corners than it has")?;
        require(far <= named, 18, "it has more far corners than named corners")?;
        require((1..=triangle_count).contains(&id_runs), 20, "its runs of ids cannot cover its triangles")?;
        require(
            (1..=triangle_count).contains(&material_runs),
            22,
            "its runs of materials cannot cover its triangles",
        )?;
        let payload_bytes = u32::from_le_bytes([bytes[24], bytes[25], bytes[26], bytes[27]]) as usize;
        require(bytes[28..32] == [0; 4], 28, "a reserved byte is not zero")?;
        let header = Header {
            codec,
            lattice,
            wide,
            widths,
            gap_width,
            triangle_count,
            vertex_count,
            predicted,
            named,
            far,
            id_runs,
            material_runs,
            payload_bytes,
            id_base: u64_at(32),
            base: [u64_at(40), u64_at(48), u64_at(56)],
        };
        require(
            payload_bytes == header.layout().end,
            24,
            "its payload length does not follow from its counts",
        )?;
        Ok(header)
    }
}

/// Longest payload of any block inside `limits`.
pub(super) fn payload_bytes_max(limits: BlockLimits) -> usize {
    // Vertex planes take no more than the decoded vertices (4 * 3 bytes, 8 * 3 if wide). A triangle has a shape, at most
    // three named corners that are all far, a run of ids and a run of materials.
    let per_triangle = 1 + 3 * 3 + (8 + 2) + 4;
    limits.block_bytes_max as usize + limits.triangle_count_max() * per_triangle
}

/// Longest stored form of any block inside `limits`.
pub(crate) fn stored_bytes_max(limits: BlockLimits) -> usize {
    // A payload that does not shrink is stored raw.
    BLOCK_HEADER_BYTES + payload_bytes_max(limits)
}
