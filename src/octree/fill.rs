//! Builds the fine tree of a decoded block into its slot.

use super::build::{BuildScratch, Groups, LeafSink, build_groups};
use super::fine::{FineLayout, HEADER_BYTES, Header, LEAF_ROWS, ORDINARY, ORDINARY_HALF};
use super::frame::Frame;
use super::node::{Child, Node, PLACE_BYTES};
use super::options::TreeQuality;
use crate::block::BlockData;
use crate::model::BlockEntry;
use crate::simd::{AnyOperation, LANES, PackedBoxes, Simd, SimdLevel, dispatch};

/// Expanded leaves hold at most this many triangles where the slot has room for enough nodes: three packets, whose rows lie one after
/// the other, are had sooner than another node and two leaves.
const LEAF_TRIANGLES_MAX: usize = 24;

/// Indexed leaves hold at most so many: two packets, because theirs are put together vertex by vertex.
const INDEXED_LEAF_TRIANGLES_MAX: usize = 16;

/// Builds `data`, the block that the directory's `entry` describes, into `slot`, which must have [`FineLayout::slot_bytes`] for it.
/// Does not allocate.
///
/// # Panics
/// If the slot is too small or not aligned, or if `scratch` is too small.
pub(crate) fn build(
    level: SimdLevel,
    entry: &BlockEntry,
    data: &BlockData,
    (layout, quality): (FineLayout, TreeQuality),
    slot: &mut [u8],
    scratch: &mut BuildScratch,
) {
    dispatch(level, Build { entry, data, layout, quality, slot, scratch });
}

struct Build<'a> {
    entry: &'a BlockEntry,
    data: &'a BlockData,
    layout: FineLayout,
    quality: TreeQuality,
    slot: &'a mut [u8],
    scratch: &'a mut BuildScratch,
}

impl AnyOperation for Build<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Build { entry, data, layout, quality, slot, scratch } = self;
        let frame = Frame { base: data.base, scale: layout.scale };
        // Lattice and plain f32 blocks hold exact offsets; where the scale or the span spoils that, exact positions
        // are kept beside the rounded ones.
        let wide = !data.vertices_wide.is_empty()
            || (layout.scale != 1.0 && (0..data.vertices.len()).any(|i| !frame.to_local(data.position(i)).1));
        let (least_id, last_id) = (data.ids[0], data.ids[data.ids.len() - 1]);
        let mut header = Header {
            base: data.base,
            inverse_scale: 1.0 / layout.scale,
            least_id,
            triangle_count: data.triangles.len() as u32,
            vertex_count: data.vertices.len() as u32,
            expanded: u32::from(layout.expanded),
            wide: u32::from(wide),
            long_ids: u32::from(last_id - least_id > u64::from(u32::MAX)),
            ..bytemuck::Zeroable::zeroed()
        };
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

        let (start, leaves) = slot.split_at_mut(header.leaves_start());
        let (start, vertices) = start.split_at_mut(header.vertices_start());
        let (start, wide) = start.split_at_mut(header.wide_start());
        let nodes: &mut [Node] = bytemuck::cast_slice_mut(&mut start[HEADER_BYTES..]);
        for (i, place) in bytemuck::cast_slice_mut::<u8, [f64; 3]>(wide).iter_mut().enumerate() {
            *place = data.position(i);
        }
        if !layout.expanded {
            let bytes = 12 * data.vertices.len();
            let vertices = bytemuck::cast_slice_mut::<u8, [f32; 3]>(&mut vertices[..bytes]);
            for (place, vertex) in vertices.iter_mut().zip(&scratch.vertices) {
                *place = [vertex[0], vertex[1], vertex[2]];
            }
        }
        let whole = leaves.len() & !(PLACE_BYTES - 1);
        let mut sink = TriangleSink {
            data,
            // Taken from the scratch for the time of the build.
            local: std::mem::take(&mut scratch.vertices),
            header: &header,
            leaves: bytemuck::cast_slice_mut(&mut leaves[..whole]),
            next_word: 0,
        };
        let (low, high) = frame.box_to_local(&entry.bounds);
        let mut boxes = PackedBoxes::new(low, high, &entry.sub_boxes).unpack();
        // A triangle's box was padded; the sub-box that holds the triangle must still hold it.
        for (row, sides) in boxes.iter_mut().enumerate() {
            for side in sides {
                *side += if row < 3 { -2.0 * header.vertex_error } else { 2.0 * header.vertex_error };
            }
        }
        let Groups { children, used, bounds } =
            build_groups(simd, scratch, count, &boxes, quality, nodes, &mut sink);
        scratch.vertices = sink.local;
        (header.children, header.groups) = (children, used);
        header.low = [bounds[0], bounds[1], bounds[2]];
        header.high = [-bounds[4], -bounds[5], -bounds[6]];
        slot[..HEADER_BYTES].copy_from_slice(bytemuck::bytes_of(&header));
    }
}

/// Writes leaves one after the other.
struct TriangleSink<'a> {
    data: &'a BlockData,
    /// Vertices in the block's frame, as boxes.
    local: Vec<[f32; LANES]>,
    header: &'a Header,
    /// The slot's leaves, in words.
    leaves: &'a mut [u32],
    next_word: usize,
}

impl<S: Simd> LeafSink<S> for TriangleSink<'_> {
    const ONE_PLANE: bool = false;

    #[inline(always)]
    fn leaf_max(&self) -> usize {
        if self.header.expanded == 1 { LEAF_TRIANGLES_MAX } else { INDEXED_LEAF_TRIANGLES_MAX }
    }

    fn inner(&mut self, index: usize) -> Child {
        Child::inner(((HEADER_BYTES + index * size_of::<Node>()) / PLACE_BYTES) as u32)
    }

    #[inline(always)]
    fn leaf(&mut self, simd: S, order: &[u32]) -> Child {
        let count = order.len();
        let parts = self.header.leaf_parts(count);
        let start = self.next_word;
        let words = (parts.end.next_multiple_of(PLACE_BYTES)) / 4;
        self.next_word += words;
        let leaf = &mut self.leaves[start..start + words];
        let (leaf, tail) = leaf.split_at_mut(parts.indices / 4);
        let (rows, ids) = leaf.split_at_mut(parts.ids / 4);
        let (edge, rows) = rows.split_at_mut(LEAF_ROWS / 4);
        let rows: &mut [f32] = bytemuck::cast_slice_mut(rows);
        let (indices, materials) =
            bytemuck::cast_slice_mut::<u32, u16>(tail).split_at_mut((parts.materials - parts.indices) / 2);
        let indices: &mut [[u16; 3]] = bytemuck::cast_slice_mut(indices);
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
            if !rows.is_empty() {
                // The last row reaches furthest: one check for all.
                let column = &mut rows[i..i + 8 * count + 1];
                column[0] = a[0];
                column[count] = a[1];
                column[2 * count] = a[2];
                column[3 * count] = b[0];
                column[4 * count] = b[1];
                column[5 * count] = b[2];
                column[6 * count] = c[0];
                column[7 * count] = c[1];
                column[8 * count] = c[2];
            }
            if !indices.is_empty() {
                let veil = ORDINARY_HALF * self.header.expanded as u16;
                indices[i] = corners.map(|corner| corner ^ veil);
            }
            let offset = self.data.ids[triangle] - self.header.least_id;
            if self.header.long_ids == 1 {
                (ids[2 * i], ids[2 * i + 1]) = (offset as u32 ^ ORDINARY, (offset >> 32) as u32 ^ ORDINARY);
            } else {
                ids[i] = offset as u32 ^ ORDINARY;
            }
            materials[i] = self.data.materials[triangle] ^ ORDINARY_HALF;
        }
        // And what fills the leaf up.
        materials[count..].fill(ORDINARY_HALF);
        edge[0] = simd.to_array(longest).into_iter().fold(0.0, f32::max).to_bits();
        let place = (self.header.leaves_start() + 4 * start) / PLACE_BYTES;
        Child::triangles(place as u32, count as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fine::{Fine, TriangleLocation};
    use super::*;
    use crate::geom::Aabb;
    use crate::units::{MaterialId, TriangleId};

    /// A wavy sheet of 2,048 triangles.
    fn sheet() -> (BlockEntry, BlockData) {
        const SIDE: u16 = 32;
        let corner = |x: u16, y: u16| y * (SIDE + 1) + x;
        let mut data = BlockData::default();
        for y in 0..=SIDE {
            for x in 0..=SIDE {
                data.vertices.push([f32::from(x), f32::from(y), f32::from(x * y % 7)]);
            }
        }
        for y in 0..SIDE {
            for x in 0..SIDE {
                let [a, b, c, d] = [corner(x, y), corner(x + 1, y), corner(x, y + 1), corner(x + 1, y + 1)];
                data.triangles.extend([[a, b, c], [d, c, b]]);
            }
        }
        data.ids = (100..100 + data.triangles.len() as u64).collect();
        data.materials = vec![0; data.triangles.len()];
        let side = f64::from(SIDE);
        let entry = BlockEntry {
            offset: 0,
            stored_bytes: 0,
            checksum: 0,
            triangle_count: data.triangles.len() as u32,
            vertex_count: data.vertices.len() as u32,
            bounds: Aabb { min: [0.0; 3], max: [side, side, 6.0] },
            // None is a box: the block is the only one.
            sub_boxes: [[1, 1, 1, 0, 0, 0]; LANES],
            material_range: [0, 0],
        };
        (entry, data)
    }

    /// The triangles in each leaf of the tree in `slot`: ids and materials.
    fn leaves(slot: &[u8]) -> Vec<Vec<(TriangleId, MaterialId)>> {
        let fine = Fine::new(slot);
        let (groups, used) = fine.groups();
        let mut waiting: Vec<Child> =
            (0..LANES).filter(|lane| used >> lane & 1 == 1).map(|lane| groups[lane]).collect();
        let mut leaves = Vec::new();
        while let Some(child) = waiting.pop() {
            if child.is_leaf() {
                let places = (0..child.triangle_count()).map(|lane| TriangleLocation { leaf: child, lane });
                leaves.push(places.map(|at| (fine.id(at), fine.material(at))).collect());
                continue;
            }
            let node = fine.node(child);
            let lanes = (0..LANES).filter(|lane| node.bounds[0][*lane] <= node.bounds[3][*lane]);
            waiting.extend(lanes.map(|lane| node.children[lane]));
        }
        leaves
    }

    #[test]
    fn what_kernels_load_behind_the_rows_is_no_subnormal_number() {
        let (entry, mut data) = sheet();
        for (index, material) in data.materials.iter_mut().enumerate() {
            *material = (index % 3) as u16;
        }
        let count = data.triangles.len();
        let layout = FineLayout { expanded: true, scale: 1.0 };
        let bytes = layout.slot_bytes(count, data.vertices.len(), false).as_usize();
        // Whether ids fit in 32 bits, and numbers from the least one up.
        for far in [false, true] {
            if far {
                *data.ids.last_mut().unwrap() += 1 << 33;
            }
            let mut memory = vec![0u8; bytes + 64];
            let start = memory.as_ptr().align_offset(64);
            let slot = &mut memory[start..start + bytes];
            let mut scratch = BuildScratch::new(count, data.vertices.len());
            build(SimdLevel::best(), &entry, &data, (layout, TreeQuality::Best), slot, &mut scratch);
            let leaves_start = bytemuck::from_bytes::<Header>(&slot[..HEADER_BYTES]).leaves_start();
            let words: &[f32] = bytemuck::cast_slice(&slot[leaves_start..]);
            assert!(words.iter().any(|word| *word != 0.0));
            assert!(!words.iter().any(|word| word.is_subnormal()), "{far}");
            let mut seen: Vec<_> = leaves(slot).into_iter().flatten().collect();
            seen.sort();
            let stored = data.ids.iter().zip(&data.materials);
            assert!(
                seen.into_iter().eq(stored.map(|(id, material)| (TriangleId(*id), MaterialId(*material))))
            );
        }
    }

    #[test]
    fn leaves_hold_each_triangle_once_and_no_more_than_their_layout_likes() {
        let (entry, data) = sheet();
        let count = data.triangles.len();
        for (expanded, most) in [(true, LEAF_TRIANGLES_MAX), (false, INDEXED_LEAF_TRIANGLES_MAX)] {
            for quality in [TreeQuality::Finest, TreeQuality::Best, TreeQuality::Quick] {
                for level in [SimdLevel::Portable, SimdLevel::best()] {
                    let layout = FineLayout { expanded, scale: 1.0 };
                    let bytes = layout.slot_bytes(count, data.vertices.len(), false).as_usize();
                    let mut memory = vec![0u8; bytes + 64];
                    // Slots begin at a multiple of 64 bytes.
                    let start = memory.as_ptr().align_offset(64);
                    let slot = &mut memory[start..start + bytes];
                    let mut scratch = BuildScratch::new(count, data.vertices.len());
                    build(level, &entry, &data, (layout, quality), slot, &mut scratch);
                    let leaves = leaves(slot);
                    let longest = leaves.iter().map(Vec::len).max().unwrap();
                    assert!(longest <= most, "{longest} of {most}");
                    let mut ids: Vec<TriangleId> = leaves.into_iter().flatten().map(|(id, _)| id).collect();
                    ids.sort();
                    assert!(ids.into_iter().eq(data.ids.iter().map(|id| TriangleId(*id))));
                }
            }
        }
    }
}
