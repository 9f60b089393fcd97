//! A bucket to encoded blocks.

use super::bucket::Bucket;
use super::cut::{Box4, Cutter, Piece};
use super::point::{Point, Real};
use crate::block::{self, BlockInput, BlockLimits, Codec, EncodeScratch};
use crate::error::CompileError;
use crate::geom::{Aabb, Precision, count_degenerate};
use crate::model::{CellEntry, SubBoxes};

/// How blocks are to be made.
#[derive(Clone, Copy, Debug)]
pub(super) struct BlockSettings {
    pub(super) precision: Precision,
    pub(super) limits: BlockLimits,
    pub(super) codec: Codec,
}

impl BlockSettings {
    /// The length of a coordinate step.
    pub(super) fn unit(&self) -> f64 {
        match self.precision {
            Precision::Float32 => 1.0,
            Precision::Lattice(lattice) => lattice.step(),
        }
    }
}

/// What the directory needs to know about a block, and where its bytes end.
#[derive(Clone, Debug)]
pub(super) struct EncodedBlock {
    pub(super) end: usize,
    pub(super) triangle_count: u32,
    pub(super) vertex_count: u32,
    pub(super) bounds: Aabb,
    pub(super) sub_boxes: SubBoxes,
    pub(super) material_range: [u16; 2],
}

/// The blocks of a bucket.
#[derive(Debug, Default)]
pub(super) struct EncodedBucket {
    pub(super) bytes: Vec<u8>,
    pub(super) blocks: Vec<EncodedBlock>,
    pub(super) degenerate: u64,
    pub(super) duplicates: u64,
}

/// Makes blocks of one bucket after the other, in memory of its own.
pub(super) struct BlockMaker<P: Point> {
    settings: BlockSettings,
    cutter: Cutter<P::Real>,
    pieces: Vec<Piece>,
    /// Block number and local index of each of the bucket's vertices: `number << 16 | local`; number 0 is none.
    local_of: Vec<u32>,
    vertices: Vec<P>,
    triangles: Vec<[u16; 3]>,
    ids: Vec<u64>,
    materials: Vec<u16>,
    duplicates: Duplicates,
    scratch: EncodeScratch,
    stored: Vec<u8>,
}

impl<P: Point> BlockMaker<P> {
    pub(super) fn new(settings: BlockSettings) -> BlockMaker<P> {
        BlockMaker {
            settings,
            cutter: Cutter::new(),
            pieces: Vec::new(),
            local_of: Vec::new(),
            vertices: Vec::new(),
            triangles: Vec::new(),
            ids: Vec::new(),
            materials: Vec::new(),
            duplicates: Duplicates::default(),
            scratch: EncodeScratch::with_limits(settings.limits),
            stored: Vec::new(),
        }
    }

    /// Memory that making the blocks of a bucket of these counts takes at most, its own and the output's.
    pub(super) fn bytes_needed(limits: BlockLimits, triangles: u64, vertices: u64) -> u64 {
        let per_triangle = size_of::<Box4<P::Real>>() as u64 + 3 * 4;
        let output = triangles * 10 + vertices * size_of::<P>() as u64;
        let block = u64::from(limits.block_bytes_max) * 8;
        triangles * per_triangle
            + vertices * 4
            + output
            + EncodeScratch::bytes_needed(limits).0
            + block
            + (1 << 20)
    }

    /// Finds the pieces of a bucket.
    pub(super) fn cut(&mut self, bucket: &Bucket<P>) {
        let len_max = self.triangles_per_block(bucket);
        let cutter = &mut self.cutter;
        let count = bucket.triangles.len();
        cutter.boxes.clear();
        cutter.boxes.extend(bucket.triangles.iter().map(|triangle| {
            let [a, b, c] = *triangle;
            let quad = |vertex: u32| P::quad(&bucket.vertices, vertex as usize);
            Box4::of(quad(a), quad(b), quad(c))
        }));
        cutter.order.clear();
        cutter.order.extend(0..count as u32);
        if !bucket.ids.is_sorted() {
            // Runs of ascending ids, which a merge sort takes as they are.
            cutter.order.sort_by_key(|triangle| bucket.ids[*triangle as usize]);
        }
        self.pieces.clear();
        cutter.cut(0, count, len_max, &mut self.pieces);
    }

    /// Finds pieces again where [`BlockMaker::cut`] led to too many blocks: as few as can be promised for any triangles, each
    /// no larger than a block, along the order that is there.
    pub(super) fn cut_evenly(&mut self, bucket: &Bucket<P>) {
        let len_max = CellEntry::triangles_that_always_fit(self.settings.limits);
        self.pieces.clear();
        self.cutter.cut_evenly(0, bucket.triangles.len(), len_max, &mut self.pieces);
    }

    /// How many triangles should go into a block: as many as fit if its share of vertices is that of the bucket, and
    /// those on its border.
    fn triangles_per_block(&self, bucket: &Bucket<P>) -> usize {
        let limits = self.settings.limits;
        let (vertices, triangles) = (bucket.vertices.len(), bucket.triangles.len());
        if limits.fits(vertices, triangles, false)
            && limits.fits(vertices, triangles, P::is_wide(&bucket.vertices, self.settings.precision))
        {
            return triangles;
        }
        let ratio = vertices as f64 / triangles as f64;
        let bytes = 10.0 + 12.0 * ratio * 1.06;
        ((f64::from(limits.block_bytes_max) / bytes) as usize).clamp(1, limits.triangle_count_max())
    }

    /// Encodes the pieces that [`BlockMaker::cut`] found. A piece that is larger than a block is cut again.
    pub(super) fn encode(&mut self, bucket: &Bucket<P>, out: &mut EncodedBucket) -> Result<(), CompileError> {
        out.bytes.clear();
        out.blocks.clear();
        (out.degenerate, out.duplicates) = (0, 0);
        self.local_of.clear();
        self.local_of.resize(bucket.vertices.len(), 0);
        let mut number = 0;
        // From the end, so that the parts of a piece come to stand where it stood.
        self.pieces.reverse();
        while let Some(piece) = self.pieces.pop() {
            number += 1;
            if number == 1 << 16 {
                self.local_of.fill(0);
                number = 1;
            }
            if self.gather(bucket, &piece, number) {
                self.encode_block(&piece, out)?;
            } else {
                let mut parts = Vec::new();
                self.cutter.cut(piece.start, piece.len, piece.len.div_ceil(2), &mut parts);
                self.pieces.extend(parts.into_iter().rev());
            }
        }
        Ok(())
    }

    /// Collects the block of a piece; false if it is larger than a block may be.
    fn gather(&mut self, bucket: &Bucket<P>, piece: &Piece, number: u32) -> bool {
        let BlockMaker { settings, cutter, local_of, vertices, triangles, ids, materials, .. } = self;
        vertices.clear();
        triangles.clear();
        ids.clear();
        materials.clear();
        let order = &cutter.order[piece.start..piece.start + piece.len];
        // No piece has more triangles than a block may have, so that even three times as many vertices have 16-bit numbers.
        debug_assert!(3 * piece.len < 1 << 16);
        triangles.resize(piece.len, [0; 3]);
        // Loops over slices and numbers of their own: what a closure has by reference is loaded and stored again and again.
        let (all, local_of) = (&bucket.vertices[..], &mut local_of[..]);
        for (corners, &index) in triangles.iter_mut().zip(order) {
            let triangle = bucket.triangles[index as usize];
            for corner in 0..3 {
                let vertex = triangle[corner] as usize;
                let entry = &mut local_of[vertex];
                if *entry >> 16 != number {
                    *entry = number << 16 | vertices.len() as u32;
                    vertices.push(all[vertex]);
                }
                corners[corner] = *entry as u16;
            }
        }
        ids.extend(order.iter().map(|&index| bucket.ids[index as usize]));
        materials.extend(order.iter().map(|&index| bucket.materials[index as usize]));
        let wide = P::is_wide(vertices, settings.precision);
        settings.limits.fits(vertices.len(), triangles.len(), wide)
    }

    fn encode_block(&mut self, piece: &Piece, out: &mut EncodedBucket) -> Result<(), CompileError> {
        let BlockSettings { precision, limits, codec } = self.settings;
        let input = BlockInput {
            vertices: P::input(&self.vertices),
            triangles: &self.triangles,
            ids: &self.ids,
            materials: &self.materials,
        };
        block::encode(&input, precision, limits, codec, &mut self.scratch, &mut self.stored)?;
        out.bytes.extend_from_slice(&self.stored);
        out.duplicates += self.duplicates.count(&self.triangles, self.vertices.len());
        out.degenerate += self.degenerate_count();
        // A coordinate times the unit is exact: 1, or a power of two with coordinates of at most 53 bits.
        let unit = self.settings.unit();
        let to_space =
            |bounds: &Aabb| Aabb { min: bounds.min.map(|x| x * unit), max: bounds.max.map(|x| x * unit) };
        let mut bounds = Box4::<P::Real>::empty();
        for vertex in 0..self.vertices.len() {
            bounds.grow(P::quad(&self.vertices, vertex));
        }
        let bounds = to_space(&bounds.to_aabb());
        let sub_boxes = piece.sub_boxes.map(|part| to_space(&part));
        let materials = self.materials.iter();
        let range =
            materials.fold([u16::MAX, 0], |[min, max], &material| [min.min(material), max.max(material)]);
        out.blocks.push(EncodedBlock {
            end: out.bytes.len(),
            triangle_count: self.triangles.len() as u32,
            vertex_count: self.vertices.len() as u32,
            bounds,
            sub_boxes: SubBoxes::quantize(&bounds, &sub_boxes),
            material_range: range,
        });
        Ok(())
    }

    /// Triangles of exactly zero area.
    fn degenerate_count(&self) -> u64 {
        count_degenerate(&self.triangles, |corner| self.vertices[usize::from(corner)].real(), Real::to_f64)
    }
}

/// Finds triangles of one block with the same three vertices, in any order.
///
/// Triangles whose greatest vertex is the same stand in a list. Vertices are numbered in the order of their first use, so that most
/// triangles are alone in theirs, and what is looked at lies close together.
#[derive(Default)]
struct Duplicates {
    /// The last triangle in the list of each vertex, or [`NO_TRIANGLE`].
    last: Vec<u16>,
    /// Of each triangle: the other two vertices, and the triangle before it in its list.
    links: Vec<([u16; 2], u16)>,
    /// The triangles, each with its vertices in order, where lists are too long.
    sorted: Vec<[u16; 3]>,
}

/// Steps along lists for each triangle of a block, on average, beyond which its triangles are sorted instead: many share their
/// greatest vertex then.
const STEPS_MAX: usize = 8;

/// More than any block has.
const NO_TRIANGLE: u16 = u16::MAX;

/// The vertices of a triangle, the least first.
#[inline(always)]
fn in_order([a, b, c]: [u16; 3]) -> [u16; 3] {
    let (low, high) = (a.min(b), a.max(b));
    [low.min(c), low.max(c.min(high)), high.max(c)]
}

impl Duplicates {
    /// How many triangles have the vertices of one before them. All vertices are below `vertex_count`.
    fn count(&mut self, triangles: &[[u16; 3]], vertex_count: usize) -> u64 {
        self.last.clear();
        self.last.resize(vertex_count, NO_TRIANGLE);
        self.links.resize(triangles.len(), ([0; 2], NO_TRIANGLE));
        let (last, links) = (&mut self.last[..], &mut self.links[..]);
        let (mut duplicates, mut steps_left) = (0, STEPS_MAX * triangles.len());
        for (index, &triangle) in triangles.iter().enumerate() {
            let [low, middle, high] = in_order(triangle);
            let others = [low, middle];
            let last = &mut last[usize::from(high)];
            let mut earlier = *last;
            while earlier != NO_TRIANGLE {
                if steps_left == 0 {
                    return self.count_sorted(triangles);
                }
                steps_left -= 1;
                let (vertices, before) = links[usize::from(earlier)];
                if vertices == others {
                    duplicates += 1;
                    break;
                }
                earlier = before;
            }
            links[index] = (others, *last);
            *last = index as u16;
        }
        duplicates
    }

    /// [`Duplicates::count`], whatever the triangles share.
    fn count_sorted(&mut self, triangles: &[[u16; 3]]) -> u64 {
        self.sorted.clear();
        self.sorted.extend(triangles.iter().map(|&triangle| in_order(triangle)));
        self.sorted.sort_unstable();
        self.sorted.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    #[test]
    fn duplicates_are_counted_as_a_set_does() {
        let mut random = Random::new(9);
        let mut duplicates = Duplicates::default();
        for round in 0..300 {
            // Few vertices and many triangles, and the other way round; also corners that coincide.
            let vertices = 1 + random.next_u64() as usize % [6, 40, 900][round % 3];
            let count = random.next_u64() as usize % 200;
            let mut triangles: Vec<[u16; 3]> =
                (0..count).map(|_| [0; 3].map(|_| (random.next_u64() as usize % vertices) as u16)).collect();
            if round % 10 == 9 {
                // All about one hub, so that all lists are one.
                triangles.iter_mut().for_each(|[_, b, _]| *b = vertices as u16);
            }
            let sets: std::collections::HashSet<[u16; 3]> = triangles
                .iter()
                .map(|triangle| {
                    let mut sorted = *triangle;
                    sorted.sort_unstable();
                    sorted
                })
                .collect();
            let found = duplicates.count(&triangles, vertices + 1);
            assert_eq!(found, (count - sets.len()) as u64);
            assert_eq!(duplicates.count_sorted(&triangles), found);
        }
    }
}
