//! Buckets that came out too large (geometry much denser than its vertices promised, or one far outlier that made the
//! grid coarse) are parted again, each with a grid of its own.

use std::ops::Range;

use super::bucket::{BUCKET_TRIANGLES_MAX, Bucket};
use super::chunk::{Buffered, CHUNK_TRIANGLES_MAX, ChunkRecord};
use super::point::Point;
use super::scatter::{Scattered, ranges_by_bucket};
use crate::error::CompileError;

/// Cells per side of the grid over one bucket; a power of two.
const SIDE: usize = 32;
/// Triangles that a part should not exceed.
const PART_TRIANGLES: u64 = BUCKET_TRIANGLES_MAX / 2;

/// Sum of the triangles of chunks.
pub(super) fn triangle_count(chunks: &[ChunkRecord]) -> u64 {
    chunks.iter().map(|chunk| u64::from(chunk.triangles)).sum()
}

/// Parts every bucket of more than [`BUCKET_TRIANGLES_MAX`] triangles. `go_on` is asked between passes.
pub(super) fn refine<P: Point>(
    scattered: &mut Scattered<P>,
    bucket: &mut Bucket<P>,
    mut go_on: impl FnMut() -> Result<(), CompileError>,
) -> Result<(), CompileError> {
    let mut done = Vec::with_capacity(scattered.buckets.len());
    // Taken from the end, so that parts come to stand where their bucket stood.
    let mut open: Vec<Range<usize>> = scattered.buckets.drain(..).rev().collect();
    while let Some(range) = open.pop() {
        if triangle_count(&scattered.chunks[range.clone()]) <= BUCKET_TRIANGLES_MAX {
            done.push(range);
            continue;
        }
        go_on()?;
        let grid = Grid::over(scattered, bucket, range.clone())?;
        let parts = part(scattered, bucket, range, &grid)?;
        open.extend(parts.into_iter().rev());
    }
    scattered.buckets = done;
    Ok(())
}

/// Ranges of chunks with at most [`PART_TRIANGLES`] each (or one chunk), to be read one after the other.
fn segments(chunks: &[ChunkRecord], range: Range<usize>) -> Vec<Range<usize>> {
    let mut parts = Vec::new();
    let (mut start, mut count) = (range.start, 0);
    for index in range.clone() {
        let triangles = u64::from(chunks[index].triangles);
        if count + triangles > PART_TRIANGLES && index > start {
            parts.push(start..index);
            (start, count) = (index, 0);
        }
        count += triangles;
    }
    parts.push(start..range.end);
    parts
}

/// Cells over a bucket, and the part that each belongs to. Everything in it depends on the set of triangles alone.
struct Grid {
    kind: Kind,
    part_of: Vec<u32>,
}

/// What the cells are cells of.
enum Kind {
    /// Centroids; in Morton order, so that neighbouring cells come into one part.
    Place { min: [f64; 3], scale: [f64; 3] },
    /// Ids, where all centroids coincide.
    Ids { min: u64, scale: f64 },
}

impl Grid {
    /// Two passes over the bucket, which must have at least two triangles. There are at least two parts if there are
    /// more than [`PART_TRIANGLES`] triangles: the ends of the range lie in different cells.
    fn over<P: Point>(
        scattered: &Scattered<P>,
        bucket: &mut Bucket<P>,
        range: Range<usize>,
    ) -> Result<Grid, CompileError> {
        let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        let (mut id_min, mut id_max) = (u64::MAX, 0);
        for_each(scattered, bucket, range.clone(), |sum, id| {
            for axis in 0..3 {
                min[axis] = min[axis].min(sum[axis]);
                max[axis] = max[axis].max(sum[axis]);
            }
            (id_min, id_max) = (id_min.min(id), id_max.max(id));
        })?;
        let scale = [0, 1, 2].map(|axis| {
            let scale = SIDE as f64 / (max[axis] - min[axis]);
            if scale.is_finite() { scale } else { 0.0 }
        });
        let kind = if scale == [0.0; 3] {
            Kind::Ids { min: id_min, scale: (SIDE * SIDE * SIDE) as f64 / (id_max - id_min).max(1) as f64 }
        } else {
            Kind::Place { min, scale }
        };
        let mut grid = Grid { kind, part_of: vec![0; SIDE * SIDE * SIDE] };
        let mut counts = vec![0_u64; SIDE * SIDE * SIDE];
        for_each(scattered, bucket, range, |sum, id| counts[grid.cell(sum, id)] += 1)?;
        let (mut part, mut sum) = (0, 0);
        for (count, part_of) in counts.iter().zip(&mut grid.part_of) {
            if sum > 0 && sum + count > PART_TRIANGLES {
                (part, sum) = (part + 1, 0);
            }
            sum += count;
            *part_of = part;
        }
        Ok(grid)
    }

    /// The cell of a triangle.
    fn cell(&self, sum: [f64; 3], id: u64) -> usize {
        match self.kind {
            Kind::Ids { min, scale } => (((id - min) as f64 * scale) as usize).min(SIDE * SIDE * SIDE - 1),
            Kind::Place { min, scale } => {
                let mut code = 0;
                for axis in 0..3 {
                    let at = (((sum[axis] - min[axis]) * scale[axis]) as usize).min(SIDE - 1);
                    for bit in 0..SIDE.trailing_zeros() as usize {
                        code |= (at >> bit & 1) << (3 * bit + axis);
                    }
                }
                code
            }
        }
    }
}

fn for_each<P: Point>(
    scattered: &Scattered<P>,
    bucket: &mut Bucket<P>,
    range: Range<usize>,
    mut take: impl FnMut([f64; 3], u64),
) -> Result<(), CompileError> {
    for segment in segments(&scattered.chunks, range) {
        bucket.load(&scattered.spills, &scattered.chunks[segment])?;
        for (triangle, id) in bucket.triangles.iter().zip(&bucket.ids) {
            take(sum(bucket, triangle), *id);
        }
    }
    Ok(())
}

fn sum<P: Point>(bucket: &Bucket<P>, triangle: &[u32; 3]) -> [f64; 3] {
    let [a, b, c] = triangle.map(|vertex| bucket.vertices[vertex as usize]);
    P::sum(a, b, c)
}

/// Writes the bucket again, part by part; returns the chunks of each.
fn part<P: Point>(
    scattered: &mut Scattered<P>,
    bucket: &mut Bucket<P>,
    range: Range<usize>,
    grid: &Grid,
) -> Result<Vec<Range<usize>>, CompileError> {
    let first_chunk = scattered.chunks.len();
    let mut keyed: Vec<(u32, u32)> = Vec::new();
    let mut buffer: Vec<Buffered> = Vec::new();
    let mut materials: Vec<[u16; 2]> = Vec::new();
    for segment in segments(&scattered.chunks, range) {
        bucket.load(&scattered.spills, &scattered.chunks[segment])?;
        keyed.clear();
        keyed.extend((0..).zip(&bucket.triangles).map(|(index, triangle)| {
            let cell = grid.cell(sum(bucket, triangle), bucket.ids[index as usize]);
            (grid.part_of[cell], index)
        }));
        // Chunks hold ascending ids; those of several threads come in turns.
        keyed.sort_unstable_by_key(|&(part, index): &(u32, u32)| (part, bucket.ids[index as usize]));
        for group in keyed.chunk_by(|a, b| a.0 == b.0) {
            let mut rest = group;
            while let Some(&(part, first)) = rest.first() {
                let first_id = bucket.ids[first as usize];
                buffer.clear();
                materials.clear();
                for &(_, index) in rest.iter().take(CHUNK_TRIANGLES_MAX) {
                    let index = index as usize;
                    let Ok(delta) = u32::try_from(bucket.ids[index] - first_id) else { break };
                    let [a, b, c] = bucket.triangles[index];
                    buffer.push([a, b, c, delta]);
                    match materials.last_mut() {
                        Some(run) if run[1] == bucket.materials[index] => run[0] += 1,
                        _ => materials.push([1, bucket.materials[index]]),
                    }
                }
                rest = &rest[buffer.len()..];
                let lookup = |vertex: u32| Ok(bucket.vertices[vertex as usize]);
                let bytes = scattered.writer.write(&buffer, first_id, &materials, lookup)?;
                let offset = scattered.spills[0].append(bytes)?;
                let bytes = bytes.len() as u32;
                let vertices = scattered.writer.vertex_count() as u16;
                let triangles = buffer.len() as u16;
                scattered.chunks.push(ChunkRecord {
                    offset,
                    bytes,
                    bucket: part,
                    spill: 0,
                    triangles,
                    vertices,
                })?;
            }
        }
    }
    scattered.chunks.sort_by_bucket(first_chunk);
    Ok(ranges_by_bucket(&scattered.chunks, first_chunk))
}
