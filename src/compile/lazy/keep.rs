//! The end of the one pass: buckets become cells of the working file.

use super::super::chunk::survey;
use super::super::clock::{Meter, Moment};
use super::super::compiler::{Compiler, Ending, Settled};
use super::super::cut::Box4;
use super::super::point::Point;
use super::lazy_model::{Contents, LazyModel, LazyOptions, options_hash};
use super::working_file::WorkingFile;
use crate::block;
use crate::error::CompileError;
use crate::geom::Aabb;
use crate::model::{
    CELL_RECORD_BYTES, CellRecord, Section, WORKING_HEADER_BYTES, WorkingHeader, WorkingOptions, table_bytes,
};
use crate::units::Bytes;

/// Bytes that are gathered before they are written.
const BUFFER_BYTES: usize = 1 << 20;

/// Leaves the buckets in a working file, which is empty.
pub(super) struct KeepCells {
    pub working: WorkingFile,
    pub cell_triangles: u32,
    pub cells_at_once: u32,
}

impl KeepCells {
    pub fn of(working: WorkingFile, options: &LazyOptions) -> KeepCells {
        KeepCells { working, cell_triangles: options.cell_triangles, cells_at_once: options.cells_at_once }
    }
}

impl Ending for KeepCells {
    type Output = LazyModel;

    fn end<P: Point>(
        mut self,
        compiler: Compiler<'_>,
        settled: Settled<P>,
    ) -> Result<LazyModel, CompileError> {
        let mut remains = compiler.into_remains(&settled);
        // One limit for the spill and the cells.
        self.working.set_quota(remains.quota);
        let start = Moment::now();
        if settled.scattered.buckets.is_empty() {
            return Err(CompileError::Empty);
        }
        let (records, bounds, cells_end) = write_cells(&settled, &self.working, &remains.budget)?;
        let Settled { scattered, settings, decision, error_bound, .. } = settled;
        let skipped = scattered.skipped;
        drop(scattered);
        let options = options_hash(&remains.options, self.cell_triangles);
        let mut cells = Vec::with_capacity(records.len() * CELL_RECORD_BYTES);
        records.iter().for_each(|record| record.put(&mut cells));
        let (materials, material_count) = table_bytes(&remains.materials)?;
        let with_images = remains.materials.iter().any(|record| record.images.is_some());
        let details_left_out = remains.attributes_left_out || with_images;
        let section = |offset, bytes: &[u8]| Section {
            offset,
            bytes: bytes.len() as u64,
            checksum: block::checksum(bytes),
        };
        let header = WorkingHeader {
            made_for: WorkingOptions { source: remains.source, options },
            limits: settings.limits,
            codec: settings.codec,
            precision: decision.precision,
            tolerance_met: decision.tolerance_met,
            details_left_out,
            error_bound,
            bounds,
            triangle_count: records.iter().map(|record| u64::from(record.triangle_count)).sum(),
            skipped,
            // Buckets are numbered by 32 bits.
            cell_count: records.len() as u32,
            material_count,
            cells: section(cells_end, &cells),
            materials: section(cells_end + cells.len() as u64, &materials),
        };
        self.working.write(header.cells.offset, &cells)?;
        self.working.write(header.materials.offset, &materials)?;
        // Last: before that the file is none. What a power cut may lose in spite of the order has checksums.
        self.working.write(0, &header.to_bytes())?;
        self.working.keep();
        let contents = Contents::parse(header, &cells, &materials);
        // Read as it will be read again, so that what cannot be is not used either.
        let contents = contents.map_err(|error| CompileError::Limit { reason: error.to_string() })?;
        let mut write = Meter::default();
        write.add_since(start);
        remains.seconds.write = write.seconds();
        LazyModel::assemble(
            self.working,
            contents,
            &remains.budget,
            remains.options,
            self.cells_at_once,
            remains.seconds,
        )
    }
}

/// Writes the triangles of all buckets; returns where each is, the box of all, and the end.
fn write_cells<P: Point>(
    settled: &Settled<P>,
    working: &WorkingFile,
    budget: &crate::budget::MemoryBudget,
) -> Result<(Vec<CellRecord>, Aabb, u64), CompileError> {
    let scattered = &settled.scattered;
    let bytes_of = |range: &std::ops::Range<usize>| -> usize {
        scattered.chunks[range.clone()].iter().map(|chunk| 4 + chunk.bytes as usize).sum()
    };
    let largest = scattered.buckets.iter().map(bytes_of).max().unwrap_or(0);
    let purpose = "writing the cells of a lazy compile";
    let _memory = budget.reserve(Bytes((BUFFER_BYTES + largest) as u64), purpose)?;
    let mut buffer: Vec<u8> = Vec::with_capacity(BUFFER_BYTES + largest);
    let unit = settled.settings.unit();
    let mut records = Vec::with_capacity(scattered.buckets.len());
    let (mut offset, mut bounds) = (WORKING_HEADER_BYTES as u64, Aabb::EMPTY);
    for range in &scattered.buckets {
        if buffer.len() >= BUFFER_BYTES {
            working.write(offset, &buffer)?;
            offset += buffer.len() as u64;
            buffer.clear();
        }
        let start = buffer.len();
        let (mut cell, mut materials) = (Box4::<P::Real>::empty(), [u16::MAX, 0]);
        let (mut triangles, mut vertices) = (0, 0);
        for chunk in &scattered.chunks[range.clone()] {
            triangles += u32::from(chunk.triangles);
            vertices += u32::from(chunk.vertices);
            buffer.extend_from_slice(&chunk.bytes.to_le_bytes());
            let start = buffer.len();
            buffer.resize(start + chunk.bytes as usize, 0);
            scattered.spills[chunk.spill as usize].read(chunk.offset, &mut buffer[start..])?;
            survey(
                &buffer[start..],
                |vertex: P| cell.grow(P::quad(&[vertex], 0)),
                |material| materials = [materials[0].min(material), materials[1].max(material)],
            );
        }
        let cell = cell.to_aabb();
        // Exact, as in the blocks.
        let cell = Aabb { min: cell.min.map(|x| x * unit), max: cell.max.map(|x| x * unit) };
        bounds.merge(&cell);
        let bytes = &buffer[start..];
        records.push(CellRecord {
            offset: offset + start as u64,
            bytes: bytes.len() as u64,
            checksum: block::checksum(bytes),
            triangle_count: triangles,
            vertex_count: vertices,
            material_range: materials,
            bounds: cell,
        });
    }
    working.write(offset, &buffer)?;
    Ok((records, bounds, offset + buffer.len() as u64))
}
