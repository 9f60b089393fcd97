//! The compiled file while it is written: under a temporary name, its header last.

use std::path::{Path, PathBuf};

use super::blocks::EncodedBucket;
use super::options::{CompileReport, PhaseSeconds};
use super::precision::Decision;
use super::temporary::{DiskQuota, TemporaryFile, write_at};
use crate::block::attributes::PageCheck;
use crate::block::{BlockLimits, Codec};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::CompileError;
use crate::geom::Precision;
use crate::model::{CompileRecord, MaterialRecord, ModelWriter, NewBlock, SourceRecord};
use crate::units::Bytes;

/// Bytes that are gathered before they are written.
const BUFFER_BYTES: usize = 1 << 20;
/// Blocks for which memory is reserved at once at least.
const DIRECTORY_STEP: usize = 1024;

/// Writes blocks one after the other, and seals the file.
#[derive(Debug)]
pub(super) struct Output {
    path: PathBuf,
    file: TemporaryFile,
    quota: DiskQuota,
    writer: ModelWriter,
    buffer: Vec<u8>,
    /// Where in the file the buffer goes.
    buffer_offset: u64,
    vertices: u64,
    degenerate: u64,
    duplicates: u64,
    budget: MemoryBudget,
    /// For the directory, and for its bytes when the file is sealed.
    memory: Vec<Reservation>,
    /// Blocks that `memory` has room for.
    room: usize,
}

/// What a sealed file holds, as in [`CompileReport`](super::CompileReport).
#[derive(Debug)]
pub(super) struct Written {
    pub triangles: u64,
    pub blocks: u32,
    pub vertices: u64,
    pub file_bytes: u64,
    pub degenerate: u64,
    pub duplicates: u64,
}

impl Written {
    /// A report of what is in the file; what making it took is left at zero.
    pub(super) fn report(&self, decision: Decision, error_bound: f64, codec: Codec) -> CompileReport {
        let &Written { triangles, blocks, vertices, file_bytes, degenerate, duplicates } = self;
        CompileReport {
            triangles,
            blocks,
            vertices,
            file_bytes,
            bytes_per_triangle: file_bytes as f64 / triangles as f64,
            degenerate,
            duplicates,
            skipped: 0,
            import: None,
            triangles_with_attributes: 0,
            attribute_bytes: 0,
            precision: decision.precision,
            error_bound,
            tolerance_met: decision.tolerance_met,
            codec,
            seconds: PhaseSeconds::default(),
            spill_bytes: 0,
            budget_peak: Bytes(0),
        }
    }
}

impl Output {
    pub(super) fn create(
        path: &Path,
        quota: DiskQuota,
        precision: Precision,
        limits: BlockLimits,
        budget: &MemoryBudget,
    ) -> Result<Output, CompileError> {
        let writer = ModelWriter::new(precision, limits)?;
        let file = TemporaryFile::beside(path, ".partial")?;
        Ok(Output {
            path: path.to_path_buf(),
            file,
            quota,
            buffer: Vec::with_capacity(BUFFER_BYTES),
            buffer_offset: writer.next_offset(),
            writer,
            vertices: 0,
            degenerate: 0,
            duplicates: 0,
            budget: budget.clone(),
            memory: Vec::new(),
            room: 0,
        })
    }

    /// What the directory of `blocks` blocks takes of the budget.
    pub(super) fn directory_bytes(blocks: u64) -> u64 {
        // As entries, which come to be copied when the list grows, and as bytes at the end.
        blocks * 2 * ModelWriter::BYTES_PER_BLOCK
    }

    /// Reserves memory for one more block.
    fn make_room(&mut self) -> Result<(), CompileError> {
        if self.writer.block_count() == self.room {
            // By a part of what there is, not to twice its size.
            let count = DIRECTORY_STEP.max(self.room / 8);
            let bytes = Output::directory_bytes(count as u64);
            // Where others have left no room it grows uncounted: a compile that has come so far is not refused for it.
            self.memory.extend(self.budget.reserve(Bytes(bytes), "the directory of the compiled file").ok());
            self.room += count;
            self.writer.reserve(count);
        }
        Ok(())
    }

    /// Triangles of all blocks so far.
    pub(super) fn triangles(&self) -> u64 {
        self.writer.triangle_count()
    }

    pub(super) fn write_bucket(&mut self, bucket: &EncodedBucket) -> Result<(), CompileError> {
        self.degenerate += bucket.degenerate;
        self.duplicates += bucket.duplicates;
        let mut start = 0;
        for block in &bucket.blocks {
            let stored = &bucket.bytes[start..block.end];
            start = block.end;
            self.make_room()?;
            self.writer.push(&NewBlock {
                stored,
                triangle_count: block.triangle_count,
                vertex_count: block.vertex_count,
                bounds: block.bounds,
                sub_boxes: block.sub_boxes,
                material_range: block.material_range,
            })?;
            self.vertices += u64::from(block.vertex_count);
            if self.buffer.len() + stored.len() > BUFFER_BYTES {
                self.flush()?;
            }
            self.buffer.extend_from_slice(stored);
        }
        Ok(())
    }

    /// Reserves memory for the directory of `count` pages of attributes.
    pub(super) fn reserve_pages(&mut self, count: u64) -> Result<(), CompileError> {
        // As entries, and as bytes at the end.
        let bytes = count * 2 * ModelWriter::BYTES_PER_PAGE;
        self.memory.push(self.budget.reserve(Bytes(bytes), "the directory of attributes")?);
        self.writer.reserve_pages(usize::try_from(count).unwrap_or(usize::MAX));
        Ok(())
    }

    /// Appends a page of attributes; all blocks must have come.
    pub(super) fn write_page(&mut self, stored: &[u8], check: Option<PageCheck>) -> Result<(), CompileError> {
        self.writer.push_page(stored, check)?;
        if self.buffer.len() + stored.len() > BUFFER_BYTES {
            self.flush()?;
        }
        self.buffer.extend_from_slice(stored);
        Ok(())
    }

    fn flush(&mut self) -> Result<(), CompileError> {
        let Output { path, file, quota, buffer, buffer_offset, .. } = self;
        let write = |error| CompileError::Write { path: path.clone(), error };
        quota.take(buffer.len() as u64).map_err(write)?;
        write_at(file.file(), *buffer_offset, buffer).map_err(write)?;
        *buffer_offset += buffer.len() as u64;
        buffer.clear();
        Ok(())
    }

    /// Writes directory, materials and, last, the header; makes it durable and gives it its name. Until then no file of that
    /// name changes, and what is left of an interrupted run has no header.
    pub(super) fn seal(
        mut self,
        materials: &[MaterialRecord],
        source: SourceRecord,
        compiled: CompileRecord,
    ) -> Result<Written, CompileError> {
        self.flush()?;
        // `ModelWriter` takes at most 2^32 - 1 blocks.
        let (triangles, blocks) = (self.writer.triangle_count(), self.writer.block_count() as u32);
        let sealed = self.writer.seal(materials, source, Some(compiled))?;
        let write = |error| CompileError::Write { path: self.path.clone(), error };
        self.quota.take((sealed.tail.len() + sealed.header.len()) as u64).map_err(write)?;
        write_at(self.file.file(), sealed.tail_offset, &sealed.tail).map_err(write)?;
        write_at(self.file.file(), 0, &sealed.header).map_err(write)?;
        self.file.publish(&self.path)?;
        Ok(Written {
            triangles,
            blocks,
            vertices: self.vertices,
            file_bytes: sealed.file_bytes,
            degenerate: self.degenerate,
            duplicates: self.duplicates,
        })
    }
}
