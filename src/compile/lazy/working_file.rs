//! The working file on disk: open, locked, and inside the caller's limit on disk space.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::super::file_lock::{open_locked, same_file};
use super::super::temporary::{DiskQuota, read_at, write_at};
use crate::error::CompileError;

/// What the name of a working file adds to that of the compiled file.
const SUFFIX: &str = ".working";

/// Locked as long as it lives: the system lets go of the lock when the process ends, however that happens.
#[derive(Debug)]
pub(super) struct WorkingFile {
    file: File,
    path: PathBuf,
    quota: DiskQuota,
    /// Emptied, and nobody has said yet that another run can go on with it.
    is_useless: bool,
}

impl WorkingFile {
    /// Where the working file of a compile to `output` is.
    pub fn path_for(output: &Path) -> PathBuf {
        let mut name: OsString = output.as_os_str().to_os_string();
        name.push(SUFFIX);
        PathBuf::from(name)
    }

    /// Opens the working file of a compile to `output`, or makes an empty one.
    ///
    /// # Errors
    /// [`CompileError::Locked`] if it is in use.
    pub fn lock(output: &Path, quota: DiskQuota) -> Result<WorkingFile, CompileError> {
        let path = WorkingFile::path_for(output);
        let write = |error| CompileError::Write { path: path.clone(), error };
        match open_locked(&path).map_err(write)? {
            Some(file) => Ok(WorkingFile { file, path, quota, is_useless: false }),
            None => Err(CompileError::Locked { path }),
        }
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    /// How long it is.
    pub fn len(&self) -> Result<u64, CompileError> {
        let metadata = self.file.metadata();
        Ok(metadata.map_err(|error| CompileError::Write { path: self.path.clone(), error })?.len())
    }

    /// Fills `into` from `offset` on.
    pub fn read(&self, offset: u64, into: &mut [u8]) -> Result<(), CompileError> {
        read_at(&self.file, offset, into).map_err(|error| self.damaged(offset, error.to_string()))
    }

    /// As [`WorkingFile::read`], with the system's own error.
    pub fn read_raw(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        read_at(&self.file, offset, into)
    }

    /// Writes `bytes`, which count against the limit on disk space.
    pub fn write(&self, offset: u64, bytes: &[u8]) -> Result<(), CompileError> {
        let write = |error| CompileError::Write { path: self.path.clone(), error };
        self.quota.take(bytes.len() as u64).map_err(write)?;
        write_at(&self.file, offset, bytes).map_err(|error| {
            // Whoever tries again writes to the same place.
            self.quota.give_back(bytes.len() as u64);
            write(error)
        })
    }

    /// Takes away what is behind `length`.
    pub fn truncate(&self, length: u64) -> Result<(), CompileError> {
        self.file.set_len(length).map_err(|error| CompileError::Write { path: self.path.clone(), error })
    }

    /// Counts what is there already against the limit on disk space.
    pub fn count_existing(&self, bytes: u64) -> Result<(), CompileError> {
        self.quota.take(bytes).map_err(|error| CompileError::Write { path: self.path.clone(), error })
    }

    /// Takes everything away, to begin anew. Unless [`WorkingFile::keep`] is called, the file goes when this is dropped: what has
    /// no header yet is of no use to anybody, and on a full disk in the way.
    pub fn empty(&mut self) -> Result<(), CompileError> {
        self.truncate(0)?;
        self.is_useless = true;
        Ok(())
    }

    /// Says that another run can go on with what was written since.
    pub fn keep(&mut self) {
        self.is_useless = false;
    }

    /// Takes the name away; the file goes when it is closed. Where the system refuses, it stays.
    pub fn remove(&self) {
        let _ = fs::remove_file(&self.path);
    }

    /// From now on counts what is written as the part of another's.
    pub fn set_quota(&mut self, quota: DiskQuota) {
        self.quota = quota;
    }

    pub fn quota(&self) -> &DiskQuota {
        &self.quota
    }

    /// The error of bytes that are not what was written.
    pub fn damaged(&self, offset: u64, reason: impl Into<String>) -> CompileError {
        CompileError::WorkingFile { path: self.path.clone(), offset, reason: reason.into() }
    }
}

impl Drop for WorkingFile {
    fn drop(&mut self) {
        // The lock still holds, so the name is that of this file.
        if self.is_useless && same_file(&self.file, &self.path).unwrap_or(false) {
            self.remove();
        }
    }
}
