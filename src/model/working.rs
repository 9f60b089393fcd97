//! The bytes of a working file: what a lazy compile keeps between runs. No I/O. `docs/lazy-compile.md` has the same tables.
//!
//! ```text
//! header 256 | triangles of cell 0 | of cell 1 | .. | cell records 96 x cells | materials | refinements, appended one by one
//! ```
//!
//! Nothing read is believed (I5). What is wrong in the header, the cells or the materials makes the file useless, and it is made anew
//! from its source; a refinement that is wrong ends the log, and the cells that were in it or behind it are cut again.

use super::directory::{BlockEntry, ENTRY_BYTES, EntryContext, Fields, is_sound, put_aabb};
use super::header::Section;
use super::material::parse_table;
use super::{CellEntry, Cells, Model, SourceRecord};
use crate::block::{BlockLimits, Codec, checksum};
use crate::error::ModelError;
use crate::geom::{Aabb, Lattice, Precision};

/// Bytes of the header; the triangles of the first cell start here.
pub(crate) const WORKING_HEADER_BYTES: usize = 256;
/// Bytes of a cell record.
pub(crate) const CELL_RECORD_BYTES: usize = 96;
/// Bytes of a refinement before its block entries.
pub(crate) const RECORD_BYTES: usize = 64;

const SIGNATURE: [u8; 12] = *b"\x89outcrop\r\n\x1a~";
const VERSION: u32 = 3;
/// Written in the byte order of the machine, as the triangles are.
const BYTE_ORDER: u32 = 0x0102_0304;
const CHECKSUM_AT: usize = WORKING_HEADER_BYTES - 8;
const RECORD_MARK: u32 = u32::from_le_bytes(*b"cell");

/// For what a working file was made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct WorkingOptions {
    /// The model file as it was.
    pub source: SourceRecord,
    /// A hash over all options that change blocks.
    pub options: u64,
}

/// The header.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WorkingHeader {
    pub made_for: WorkingOptions,
    pub limits: BlockLimits,
    pub codec: Codec,
    pub precision: Precision,
    pub tolerance_met: bool,
    /// Whether the source has attributes or images, which the file does not hold.
    pub details_left_out: bool,
    pub error_bound: f64,
    pub bounds: Aabb,
    pub triangle_count: u64,
    /// Triangles left out because they were not finite.
    pub skipped: u64,
    pub cell_count: u32,
    pub material_count: u32,
    pub cells: Section,
    pub materials: Section,
}

/// Where the triangles of a cell are, and what is known about them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CellRecord {
    pub offset: u64,
    pub bytes: u64,
    pub checksum: u64,
    pub triangle_count: u32,
    /// Vertices, counted once per chunk.
    pub vertex_count: u32,
    pub material_range: [u16; 2],
    pub bounds: Aabb,
}

/// The head of a refinement: a cell cut into blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RefinementRecord {
    pub cell: u32,
    pub block_count: u32,
    /// Length of all its blocks.
    pub stored_bytes: u64,
    pub degenerate: u32,
    pub duplicates: u32,
}

fn damaged(part: &'static str, offset: u64, reason: &'static str) -> ModelError {
    ModelError::Damaged { part, offset, reason }
}

impl WorkingHeader {
    pub fn to_bytes(self) -> [u8; WORKING_HEADER_BYTES] {
        let mut out = Vec::with_capacity(WORKING_HEADER_BYTES);
        out.extend_from_slice(&SIGNATURE);
        out.extend_from_slice(&VERSION.to_le_bytes());
        out.extend_from_slice(&BYTE_ORDER.to_ne_bytes());
        out.extend_from_slice(&self.limits.block_bytes_max.to_le_bytes());
        let (kind, exponent) = match self.precision {
            Precision::Float32 => (0, 0),
            Precision::Lattice(lattice) => (1, lattice.exponent),
        };
        out.extend_from_slice(&[
            self.codec.id(),
            kind,
            u8::from(self.tolerance_met),
            u8::from(self.details_left_out),
        ]);
        out.extend_from_slice(&exponent.to_le_bytes());
        let SourceRecord { file_bytes, modified_ns, fingerprint } = self.made_for.source;
        let key = [file_bytes, modified_ns, fingerprint, self.made_for.options];
        out.extend(key.iter().flat_map(|field| field.to_le_bytes()));
        out.extend_from_slice(&self.error_bound.to_le_bytes());
        put_aabb(&self.bounds, &mut out);
        out.extend_from_slice(&self.triangle_count.to_le_bytes());
        out.extend_from_slice(&self.skipped.to_le_bytes());
        out.extend_from_slice(&self.cell_count.to_le_bytes());
        out.extend_from_slice(&self.material_count.to_le_bytes());
        for section in [self.cells, self.materials] {
            let fields = [section.offset, section.bytes, section.checksum];
            out.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
        }
        out.resize(CHECKSUM_AT, 0);
        out.extend_from_slice(&checksum(&out).to_le_bytes());
        let mut bytes = [0; WORKING_HEADER_BYTES];
        bytes.copy_from_slice(&out);
        bytes
    }

    /// Reads the header of a file of `file_bytes` bytes.
    pub fn parse(bytes: &[u8; WORKING_HEADER_BYTES], file_bytes: u64) -> Result<WorkingHeader, ModelError> {
        let require = |holds, offset, reason| {
            if holds { Ok(()) } else { Err(damaged("header", offset, reason)) }
        };
        let mut fields = Fields(bytes);
        if fields.take() != SIGNATURE {
            return Err(ModelError::NotCompiled);
        }
        let version = fields.u32();
        if version != VERSION {
            return Err(ModelError::Version { found: version, supported: VERSION });
        }
        let mut stored = [0; 8];
        stored.copy_from_slice(&bytes[CHECKSUM_AT..]);
        let intact = u64::from_le_bytes(stored) == checksum(&bytes[..CHECKSUM_AT]);
        require(intact, CHECKSUM_AT as u64, "its checksum is wrong")?;
        require(
            u32::from_ne_bytes(fields.take()) == BYTE_ORDER,
            16,
            "it is of a machine with another byte order",
        )?;
        let limits = BlockLimits { block_bytes_max: fields.u32() };
        limits.validate().map_err(|reason| damaged("header", 20, reason))?;
        let [codec, kind, tolerance_met, details_left_out] = fields.take();
        let codec = Codec::from_id(codec).filter(|codec| codec.is_available());
        let codec = codec.ok_or(damaged("header", 24, "its codec is not in this build"))?;
        let precision = match (kind, fields.u32() as i32) {
            (0, 0) => Precision::Float32,
            (1, exponent @ Lattice::EXPONENT_MIN..=Lattice::EXPONENT_MAX) => {
                Precision::Lattice(Lattice { exponent })
            }
            _ => return Err(damaged("header", 25, "its precision is unknown")),
        };
        let source =
            SourceRecord { file_bytes: fields.u64(), modified_ns: fields.u64(), fingerprint: fields.u64() };
        let made_for = WorkingOptions { source, options: fields.u64() };
        let error_bound = fields.f64();
        let bounds = fields.aabb();
        require(is_sound(&bounds), 72, "the box of the model is not a box")?;
        let (triangle_count, skipped) = (fields.u64(), fields.u64());
        let (cell_count, material_count) = (fields.u32(), fields.u32());
        let mut section = || Section { offset: fields.u64(), bytes: fields.u64(), checksum: fields.u64() };
        let (cells, materials) = (section(), section());
        require(cell_count >= 1, 136, "it has no cells")?;
        require((1..=1 << 16).contains(&material_count), 140, "it has an impossible number of materials")?;
        let cells_bytes = u64::from(cell_count) * CELL_RECORD_BYTES as u64;
        require(cells.bytes == cells_bytes, 152, "there is not one record for each cell")?;
        require(cells.end() == Some(materials.offset), 168, "the materials do not follow the cells")?;
        require(
            materials.end().is_some_and(|end| end <= file_bytes),
            176,
            "the file ends before its materials do",
        )?;
        Ok(WorkingHeader {
            made_for,
            limits,
            codec,
            precision,
            tolerance_met: tolerance_met == 1,
            details_left_out: details_left_out == 1,
            error_bound,
            bounds,
            triangle_count,
            skipped,
            cell_count,
            material_count,
            cells,
            materials,
        })
    }

    /// Where the log starts.
    pub fn log_offset(&self) -> u64 {
        // `parse` has added the two; a header that is written is one that was measured.
        self.materials.offset + self.materials.bytes
    }

    /// Reads the cell records and the materials, each from its whole section: where the triangles are, and the model without any
    /// block.
    pub fn model(
        &self,
        cell_bytes: &[u8],
        material_bytes: &[u8],
        triangles_per_cell_max: u32,
    ) -> Result<(Vec<CellRecord>, Model), ModelError> {
        for (part, section, bytes) in
            [("cell records", self.cells, cell_bytes), ("material table", self.materials, material_bytes)]
        {
            if checksum(bytes) != section.checksum {
                return Err(damaged(part, section.offset, "its checksum is wrong"));
            }
        }
        let (mut offset, mut triangles, mut bounds) = (WORKING_HEADER_BYTES as u64, 0, Aabb::EMPTY);
        let mut records = Vec::with_capacity(self.cell_count as usize);
        for (index, bytes) in cell_bytes.as_chunks::<CELL_RECORD_BYTES>().0.iter().enumerate() {
            let record = CellRecord::get(bytes);
            let fault = |reason| {
                let at = self.cells.offset + (index * CELL_RECORD_BYTES) as u64;
                damaged("cell records", at, reason)
            };
            record.fault(offset, self, triangles_per_cell_max).map_err(fault)?;
            // `fault` compared the end with the start of this section.
            offset += record.bytes;
            triangles += u64::from(record.triangle_count);
            bounds.merge(&record.bounds);
            records.push(record);
        }
        if (offset, triangles, bounds) != (self.cells.offset, self.triangle_count, self.bounds) {
            let reason = "the cells do not make up the model";
            return Err(damaged("cell records", self.cells.offset, reason));
        }
        let known = records.iter().map(|record| {
            let counts = [record.triangle_count, record.vertex_count];
            (record.bounds, counts, record.material_range)
        });
        let cells = Cells::new(known, self.limits);
        let reason = "there are more cells than blocks can be numbered";
        let cells = cells.ok_or(damaged("cell records", self.cells.offset, reason))?;
        let model = Model {
            precision: self.precision,
            limits: self.limits,
            bounds: self.bounds,
            triangle_count: self.triangle_count,
            blocks: Vec::new(),
            cells,
            materials: parse_table(material_bytes, self.material_count, self.materials.offset)?,
            source: self.made_for.source,
            compiled: None,
            attributes: super::AttributePages::default(),
        };
        Ok((records, model))
    }
}

impl CellRecord {
    pub fn put(&self, out: &mut Vec<u8>) {
        let start = out.len();
        let long = [self.offset, self.bytes, self.checksum];
        out.extend(long.iter().flat_map(|field| field.to_le_bytes()));
        out.extend_from_slice(&self.triangle_count.to_le_bytes());
        out.extend_from_slice(&self.vertex_count.to_le_bytes());
        out.extend(self.material_range.iter().flat_map(|material| material.to_le_bytes()));
        out.extend_from_slice(&[0; 4]);
        put_aabb(&self.bounds, out);
        out.extend_from_slice(&[0; 8]);
        debug_assert_eq!(out.len() - start, CELL_RECORD_BYTES);
    }

    fn get(bytes: &[u8; CELL_RECORD_BYTES]) -> CellRecord {
        let mut fields = Fields(bytes);
        let (offset, bytes, checksum) = (fields.u64(), fields.u64(), fields.u64());
        let (triangle_count, vertex_count) = (fields.u32(), fields.u32());
        let material_range = [fields.u16(), fields.u16()];
        fields.u32();
        let bounds = fields.aabb();
        CellRecord { offset, bytes, checksum, triangle_count, vertex_count, material_range, bounds }
    }

    /// Why the record cannot be right, if it cannot.
    fn fault(&self, offset: u64, header: &WorkingHeader, triangles_max: u32) -> Result<(), &'static str> {
        let require = |holds: bool, reason| if holds { Ok(()) } else { Err(reason) };
        require(self.offset == offset, "a cell does not start where the one before it ends")?;
        let end = self.offset.checked_add(self.bytes);
        require(end.is_some_and(|end| end <= header.cells.offset), "a cell ends behind the last one")?;
        require(
            (1..=triangles_max).contains(&self.triangle_count),
            "a cell has an impossible number of triangles",
        )?;
        require(
            u64::from(self.vertex_count) <= 3 * u64::from(self.triangle_count),
            "a cell has more vertices than its triangles can use",
        )?;
        // A vertex takes at most 24 bytes; a triangle 3, with escapes, a run of ids and one of materials 21, and a chunk 28.
        let bytes_max = u64::from(self.vertex_count) * 24 + u64::from(self.triangle_count) * 52;
        require(self.bytes <= bytes_max, "a cell takes more bytes than its triangles can")?;
        require(
            self.material_range[0] <= self.material_range[1]
                && u32::from(self.material_range[1]) < header.material_count,
            "a cell uses materials that are not in the table",
        )?;
        require(
            is_sound(&self.bounds) && header.bounds.contains(&self.bounds),
            "the box of a cell is not inside that of the model",
        )
    }
}

impl RefinementRecord {
    /// Length of head and entries.
    pub fn head_bytes(&self) -> usize {
        RECORD_BYTES + self.block_count as usize * ENTRY_BYTES
    }

    /// Appends head and entries; the stored blocks come behind them.
    pub fn put(&self, made_for: &WorkingOptions, entries: &[BlockEntry], out: &mut Vec<u8>) {
        let start = out.len();
        out.extend_from_slice(&RECORD_MARK.to_le_bytes());
        out.extend_from_slice(&self.cell.to_le_bytes());
        out.extend_from_slice(&self.block_count.to_le_bytes());
        out.extend_from_slice(&self.degenerate.to_le_bytes());
        out.extend_from_slice(&self.stored_bytes.to_le_bytes());
        out.extend_from_slice(&self.duplicates.to_le_bytes());
        out.resize(start + RECORD_BYTES, 0);
        entries.iter().for_each(|entry| entry.put(out));
        let sum = record_checksum(made_for, &out[start..]);
        out[start + RECORD_BYTES - 8..start + RECORD_BYTES].copy_from_slice(&sum.to_le_bytes());
    }

    /// Reads the head alone; `None` if it cannot be one.
    pub fn parse(bytes: &[u8; RECORD_BYTES], cells: &Cells) -> Option<RefinementRecord> {
        let mut fields = Fields(bytes);
        if fields.u32() != RECORD_MARK {
            return None;
        }
        let (cell, block_count, degenerate) = (fields.u32(), fields.u32(), fields.u32());
        let (stored_bytes, duplicates) = (fields.u64(), fields.u32());
        let entry = cells.get(crate::units::CellId(cell))?;
        let possible = (1..=entry.block_count_max).contains(&block_count);
        possible.then_some(RefinementRecord { cell, block_count, stored_bytes, degenerate, duplicates })
    }

    /// Reads the entries of a refinement whose head and entries are `bytes` and which starts at `offset` of the file; `None` if
    /// anything is wrong.
    pub fn entries(
        &self,
        bytes: &[u8],
        offset: u64,
        made_for: &WorkingOptions,
        model: &Model,
    ) -> Option<Vec<BlockEntry>> {
        let (head, entry_bytes) = bytes.split_first_chunk::<RECORD_BYTES>()?;
        let stored = u64::from_le_bytes(*head.last_chunk()?);
        if bytes.len() != self.head_bytes() || record_checksum(made_for, bytes) != stored {
            return None;
        }
        let cell = model.cells.get(crate::units::CellId(self.cell))?;
        let context = EntryContext {
            limits: model.limits,
            bounds: cell.bounds,
            // Not empty, and at most 65,536.
            material_count: model.materials.len() as u32,
        };
        let first = offset.checked_add(bytes.len() as u64)?;
        let (mut at, mut triangles, mut bounds) = (first, 0, Aabb::EMPTY);
        let mut entries = Vec::with_capacity(self.block_count as usize);
        for bytes in entry_bytes.as_chunks::<ENTRY_BYTES>().0 {
            let entry = BlockEntry::get(bytes);
            entry.fault(at, &context).ok()?;
            at = at.checked_add(u64::from(entry.stored_bytes))?;
            triangles += u64::from(entry.triangle_count);
            bounds.merge(&entry.bounds);
            entries.push(entry);
        }
        let whole = (at - first, triangles, bounds)
            == (self.stored_bytes, u64::from(cell.triangle_count), cell.bounds);
        whole.then_some(entries)
    }
}

/// Over head and entries but the checksum itself, and over what the file was made for, so that no record of another file passes.
fn record_checksum(made_for: &WorkingOptions, bytes: &[u8]) -> u64 {
    let SourceRecord { file_bytes, modified_ns, fingerprint } = made_for.source;
    let mut hash = xxhash_rust::xxh3::Xxh3::new();
    for field in [file_bytes, modified_ns, fingerprint, made_for.options] {
        hash.update(&field.to_le_bytes());
    }
    hash.update(&bytes[..RECORD_BYTES - 8]);
    hash.update(&bytes[RECORD_BYTES..]);
    hash.digest()
}

impl CellEntry {
    /// Memory that the directory of the cell, cut into `block_count` blocks, takes.
    pub(crate) fn directory_bytes(block_count: usize) -> u64 {
        (block_count * size_of::<BlockEntry>()) as u64
    }
}
