//! A bucket read back: one list of vertices, merged by exact bits, and one of triangles.

use super::chunk::{Chunk, ChunkRecord};
use super::point::Point;
use super::spill::Spill;
use crate::error::CompileError;
use crate::simd::prefetch;

/// Most triangles that are read back as one bucket; larger ones are parted first.
pub(super) const BUCKET_TRIANGLES_MAX: u64 = 128 << 10;

/// Vertices whose places in the table are asked for at once.
const PREFETCHED: usize = 64;

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

/// Where the search for a vertex of this hash begins in a table of `2^length_bits` places: its first bits, which depend on all bits
/// of its coordinates. The last ones do not depend on those of whole numbers and of steps of an eighth, whose bits as floats end
/// with zeros.
#[inline(always)]
fn home(hash: u64, length_bits: u32) -> u32 {
    // In two steps, for tables of one place.
    (hash >> 32 >> (32 - length_bits)) as u32
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
    pub(super) fn bytes_needed(triangles: u64, vertices: u64) -> u64 {
        let table = 4 * (vertices + vertices / 3 + 1).next_power_of_two();
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
        // At most three quarters full; larger ones cost more in cache misses than they save in steps.
        self.table.clear();
        self.table.resize((vertices + vertices / 3 + 1).next_power_of_two(), 0);
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
        let length_bits = table.len().trailing_zeros();
        merged.clear();
        merged.resize(chunk.vertices.len(), 0);
        for (part, merged) in chunk.vertices.chunks(PREFETCHED).zip(merged.chunks_mut(PREFETCHED)) {
            // The table is larger than the first caches: ask for all places, then go there.
            for (slot, vertex) in merged.iter_mut().zip(part) {
                *slot = home(vertex.hash(), length_bits);
                prefetch(table, *slot as usize);
            }
            for (merged, &vertex) in merged.iter_mut().zip(part) {
                let mut slot = *merged as usize;
                *merged = loop {
                    match table[slot & mask] {
                        0 => {
                            vertices.push(vertex);
                            table[slot & mask] = vertices.len() as u32;
                            break vertices.len() as u32 - 1;
                        }
                        entry if vertices[entry as usize - 1].same(vertex) => break entry - 1,
                        _ => slot += 1,
                    }
                };
            }
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The steps that putting so many different vertices into a table takes for each.
    fn steps_per_vertex<P: Point>(vertices: &[P]) -> f64 {
        let length = (vertices.len() + vertices.len() / 3 + 1).next_power_of_two();
        let mut taken = vec![false; length];
        let mut steps = 0;
        for vertex in vertices {
            let mut slot = home(vertex.hash(), length.trailing_zeros()) as usize;
            while std::mem::replace(&mut taken[slot % length], true) {
                slot += 1;
                steps += 1;
            }
        }
        steps as f64 / vertices.len() as f64
    }

    #[test]
    fn whole_numbers_and_even_steps_are_spread_over_the_table() {
        let grid = |width: u32, count: u32, place: &dyn Fn(f32, f32) -> [f32; 3]| -> Vec<[f32; 3]> {
            (0..count).map(|i| place((i % width) as f32, (i / width) as f32)).collect()
        };
        let grids = [
            grid(220, 48_400, &|x, y| [x, y, 5.0]),
            grid(1024, 48_128, &|x, y| [x, y, 7.0]),
            grid(220, 48_400, &|x, y| [5.0, x, y]),
            grid(220, 48_400, &|x, y| [x, -3.0, y]),
            grid(220, 48_400, &|x, y| [x, y, (x * 7.0 + y * 3.0) % 16.0]),
            grid(220, 48_400, &|x, y| [0.1 * x, 0.1 * y, 0.0]),
            grid(220, 48_400, &|x, y| [0.125 * x - 9.0, 0.125 * y, 1.0]),
            grid(1, 30_000, &|_, y| [y, 0.0, 0.0]),
            grid(1, 30_000, &|_, y| [0.0, 0.0, y]),
        ];
        for (index, vertices) in grids.iter().enumerate() {
            let steps = steps_per_vertex(vertices);
            assert!(steps < 8.0, "{index}: {steps}");
            let on_lattice: Vec<[i64; 3]> =
                vertices.iter().map(|vertex| vertex.map(|x| (64.0 * x) as i64)).collect();
            let steps = steps_per_vertex(&on_lattice);
            assert!(steps < 8.0, "{index}, lattice: {steps}");
        }
        assert_eq!(home(u64::MAX, 0), 0);
    }
}
