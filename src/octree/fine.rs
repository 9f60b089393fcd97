//! The fine octree of one block as it lies in the block's slot (I1: it lives there and leaves with it).
//!
//! A slot begins at a multiple of 64 bytes and holds, one after the other:
//!
//! | part | bytes | when |
//! |---|---|---|
//! | header, with the first node or leaf of each of the block's sub-boxes | 128 | always |
//! | nodes | 256 each; room for [`FineLayout::node_count_max`] | always |
//! | exact vertices: f64 x, y, z | 24 per vertex | where f32 offsets are not exact |
//! | vertices: f32 x, y, z | 12 per vertex | indexed |
//! | leaves, each at a multiple of 16 bytes | | always |
//!
//! A leaf of `n` triangles holds what deciding and reporting a hit on them takes, so that it costs one wait for memory:
//!
//! | part of a leaf | bytes | when |
//! |---|---|---|
//! | a bound on the magnitude of its edge components: f32 | 4 | always |
//! | rows: nine f32 per triangle, `a.x` of all first, then `a.y`, ... `c.z` | 36 n | expanded |
//! | ids: source ordinals, as offsets from the block's least if all fit in 32 bits, else low and high halves; see [`ORDINARY`] | 4 n or 8 n | always |
//! | vertex indices: three u16; behind rows see [`ORDINARY_HALF`] | 6 n | indexed, or where f32 offsets are not exact |
//! | materials: u16; see [`ORDINARY_HALF`] | 2 n | always |
//!
//! Everything is in native byte order: a slot never leaves the process.

use super::frame::Frame;
use super::node::{Child, Node, PLACE_BYTES};
use crate::simd::{LANES, Packet, PacketRows, Simd};
use crate::units::{Bytes, MaterialId, TriangleId};

/// How a model's slots are laid out; the same for all its blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FineLayout {
    /// Leaves hold rows of coordinates instead of vertex indices.
    pub expanded: bool,
    /// The model's scale; see [`Frame`].
    pub scale: f64,
}

#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(super) struct Header {
    /// The trees of the block's sub-boxes, and a bit for each that has triangles.
    pub children: [Child; LANES],
    pub groups: u32,
    /// How far f32 vertices are off, per axis; 0 where they are exact.
    pub vertex_error: f32,
    /// Corners of the block in its frame.
    pub low: [f32; 3],
    pub high: [f32; 3],
    pub base: [f64; 3],
    /// Of the model's scale, a power of two, so that the inverse is exact.
    pub inverse_scale: f64,
    pub least_id: u64,
    pub triangle_count: u32,
    pub vertex_count: u32,
    /// 1 or 0.
    pub expanded: u32,
    /// 1 if leaves name vertices by index and exact f64 vertices are there.
    pub wide: u32,
    /// 1 if ids are 64-bit.
    pub long_ids: u32,
    pub _padding: u32,
}

pub(super) const HEADER_BYTES: usize = size_of::<Header>();

impl Header {
    /// Where the exact vertices begin, in bytes.
    pub fn wide_start(&self) -> usize {
        let nodes = FineLayout::node_count_max(self.triangle_count as usize);
        HEADER_BYTES + nodes * size_of::<Node>()
    }

    /// Where the f32 vertices begin.
    pub fn vertices_start(&self) -> usize {
        self.wide_start() + self.wide as usize * 24 * self.vertex_count as usize
    }

    /// Where the leaves begin.
    pub fn leaves_start(&self) -> usize {
        let vertices = (1 - self.expanded as usize) * 12 * self.vertex_count as usize;
        (self.vertices_start() + vertices).next_multiple_of(PLACE_BYTES)
    }

    /// The parts of a leaf of `count` triangles, in bytes from its start.
    #[inline(always)]
    pub fn leaf_parts(&self, count: usize) -> LeafParts {
        let ids = LEAF_ROWS + count * 36 * self.expanded as usize;
        let indices = ids + count * (4 + 4 * self.long_ids as usize);
        let materials = indices + count * 6 * (self.wide | (1 - self.expanded)) as usize;
        LeafParts { ids, indices, materials, end: materials + 2 * count }
    }
}

/// What ids are stored in exclusive or with: kernels load a few words behind the rows, and what is in those lanes is computed with
/// before it is masked. A small integer is a subnormal f32, on which Intel's processors spend 150 cycles in each multiplication;
/// with this bit those below 2^23 are numbers between 2 and 4. (Offsets from 2^30 to 2^30 + 2^23 are subnormal with it: only time depends
/// on that.)
pub(super) const ORDINARY: u32 = 0x4000_0000;

/// The same for materials, and for vertex indices behind rows.
pub(super) const ORDINARY_HALF: u16 = (ORDINARY >> 16) as u16;

/// Where the rows of a leaf begin, in bytes from its start: at the same place in all, so that a kernel has nothing to wait for.
pub(super) const LEAF_ROWS: usize = 4;

/// See [`Header::leaf_parts`].
pub(super) struct LeafParts {
    pub ids: usize,
    pub indices: usize,
    pub materials: usize,
    pub end: usize,
}

impl FineLayout {
    /// Nodes that a block's tree may have: with fewer than it needs its leaves grow. Real blocks need two thirds.
    pub fn node_count_max(triangles: usize) -> usize {
        8 + triangles / 24
    }

    /// Bytes into which any block with at most so many triangles and vertices can be built. `wide`: some block's f32
    /// offsets are not exact.
    pub fn slot_bytes(self, triangles: usize, vertices: usize, wide: bool) -> Bytes {
        let header = Header {
            triangle_count: triangles as u32,
            vertex_count: vertices as u32,
            expanded: u32::from(self.expanded),
            wide: u32::from(wide),
            long_ids: 1,
            ..bytemuck::Zeroable::zeroed()
        };
        // Every node but the root takes the place of a leaf and brings at most eight.
        let leaves = triangles.min(7 * Self::node_count_max(triangles) + 1);
        // Each leaf has its edge bound and up to 15 bytes of alignment.
        let bytes = header.leaves_start()
            + header.leaf_parts(triangles).end
            + leaves * (4 + PLACE_BYTES - 1)
            + OVERREAD_BYTES;
        Bytes(bytes as u64)
    }
}

/// The last packet's loads reach up to seven lanes past the last row.
const OVERREAD_BYTES: usize = 4 * LANES;

/// A triangle of a slot.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleLocation {
    pub leaf: Child,
    /// Which triangle of the leaf.
    pub lane: usize,
}

/// The triangles of a leaf, as kernels take them.
pub(crate) enum Leaf<'a> {
    Rows(PacketRows<'a>),
    Indices { vertices: &'a [[f32; 3]], triangles: &'a [[u16; 3]] },
}

impl Leaf<'_> {
    /// Eight triangles, from the one at `first` (below the count) on. Lanes from the leaf's count on hold anything.
    #[inline(always)]
    pub fn packet<S: Simd>(&self, simd: S, first: usize) -> Packet<S> {
        match self {
            Leaf::Rows(rows) => rows.packet(simd, first),
            Leaf::Indices { vertices, triangles } => {
                Packet::from_indices(simd, vertices, &triangles[first..])
            }
        }
    }
}

/// Reads a built slot.
#[derive(Clone, Copy)]
pub(crate) struct Fine<'a> {
    header: &'a Header,
    /// The slot as 32-bit words.
    words: &'a [u32],
}

impl<'a> Fine<'a> {
    /// # Panics
    /// If `slot` was not filled by [`build`](super::fill::build).
    #[inline(always)]
    pub fn new(slot: &'a [u8]) -> Fine<'a> {
        let header: &Header = bytemuck::from_bytes(&slot[..HEADER_BYTES]);
        let words = bytemuck::cast_slice(&slot[..slot.len() & !3]);
        Fine { header, words }
    }

    pub fn frame(&self) -> Frame {
        Frame { base: self.header.base, scale: 1.0 / self.header.inverse_scale }
    }

    /// Lowest and highest corner of the block in its frame.
    #[inline(always)]
    pub fn extents(&self) -> (&[f32; 3], &[f32; 3]) {
        (&self.header.low, &self.header.high)
    }

    #[inline(always)]
    pub fn vertex_error(&self) -> f32 {
        self.header.vertex_error
    }

    /// The trees of the block's sub-boxes, and which of them have triangles.
    #[inline(always)]
    pub fn groups(&self) -> (&'a [Child; LANES], u32) {
        (&self.header.children, self.header.groups)
    }

    /// An inner child.
    #[inline(always)]
    pub fn node(&self, child: Child) -> &'a Node {
        // The address is what the next step waits for, so it is one shift away from the child.
        let start = child.inner_place() * (PLACE_BYTES / 4);
        bytemuck::from_bytes(bytemuck::cast_slice(&self.words[start..start + size_of::<Node>() / 4]))
    }

    /// Asks for a node, or for the beginning of a leaf.
    #[inline(always)]
    pub fn prefetch<S: Simd>(&self, simd: S, child: Child) {
        let start = child.place() * (PLACE_BYTES / 4);
        simd.prefetch(self.words, start);
        simd.prefetch(self.words, start + 16);
        simd.prefetch(self.words, start + 32);
        simd.prefetch(self.words, start + 48);
        simd.prefetch(self.words, start + 64);
        simd.prefetch(self.words, start + 80);
    }

    /// The bound on the magnitude of a leaf's edge components.
    #[inline(always)]
    pub fn edge(&self, leaf: Child) -> f32 {
        f32::from_bits(self.words[leaf.place() * (PLACE_BYTES / 4)])
    }

    /// What packets of a leaf are made from. `expanded`: how its slot is laid out, if the caller knows at compile time.
    #[inline(always)]
    pub fn leaf(&self, expanded: Option<bool>, leaf: Child) -> Leaf<'a> {
        if expanded.unwrap_or(self.header.expanded == 1) {
            let start = leaf.place() * (PLACE_BYTES / 4) + LEAF_ROWS / 4;
            Leaf::Rows(PacketRows::new(bytemuck::cast_slice(&self.words[start..]), leaf.triangle_count()))
        } else {
            Leaf::Indices { vertices: self.vertices(), triangles: self.indices(leaf) }
        }
    }

    fn vertices(&self) -> &'a [[f32; 3]] {
        let count = (1 - self.header.expanded as usize) * self.header.vertex_count as usize;
        bytemuck::cast_slice(&self.words[self.header.vertices_start() / 4..][..3 * count])
    }

    /// Vertex indices of a leaf. Empty if expanded and exact.
    #[inline(always)]
    fn indices(&self, leaf: Child) -> &'a [[u16; 3]] {
        let parts = self.header.leaf_parts(leaf.triangle_count());
        let halves: &[u16] = bytemuck::cast_slice(self.words);
        let start = leaf.place() * (PLACE_BYTES / 2);
        bytemuck::cast_slice(&halves[start + parts.indices / 2..start + parts.materials / 2])
    }

    /// The exact vertices of a triangle.
    #[inline(always)]
    pub fn exact_vertices(&self, at: TriangleLocation) -> [[f64; 3]; 3] {
        let header = self.header;
        if header.expanded == 1 && header.wide == 0 {
            let count = at.leaf.triangle_count();
            let start = at.leaf.place() * (PLACE_BYTES / 4) + LEAF_ROWS / 4;
            // The last row reaches furthest: one check for all.
            let rows: &[f32] = bytemuck::cast_slice(&self.words[start + at.lane..][..8 * count + 1]);
            return [
                self.model_position([rows[0], rows[count], rows[2 * count]]),
                self.model_position([rows[3 * count], rows[4 * count], rows[5 * count]]),
                self.model_position([rows[6 * count], rows[7 * count], rows[8 * count]]),
            ];
        }
        let veil = ORDINARY_HALF * header.expanded as u16;
        let [a, b, c] = self.indices(at.leaf)[at.lane];
        let [a, b, c] = [usize::from(a ^ veil), usize::from(b ^ veil), usize::from(c ^ veil)];
        if header.wide == 1 {
            let words = &self.words[header.wide_start() / 4..][..6 * header.vertex_count as usize];
            let vertices: &[[f64; 3]] = bytemuck::cast_slice(words);
            return [vertices[a], vertices[b], vertices[c]];
        }
        let vertices = self.vertices();
        [self.model_position(vertices[a]), self.model_position(vertices[b]), self.model_position(vertices[c])]
    }

    /// Exact wherever the slot has no separate exact vertices: the builder checked.
    #[inline(always)]
    fn model_position(self, local: [f32; 3]) -> [f64; 3] {
        // The scale is a power of two whose inverse is one too, so the product with it is exact.
        let inverse = self.header.inverse_scale;
        let base = &self.header.base;
        [
            base[0] + f64::from(local[0]) * inverse,
            base[1] + f64::from(local[1]) * inverse,
            base[2] + f64::from(local[2]) * inverse,
        ]
    }

    #[inline(always)]
    pub fn id(&self, at: TriangleLocation) -> TriangleId {
        let parts = self.header.leaf_parts(at.leaf.triangle_count());
        let start = at.leaf.place() * (PLACE_BYTES / 4) + parts.ids / 4;
        let offset = if self.header.long_ids == 1 {
            let at = start + 2 * at.lane;
            u64::from(self.words[at] ^ ORDINARY) | u64::from(self.words[at + 1] ^ ORDINARY) << 32
        } else {
            u64::from(self.words[start + at.lane] ^ ORDINARY)
        };
        TriangleId(self.header.least_id + offset)
    }

    #[inline(always)]
    pub fn material(&self, at: TriangleLocation) -> MaterialId {
        let parts = self.header.leaf_parts(at.leaf.triangle_count());
        let halves: &[u16] = bytemuck::cast_slice(self.words);
        let material = halves[at.leaf.place() * (PLACE_BYTES / 2) + parts.materials / 2 + at.lane];
        MaterialId(material ^ ORDINARY_HALF)
    }
}
