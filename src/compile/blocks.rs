//! A bucket to encoded blocks.

use super::bucket::Bucket;
use super::cut::{Box4, Cutter, Piece};
use super::point::{Point, Real};
use crate::block::{self, BlockInput, BlockLimits, Codec, EncodeScratch};
use crate::error::CompileError;
use crate::geom::{Aabb, Precision, is_degenerate};
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
    duplicates: DuplicateTable,
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
            duplicates: DuplicateTable::new(settings.limits),
            scratch: EncodeScratch::with_limits(settings.limits),
            stored: Vec::new(),
        }
    }

    /// Memory that making the blocks of a bucket of these counts takes at most, its own and the output's.
    pub(super) fn bytes_for(limits: BlockLimits, triangles: u64, vertices: u64) -> u64 {
        let per_triangle = size_of::<Box4<P::Real>>() as u64 + 3 * 4;
        let output = triangles * 10 + vertices * size_of::<P>() as u64;
        let block = u64::from(limits.block_bytes_max) * 8;
        triangles * per_triangle
            + vertices * 4
            + output
            + EncodeScratch::bytes_for(limits).0
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
            let real = |corner: usize| bucket.vertices[triangle[corner] as usize].real();
            Box4::of(real(0), real(1), real(2))
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
        self.vertices.clear();
        self.triangles.clear();
        self.ids.clear();
        self.materials.clear();
        let vertex_count_max = self.settings.limits.vertex_count_max();
        for &index in &self.cutter.order[piece.start..piece.start + piece.len] {
            let index = index as usize;
            let mut corners = [0; 3];
            for (corner, vertex) in corners.iter_mut().zip(bucket.triangles[index]) {
                let entry = &mut self.local_of[vertex as usize];
                if *entry >> 16 != number {
                    *entry = number << 16 | self.vertices.len() as u32;
                    self.vertices.push(bucket.vertices[vertex as usize]);
                }
                *corner = *entry as u16;
            }
            if self.vertices.len() > vertex_count_max {
                return false;
            }
            self.triangles.push(corners);
            self.ids.push(bucket.ids[index]);
            self.materials.push(bucket.materials[index]);
        }
        let wide = P::is_wide(&self.vertices, self.settings.precision);
        self.settings.limits.fits(self.vertices.len(), self.triangles.len(), wide)
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
        out.duplicates += self.duplicates.count(&self.triangles);
        out.degenerate += self.degenerate_count();
        // A coordinate times the unit is exact: 1, or a power of two with coordinates of at most 53 bits.
        let unit = self.settings.unit();
        let to_space =
            |bounds: &Aabb| Aabb { min: bounds.min.map(|x| x * unit), max: bounds.max.map(|x| x * unit) };
        let mut bounds = Aabb::EMPTY;
        for vertex in &self.vertices {
            bounds.grow(vertex.real().map(Real::to_f64));
        }
        let bounds = to_space(&bounds);
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
        let position = |corner: u16| {
            let [x, y, z] = self.vertices[usize::from(corner)].real();
            [x.to_f64(), y.to_f64(), z.to_f64()]
        };
        let mut count = 0;
        for &[a, b, c] in &self.triangles {
            count += u64::from(is_degenerate(&[position(a), position(b), position(c)]));
        }
        count
    }
}

/// Finds triangles of one block with the same three vertices, in any order.
struct DuplicateTable {
    /// `vertices << 16 | block number`: entries of earlier blocks need no clearing.
    slots: Vec<u64>,
    number: u64,
}

impl DuplicateTable {
    fn new(limits: BlockLimits) -> DuplicateTable {
        DuplicateTable { slots: vec![0; (2 * limits.triangle_count_max()).next_power_of_two()], number: 0 }
    }

    /// How many triangles have the vertices of one before them.
    fn count(&mut self, triangles: &[[u16; 3]]) -> u64 {
        self.number += 1;
        if self.number == 1 << 16 {
            self.slots.fill(0);
            self.number = 1;
        }
        let mask = self.slots.len() - 1;
        let mut duplicates = 0;
        for &[a, b, c] in triangles {
            let (low, high) = (a.min(b), a.max(b));
            let (a, b, c) = (low.min(c), low.max(c.min(high)), high.max(c));
            let entry = u64::from(a) << 48 | u64::from(b) << 32 | u64::from(c) << 16 | self.number;
            let hash = entry.wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let mut slot = (hash >> 32) as usize & mask;
            loop {
                if self.slots[slot] == entry {
                    duplicates += 1;
                    break;
                }
                if self.slots[slot] & 0xffff != self.number {
                    self.slots[slot] = entry;
                    break;
                }
                slot = (slot + 1) & mask;
            }
        }
        duplicates
    }
}
