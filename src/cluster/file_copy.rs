//! A node's own copy of the compiled file, brought over the network while it renders.
//!
//! Blocks come in the order of the file, a few at a time, and are written only when they match their checksums in the directory; so
//! what lies on disk is always the beginning of the file, and a later attempt goes on after the last block that is still sound.
//! Pages of attributes, directories and materials come after the blocks and the header comes last, as a compile writes it; the pages are
//! held against their checksums, the whole is opened and checked under a name of its own, and it gets its real name only when nothing is
//! wrong.

use std::fs::{self, File};
use std::io;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use parking_lot::Mutex;

use super::file_fetch::FileFetch;
use super::message::RANGE_BYTES_MAX;
use super::model_file::model_key;
use crate::block::checksum;
use crate::compile::open_locked;
use crate::error::SourceError;
use crate::model::Model;
use crate::source::{BlockSource, DiskSource, PageCache};
use crate::transport::Transport;
use crate::units::Bytes;

/// Where a worker's copy goes and how it comes.
#[derive(Clone)]
pub struct CopyOptions {
    /// The file. While it is not complete it is called so with `.part` at the end.
    pub path: PathBuf,
    /// Used for this and nothing else.
    pub transport: Arc<dyn Transport>,
    /// How the copy is read when it is complete.
    pub page_cache: PageCache,
    /// After a node gave nothing, or nothing sound, so long passes before the next is asked.
    pub retry_after: Duration,
    /// Longest wait for an answer.
    pub answer_time_max: Duration,
    /// Bytes that are asked for at one time, at most 256 KiB.
    pub piece_bytes: u32,
}

impl CopyOptions {
    /// A copy at `path`, over `transport`.
    pub fn new(path: impl Into<PathBuf>, transport: Arc<dyn Transport>) -> CopyOptions {
        CopyOptions {
            path: path.into(),
            transport,
            page_cache: PageCache::Use,
            retry_after: Duration::from_millis(500),
            answer_time_max: Duration::from_secs(10),
            piece_bytes: RANGE_BYTES_MAX,
        }
    }
}

/// What became of a copy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CopyCounters {
    /// Blocks that were there already, from an earlier attempt, and sound.
    pub blocks_kept: u64,
    /// Blocks that came over the network and are sound.
    pub blocks_fetched: u64,
    /// Pieces that arrived damaged, and were asked for again.
    pub damaged: u64,
    /// Times that a node was given up: it could not be reached, went away, or did not answer.
    pub nodes_lost: u64,
    /// Whether the copy is complete.
    pub is_complete: bool,
}

/// There will be no copy; the node can do without.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CopyError {
    /// The disk.
    #[error("cannot write the copy {}: {error}", path.display())]
    Disk {
        /// The file.
        path: PathBuf,
        /// The cause; `StorageFull` if there was no room: then what was written is removed.
        #[source]
        error: io::Error,
    },
    /// Something else has the copy's name.
    #[error("{} is there and is not the model that is rendered; it is left as it is", path.display())]
    OtherFile {
        /// The file.
        path: PathBuf,
    },
    /// Another process is at it.
    #[error("another process is writing {}", path.display())]
    Busy {
        /// The unfinished file.
        path: PathBuf,
    },
}

/// A copy of a compiled file in the making.
pub struct FileCopy {
    options: CopyOptions,
    model: Arc<Model>,
    counters: Mutex<CopyCounters>,
}

/// Why the node that is asked is given up.
enum Trouble {
    Node,
    Damaged,
    Disk(io::Error),
    Stopped,
}

impl From<SourceError> for Trouble {
    fn from(_: SourceError) -> Trouble {
        Trouble::Node
    }
}

impl FileCopy {
    /// Most memory that a copy of this model takes, beside the model: a piece of the file, and while the result is checked, its directory.
    pub fn bytes_needed(model: &Model) -> Bytes {
        let pages = &model.attributes;
        let piece =
            u64::from(RANGE_BYTES_MAX).max(model.stored_bytes_max().0).max(pages.stored_bytes_max().0);
        let directories = 160 * model.blocks.len() as u64 + 56 * pages.entries().len() as u64;
        Bytes(piece + directories + (1 << 20))
    }

    /// A copy of the file of `model`.
    pub fn new(model: Arc<Model>, options: CopyOptions) -> FileCopy {
        FileCopy { options, model, counters: Mutex::default() }
    }

    /// What it did so far.
    pub fn counters(&self) -> CopyCounters {
        *self.counters.lock()
    }

    /// A copy that was completed earlier, opened.
    ///
    /// # Errors
    /// [`CopyError::OtherFile`] if there is something, but not this model.
    pub fn existing(&self) -> Result<Option<DiskSource>, CopyError> {
        let path = &self.options.path;
        match DiskSource::open_with(path, self.options.page_cache) {
            Ok(source) if model_key(source.model()) == model_key(&self.model) => {
                self.counters.lock().is_complete = true;
                Ok(Some(source))
            }
            Err(SourceError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            _ => Err(CopyError::OtherFile { path: path.clone() }),
        }
    }

    /// Makes the copy from the nodes that `nodes` names, which is asked again before each attempt, and opens it. Nodes that fail
    /// are tried again for as long as it takes; `None` if `stop` was set before the copy was complete. What there is then is kept
    /// for the next time.
    ///
    /// # Errors
    /// [`CopyError`].
    pub fn run(
        &self,
        nodes: &dyn Fn() -> Vec<String>,
        stop: &AtomicBool,
    ) -> Result<Option<DiskSource>, CopyError> {
        if let Some(source) = self.existing()? {
            return Ok(Some(source));
        }
        let path = self.part();
        let disk = |error| CopyError::Disk { path: path.clone(), error };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(disk)?;
        }
        let Some(file) = open_locked(&path).map_err(disk)? else { return Err(CopyError::Busy { path }) };
        // Another process may have finished it before the lock was free.
        if let Some(source) = self.existing()? {
            return Ok(Some(source));
        }
        let mut next = self.kept(&file, stop);
        self.counters.lock().blocks_kept = next as u64;
        for attempt in 0_usize.. {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let nodes: Vec<String> = nodes().into_iter().filter(|node| !node.is_empty()).collect();
            let node = attempt.checked_rem(nodes.len()).map(|place| &nodes[place]);
            let result = node.map(|node| self.attempt(node, &file, &path, &mut next, stop));
            match result {
                Some(Ok(())) => break,
                Some(Err(Trouble::Stopped)) => return Ok(None),
                Some(Err(Trouble::Disk(error))) => {
                    if error.kind() == io::ErrorKind::StorageFull {
                        // Others may need the room; that it cannot be removed either changes nothing.
                        let _ = fs::remove_file(&path);
                    }
                    return Err(disk(error));
                }
                // Counted where it was seen.
                Some(Err(Trouble::Damaged)) => {}
                Some(Err(Trouble::Node)) => self.counters.lock().nodes_lost += 1,
                None => {}
            }
            thread::sleep(self.options.retry_after);
        }
        self.existing()
    }

    fn piece_bytes(&self) -> u64 {
        u64::from(self.options.piece_bytes.clamp(1, RANGE_BYTES_MAX))
    }

    fn part(&self) -> PathBuf {
        let mut name = self.options.path.clone().into_os_string();
        name.push(".part");
        PathBuf::from(name)
    }

    /// How many blocks from the first on are there and sound.
    fn kept(&self, file: &File, stop: &AtomicBool) -> usize {
        let mut bytes = Vec::new();
        let is_sound = |entry: &&crate::model::BlockEntry| {
            bytes.clear();
            bytes.resize(entry.stored_bytes as usize, 0);
            !stop.load(Ordering::Relaxed)
                && read_at(file, entry.offset, &mut bytes).is_ok()
                && checksum(&bytes) == entry.checksum
        };
        self.model.blocks.iter().take_while(is_sound).count()
    }

    /// Fetches from one node what is missing, from block `next` on; then gives the copy its name.
    fn attempt(
        &self,
        node: &str,
        file: &File,
        path: &Path,
        next: &mut usize,
        stop: &AtomicBool,
    ) -> Result<(), Trouble> {
        let blocks = &self.model.blocks;
        let time_max = self.options.answer_time_max;
        let mut fetch = FileFetch::start(&*self.options.transport, node, time_max)?;
        let mut piece = Vec::new();
        while *next < blocks.len() {
            if stop.load(Ordering::Relaxed) {
                return Err(Trouble::Stopped);
            }
            let start = blocks[*next].offset;
            let end_of = |entry: &crate::model::BlockEntry| entry.offset + u64::from(entry.stored_bytes);
            let fits = |entry: &&crate::model::BlockEntry| end_of(entry) - start <= self.piece_bytes();
            // One that is longer than a piece comes alone.
            let count = blocks[*next..].iter().take_while(fits).count().max(1);
            let group = &blocks[*next..*next + count];
            piece.clear();
            piece.resize((end_of(&group[count - 1]) - start) as usize, 0);
            fetch.range("blocks of the file", start, &mut piece)?;
            for entry in group {
                let from = (entry.offset - start) as usize;
                let bytes = &piece[from..from + entry.stored_bytes as usize];
                if checksum(bytes) != entry.checksum {
                    return Err(self.damaged());
                }
                write_at(file, entry.offset, bytes).map_err(Trouble::Disk)?;
                *next += 1;
                self.counters.lock().blocks_fetched += 1;
            }
        }
        self.finish(&mut fetch, file, path, stop)
    }

    fn damaged(&self) -> Trouble {
        self.counters.lock().damaged += 1;
        Trouble::Damaged
    }

    /// Fetches what is after the blocks and what is before them, checks the whole, and gives it its name.
    fn finish(
        &self,
        fetch: &mut FileFetch<'_>,
        file: &File,
        path: &Path,
        stop: &AtomicBool,
    ) -> Result<(), Trouble> {
        let blocks = &self.model.blocks;
        let end = blocks.last().map_or(0, |entry| entry.offset + u64::from(entry.stored_bytes));
        let start = blocks.first().map_or(0, |entry| entry.offset);
        let length = fetch.file_bytes;
        if !lengths(&self.model).contains(&length) {
            return Err(self.damaged());
        }
        let mut piece = Vec::new();
        for (from, to) in [(end, length), (0, start)] {
            let mut at = from;
            while at < to {
                if stop.load(Ordering::Relaxed) {
                    return Err(Trouble::Stopped);
                }
                piece.clear();
                piece.resize((to - at).min(self.piece_bytes()) as usize, 0);
                fetch.range("the file around its blocks", at, &mut piece)?;
                write_at(file, at, &piece).map_err(Trouble::Disk)?;
                at += piece.len() as u64;
            }
        }
        for page in self.model.attributes.entries().iter().filter(|page| page.stored_bytes > 0) {
            if stop.load(Ordering::Relaxed) {
                return Err(Trouble::Stopped);
            }
            piece.clear();
            piece.resize(page.stored_bytes as usize, 0);
            read_at(file, page.offset, &mut piece).map_err(Trouble::Disk)?;
            if checksum(&piece) != page.checksum {
                return Err(self.damaged());
            }
        }
        // An earlier attempt at another model may have been longer.
        file.set_len(length).map_err(Trouble::Disk)?;
        file.sync_all().map_err(Trouble::Disk)?;
        match DiskSource::open_with(path, self.options.page_cache) {
            Ok(whole) if model_key(whole.model()) == model_key(&self.model) => {}
            Err(SourceError::Io { error, .. }) => return Err(Trouble::Disk(error)),
            _ => return Err(self.damaged()),
        }
        fs::rename(path, &self.options.path).map_err(Trouble::Disk)
    }
}

/// For materials and the names of images.
const LENGTH_ROOM: u64 = 64 << 20;

/// How long the file of a model may be. Directories, materials and the names of images are known, but not to their last byte; no node makes
/// another fill its disk.
fn lengths(model: &Model) -> RangeInclusive<u64> {
    let pages = model.attributes.entries();
    let end_of_blocks = model.blocks.last().map_or(0, |entry| entry.offset + u64::from(entry.stored_bytes));
    // Pages lie behind the blocks; one without bytes may be anywhere.
    let ends = pages.iter().filter(|page| page.stored_bytes > 0);
    let end = ends.map(|page| page.offset + u64::from(page.stored_bytes)).fold(end_of_blocks, u64::max);
    end..=end + 128 * model.blocks.len() as u64 + 24 * pages.len() as u64 + LENGTH_ROOM
}

#[cfg(unix)]
fn read_at(file: &File, offset: u64, into: &mut [u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, into, offset)
}

#[cfg(unix)]
fn write_at(file: &File, offset: u64, bytes: &[u8]) -> io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(not(unix))]
fn read_at(mut file: &File, offset: u64, into: &mut [u8]) -> io::Result<()> {
    use std::io::{Read, Seek};
    file.seek(io::SeekFrom::Start(offset))?;
    file.read_exact(into)
}

#[cfg(not(unix))]
fn write_at(mut file: &File, offset: u64, bytes: &[u8]) -> io::Result<()> {
    use std::io::{Seek, Write};
    file.seek(io::SeekFrom::Start(offset))?;
    file.write_all(bytes)
}

impl std::fmt::Debug for CopyOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("CopyOptions")
            .field("path", &self.path)
            .field("page_cache", &self.page_cache)
            .finish_non_exhaustive()
    }
}

impl std::fmt::Debug for FileCopy {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileCopy").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::budget::MemoryBudget;
    use crate::compile::{CompileOptions, Control, compile_file};

    #[test]
    fn pages_of_attributes_count_for_the_length_of_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let (input, output) = (folder.path().join("a.obj"), folder.path().join("a.outcrop"));
        let mut text = String::new();
        for i in 0..3000 {
            // Normals that do not compress.
            let normal = |k: i32| f64::from((i * 7919 + k * 104_729) % 10_007) / 10_007.0 + 0.001;
            text += &format!("v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nvn {} {} 1\n", normal(1), normal(2));
            let at = 3 * i + 1;
            text += &format!("f {at}//{n} {}//{n} {}//{n}\n", at + 1, at + 2, n = i + 1);
        }
        fs::write(&input, text).unwrap();
        let budget = MemoryBudget::new(Bytes::mib(64));
        compile_file(&input, &output, &CompileOptions::default(), &budget, &mut |_| Control::Continue)
            .unwrap();
        let source = DiskSource::open(&output).unwrap();
        let model = source.model();
        let (file_bytes, materials_max) = (fs::metadata(&output).unwrap().len(), 1000);
        let pages = model.attributes.entries().iter().map(|page| u64::from(page.stored_bytes));
        assert!(pages.sum::<u64>() > materials_max);
        let lengths = lengths(model);
        assert!(lengths.contains(&file_bytes));
        // However many pages there are, the room is for other things.
        let room = lengths.end() - file_bytes;
        assert!((LENGTH_ROOM - materials_max..=LENGTH_ROOM).contains(&room), "{room}");
    }
}
