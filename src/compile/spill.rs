//! Append-only store of bytes: the first in memory, as many as the budget allows, the rest in a temporary file.

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
    /// The first bytes, in pieces of `SEGMENT_BYTES`, all full but the last. Once there is a file the last is its write buffer.
    segments: Vec<Vec<u8>>,
    reservations: Vec<Reservation>,
    file: Option<TemporaryFile>,
    /// Bytes in the file: they come after those of all segments but the last.
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
        let segments = vec![Vec::new()];
        let reservations = vec![first];
        Ok(Spill { place, suffix, segments, reservations, file: None, file_bytes: 0, len: 0, headroom })
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
            // `new` makes a first segment, and none is ever taken away.
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

    /// Makes room after the last segment is full: one more in memory, or by writing it to the file.
    fn grow(&mut self) -> Result<(), CompileError> {
        let budget = &self.place.budget;
        let fits = budget.available().0 >= self.headroom.saturating_add(SEGMENT_BYTES as u64);
        if self.file.is_none()
            && fits
            && let Ok(reservation) = budget.reserve(Bytes(SEGMENT_BYTES as u64), "a spill buffer")
        {
            self.reservations.push(reservation);
            self.segments.push(Vec::new());
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
        let write = |error| CompileError::Write { path: file.path().to_path_buf(), error };
        // As in `append`.
        let segment = self.segments.last_mut().expect("never empty");
        self.place.quota.take(segment.len() as u64).map_err(write)?;
        write_at(file.file(), self.file_bytes, segment).map_err(write)?;
        self.file_bytes += segment.len() as u64;
        segment.clear();
        Ok(())
    }

    /// Fills `into` with the bytes from `offset` on. The range must have been appended.
    pub(super) fn read(&self, mut offset: u64, mut into: &mut [u8]) -> Result<(), CompileError> {
        let memory_bytes = ((self.segments.len() - 1) * SEGMENT_BYTES) as u64;
        while !into.is_empty() {
            let count = match &self.file {
                Some(file) if offset >= memory_bytes && offset < memory_bytes + self.file_bytes => {
                    let at = offset - memory_bytes;
                    let count = into.len().min((self.file_bytes - at) as usize);
                    read_at(file.file(), at, &mut into[..count])
                        .map_err(|error| spill_read_error(file.path(), error))?;
                    count
                }
                _ => {
                    // In one of the segments before the file, or in the last, which comes after it.
                    let at = if offset < memory_bytes { offset } else { offset - self.file_bytes } as usize;
                    let segment = &self.segments[at / SEGMENT_BYTES][at % SEGMENT_BYTES..];
                    let count = into.len().min(segment.len());
                    into[..count].copy_from_slice(&segment[..count]);
                    count
                }
            };
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
