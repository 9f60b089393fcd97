//! A bucket read back: one list of vertices, merged by exact bits, and one of triangles.

use super::chunk::{Chunk, ChunkRecord};
use super::point::Point;
use super::spill::Spill;
use crate::error::CompileError;

/// Most triangles that are read back as one bucket; larger ones are parted first.
pub(super) const BUCKET_TRIANGLES_MAX: u64 = 128 << 10;

/// The triangles of a bucket; keeps its memory from one to the next.
#[derive(Debug)]
pub(super) struct Bucket<P> {
    pub(super) vertices: Vec<P>,
    pub(super) triangles: Vec<[u32; 3]>,
    pub(super) ids: Vec<u64>,
    pub(super) materials: Vec<u16>,
    /// Open addressing: vertex + 1, or 0.
    table: Vec<u32>,
    /// From a chunk's vertex to the bucket's.
    merged: Vec<u32>,
    chunk: Chunk<P>,
    bytes: Vec<u8>,
}

impl<P: Point> Bucket<P> {
    pub(super) fn new() -> Bucket<P> {
        Bucket {
            vertices: Vec::new(),
            triangles: Vec::new(),
            ids: Vec::new(),
            materials: Vec::new(),
            table: Vec::new(),
            merged: Vec::new(),
            chunk: Chunk::new(),
            bytes: Vec::new(),
        }
    }

    /// Memory that a bucket of these counts takes at most.
    pub(super) fn bytes_for(triangles: u64, vertices: u64) -> u64 {
        let table = 4 * (2 * vertices).next_power_of_two();
        vertices * size_of::<P>() as u64 + table + triangles * (12 + 8 + 2) + (256 << 10)
    }

    /// Reads chunks, in their order.
    pub(super) fn load(&mut self, spills: &[Spill], chunks: &[ChunkRecord]) -> Result<(), CompileError> {
        self.begin(chunks.iter().map(|chunk| usize::from(chunk.vertices)).sum());
        for record in chunks {
            self.bytes.resize(record.bytes as usize, 0);
            let spill = &spills[record.spill as usize];
            spill.read(record.offset, &mut self.bytes)?;
            if !self.chunk.read(&self.bytes) {
                return Err(spill.damaged());
            }
            self.add_chunk();
        }
        Ok(())
    }

    /// Empties the bucket and makes room for chunks with so many vertices.
    fn begin(&mut self, vertices: usize) {
        self.vertices.clear();
        self.triangles.clear();
        self.ids.clear();
        self.materials.clear();
        self.table.clear();
        self.table.resize((2 * vertices).next_power_of_two(), 0);
    }

    /// Reads a cell of a working file: chunks, each with its length before it. Nothing is believed (I5): false if the
    /// bytes are not chunks with these numbers of triangles and vertices.
    pub(super) fn load_cell(&mut self, mut bytes: &[u8], triangles: usize, vertices: usize) -> bool {
        self.begin(vertices);
        let mut vertices_left = vertices;
        while let Some((length, rest)) = bytes.split_first_chunk() {
            let Some((chunk, rest)) = rest.split_at_checked(u32::from_le_bytes(*length) as usize) else {
                return false;
            };
            bytes = rest;
            if !self.chunk.read(chunk)
                || !self.chunk.is_consistent()
                || self.triangles.len() + self.chunk.triangles.len() > triangles
                || self.chunk.vertices.len() > vertices_left
            {
                return false;
            }
            vertices_left -= self.chunk.vertices.len();
            self.add_chunk();
        }
        bytes.is_empty() && self.triangles.len() == triangles && vertices_left == 0
    }

    fn add_chunk(&mut self) {
        let Bucket { vertices, triangles, ids, materials, table, merged, chunk, .. } = self;
        let mask = table.len() - 1;
        merged.clear();
        for &vertex in &chunk.vertices {
            let mut slot = vertex.hash() as usize & mask;
            let index = loop {
                match table[slot] {
                    0 => {
                        vertices.push(vertex);
                        table[slot] = vertices.len() as u32;
                        break vertices.len() as u32 - 1;
                    }
                    entry if vertices[entry as usize - 1].same(vertex) => break entry - 1,
                    _ => slot = (slot + 1) & mask,
                }
            };
            merged.push(index);
        }
        let at = |corner: u16| merged[usize::from(corner)];
        triangles.extend(chunk.triangles.iter().map(|&[a, b, c]| [at(a), at(b), at(c)]));
        let mut id = chunk.first_id;
        for &[gap, len] in &chunk.id_runs {
            id += u64::from(gap);
            ids.extend(id..id + u64::from(len));
            id += u64::from(len);
        }
        for &[len, material] in &chunk.materials {
            materials.resize(materials.len() + usize::from(len), material);
        }
    }
}
