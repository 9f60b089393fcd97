//! Append-only store of bytes: in memory while it fits its share of the budget, then in a temporary file.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};

use super::temporary::{DiskQuota, TemporaryFile, read_at, write_at};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, CompileError};
use crate::units::Bytes;

/// Size of a piece of the memory part, and of one write to the file.
const SEGMENT_BYTES: usize = 1 << 20;

/// Where temporary files go.
#[derive(Clone, Debug)]
pub(super) struct SpillPlace {
    pub(super) dir: PathBuf,
    pub(super) name: OsString,
    pub(super) quota: DiskQuota,
    pub(super) budget: MemoryBudget,
}

/// See the module's text. Reading is shared; appending is exclusive.
#[derive(Debug)]
pub(super) struct Spill {
    place: SpillPlace,
    suffix: &'static str,
    /// The bytes from `file_bytes` on, in pieces of `SEGMENT_BYTES`, all full but the last.
    segments: Vec<Vec<u8>>,
    reservations: Vec<Reservation>,
    file: Option<TemporaryFile>,
    file_bytes: u64,
    len: u64,
    /// What must stay in the budget for others when a piece is added in memory.
    headroom: u64,
}

impl Spill {
    /// An empty store that leaves `headroom` bytes of the budget alone.
    ///
    /// # Errors
    /// The budget cannot hold one piece.
    pub(super) fn new(place: SpillPlace, suffix: &'static str, headroom: u64) -> Result<Spill, BudgetError> {
        let first = place.budget.reserve(Bytes(SEGMENT_BYTES as u64), "a spill buffer")?;
        Ok(Spill {
            place,
            suffix,
            segments: vec![Vec::new()],
            reservations: vec![first],
            file: None,
            file_bytes: 0,
            len: 0,
            headroom,
        })
    }

    /// How many bytes were appended.
    pub(super) fn len(&self) -> u64 {
        self.len
    }

    /// How many bytes went to the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.file_bytes
    }

    /// Appends `bytes` and returns where they begin.
    pub(super) fn append(&mut self, mut bytes: &[u8]) -> Result<u64, CompileError> {
        let offset = self.len;
        self.len += bytes.len() as u64;
        while !bytes.is_empty() {
            // There is always a last segment: `new` and `grow` keep one.
            let last = self.segments.last_mut().expect("never empty");
            if last.capacity() == 0 {
                last.reserve_exact(SEGMENT_BYTES);
            }
            let count = bytes.len().min(SEGMENT_BYTES - last.len());
            last.extend_from_slice(&bytes[..count]);
            bytes = &bytes[count..];
            if last.len() == SEGMENT_BYTES {
                self.grow()?;
            }
        }
        Ok(offset)
    }

    /// Makes room for another segment: one more in memory, or the full ones to the file.
    fn grow(&mut self) -> Result<(), CompileError> {
        let budget = &self.place.budget;
        if self.file.is_none() && budget.available().0 >= self.headroom + SEGMENT_BYTES as u64 {
            if let Ok(reservation) = budget.reserve(Bytes(SEGMENT_BYTES as u64), "a spill buffer") {
                self.reservations.push(reservation);
                self.segments.push(Vec::new());
                return Ok(());
            }
        }
        self.write_out()
    }

    /// Moves everything in memory to the file; keeps one segment as the write buffer.
    pub(super) fn write_out(&mut self) -> Result<(), CompileError> {
        if self.len == self.file_bytes {
            return Ok(());
        }
        let file = match &mut self.file {
            Some(file) => file,
            none => {
                let mut file = TemporaryFile::create(&self.place.dir, &self.place.name, self.suffix)?;
                file.unlink();
                none.insert(file)
            }
        };
        for segment in &self.segments {
            let write = |error| CompileError::Write { path: file.path().to_path_buf(), error };
            self.place.quota.take(segment.len() as u64).map_err(write)?;
            write_at(file.file(), self.file_bytes, segment).map_err(write)?;
            self.file_bytes += segment.len() as u64;
        }
        self.segments.truncate(1);
        self.segments[0].clear();
        self.reservations.truncate(1);
        Ok(())
    }

    /// Fills `into` with the bytes from `offset` on. The range must have been appended.
    pub(super) fn read(&self, mut offset: u64, mut into: &mut [u8]) -> Result<(), CompileError> {
        if offset < self.file_bytes
            && let Some(file) = &self.file
        {
            let count = into.len().min((self.file_bytes - offset) as usize);
            let (head, tail) = into.split_at_mut(count);
            read_at(file.file(), offset, head).map_err(|error| spill_read_error(file.path(), error))?;
            offset += count as u64;
            into = tail;
        }
        while !into.is_empty() {
            let at = (offset - self.file_bytes) as usize;
            let segment = &self.segments[at / SEGMENT_BYTES][at % SEGMENT_BYTES..];
            let count = into.len().min(segment.len());
            into[..count].copy_from_slice(&segment[..count]);
            offset += count as u64;
            into = &mut into[count..];
        }
        Ok(())
    }

    /// The error of bytes that are not what was written.
    pub(super) fn damaged(&self) -> CompileError {
        let path =
            self.file.as_ref().map_or_else(|| self.place.dir.clone(), |file| file.path().to_path_buf());
        spill_read_error(&path, io::ErrorKind::InvalidData.into())
    }
}

/// A spill that cannot be read back: named as what it is, although the error is one of the output's directory.
fn spill_read_error(path: &Path, error: io::Error) -> CompileError {
    let error = io::Error::new(error.kind(), format!("temporary data cannot be read back: {error}"));
    CompileError::Write { path: path.to_path_buf(), error }
}
