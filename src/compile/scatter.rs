//! Triangles to buckets: each goes to the bucket of its centroid, and buckets are flushed as chunks.

use std::ops::Range;
use std::sync::Arc;

use super::chunk::{Buffered, CHUNK_TRIANGLES_MAX, ChunkRecord, ChunkWriter};
use super::grid::{BucketMap, is_valid};
use super::lookup::{Fault, Lookup, Work};
use super::point::Point;
use super::records::ChunkRecords;
use super::spill::{Spill, SpillPlace};

use crate::budget::Reservation;
use crate::error::{BudgetError, CompileError};
use crate::units::Bytes;

/// Fewest triangles in a bucket's buffer that still make useful chunks.
const BUFFER_TRIANGLES_MIN: usize = 32;

/// Triangles whose cells are found at once.
const BATCH: usize = 64;

/// The triangles of every bucket, in chunks.
#[derive(Debug)]
pub(super) struct Scattered<P> {
    /// One per thread that scattered; never empty.
    pub(super) spills: Vec<Spill>,
    pub(super) chunks: ChunkRecords,
    /// The chunks of each bucket that holds any, in octree order.
    pub(super) buckets: Vec<Range<usize>>,
    /// Source ordinals of triangles that were left out because they are not finite.
    pub(super) skipped: u64,
    pub(super) writer: ChunkWriter<P>,
}

impl<P: Point> Scattered<P> {
    /// Puts the buckets of several threads together. There must be at least one.
    pub(super) fn join(parts: Vec<Scattered<P>>) -> Result<Scattered<P>, BudgetError> {
        let mut parts = parts.into_iter();
        // The caller has started at least one thread, and each leaves a part.
        let mut joined = parts.next().expect("at least one part");
        for part in parts {
            let spill = joined.spills.len() as u32;
            joined.spills.extend(part.spills);
            joined.chunks.extend(part.chunks.iter().map(|chunk| ChunkRecord { spill, ..*chunk }))?;
            joined.skipped += part.skipped;
        }
        joined.chunks.sort_by_bucket(0);
        joined.buckets = ranges_by_bucket(&joined.chunks, 0);
        Ok(joined)
    }

    /// Bytes that went to temporary files.
    pub(super) fn spill_bytes(&self) -> u64 {
        self.spills.iter().map(Spill::file_bytes).sum()
    }
}

/// Takes triangles, one batch after the other.
#[derive(Debug)]
pub(super) struct Scatter<P> {
    map: Arc<BucketMap>,
    /// Grid cells per third of a point's unit: takes a sum of three vertices to the grid.
    scale: f64,
    /// Triangles per bucket in `buffers`.
    capacity: usize,
    buffers: Vec<Buffered>,
    buckets: Vec<Bucket>,
    writer: ChunkWriter<P>,
    /// Runs of (length, material) of the buffer that is written.
    runs: Vec<[u16; 2]>,
    spill: Spill,
    chunks: ChunkRecords,
    skip_not_finite: bool,
    skipped: u64,
    _reservation: Reservation,
}

/// The state of a bucket's buffer: triangles from its start on and, so that runs of materials take no memory of their own, closed runs
/// from its end on, four in the place of a triangle.
#[derive(Clone, Debug, Default)]
struct Bucket {
    first_id: u64,
    /// Triangles in it.
    len: u32,
    /// Places for triangles.
    room: u32,
    material: u16,
    /// Where the run starts that is not closed.
    run_start: u16,
    /// Closed runs.
    run_count: u16,
}

/// Closed runs in the place of a triangle.
const RUNS_PER_PLACE: u16 = 4;

impl Bucket {
    fn start(&mut self, id: u64, material: u16, capacity: usize) {
        // A buffer holds at most `CHUNK_TRIANGLES_MAX`.
        *self = Bucket { first_id: id, room: capacity as u32, material, ..Bucket::default() };
    }

    /// Closes the run if the buffer has room for that and for a triangle more.
    fn close_run(&mut self, material: u16, buffer: &mut [Buffered]) -> bool {
        let lane = self.run_count % RUNS_PER_PLACE;
        if lane == 0 {
            if self.len + 2 > self.room {
                return false;
            }
            self.room -= 1;
        }
        let run = (self.len - u32::from(self.run_start)) | u32::from(self.material) << 16;
        buffer[self.room as usize][usize::from(lane)] = run;
        self.run_count += 1;
        (self.material, self.run_start) = (material, self.len as u16);
        true
    }

    /// All runs, with the last.
    fn runs(&self, buffer: &[Buffered]) -> impl Iterator<Item = [u16; 2]> {
        let closed = buffer.iter().rev().flatten().take(usize::from(self.run_count));
        let last = [self.len as u16 - self.run_start, self.material];
        closed.map(|run| [*run as u16, (run >> 16) as u16]).chain([last])
    }
}

/// Triangles that the buffer of each of `count` buckets holds, if all of them may take `share` bytes.
fn capacity_for(count: usize, share: u64) -> usize {
    let fitting = share as usize / (count * size_of::<Buffered>());
    fitting.clamp(BUFFER_TRIANGLES_MIN, CHUNK_TRIANGLES_MAX)
}

fn buffer_bytes(count: usize, capacity: usize) -> usize {
    count * (capacity * size_of::<Buffered>() + size_of::<Bucket>())
}

/// The list of the chunks of so many triangles: up to two for each full buffer, as buffers are written before they are full, too.
fn list_bytes(count: usize, capacity: usize, triangles: u64) -> u64 {
    ChunkRecords::bytes_needed(2 * (triangles / capacity as u64) + count as u64)
}

/// What a [`Scatter`] of so many triangles needs of the budget, its spill apart, if its buffers may take `share` bytes: for them, and for
/// the list of chunks.
pub(super) fn bytes_needed(map: &BucketMap, share: u64, triangles: u64) -> [u64; 2] {
    let capacity = capacity_for(map.count(), share);
    [buffer_bytes(map.count(), capacity) as u64, list_bytes(map.count(), capacity, triangles)]
}

impl<P: Point> Scatter<P> {
    /// `unit` is the length of a coordinate step of `P`; `share` the bytes that the buffers may take. The spill leaves
    /// `spill_headroom` bytes of the budget alone, and what the list of the chunks of `triangles` triangles takes.
    pub(super) fn new(
        map: Arc<BucketMap>,
        unit: f64,
        place: SpillPlace,
        share: u64,
        (triangles, spill_headroom): (u64, u64),
        skip_not_finite: bool,
    ) -> Result<Scatter<P>, BudgetError> {
        let count = map.count();
        let capacity = capacity_for(count, share);
        let bytes = buffer_bytes(count, capacity);
        let reservation = place.budget.reserve(Bytes(bytes as u64), "the buffers of buckets")?;
        let chunks = ChunkRecords::new(&place.budget);
        let spill_headroom = spill_headroom + list_bytes(count, capacity, triangles);
        Ok(Scatter {
            scale: map.scale() * unit / 3.0,
            capacity,
            buffers: vec![[0; 4]; count * capacity],
            buckets: vec![Bucket::default(); count],
            writer: ChunkWriter::new(),
            runs: Vec::new(),
            spill: Spill::new(place, ".spill", spill_headroom)?,
            chunks,
            skip_not_finite,
            skipped: 0,
            _reservation: reservation,
            map,
        })
    }

    /// Places triangles with ids from `first_id` on.
    ///
    /// # Errors
    /// Spill cannot be written or read, or a triangle is not valid and may not be skipped.
    pub(super) fn add<L: Lookup<Point = P>>(
        &mut self,
        triangles: &[[u32; 3]],
        material: u16,
        first_id: u64,
        lookup: &mut L,
    ) -> Result<(), CompileError> {
        let mut sums = [[0.0; BATCH]; 3];
        let mut indices = [0; BATCH];
        for (triangles, first_id) in triangles.chunks(BATCH).zip((first_id..).step_by(BATCH)) {
            // First where they are, then all cells at once, then into the buffers.
            for (at, &triangle) in triangles.iter().enumerate() {
                let [a, b, c] = lookup.get_three(triangle)?;
                [sums[0][at], sums[1][at], sums[2][at]] = P::sum(a, b, c);
            }
            let are_valid = self.map.buckets(&sums, self.scale, &mut indices, triangles.len());
            for (at, &triangle) in triangles.iter().enumerate() {
                let id = first_id + at as u64;
                if !are_valid && !is_valid([sums[0][at], sums[1][at], sums[2][at]]) {
                    self.refuse(triangle, id, lookup)?;
                    continue;
                }
                let index = usize::from(indices[at]);
                let bucket = &mut self.buckets[index];
                let distance = id.wrapping_sub(bucket.first_id);
                // The first in its buffer, or one that does not go into it as it is.
                if bucket.len.wrapping_sub(1) >= bucket.room.wrapping_sub(1)
                    || bucket.material != material
                    || distance > u64::from(u32::MAX)
                {
                    self.add_odd(index, triangle, material, id, lookup)?;
                    continue;
                }
                let [a, b, c] = triangle;
                self.buffers[index * self.capacity + bucket.len as usize] = [a, b, c, distance as u32];
                bucket.len += 1;
            }
        }
        Ok(())
    }

    /// Leaves out a triangle that no file can hold, or says why not.
    #[cold]
    fn refuse<L: Lookup<Point = P>>(
        &mut self,
        triangle: [u32; 3],
        id: u64,
        lookup: &mut L,
    ) -> Result<(), CompileError> {
        match lookup.fault(triangle)? {
            Fault::NotFinite if self.skip_not_finite => {
                self.skipped += 1;
                Ok(())
            }
            Fault::NotFinite => Err(CompileError::NotFinite { triangle: id }),
            Fault::OutOfRange => {
                let reason = format!(
                    "triangle {id} has a coordinate outside the range of the chosen precision; choose a coarser lattice"
                );
                Err(CompileError::Limit { reason })
            }
        }
    }

    /// Places a triangle in a bucket whose buffer is empty, full or of another material.
    #[cold]
    fn add_odd<L: Lookup<Point = P>>(
        &mut self,
        index: usize,
        [a, b, c]: [u32; 3],
        material: u16,
        id: u64,
        lookup: &mut L,
    ) -> Result<(), CompileError> {
        let bucket = &mut self.buckets[index];
        let buffer = index * self.capacity..(index + 1) * self.capacity;
        let fits = bucket.len > 0
            && bucket.len < bucket.room
            && id - bucket.first_id <= u64::from(u32::MAX)
            && (bucket.material == material || bucket.close_run(material, &mut self.buffers[buffer.clone()]));
        if !fits {
            if bucket.len > 0 {
                self.flush(index, lookup)?;
            }
            self.buckets[index].start(id, material, self.capacity);
        }
        let bucket = &mut self.buckets[index];
        self.buffers[buffer][bucket.len as usize] = [a, b, c, (id - bucket.first_id) as u32];
        bucket.len += 1;
        Ok(())
    }

    fn flush<L: Lookup<Point = P>>(&mut self, index: usize, lookup: &mut L) -> Result<(), CompileError> {
        let bucket = &mut self.buckets[index];
        let len = bucket.len as usize;
        let buffer = &self.buffers[index * self.capacity..(index + 1) * self.capacity];
        self.runs.clear();
        self.runs.extend(bucket.runs(buffer));
        let bytes =
            self.writer.write(&buffer[..len], bucket.first_id, &self.runs, |vertex| lookup.get(vertex))?;
        let offset = self.spill.append(bytes)?;
        let bytes = bytes.len() as u32;
        let vertices = self.writer.vertex_count() as u16;
        self.chunks.push(ChunkRecord {
            offset,
            bytes,
            bucket: index as u32,
            spill: 0,
            triangles: len as u16,
            vertices,
        })?;
        bucket.len = 0;
        Ok(())
    }

    /// Flushes all buffers.
    pub(super) fn flush_all<L: Lookup<Point = P>>(&mut self, lookup: &mut L) -> Result<(), CompileError> {
        for index in 0..self.buckets.len() {
            if self.buckets[index].len > 0 {
                self.flush(index, lookup)?;
            }
        }
        Ok(())
    }

    fn finish<L: Lookup<Point = P>>(mut self, lookup: &mut L) -> Result<Scattered<P>, CompileError> {
        self.flush_all(lookup)?;
        // Chunks of a bucket stay in the order of ids.
        self.chunks.sort_by_bucket(0);
        Ok(Scattered {
            spills: vec![self.spill],
            buckets: ranges_by_bucket(&self.chunks, 0),
            chunks: self.chunks,
            skipped: self.skipped,
            writer: self.writer,
        })
    }
}

/// Placing a batch of triangles.
pub(super) struct AddBatch<'a, P> {
    pub(super) scatter: &'a mut Scatter<P>,
    pub(super) triangles: &'a [[u32; 3]],
    pub(super) material: u16,
    pub(super) first_id: u64,
}

impl<P: Point> Work<P> for AddBatch<'_, P> {
    type Output = Result<(), CompileError>;

    fn run<L: Lookup<Point = P>>(self, lookup: &mut L) -> Self::Output {
        self.scatter.add(self.triangles, self.material, self.first_id, lookup)
    }
}

/// Flushing what is left.
pub(super) struct FinishScatter<P>(pub(super) Scatter<P>);

impl<P: Point> Work<P> for FinishScatter<P> {
    type Output = Result<Scattered<P>, CompileError>;

    fn run<L: Lookup<Point = P>>(self, lookup: &mut L) -> Self::Output {
        self.0.finish(lookup)
    }
}

/// The ranges of equal buckets in `chunks[start..]`, which is sorted by bucket.
pub(super) fn ranges_by_bucket(chunks: &[ChunkRecord], mut start: usize) -> Vec<Range<usize>> {
    let groups = chunks[start..].chunk_by(|a, b| a.bucket == b.bucket);
    groups
        .map(|group| {
            start += group.len();
            start - group.len()..start
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a list would hold of the materials of triangles that come one by one, and what the buffer of a bucket does.
    #[test]
    fn runs_at_the_end_of_a_buffer_are_those_of_a_list() {
        const CAPACITY: usize = 40;
        // Runs of one, of two and of seven triangles.
        for period in [1, 2, 7] {
            let mut buffer = vec![[u32::MAX; 4]; CAPACITY];
            let mut bucket = Bucket::default();
            bucket.start(9, 0, CAPACITY);
            let mut expected: Vec<[u16; 2]> = vec![[0, 0]];
            for triangle in 0_u32.. {
                let material = (triangle / period) as u16 * 3;
                if bucket.len == bucket.room {
                    break;
                }
                if material != bucket.material {
                    if !bucket.close_run(material, &mut buffer) {
                        break;
                    }
                    expected.push([0, material]);
                }
                buffer[bucket.len as usize] = [triangle; 4];
                bucket.len += 1;
                expected.last_mut().unwrap()[0] += 1;
            }
            assert_eq!(bucket.runs(&buffer).collect::<Vec<_>>(), expected);
            let len = bucket.len as usize;
            assert!(buffer[..len].iter().zip(0..).all(|(place, triangle)| *place == [triangle; 4]));
            let places = len + expected.len().saturating_sub(1).div_ceil(4);
            assert!((CAPACITY - 1..=CAPACITY).contains(&places), "{places} of {CAPACITY} places are used");
        }
    }
}
