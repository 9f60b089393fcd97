//! A block's triangles outside the file: what goes into the encoder and what comes out of the decoder.

use crate::units::Bytes;

/// Sizes that hold for every block of a compiled file; recorded in its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockLimits {
    /// Most bytes of a block in its plain decoded form (12 per vertex or 24 if wide, 6 per triangle, 4 per
    /// triangle for id and material): 4 KiB to 256 KiB. It need not be a power of two.
    pub block_bytes_max: u32,
}

impl BlockLimits {
    /// Smallest allowed `block_bytes_max`.
    pub const BLOCK_BYTES_LEAST: u32 = 4 << 10;
    /// Largest allowed `block_bytes_max`.
    pub const BLOCK_BYTES_MOST: u32 = 256 << 10;

    /// Whether these limits can be used.
    ///
    /// # Errors
    /// Why they cannot: a block size outside of [`BlockLimits::BLOCK_BYTES_LEAST`] to [`BlockLimits::BLOCK_BYTES_MOST`].
    pub fn validate(self) -> Result<(), &'static str> {
        if (Self::BLOCK_BYTES_LEAST..=Self::BLOCK_BYTES_MOST).contains(&self.block_bytes_max) {
            Ok(())
        } else {
            Err("the block size must be between 4 KiB and 256 KiB")
        }
    }

    /// Most triangles in a block: `block_bytes_max / 16`.
    pub fn triangle_count_max(self) -> usize {
        self.block_bytes_max as usize / 16
    }

    /// Most vertices in a block. Always below 65,536, so that indices fit in 16 bits.
    pub fn vertex_count_max(self) -> usize {
        // Triangles that share no vertex take 3 * 12 + 10 = 46 bytes; with more triangles in the same bytes each
        // has fewer vertices of its own.
        self.block_bytes_max as usize * 3 / 46
    }

    /// Bytes of a block in its plain decoded form.
    pub fn decoded_bytes(vertex_count: usize, triangle_count: usize, wide: bool) -> usize {
        vertex_count * if wide { 24 } else { 12 } + triangle_count * 10
    }

    /// Whether a block with these counts is inside the limits.
    pub fn fits(self, vertex_count: usize, triangle_count: usize, wide: bool) -> bool {
        triangle_count <= self.triangle_count_max()
            && vertex_count <= self.vertex_count_max()
            && Self::decoded_bytes(vertex_count, triangle_count, wide) <= self.block_bytes_max as usize
    }
}

/// Vertex positions as the encoder takes them.
#[derive(Clone, Copy, Debug)]
pub enum VertexInput<'a> {
    /// For `Precision::Float32`: kept bit for bit. Finite.
    Float32(&'a [[f32; 3]]),
    /// For `Precision::Lattice`: global lattice coordinates.
    Lattice(&'a [[i64; 3]]),
}

impl VertexInput<'_> {
    /// How many there are.
    pub fn count(&self) -> usize {
        match self {
            VertexInput::Float32(vertices) => vertices.len(),
            VertexInput::Lattice(vertices) => vertices.len(),
        }
    }
}

/// A block's triangles on the way into the encoder. Vertices should be distinct and in first-use order: any other
/// order is encoded correctly too, but takes more bytes.
#[derive(Clone, Copy, Debug)]
pub struct BlockInput<'a> {
    /// Positions.
    pub vertices: VertexInput<'a>,
    /// Indices into `vertices`.
    pub triangles: &'a [[u16; 3]],
    /// Source ordinals, strictly ascending.
    pub ids: &'a [u64],
    /// Material of each triangle.
    pub materials: &'a [u16],
}

/// A decoded block. Reused from block to block: after [`BlockData::with_limits`] decoding never allocates.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BlockData {
    /// Origin of `vertices`, exact in f64; zero for `Float32` files.
    pub base: [f64; 3],
    /// Offsets from `base`. Exact, unless `vertices_wide` is not empty: then each is the nearest finite f32.
    pub vertices: Vec<[f32; 3]>,
    /// Empty, or the exact absolute positions of a lattice block too large for exact f32 offsets (2^24 steps and more).
    pub vertices_wide: Vec<[f64; 3]>,
    /// Indices into `vertices`, all in range.
    pub triangles: Vec<[u16; 3]>,
    /// Source ordinals, strictly ascending.
    pub ids: Vec<u64>,
    /// Material of each triangle.
    pub materials: Vec<u16>,
}

impl BlockData {
    /// An empty block with room for any block inside `limits`.
    pub fn with_limits(limits: BlockLimits) -> BlockData {
        let (triangles, vertices) = (limits.triangle_count_max(), limits.vertex_count_max());
        BlockData {
            base: [0.0; 3],
            vertices: Vec::with_capacity(vertices),
            vertices_wide: Vec::with_capacity(vertices),
            triangles: Vec::with_capacity(triangles),
            ids: Vec::with_capacity(triangles),
            materials: Vec::with_capacity(triangles),
        }
    }

    /// What [`BlockData::with_limits`] allocates, for the memory budget (I1).
    pub fn bytes_needed(limits: BlockLimits) -> Bytes {
        Bytes((limits.vertex_count_max() * (12 + 24) + limits.triangle_count_max() * (6 + 8 + 2)) as u64)
    }

    /// Empties the block and keeps its memory.
    pub fn clear(&mut self) {
        self.base = [0.0; 3];
        self.vertices.clear();
        self.vertices_wide.clear();
        self.triangles.clear();
        self.ids.clear();
        self.materials.clear();
    }

    /// The exact position of a vertex.
    pub fn position(&self, vertex: usize) -> [f64; 3] {
        match self.vertices_wide.get(vertex) {
            Some(position) => *position,
            None => [0, 1, 2].map(|axis| self.base[axis] + f64::from(self.vertices[vertex][axis])),
        }
    }
}
