//! A compiled file in memory.

use std::sync::Arc;

use super::{BlockSource, block_name, page_name, place_of, place_of_page};
use crate::error::SourceError;
use crate::model::{Model, ModelReader};
use crate::units::BlockId;

const NAME: &str = "the compiled model in memory";

/// Serves blocks from a whole compiled file in memory. The bytes do not count towards any budget: they are the
/// caller's.
#[derive(Clone, Debug)]
pub struct MemorySource {
    bytes: Arc<[u8]>,
    model: Arc<Model>,
}

impl MemorySource {
    /// Takes the bytes of a compiled file (a `Vec<u8>` or `Arc<[u8]>`; the latter is shared and not copied).
    ///
    /// # Errors
    /// [`SourceError::Model`] if header, directory or materials are damaged. Blocks are checked when they are decoded.
    pub fn new(bytes: impl Into<Arc<[u8]>>) -> Result<MemorySource, SourceError> {
        let bytes = bytes.into();
        let model = ModelReader::parse(&bytes)
            .map_err(|error| SourceError::Model { name: NAME.to_owned(), error })?;
        Ok(MemorySource { bytes, model: Arc::new(model) })
    }

    /// The whole file.
    pub fn bytes(&self) -> &Arc<[u8]> {
        &self.bytes
    }
}

impl BlockSource for MemorySource {
    fn model(&self) -> &Arc<Model> {
        &self.model
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of(&self.model, block, NAME)?;
        let stored = usize::try_from(offset).ok().and_then(|start| self.bytes.get(start..)?.get(..length));
        // The parser has compared the directory with the length of the file, so this does not happen.
        let stored = stored.ok_or_else(|| SourceError::Truncated {
            what: block_name(block),
            name: NAME.to_owned(),
            end: self.bytes.len() as u64,
        })?;
        into.extend_from_slice(stored);
        Ok(())
    }

    fn gives_attributes(&self) -> bool {
        true
    }

    fn read_attributes(&self, page: u32, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let (offset, length) = place_of_page(&self.model, page, NAME)?;
        let stored = usize::try_from(offset).ok().and_then(|start| self.bytes.get(start..)?.get(..length));
        // The parser has compared the directory with the length of the file, so this does not happen.
        let stored = stored.ok_or_else(|| SourceError::Truncated {
            what: page_name(page),
            name: NAME.to_owned(),
            end: self.bytes.len() as u64,
        })?;
        into.extend_from_slice(stored);
        Ok(())
    }
}
