//! A run of triangles of one bucket on its way through the spill, with its own vertices: reading it back needs
//! nothing else. Written and read by one process, so it has no version and no checksum.
//!
//! ```text
//! u16 vertices, u16 triangles, u16 escapes, u16 id runs, u16 material runs, 6 bytes 0, u64 first id
//! vertices    f32 x 3 or i64 x 3 each, distinct source vertices in first-use order
//! triangles   u8 x 3 each: how many vertices before the next new one (0 is that one itself); 255 for an escape
//! escapes     u16 each, for what does not fit
//! id runs     u32 gap since the end of the last run, u32 length
//! materials   u16 length, u16 material
//! ```

use super::point::Point;
use crate::error::CompileError;

/// Most triangles in a chunk, so that counts and indices fit in 16 bits.
pub(super) const CHUNK_TRIANGLES_MAX: usize = 1024;
const HEADER_BYTES: usize = 24;
/// A distance that stands among the escapes.
const ESCAPE: u8 = 255;
/// Slots of the table that finds a vertex again; at most three quarters full.
const TABLE_SLOTS: usize = 4 * CHUNK_TRIANGLES_MAX;

/// A triangle in the buffer of its bucket: three source vertices, and the distance of its id from the first in the buffer.
pub(super) type Buffered = [u32; 4];

/// Where a chunk is.
#[derive(Clone, Copy, Debug)]
pub(super) struct ChunkRecord {
    pub(super) offset: u64,
    pub(super) bytes: u32,
    pub(super) bucket: u32,
    /// Which spill it is in.
    pub(super) spill: u32,
    pub(super) triangles: u16,
    pub(super) vertices: u16,
}

/// Makes chunks; keeps its tables from one to the next.
#[derive(Debug)]
pub(super) struct ChunkWriter<P> {
    /// Vertex, local index and the number of the chunk: `stamp << 48 | local << 32 | vertex`. Old entries need no clearing.
    table: Box<[u64; TABLE_SLOTS]>,
    stamp: u64,
    vertices: Vec<P>,
    distances: Vec<[u8; 3]>,
    escapes: Vec<u16>,
    id_runs: Vec<[u32; 2]>,
    bytes: Vec<u8>,
}

impl<P: Point> ChunkWriter<P> {
    pub(super) fn new() -> ChunkWriter<P> {
        ChunkWriter {
            table: Box::new([0; TABLE_SLOTS]),
            stamp: 0,
            vertices: Vec::with_capacity(3 * CHUNK_TRIANGLES_MAX),
            distances: Vec::with_capacity(CHUNK_TRIANGLES_MAX),
            escapes: Vec::new(),
            id_runs: Vec::new(),
            bytes: Vec::new(),
        }
    }

    /// How many vertices the last chunk has.
    pub(super) fn vertex_count(&self) -> usize {
        self.vertices.len()
    }

    /// The bytes of a chunk of 1 to [`CHUNK_TRIANGLES_MAX`] triangles with ascending ids. `materials` are runs of (length, material).
    pub(super) fn write(
        &mut self,
        triangles: &[Buffered],
        first_id: u64,
        materials: &[[u16; 2]],
        mut lookup: impl FnMut(u32) -> Result<P, CompileError>,
    ) -> Result<&[u8], CompileError> {
        self.begin();
        let ChunkWriter { table, stamp, vertices, distances, escapes, id_runs, .. } = self;
        // The id that goes on with the last run.
        let mut next_id = 0;
        let mut run = [0; 2];
        for &[a, b, c, id] in triangles {
            let corners = [a, b, c];
            let mut distances_here = [0; 3];
            for corner in 0..3 {
                let vertex = corners[corner];
                match find(table, *stamp, vertex) {
                    Ok(local) => {
                        let far = vertices.len() as u16 - local;
                        distances_here[corner] = if far < u16::from(ESCAPE) {
                            far as u8
                        } else {
                            escapes.push(far);
                            ESCAPE
                        };
                    }
                    Err(slot) => {
                        table[slot] = *stamp << 48 | (vertices.len() as u64) << 32 | u64::from(vertex);
                        vertices.push(lookup(vertex)?);
                    }
                }
            }
            distances.push(distances_here);
            if id != next_id {
                if run[1] > 0 {
                    id_runs.push(run);
                }
                run = [id - next_id, 0];
            }
            run[1] += 1;
            // Nothing comes after the greatest.
            next_id = id.wrapping_add(1);
        }
        id_runs.push(run);
        let counts = [
            self.vertices.len(),
            self.distances.len(),
            self.escapes.len(),
            self.id_runs.len(),
            materials.len(),
        ];
        self.bytes.clear();
        for count in counts {
            self.bytes.extend_from_slice(&(count as u16).to_ne_bytes());
        }
        self.bytes.extend_from_slice(&[0; 6]);
        self.bytes.extend_from_slice(&first_id.to_ne_bytes());
        self.bytes.extend_from_slice(bytemuck::cast_slice(&self.vertices));
        self.bytes.extend_from_slice(self.distances.as_flattened());
        self.bytes.extend_from_slice(bytemuck::cast_slice(&self.escapes));
        self.bytes.extend_from_slice(bytemuck::cast_slice(&self.id_runs));
        self.bytes.extend_from_slice(bytemuck::cast_slice(materials));
        Ok(&self.bytes)
    }

    fn begin(&mut self) {
        self.stamp += 1;
        if self.stamp == 1 << 16 {
            self.table.fill(0);
            self.stamp = 1;
        }
        self.vertices.clear();
        self.distances.clear();
        self.escapes.clear();
        self.id_runs.clear();
    }
}

/// The local index of a vertex in the chunk of that stamp, or the slot to put it in.
#[inline(always)]
fn find(table: &[u64; TABLE_SLOTS], stamp: u64, vertex: u32) -> Result<u16, usize> {
    // Eight neighbours share a cache line. A step goes to the next line and the next place in it, so that it meets every slot.
    let line = (vertex >> 3).wrapping_mul(0x9e37_79b1) >> (32 - (TABLE_SLOTS / 8).trailing_zeros());
    let mut slot = (line << 3 | vertex & 7) as usize;
    loop {
        let entry = table[slot % TABLE_SLOTS];
        if entry >> 48 != stamp {
            return Err(slot % TABLE_SLOTS);
        }
        if entry as u32 == vertex {
            return Ok((entry >> 32) as u16);
        }
        slot += 9;
    }
}

/// A chunk taken apart; the vectors are reused.
#[derive(Debug, Default)]
pub(super) struct Chunk<P> {
    pub(super) vertices: Vec<P>,
    /// Indices of triangles.
    pub(super) triangles: Vec<[u16; 3]>,
    escapes: Vec<u16>,
    pub(super) id_runs: Vec<[u32; 2]>,
    pub(super) materials: Vec<[u16; 2]>,
    pub(super) first_id: u64,
}

impl<P: Point> Chunk<P> {
    pub(super) fn new() -> Chunk<P> {
        Chunk {
            vertices: Vec::new(),
            triangles: Vec::new(),
            escapes: Vec::new(),
            id_runs: Vec::new(),
            materials: Vec::new(),
            first_id: 0,
        }
    }

    /// Takes apart what [`ChunkWriter::write`] made; false if the bytes are something else.
    pub(super) fn read(&mut self, bytes: &[u8]) -> bool {
        let Some((header, mut rest)) = bytes.split_at_checked(HEADER_BYTES) else { return false };
        let count =
            |index: usize| usize::from(u16::from_ne_bytes([header[2 * index], header[2 * index + 1]]));
        if count(1) > CHUNK_TRIANGLES_MAX {
            return false;
        }
        self.first_id = bytemuck::pod_read_unaligned(&header[16..]);
        if !take(&mut rest, count(0), &mut self.vertices) {
            return false;
        }
        let Some((distances, mut rest)) = rest.split_at_checked(3 * count(1)) else { return false };
        take(&mut rest, count(2), &mut self.escapes)
            && take(&mut rest, count(3), &mut self.id_runs)
            && take(&mut rest, count(4), &mut self.materials)
            && rest.is_empty()
            && self.resolve(distances)
    }

    /// Whether a chunk that anyone may have written is one that [`ChunkWriter`] could have: as many ids and materials as triangles,
    /// ids that do not overflow, positions that a file can hold.
    pub(super) fn is_consistent(&self) -> bool {
        let count = self.triangles.len() as u64;
        let ids = self.id_runs.iter().try_fold((self.first_id, 0_u64), |(id, sum), &[gap, len]| {
            let end = id.checked_add(u64::from(gap))?.checked_add(u64::from(len))?;
            Some((end, sum + u64::from(len)))
        });
        let materials: u64 = self.materials.iter().map(|&[len, _]| u64::from(len)).sum();
        ids.is_some_and(|(_, sum)| sum == count)
            && materials == count
            && self.vertices.iter().all(|vertex| vertex.is_valid())
    }

    /// Turns distances into indices; false if one leads nowhere.
    fn resolve(&mut self, distances: &[u8]) -> bool {
        let (distances, _) = distances.as_chunks::<3>();
        let mut escapes = self.escapes.iter();
        let mut next = 0_u32;
        // Has its top bit set if an index is below zero: no other comes near that.
        let mut all = 0;
        self.triangles.resize(distances.len(), [0; 3]);
        for (corners, distances) in self.triangles.iter_mut().zip(distances) {
            for corner in 0..3 {
                let mut far = u32::from(distances[corner]);
                if far == u32::from(ESCAPE) {
                    far = u32::from(escapes.next().copied().unwrap_or(u16::MAX));
                }
                let index = next.wrapping_sub(far);
                all |= index;
                next += u32::from(far == 0);
                corners[corner] = index as u16;
            }
        }
        all >> 31 == 0 && next as usize == self.vertices.len()
    }
}

/// What a cell must know of a chunk that this process wrote: calls `vertex` for each vertex, and `material` for each material
/// in turn.
pub(super) fn survey<P: Point>(bytes: &[u8], mut vertex: impl FnMut(P), mut material: impl FnMut(u16)) {
    let count = |index: usize| usize::from(u16::from_ne_bytes([bytes[2 * index], bytes[2 * index + 1]]));
    let vertices = &bytes[HEADER_BYTES..HEADER_BYTES + count(0) * size_of::<P>()];
    for bytes in vertices.chunks_exact(size_of::<P>()) {
        vertex(bytemuck::pod_read_unaligned(bytes));
    }
    for run in bytes[bytes.len() - 4 * count(4)..].as_chunks::<4>().0 {
        material(u16::from_ne_bytes([run[2], run[3]]));
    }
}

/// Moves `count` items from the front of `bytes` to `into`.
fn take<T: bytemuck::Pod>(bytes: &mut &[u8], count: usize, into: &mut Vec<T>) -> bool {
    let Some((items, rest)) = bytes.split_at_checked(count * size_of::<T>()) else { return false };
    *bytes = rest;
    into.resize(count, T::zeroed());
    // A copy of bytes into typed memory: the bytes need not be aligned.
    bytemuck::cast_slice_mut(into).copy_from_slice(items);
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_may_be_as_far_apart_as_a_buffer_allows() {
        let mut writer = ChunkWriter::new();
        let corner = |vertex: u32| Ok([vertex as f32, 0.0, 0.0]);
        let triangles = [[0, 1, 2, 0], [2, 1, 3, 1], [0, 1, 3, u32::MAX]];
        let bytes = writer.write(&triangles, 5, &[[3, 0]], corner).unwrap();
        let mut chunk = Chunk::<[f32; 3]>::new();
        assert!(chunk.read(bytes) && chunk.is_consistent());
        assert_eq!((chunk.first_id, &chunk.id_runs[..]), (5, &[[0, 2], [u32::MAX - 2, 1]][..]));
    }
}
