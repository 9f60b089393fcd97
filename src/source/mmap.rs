//! A compiled file mapped into memory.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use memmap2::Mmap;

use super::{BlockSource, block_name, page_name, place_of, place_of_page};
use crate::error::SourceError;
use crate::model::{Model, ModelReader};
use crate::units::BlockId;

/// Serves blocks from a mapped file. Pages that were read count to the process until the kernel takes them back, so this
/// is for machines where memory is free; under a hard memory cap use [`super::DiskSource`].
#[derive(Debug)]
pub struct MmapSource {
    map: Mmap,
    name: String,
    model: Arc<Model>,
}

impl MmapSource {
    /// Maps a compiled file.
    ///
    /// # Safety
    /// As long as the source lives, nobody may make the file shorter or write to it, and the device must not fail. A page that
    /// cannot be read raises a signal (`SIGBUS`) that ends the process, not an error; bytes that change while they are
    /// copied are undefined behaviour in Rust's terms. To narrow the second, blocks are copied out of the map before
    /// they are checked, so that the decoder never looks at a byte twice that could change in between.
    ///
    /// # Errors
    /// [`SourceError`] if the file cannot be mapped or is not a sound compiled file.
    pub unsafe fn open(path: impl AsRef<Path>) -> Result<MmapSource, SourceError> {
        let path = path.as_ref();
        let name = path.display().to_string();
        let failed = |error| SourceError::Io { what: "the header".to_owned(), name: name.clone(), error };
        let file = File::open(path).map_err(failed)?;
        // SAFETY: the caller promises that the file stays as it is while the map lives.
        let map = unsafe { Mmap::map(&file) }.map_err(failed)?;
        let model =
            ModelReader::parse(&map).map_err(|error| SourceError::Model { name: name.clone(), error })?;
        Ok(MmapSource { map, name, model: Arc::new(model) })
    }
}

impl BlockSource for MmapSource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of(&self.model, block, &self.name)?;
        let stored = usize::try_from(offset).ok().and_then(|start| self.map.get(start..)?.get(..length));
        // The parser has compared the directory with the length of the map, so this does not happen.
        let stored = stored.ok_or_else(|| SourceError::Truncated {
            what: block_name(block),
            name: self.name.clone(),
            end: self.map.len() as u64,
        })?;
        into.extend_from_slice(stored);
        Ok(())
    }

    fn gives_attributes(&self) -> bool {
        true
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of_page(&self.model, page, &self.name)?;
        let stored = usize::try_from(offset).ok().and_then(|start| self.map.get(start..)?.get(..length));
        // The parser has compared the directory with the length of the map, so this does not happen.
        let stored = stored.ok_or_else(|| SourceError::Truncated {
            what: page_name(page),
            name: self.name.clone(),
            end: self.map.len() as u64,
        })?;
        into.extend_from_slice(stored);
        Ok(())
    }
}
