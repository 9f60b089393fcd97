//! The fine octree of one block as it lies in the block's slot (I1: it lives there and leaves with it).
//!
//! A slot begins at a multiple of 64 bytes and holds, one after the other:
//!
//! | part | bytes | when |
//! |---|---|---|
//! | header | 128 | always |
//! | rows: nine f32 per triangle, leaf by leaf, `a.x` of all its triangles first | 36 per triangle | expanded |
//! | exact vertices: f64 x, y, z | 24 per vertex | where f32 offsets are not exact |
//! | vertices: f32 x, y, z | 12 per vertex | indexed |
//! | ids: source ordinals, as offsets from the least if all fit in 32 bits | 4 or 8 per triangle | always |
//! | vertex indices: three u16 | 6 per triangle | indexed, or where f32 offsets are not exact |
//! | materials: u16 | 2 per triangle | always |
//! | nodes | 256 each | always |
//!
//! Everything is in native byte order: a slot never leaves the process. Triangles are in the order of the leaves.

use super::frame::Frame;
use super::node::Node;
use crate::simd::LANES;
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
    pub base: [f64; 3],
    pub scale: f64,
    pub least_id: u64,
    /// Corners of the block in its frame.
    pub low: [f32; 3],
    pub high: [f32; 3],
    /// How far f32 vertices are off, per axis; 0 where they are exact.
    pub vertex_error: f32,
    pub triangle_count: u32,
    pub vertex_count: u32,
    pub node_count: u32,
    /// 1 or 0.
    pub expanded: u32,
    /// 1 if exact f64 vertices follow the rows.
    pub wide: u32,
    /// 1 if ids are 64-bit.
    pub long_ids: u32,
    pub parts: Parts,
    pub _padding: [u32; 3],
}

pub(super) const HEADER_BYTES: usize = size_of::<Header>();

/// Where the parts of a slot begin, in bytes.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C)]
pub(super) struct Parts {
    pub wide: u32,
    pub vertices: u32,
    pub ids: u32,
    pub indices: u32,
    pub materials: u32,
    pub nodes: u32,
}

impl Header {
    /// Sets `parts` from the counts and flags.
    pub fn lay_out(&mut self) {
        let [triangles, vertices] = [self.triangle_count, self.vertex_count];
        let wide = (HEADER_BYTES as u32 + self.expanded * 36 * triangles).next_multiple_of(8);
        let vertices_start = wide + self.wide * 24 * vertices;
        let ids = (vertices_start + (1 - self.expanded) * 12 * vertices).next_multiple_of(8);
        let indices = ids + triangles * (4 + 4 * self.long_ids);
        let materials = indices + (self.wide | (1 - self.expanded)) * 6 * triangles;
        let nodes = (materials + 2 * triangles).next_multiple_of(64);
        self.parts = Parts { wide, vertices: vertices_start, ids, indices, materials, nodes };
    }
}

impl FineLayout {
    /// Nodes that any block's tree gets if it needs them; with fewer its leaves would grow. Real blocks need a half.
    fn node_count_max(triangles: usize) -> usize {
        8 + triangles / 24
    }

    /// Bytes into which any block with at most so many triangles and vertices can be built. `wide`: some block's f32
    /// offsets are not exact.
    pub fn slot_bytes(self, triangles: usize, vertices: usize, wide: bool) -> Bytes {
        let mut header = Header {
            triangle_count: triangles as u32,
            vertex_count: vertices as u32,
            expanded: u32::from(self.expanded),
            wide: u32::from(wide),
            long_ids: 1,
            ..bytemuck::Zeroable::zeroed()
        };
        header.lay_out();
        Bytes(u64::from(header.parts.nodes) + (Self::node_count_max(triangles) * size_of::<Node>()) as u64)
    }
}

/// A triangle of a slot: which leaf it is in and where in the leaf.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleLocation {
    /// First triangle of the leaf.
    pub start: usize,
    /// Triangles in the leaf.
    pub count: usize,
    /// Which of them.
    pub lane: usize,
}

/// Reads a built slot.
#[derive(Clone, Copy)]
pub(crate) struct Fine<'a> {
    header: &'a Header,
    pub nodes: &'a [Node],
    /// Empty unless expanded.
    pub rows: &'a [f32],
    /// Everything behind the header, for the rare reads.
    slot: &'a [u8],
}

impl<'a> Fine<'a> {
    /// # Panics
    /// If `slot` was not filled by [`build`](super::fill::build).
    #[inline(always)]
    pub fn new(slot: &'a [u8]) -> Fine<'a> {
        let header: &Header = bytemuck::from_bytes(&slot[..HEADER_BYTES]);
        let nodes_start = header.parts.nodes as usize;
        let nodes_end = nodes_start + header.node_count as usize * size_of::<Node>();
        let nodes = bytemuck::cast_slice(&slot[nodes_start..nodes_end]);
        // The last packet's loads reach up to seven lanes past the last row; nodes always follow.
        let row_bytes = header.expanded as usize * (36 * header.triangle_count as usize + 4 * LANES);
        let rows = bytemuck::cast_slice(&slot[HEADER_BYTES..HEADER_BYTES + row_bytes]);
        Fine { header, nodes, rows, slot }
    }

    pub fn frame(&self) -> Frame {
        Frame { base: self.header.base, scale: self.header.scale }
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

    #[inline(always)]
    pub fn is_expanded(&self) -> bool {
        self.header.expanded == 1
    }

    /// Local f32 vertices. Empty if expanded.
    #[inline(always)]
    pub fn vertices(&self) -> &'a [[f32; 3]] {
        let parts = &self.header.parts;
        let bytes = (1 - self.header.expanded as usize) * 12 * self.header.vertex_count as usize;
        bytemuck::cast_slice(&self.slot[parts.vertices as usize..][..bytes])
    }

    /// Vertex indices of each triangle. Empty if expanded and exact.
    #[inline(always)]
    pub fn indices(&self) -> &'a [[u16; 3]] {
        let parts = &self.header.parts;
        bytemuck::cast_slice(&self.slot[parts.indices as usize..parts.materials as usize])
    }

    /// The exact vertices of a triangle.
    #[inline(always)]
    pub fn exact_vertices(&self, at: TriangleLocation) -> [[f64; 3]; 3] {
        let header = self.header;
        if header.expanded == 1 && header.wide == 0 {
            let first = 9 * at.start + at.lane;
            let row = |r: usize| self.rows[first + r * at.count];
            return [
                self.to_model([row(0), row(1), row(2)]),
                self.to_model([row(3), row(4), row(5)]),
                self.to_model([row(6), row(7), row(8)]),
            ];
        }
        let [a, b, c] = self.indices()[at.start + at.lane];
        let [a, b, c] = [usize::from(a), usize::from(b), usize::from(c)];
        if header.wide == 1 {
            let parts = &header.parts;
            let bytes = &self.slot[parts.wide as usize..][..24 * header.vertex_count as usize];
            let vertices: &[[f64; 3]] = bytemuck::cast_slice(bytes);
            return [vertices[a], vertices[b], vertices[c]];
        }
        let vertices = self.vertices();
        [self.to_model(vertices[a]), self.to_model(vertices[b]), self.to_model(vertices[c])]
    }

    /// Exact wherever the slot has no separate exact vertices: the builder checked.
    #[inline(always)]
    fn to_model(&self, local: [f32; 3]) -> [f64; 3] {
        // The scale is a power of two whose inverse is one too, so the product with it is exact.
        let inverse = if self.header.scale == 1.0 { 1.0 } else { 1.0 / self.header.scale };
        let base = &self.header.base;
        [
            base[0] + f64::from(local[0]) * inverse,
            base[1] + f64::from(local[1]) * inverse,
            base[2] + f64::from(local[2]) * inverse,
        ]
    }

    #[inline(always)]
    pub fn id(&self, at: TriangleLocation) -> TriangleId {
        let parts = &self.header.parts;
        let index = at.start + at.lane;
        let bytes = &self.slot[parts.ids as usize..parts.indices as usize];
        if self.header.long_ids == 1 {
            TriangleId(bytemuck::cast_slice::<u8, u64>(bytes)[index])
        } else {
            TriangleId(self.header.least_id + u64::from(bytemuck::cast_slice::<u8, u32>(bytes)[index]))
        }
    }

    #[inline(always)]
    pub fn material(&self, at: TriangleLocation) -> MaterialId {
        let parts = &self.header.parts;
        let materials: &[u16] = bytemuck::cast_slice(
            &self.slot[parts.materials as usize..][..2 * self.header.triangle_count as usize],
        );
        MaterialId(materials[at.start + at.lane])
    }
}
