//! A compiled file on disk, read with positioned reads.

use std::fs::File;
use std::io;
use std::path::Path;
use std::sync::Arc;

use super::{BlockSource, DIRECTORY, OpenError, block_name, page_name, place_of, place_of_page};
use crate::budget::MemoryBudget;
use crate::error::{BudgetError, SourceError};
use crate::model::{Model, ModelReader};
use crate::units::{BlockId, Bytes};

/// Whether block reads may leave copies in the page cache of the operating system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PageCache {
    /// They may. Fast where memory is free for it, and not counted by the memory budget.
    #[default]
    Use,
    /// They do not, so that a run under a hard memory cap or a measurement of out-of-core speed does not rely on it (I1).
    ///
    /// On Linux blocks are read with `O_DIRECT`; where the file system does not take it, they are read as usual and the
    /// kernel is asked to forget them (`POSIX_FADV_DONTNEED`), which it does for pages that nobody else uses. On other
    /// systems this is the same as [`PageCache::Use`].
    Bypass,
}

/// Reads blocks from a file with positioned reads: no seek, no lock, any number of threads at once.
///
/// The file may change while it is open: bytes that are not those that were compiled fail the decoder's checks, and a
/// file that became shorter gives [`SourceError::Truncated`].
#[derive(Debug)]
pub struct DiskSource {
    file: File,
    /// The same file, opened to go past the page cache.
    direct: Option<File>,
    page_cache: PageCache,
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
        DiskSource::open_if(path.as_ref(), page_cache, |_| Ok(()))
    }

    /// Opens a compiled file if `budget` has room for its directory and materials (about 150 bytes for each block), which is asked before
    /// they are allocated (I1). The room is given back when this returns: the octree that is opened over the source takes it again, for as
    /// long as it lives.
    ///
    /// # Errors
    /// [`SourceError::Budget`], or as for [`DiskSource::open`].
    pub fn open_in(
        path: impl AsRef<Path>,
        page_cache: PageCache,
        budget: &MemoryBudget,
    ) -> Result<DiskSource, SourceError> {
        let mut room = None;
        DiskSource::open_if(path.as_ref(), page_cache, |bytes| {
            room = Some(budget.reserve(bytes, DIRECTORY)?);
            Ok(())
        })
    }

    fn open_if(
        path: &Path,
        page_cache: PageCache,
        claim: impl FnOnce(Bytes) -> Result<(), BudgetError>,
    ) -> Result<DiskSource, SourceError> {
        let name = path.display().to_string();
        let failed = |error| SourceError::Io { what: "the header".to_owned(), name: name.clone(), error };
        let file = File::open(path).map_err(failed)?;
        let file_bytes = file.metadata().map_err(failed)?.len();
        let claim = |bytes| claim(bytes).map_err(|error| OpenError::Source(error.into()));
        let model = ModelReader::read_if(file_bytes, claim, |what, offset, into: &mut [u8]| {
            read_exact_at(&file, offset, into)
                .map_err(|error| OpenError::Source(read_error(error, what.to_owned(), &name, &file)))
        });
        let model = Arc::new(model.map_err(|error| error.of(&name))?);
        let direct = match page_cache {
            PageCache::Use => None,
            PageCache::Bypass => {
                forget(&file, 0, 0);
                direct::open(path)
            }
        };
        Ok(DiskSource { file, direct, page_cache, name, model })
    }

    /// Length of the file now.
    ///
    /// # Errors
    /// The operating system's.
    pub fn file_bytes(&self) -> io::Result<u64> {
        Ok(self.file.metadata()?.len())
    }

    /// Fills `into` with the file's bytes from `offset` on, unchecked, through the page cache: to hand the file on.
    ///
    /// # Errors
    /// The operating system's; `UnexpectedEof` beyond the end.
    pub fn read_range(&self, offset: u64, into: &mut [u8]) -> io::Result<()> {
        read_exact_at(&self.file, offset, into)
    }

    fn read(&self, offset: u64, length: usize, into: &mut Vec<u8>) -> io::Result<()> {
        if let Some(direct) = &self.direct {
            match direct::read(direct, offset, length, into) {
                // The device wants a larger alignment than any known one has.
                Err(error) if error.kind() == io::ErrorKind::InvalidInput => {}
                result => return result,
            }
        }
        into.clear();
        into.resize(length, 0);
        read_exact_at(&self.file, offset, into)?;
        if self.page_cache == PageCache::Bypass {
            forget(&self.file, offset, length as u64);
        }
        Ok(())
    }
}

impl BlockSource for DiskSource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    fn buffer_bytes(&self) -> Bytes {
        let stored = self.model.stored_bytes_max();
        if self.direct.is_some() { Bytes(stored.0 + direct::SLACK_BYTES) } else { stored }
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of(&self.model, block, &self.name)?;
        self.read(offset, length, into)
            .map_err(|error| read_error(error, block_name(block), &self.name, &self.file))
    }

    fn gives_attributes(&self) -> bool {
        true
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of_page(&self.model, page, &self.name)?;
        self.read(offset, length, into)
            .map_err(|error| read_error(error, page_name(page), &self.name, &self.file))
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

/// Asks the kernel to drop a range of the file from the page cache; a length of 0 means up to the end. Only advice, so
/// a refusal is no error.
#[cfg(target_os = "linux")]
fn forget(file: &File, offset: u64, length: u64) {
    let length = std::num::NonZeroU64::new(length);
    let _ = rustix::fs::fadvise(file, offset, length, rustix::fs::Advice::DontNeed);
}

#[cfg(not(target_os = "linux"))]
fn forget(_file: &File, _offset: u64, _length: u64) {}

/// Reads that go past the page cache: offset, length and memory must be multiples of the device's block.
#[cfg(target_os = "linux")]
mod direct {
    use std::fs::{File, OpenOptions};
    use std::io;
    use std::os::unix::fs::{FileExt, OpenOptionsExt};
    use std::path::Path;

    /// Covers every device with logical blocks of 512 or 4,096 bytes, which are all that are sold.
    const ALIGNMENT: usize = 4096;

    /// What a read needs beyond the block: up to a device block before and after it, and room to align.
    pub const SLACK_BYTES: u64 = 3 * ALIGNMENT as u64;

    /// `None` if the file system does not take direct reads.
    pub fn open(path: &Path) -> Option<File> {
        OpenOptions::new().read(true).custom_flags(libc::O_DIRECT).open(path).ok()
    }

    /// Fills `into` with `length` bytes from `offset`. Reads into an aligned part of its memory and moves the bytes to the
    /// front, so that nothing but `into` is needed.
    pub fn read(file: &File, offset: u64, length: usize, into: &mut Vec<u8>) -> io::Result<()> {
        let lead = (offset % ALIGNMENT as u64) as usize;
        let start = offset - lead as u64;
        let needed = lead + length;
        let span = needed.next_multiple_of(ALIGNMENT);
        into.resize(span + ALIGNMENT, 0);
        let shift = into.as_ptr().align_offset(ALIGNMENT).min(ALIGNMENT);
        let window = &mut into[shift..shift + span];
        let mut filled = 0;
        while filled < needed {
            match file.read_at(&mut window[filled..], start + filled as u64) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Ok(count) => filled += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(error),
            }
            // Only the end of the file stops a direct read between two device blocks.
            if filled < needed && filled % ALIGNMENT != 0 {
                return Err(io::ErrorKind::UnexpectedEof.into());
            }
        }
        into.copy_within(shift + lead..shift + needed, 0);
        into.truncate(length);
        Ok(())
    }
}

#[cfg(not(target_os = "linux"))]
mod direct {
    use std::fs::File;
    use std::io;
    use std::path::Path;

    pub const SLACK_BYTES: u64 = 0;

    pub fn open(_path: &Path) -> Option<File> {
        None
    }

    pub fn read(_file: &File, _offset: u64, _length: usize, _into: &mut Vec<u8>) -> io::Result<()> {
        Err(io::ErrorKind::InvalidInput.into())
    }
}
