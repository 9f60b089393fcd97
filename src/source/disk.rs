//! A compiled file on disk, read with positioned reads.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use super::{BlockSource, OpenError, block_name, place_of};
use crate::error::SourceError;
use crate::model::{Model, ModelReader};
use crate::units::BlockId;

/// Whether block reads may leave copies in the page cache of the operating system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PageCache {
    /// They may. Fast where memory is free for it, and not counted by the memory budget.
    #[default]
    Use,
    /// They do not, so that a run under a hard memory cap or a measurement of out-of-core speed does not rely on it (I1).
    Bypass,
}

/// Reads blocks from a file with positioned reads: no seek, no lock, any number of threads at once.
#[derive(Debug)]
pub struct DiskSource {
    file: File,
    name: String,
    model: Arc<Model>,
}

impl DiskSource {
    /// Opens a compiled file through the page cache.
    ///
    /// # Errors
    /// [`SourceError`] if the file cannot be read or is not a sound compiled file.
    pub fn open(path: impl AsRef<Path>) -> Result<DiskSource, SourceError> {
        DiskSource::open_with(path, PageCache::Use)
    }

    /// Opens a compiled file.
    ///
    /// # Errors
    /// [`SourceError`] if the file cannot be read or is not a sound compiled file.
    pub fn open_with(path: impl AsRef<Path>, page_cache: PageCache) -> Result<DiskSource, SourceError> {
        let _ = page_cache;
        let path = path.as_ref();
        let name = path.display().to_string();
        let failed = |error| SourceError::Io { what: "the header".to_owned(), name: name.clone(), error };
        let file = File::open(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        let model = ModelReader::read(file_bytes, |what, offset, into: &mut [u8]| {
            read_exact_at(&file, offset, into)
                .map_err(|error| OpenError::Source(read_error(error, what.to_owned(), &name, &file)))
        });
        let model = model.map_err(|error| error.of(&name))?;
        Ok(DiskSource { file, name, model: Arc::new(model) })
    }
}

impl BlockSource for DiskSource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of(&self.model, block, &self.name)?;
        into.resize(length, 0);
        read_exact_at(&self.file, offset, into)
            .map_err(|error| read_error(error, block_name(block), &self.name, &self.file))
    }
}

fn read_error(error: io::Error, what: String, name: &str, file: &File) -> SourceError {
    let name = name.to_owned();
    if error.kind() == io::ErrorKind::UnexpectedEof {
        // The length is asked again: the file may have changed since it was opened.
        let end = file.metadata().map_or(0, |metadata| metadata.len());
        SourceError::Truncated { what, name, end }
    } else {
        SourceError::Io { what, name, error }
    }
}

#[cfg(unix)]
fn read_exact_at(file: &File, offset: u64, into: &mut [u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, into, offset)
}

#[cfg(windows)]
fn read_exact_at(file: &File, mut offset: u64, mut into: &mut [u8]) -> io::Result<()> {
    use std::os::windows::fs::FileExt;
    while !into.is_empty() {
        match file.seek_read(into, offset) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                into = &mut into[count..];
                offset += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}
