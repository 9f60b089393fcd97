//! Temporary files that never block a later run: a file left by a killed process is taken over, one in use is not.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::file_lock::open_locked;
use crate::error::CompileError;

/// How many temporary files of one name may be in use at once.
const NAMES_MAX: u32 = 1000;

/// Counts the bytes that one compile holds on disk against the caller's limit.
#[derive(Clone, Debug)]
pub(super) struct DiskQuota {
    left: Arc<AtomicU64>,
}

impl DiskQuota {
    pub(super) fn new(limit: Option<u64>) -> DiskQuota {
        DiskQuota { left: Arc::new(AtomicU64::new(limit.unwrap_or(u64::MAX))) }
    }

    pub(super) fn take(&self, bytes: u64) -> io::Result<()> {
        self.left
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(bytes))
            .map(drop)
            .map_err(|_| {
                io::Error::new(io::ErrorKind::StorageFull, "the disk limit of this compile is used up")
            })
    }

    /// Gives back what was taken and not used.
    pub(super) fn give_back(&self, bytes: u64) {
        self.left.fetch_add(bytes, Ordering::Relaxed);
    }
}

/// What could not be written, and why.
#[derive(Debug)]
pub(crate) struct WriteError {
    pub path: PathBuf,
    pub error: io::Error,
}

impl From<WriteError> for CompileError {
    fn from(WriteError { path, error }: WriteError) -> CompileError {
        CompileError::Write { path, error }
    }
}

/// An open file that is removed when dropped, unless it was published.
#[derive(Debug)]
pub(crate) struct TemporaryFile {
    file: Option<File>,
    path: PathBuf,
    unlinked: bool,
}

impl TemporaryFile {
    /// One in the folder of `path`, with the suffix behind its name.
    pub fn beside(path: &Path, suffix: &str) -> Result<TemporaryFile, WriteError> {
        TemporaryFile::create(&directory_of(path), &name_of(path), suffix)
    }

    /// Creates `<dir>/<name><suffix>`, or the same with a number if that one is in use by somebody alive. The lock on the
    /// file tells live from stale: the system drops it with the process, however that ends.
    pub fn create(dir: &Path, name: &OsString, suffix: &str) -> Result<TemporaryFile, WriteError> {
        let mut path = PathBuf::new();
        for number in 0..NAMES_MAX {
            let mut full = name.clone();
            full.push(suffix);
            if number > 0 {
                full.push(format!("-{number}"));
            }
            path = dir.join(full);
            let write = |error| WriteError { path: path.clone(), error };
            let Some(file) = open_locked(&path).map_err(write)? else { continue };
            file.set_len(0).map_err(write)?;
            return Ok(TemporaryFile { file: Some(file), path, unlinked: false });
        }
        let error = io::Error::new(io::ErrorKind::AlreadyExists, "all temporary names are in use");
        Err(WriteError { path, error })
    }

    pub fn path(&self) -> &Path {
        &self.path
    }

    pub fn file(&self) -> &File {
        // Only `publish` takes the file out, and it consumes self.
        self.file.as_ref().expect("open until published")
    }

    /// Takes the name away at once, so that the system frees the space even if this process is killed. Where the
    /// system refuses, the file is removed on drop instead.
    pub fn unlink(&mut self) {
        if cfg!(unix) && fs::remove_file(&self.path).is_ok() {
            self.unlinked = true;
        }
    }

    /// Makes the bytes durable and gives the file its final name, replacing what is there.
    pub fn publish(mut self, path: &Path) -> Result<(), WriteError> {
        let write = |error| WriteError { path: path.to_path_buf(), error };
        self.file().sync_all().map_err(write)?;
        fs::rename(&self.path, path).map_err(write)?;
        self.unlinked = true;
        drop(self.file.take());
        // The new name itself must survive a power cut too; systems that cannot sync a directory do it on their own.
        if let Some(dir) = path.parent() {
            let dir = if dir.as_os_str().is_empty() { Path::new(".") } else { dir };
            if let Ok(dir) = File::open(dir) {
                let _ = dir.sync_all();
            }
        }
        Ok(())
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        if !self.unlinked {
            // While the lock is still held: a later run must not take the name over and then lose it to this removal.
            let _ = fs::remove_file(&self.path);
        }
    }
}

/// The directory that holds `path`.
pub(super) fn directory_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// The last part of `path`.
pub(super) fn name_of(path: &Path) -> OsString {
    path.file_name().map_or_else(|| OsString::from("model"), OsString::from)
}

/// Reads exactly `into.len()` bytes at `offset`; shared by all threads.
pub(super) fn read_at(file: &File, offset: u64, into: &mut [u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, into, offset);
    #[cfg(windows)]
    {
        use std::os::windows::fs::FileExt;
        let mut done = 0;
        while done < into.len() {
            match file.seek_read(&mut into[done..], offset + done as u64)? {
                0 => return Err(io::ErrorKind::UnexpectedEof.into()),
                count => done += count,
            }
        }
        Ok(())
    }
}

/// Writes all of `bytes` at `offset`.
pub(crate) fn write_at(file: &File, offset: u64, bytes: &[u8]) -> io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::write_all_at(file, bytes, offset);
    #[cfg(windows)]
    {
        use std::os::windows::fs::FileExt;
        let mut done = 0;
        while done < bytes.len() {
            done += file.seek_write(&bytes[done..], offset + done as u64)?;
        }
        Ok(())
    }
}
