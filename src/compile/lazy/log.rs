//! The log of refinements: each a cell that was cut, appended when it was.
//!
//! A place in the log is taken under a lock and written without one (I7), so records of different threads can be written at the same
//! time, and a run that is killed may leave a hole, or blocks without the head that belongs before them. Replaying ends there: cells behind it are cut again, which gives the same blocks.

use std::sync::Arc;

use parking_lot::Mutex;

use super::cutter::Cutter;
use super::lazy_model::{Contents, CutCell};
use super::working_file::WorkingFile;
use crate::budget::Allowance;
use crate::error::CompileError;
use crate::model::{BlockEntry, CellEntry, RECORD_BYTES, RefinementRecord, WorkingOptions};
use crate::units::{Bytes, CellId};

/// What the budget is asked for.
const PURPOSE: &str = "the directory of a cell that was cut";

/// Where the next record goes.
#[derive(Debug)]
pub(super) struct Log {
    end: Mutex<u64>,
}

impl Log {
    pub fn new(end: u64) -> Log {
        Log { end: Mutex::new(end) }
    }

    /// Where the log ends.
    pub fn end(&self) -> u64 {
        *self.end.lock()
    }

    /// Appends the blocks that `cutter` has of `cell`.
    pub fn append(
        &self,
        working: &WorkingFile,
        made_for: &WorkingOptions,
        cell: CellId,
        cutter: &mut Cutter,
        allowance: &Allowance,
    ) -> Result<CutCell, CompileError> {
        let block_count = cutter.bucket.blocks.len();
        let memory = allowance.reserve(Bytes(CellEntry::directory_bytes(block_count)), PURPOSE)?;
        let head = RefinementRecord {
            cell: cell.0,
            block_count: block_count as u32,
            stored_bytes: cutter.bucket.bytes.len() as u64,
            degenerate: cutter.bucket.degenerate as u32,
            duplicates: cutter.bucket.duplicates as u32,
        };
        let length = head.head_bytes() as u64 + head.stored_bytes;
        let start = {
            let mut end = self.end.lock();
            *end += length;
            *end - length
        };
        let entries: Arc<[BlockEntry]> = cutter.entries(start + head.head_bytes() as u64).collect();
        let mut record = std::mem::take(&mut cutter.record);
        record.clear();
        head.put(made_for, &entries, &mut record);
        // The blocks first, so that a head stands for blocks that were written: a run that is killed between the two, or inside of
        // either, leaves no head.
        let written = working
            .write(start + record.len() as u64, &cutter.bucket.bytes)
            .and_then(|()| working.write(start, &record));
        cutter.record = record;
        if let Err(error) = written {
            // Without a hole if nobody has appended since.
            let mut end = self.end.lock();
            if *end == start + length {
                *end = start;
            }
            return Err(error);
        }
        Ok(CutCell { entries, degenerate: head.degenerate, duplicates: head.duplicates, _memory: memory })
    }
}

/// Calls `take` with every cell that the log holds, up to the first record that is not whole and right; returns where the log ends.
pub(super) fn replay(
    working: &WorkingFile,
    contents: &Contents,
    allowance: &Allowance,
    mut take: impl FnMut(CellId, CutCell) -> bool,
) -> Result<u64, CompileError> {
    let mut at = contents.header.log_offset();
    let file_bytes = working.len()?;
    let made_for = &contents.header.made_for;
    let mut bytes = Vec::new();
    loop {
        let mut head = [0; RECORD_BYTES];
        if at.checked_add(RECORD_BYTES as u64).is_none_or(|end| end > file_bytes) {
            return Ok(at);
        }
        working.read(at, &mut head)?;
        let Some(record) = RefinementRecord::parse(&head, &contents.model.cells) else { return Ok(at) };
        let end = at.checked_add(record.head_bytes() as u64);
        let end = end.and_then(|end| end.checked_add(record.stored_bytes));
        let Some(end) = end.filter(|end| *end <= file_bytes) else { return Ok(at) };
        bytes.resize(record.head_bytes(), 0);
        working.read(at, &mut bytes)?;
        let Some(entries) = record.entries(&bytes, at, made_for, &contents.model) else { return Ok(at) };
        let memory = allowance.reserve(Bytes(CellEntry::directory_bytes(entries.len())), PURPOSE)?;
        let cell = CutCell {
            entries: entries.into(),
            degenerate: record.degenerate,
            duplicates: record.duplicates,
            _memory: memory,
        };
        if !take(CellId(record.cell), cell) {
            // No run cuts a cell twice.
            return Ok(at);
        }
        at = end;
    }
}
