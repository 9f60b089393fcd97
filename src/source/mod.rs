//! Where blocks come from: disk, mapped file, memory. A network is one more: [`RemoteSource`](crate::cluster::RemoteSource).

use std::sync::Arc;

use crate::error::{CompileError, LoadError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::units::{BlockId, Bytes, CellId};

mod disk;
mod lazy;
mod memory;
mod mmap;
pub mod testing;

pub use disk::{DiskSource, PageCache};
pub use memory::MemorySource;
pub use mmap::MmapSource;

/// Serves the stored bytes of a compiled model's blocks. Shared by all threads; never holds a lock while it reads.
///
/// A source returns bytes as they are: checking them is the decoder's work (I5).
pub trait BlockSource: Send + Sync {
    /// Header, directory and materials, read and checked when the source was opened.
    fn model(&self) -> &Arc<Model>;

    /// Capacity with which a buffer is never reallocated by [`BlockSource::read_block`]: the largest stored block, and
    /// what the source needs beside it.
    fn buffer_bytes(&self) -> Bytes {
        self.model().stored_bytes_max()
    }

    /// Reads the stored bytes of `block` into `into` (cleared first; its capacity is reused, see
    /// [`BlockSource::buffer_bytes`]).
    ///
    /// # Errors
    /// [`SourceError`]; `into` then holds nothing useful.
    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError>;

    /// Whether [`BlockSource::read_attributes`] can give the pages that the model's directory names.
    fn gives_attributes(&self) -> bool {
        false
    }

    /// Reads the stored bytes of page `page` of the attributes into `into` (cleared first; never reallocated if it has the capacity
    /// [`AttributePages::stored_bytes_max`](crate::model::AttributePages::stored_bytes_max) and what [`BlockSource::buffer_bytes`]
    /// has beyond a block).
    ///
    /// # Errors
    /// [`SourceError`]: [`SourceError::NoAttributes`] if there is no such page or this source cannot give any.
    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        Err(SourceError::NoAttributes { page, name: "this source".to_owned() })
    }

    /// The directory entries of the blocks of `cell`, by number from [`CellEntry::first_block`](crate::model::CellEntry) on, for a
    /// model that is compiled lazily: [`Model::cells`] is not empty. Cuts the cell into these blocks if that was not done yet, which
    /// takes as long as some thousand rays. After it `read_block` can read them; the answer is always the same.
    ///
    /// # Errors
    /// [`LoadError`]; then it may be tried again.
    fn cut_cell(&self, cell: CellId) -> Result<Arc<[BlockEntry]>, LoadError> {
        let reason = format!("the source has no cell {}", cell.0);
        Err(LoadError::Cut(Box::new(CompileError::Limit { reason })))
    }
}

/// The place of a block in the file.
///
/// # Errors
/// [`SourceError::NoSuchBlock`].
fn place_of(model: &Model, block: BlockId, name: &str) -> Result<(u64, usize), SourceError> {
    match model.entry(block) {
        Some(entry) => Ok((entry.offset, entry.stored_bytes as usize)),
        None => Err(SourceError::NoSuchBlock {
            block,
            name: name.to_owned(),
            // The directory has at most 2^32 - 1 entries.
            count: model.block_id_count(),
        }),
    }
}

/// The place of a page of attributes in the file.
///
/// # Errors
/// [`SourceError::NoAttributes`].
fn place_of_page(model: &Model, page: u32, name: &str) -> Result<(u64, usize), SourceError> {
    match model.attributes.entries().get(page as usize).filter(|entry| entry.stored_bytes > 0) {
        Some(entry) => Ok((entry.offset, entry.stored_bytes as usize)),
        None => Err(SourceError::NoAttributes { page, name: name.to_owned() }),
    }
}

/// What a page of attributes is called in errors.
fn page_name(page: u32) -> String {
    format!("page {page} of the attributes")
}

/// What room for a model's directory is asked of a budget for.
pub(crate) const DIRECTORY: &str = "the model's directory and materials";

/// What a block is called in errors.
fn block_name(block: BlockId) -> String {
    format!("block {}", block.0)
}

/// Carries either error of opening a file through the parser.
enum OpenError {
    Model(crate::error::ModelError),
    Source(SourceError),
}

impl From<crate::error::ModelError> for OpenError {
    fn from(error: crate::error::ModelError) -> OpenError {
        OpenError::Model(error)
    }
}

impl OpenError {
    fn of(self, name: &str) -> SourceError {
        match self {
            OpenError::Model(error) => SourceError::Model { name: name.to_owned(), error },
            OpenError::Source(error) => error,
        }
    }
}
