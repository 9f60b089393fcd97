//! Builds the fine tree of a decoded block into its slot.

use super::build::{BuildScratch, LeafSink, build_tree};
use super::fine::{FineLayout, HEADER_BYTES, Header};
use super::frame::Frame;
use super::node::{Child, Node};
use crate::block::BlockData;
use crate::simd::{LANES, Operation, Simd, SimdLevel, dispatch};

/// Leaves hold at most this many triangles where the slot has room for enough nodes: two packets.
const LEAF_TRIANGLES_MAX: usize = 16;

/// Builds `data` into `slot`, which must have [`FineLayout::slot_bytes`] for it. Does not allocate.
///
/// # Panics
/// If the slot is too small or not aligned, or if `scratch` is too small.
pub(crate) fn build(
    level: SimdLevel,
    data: &BlockData,
    layout: FineLayout,
    slot: &mut [u8],
    scratch: &mut BuildScratch,
) {
    dispatch(level, Build { data, layout, slot, scratch });
}

struct Build<'a> {
    data: &'a BlockData,
    layout: FineLayout,
    slot: &'a mut [u8],
    scratch: &'a mut BuildScratch,
}

impl Operation for Build<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Build { data, layout, slot, scratch } = self;
        let frame = Frame { base: data.base, scale: layout.scale };
        // Lattice and plain f32 blocks hold exact offsets; where the scale or the span spoils that, exact positions
        // are kept beside the rounded ones.
        let wide = !data.vertices_wide.is_empty()
            || (layout.scale != 1.0 && (0..data.vertices.len()).any(|i| !frame.to_local(data.position(i)).1));
        let (least_id, last_id) = (data.ids[0], data.ids[data.ids.len() - 1]);
        let mut header = Header {
            base: data.base,
            scale: layout.scale,
            least_id,
            triangle_count: data.triangles.len() as u32,
            vertex_count: data.vertices.len() as u32,
            expanded: u32::from(layout.expanded),
            wide: u32::from(wide),
            long_ids: u32::from(last_id - least_id > u64::from(u32::MAX)),
            ..bytemuck::Zeroable::zeroed()
        };
        header.lay_out();
        let vertex = |i: usize| -> [f32; 3] {
            if wide || layout.scale != 1.0 { frame.to_local(data.position(i)).0 } else { data.vertices[i] }
        };

        // Vertices as boxes, so that a triangle's box is the least of three.
        for (i, place) in scratch.vertices[..data.vertices.len()].iter_mut().enumerate() {
            let [x, y, z] = vertex(i);
            *place = [x, y, z, 0.0, -x, -y, -z, 0.0];
        }
        let count = data.triangles.len();
        let (primitives, vertices) = scratch.primitives(count);
        if wide {
            // A rounded vertex is off by at most half a step of the largest coordinate (2^-24), and where the
            // difference from the base rounds in f64 too, hardly more.
            let largest = vertices[..data.vertices.len()]
                .iter()
                .flatten()
                .fold(0.0, |largest: f32, x| largest.max(x.abs()));
            header.vertex_error = largest * (1.0 / (1u32 << 23) as f32) + f32::MIN_POSITIVE;
        }
        let pad = simd.splat(header.vertex_error);
        for (place, triangle) in primitives.iter_mut().zip(&data.triangles) {
            let [a, b, c] = *triangle;
            let bounds = simd.min(simd.load(&vertices[usize::from(b)]), simd.load(&vertices[usize::from(c)]));
            let bounds = simd.min(simd.load(&vertices[usize::from(a)]), bounds);
            *place = simd.to_array(if wide { simd.sub(bounds, pad) } else { bounds });
        }

        let (parts, nodes) = slot.split_at_mut(header.parts.nodes as usize);
        let nodes = &mut nodes[..];
        let node_room = nodes.len() / size_of::<Node>();
        let nodes: &mut [Node] = bytemuck::cast_slice_mut(&mut nodes[..node_room * size_of::<Node>()]);
        let mut sink = TriangleSink::new(data, &header, parts, scratch);
        // `sink` borrows nothing of the scratch but the vertices, which it owns while the tree is built.
        let (node_count, bounds) = build_tree(simd, scratch, count, nodes, &mut sink);
        scratch.vertices = sink.local;
        header.node_count = node_count as u32;
        header.low = [bounds[0], bounds[1], bounds[2]];
        header.high = [-bounds[4], -bounds[5], -bounds[6]];
        slot[..HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
    }
}

/// Writes triangles leaf by leaf into the parts of a slot.
struct TriangleSink<'a> {
    data: &'a BlockData,
    /// Vertices in the block's frame, as boxes; taken from the scratch for the time of the build.
    local: Vec<[f32; LANES]>,
    least_id: u64,
    expanded: bool,
    rows: &'a mut [f32],
    indices: &'a mut [[u16; 3]],
    short_ids: &'a mut [u32],
    long_ids: &'a mut [u64],
    materials: &'a mut [u16],
}

impl<'a> TriangleSink<'a> {
    #[inline(always)]
    fn new(
        data: &'a BlockData,
        header: &Header,
        slot: &'a mut [u8],
        scratch: &mut BuildScratch,
    ) -> TriangleSink<'a> {
        let local = std::mem::take(&mut scratch.vertices);
        let parts = &header.parts;
        let (slot, materials) = slot.split_at_mut(parts.materials as usize);
        let (slot, indices) = slot.split_at_mut(parts.indices as usize);
        let (slot, ids) = slot.split_at_mut(parts.ids as usize);
        let (slot, vertices) = slot.split_at_mut(parts.vertices as usize);
        let (slot, wide) = slot.split_at_mut(parts.wide as usize);
        let rows = &mut slot[HEADER_BYTES..];

        let wide = bytemuck::cast_slice_mut::<u8, [f64; 3]>(&mut wide[..]);
        for (i, place) in wide.iter_mut().enumerate() {
            *place = data.position(i);
        }
        let vertex_bytes = vertices.len() / 12 * 12;
        let vertices = bytemuck::cast_slice_mut::<u8, [f32; 3]>(&mut vertices[..vertex_bytes]);
        for (place, vertex) in vertices.iter_mut().zip(&local) {
            *place = [vertex[0], vertex[1], vertex[2]];
        }
        let (short_ids, long_ids) = if header.long_ids == 1 {
            (&mut [][..], bytemuck::cast_slice_mut(ids))
        } else {
            (bytemuck::cast_slice_mut(ids), &mut [][..])
        };
        TriangleSink {
            data,
            local,
            least_id: header.least_id,
            expanded: header.expanded == 1,
            rows: bytemuck::cast_slice_mut(rows),
            indices: bytemuck::cast_slice_mut(indices),
            short_ids,
            long_ids,
            materials: bytemuck::cast_slice_mut(&mut materials[..2 * data.triangles.len()]),
        }
    }
}

impl<S: Simd> LeafSink<S> for TriangleSink<'_> {
    const LEAF_MAX: usize = LEAF_TRIANGLES_MAX;

    #[inline(always)]
    fn leaf(&mut self, simd: S, start: usize, order: &[u32]) -> (Child, f32) {
        let count = order.len();
        let mut longest = simd.splat(0.0);
        for (i, triangle) in order.iter().enumerate() {
            let triangle = *triangle as usize;
            let corners = self.data.triangles[triangle];
            let [a, b, c] = corners;
            let a = &self.local[usize::from(a)];
            let b = &self.local[usize::from(b)];
            let c = &self.local[usize::from(c)];
            // Lanes 0 to 2 hold the vertex and 4 to 6 its negative: the difference is the edge, exactly negated too.
            let (ab, ac) = (simd.sub(simd.load(b), simd.load(a)), simd.sub(simd.load(c), simd.load(a)));
            longest = simd.max(simd.max(ab, ac), longest);
            if self.expanded {
                let rows = &mut self.rows[9 * start..9 * (start + count)];
                for axis in 0..3 {
                    rows[axis * count + i] = a[axis];
                    rows[(axis + 3) * count + i] = b[axis];
                    rows[(axis + 6) * count + i] = c[axis];
                }
            }
            if !self.indices.is_empty() {
                self.indices[start + i] = corners;
            }
            let id = self.data.ids[triangle];
            if self.long_ids.is_empty() {
                // Ids ascend and the span fits in 32 bits.
                self.short_ids[start + i] = (id - self.least_id) as u32;
            } else {
                self.long_ids[start + i] = id;
            }
            self.materials[start + i] = self.data.materials[triangle];
        }
        let edge = simd.to_array(longest).into_iter().fold(0.0, f32::max);
        (Child::triangles(start as u32, count as u32), edge)
    }
}
