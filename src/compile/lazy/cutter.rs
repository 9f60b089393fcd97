//! Cells to blocks, whatever the form of their vertices.

use super::super::blocks::{BlockMaker, BlockSettings, EncodedBlock, EncodedBucket};
use super::super::bucket::Bucket;
use super::super::parallel::Worker;
use super::super::point::Point;
use super::working_file::WorkingFile;
use crate::block;
use crate::error::CompileError;
use crate::geom::Precision;
use crate::model::{BlockEntry, CellEntry, CellRecord};

/// Cuts one cell after the other, in memory of its own.
pub(super) struct Cutter {
    worker: AnyWorker,
    bytes: Vec<u8>,
    /// The blocks of the last cell.
    pub bucket: EncodedBucket,
    /// For what is made of the blocks.
    pub record: Vec<u8>,
}

/// A [`Worker`] for the file's form of vertices.
enum AnyWorker {
    Float32(Worker<[f32; 3]>),
    Lattice(Worker<[i64; 3]>),
}

impl Cutter {
    pub fn new(settings: BlockSettings) -> Cutter {
        let worker = match settings.precision {
            Precision::Float32 => AnyWorker::Float32(Worker::new(settings)),
            Precision::Lattice(_) => AnyWorker::Lattice(Worker::new(settings)),
        };
        Cutter { worker, bytes: Vec::new(), bucket: EncodedBucket::default(), record: Vec::new() }
    }

    /// Memory that cutting any of `cells` takes at most.
    pub fn bytes_needed(settings: BlockSettings, cells: &[CellRecord]) -> u64 {
        fn of<P: Point>(settings: BlockSettings, triangles: u64, vertices: u64) -> u64 {
            Bucket::<P>::bytes_needed(triangles, vertices)
                + BlockMaker::<P>::bytes_needed(settings.limits, triangles, vertices)
                // The blocks once more, as a record of the log.
                + triangles * 10
                + vertices * size_of::<P>() as u64
        }
        let triangles = cells.iter().map(|cell| u64::from(cell.triangle_count)).max().unwrap_or(0);
        let vertices = cells.iter().map(|cell| u64::from(cell.vertex_count)).max().unwrap_or(0);
        let bytes = cells.iter().map(|cell| cell.bytes).max().unwrap_or(0);
        bytes
            + match settings.precision {
                Precision::Float32 => of::<[f32; 3]>(settings, triangles, vertices),
                Precision::Lattice(_) => of::<[i64; 3]>(settings, triangles, vertices),
            }
    }

    /// Reads the triangles of a cell and makes its blocks, into `bucket`.
    ///
    /// # Errors
    /// [`CompileError::WorkingFile`] if the triangles are not those that were written.
    pub fn cut(
        &mut self,
        working: &WorkingFile,
        record: &CellRecord,
        cell: &CellEntry,
    ) -> Result<(), CompileError> {
        // `CellRecord` was checked against what its triangles can take.
        self.bytes.resize(record.bytes as usize, 0);
        working.read(record.offset, &mut self.bytes)?;
        if block::checksum(&self.bytes) != record.checksum {
            return Err(working.damaged(record.offset, "the checksum of a cell's triangles is wrong"));
        }
        let counts = (record.triangle_count as usize, record.vertex_count as usize);
        let blocks_max = cell.block_count_max as usize;
        let (bytes, bucket) = (&self.bytes, &mut self.bucket);
        let is_cell = match &mut self.worker {
            AnyWorker::Float32(worker) => worker.make_cell(bytes, counts, blocks_max, bucket),
            AnyWorker::Lattice(worker) => worker.make_cell(bytes, counts, blocks_max, bucket),
        };
        // An error here is of bytes that nobody wrote: those that were written came from triangles that can be encoded.
        let is_cell = is_cell.map_err(|error| working.damaged(record.offset, error.to_string()))?;
        let mut bounds = crate::geom::Aabb::EMPTY;
        self.bucket.blocks.iter().for_each(|block| bounds.merge(&block.bounds));
        let [low, high] = record.material_range;
        let materials_fit =
            |block: &EncodedBlock| block.material_range[0] >= low && block.material_range[1] <= high;
        if !is_cell
            || bounds != record.bounds
            || self.bucket.blocks.len() > blocks_max
            || !self.bucket.blocks.iter().all(materials_fit)
        {
            return Err(working.damaged(record.offset, "a cell's triangles are not what its record says"));
        }
        Ok(())
    }

    /// The directory entries of the blocks in `bucket`, if they are stored from `offset` on.
    pub fn entries(&self, offset: u64) -> impl Iterator<Item = BlockEntry> + '_ {
        let mut start = 0;
        self.bucket.blocks.iter().map(move |block| {
            let stored = &self.bucket.bytes[start..block.end];
            let entry = BlockEntry {
                offset: offset + start as u64,
                stored_bytes: stored.len() as u32,
                checksum: block::checksum(stored),
                triangle_count: block.triangle_count,
                vertex_count: block.vertex_count,
                bounds: block.bounds,
                sub_boxes: block.sub_boxes.0,
                material_range: block.material_range,
            };
            start = block.end;
            entry
        })
    }
}
