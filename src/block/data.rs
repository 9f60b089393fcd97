//! A block's triangles outside the file: what goes into the encoder and what comes out of the decoder.

/// Sizes that hold for every block of a compiled file; recorded in its header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BlockLimits {
    /// Most bytes of a block in its plain decoded form (12 per vertex or 24 if wide, 6 per triangle, 4 per
    /// triangle for id and material): 4 KiB to 256 KiB.
    pub block_bytes_max: u32,
}

impl BlockLimits {
    /// Most triangles in a block: `block_bytes_max / 16`.
    pub fn triangle_count_max(self) -> usize {
        self.block_bytes_max as usize / 16
    }

    /// Most vertices in a block; at most 65,535, so that indices fit in 16 bits.
    pub fn vertex_count_max(self) -> usize {
        (self.triangle_count_max() * 3).min(u16::MAX as usize)
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

/// A block's triangles on the way into the encoder. Vertices are distinct and in first-use order.
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
#[derive(Clone, Debug, Default)]
pub struct BlockData {
    /// Origin of `vertices`, exact in f64; zero for `Float32` files.
    pub base: [f64; 3],
    /// Offsets from `base`. Exact, unless `vertices_wide` is not empty: then each is the nearest f32.
    pub vertices: Vec<[f32; 3]>,
    /// Empty, or the exact absolute positions of a lattice block too large for exact f32 offsets (more than 2^24 steps).
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

    /// The exact position of a vertex.
    pub fn position(&self, vertex: usize) -> [f64; 3] {
        match self.vertices_wide.get(vertex) {
            Some(position) => *position,
            None => [0, 1, 2].map(|axis| self.base[axis] + f64::from(self.vertices[vertex][axis])),
        }
    }
}
