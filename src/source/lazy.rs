//! A model that is compiled while its blocks are read.

use std::io;
use std::sync::Arc;

use super::{BlockSource, block_name};
use crate::block::stored_bytes_max;
use crate::compile::LazyModel;
use crate::error::{LoadError, SourceError};
use crate::model::{BlockEntry, Model};
use crate::units::{BlockId, Bytes, CellId};

impl BlockSource for LazyModel {
    fn model(&self) -> &Arc<Model> {
        LazyModel::model(self)
    }

    fn buffer_bytes(&self) -> Bytes {
        Bytes(stored_bytes_max(self.model().limits) as u64)
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        into.clear();
        let name = || self.path().display().to_string();
        match LazyModel::read_block(self, block, into) {
            Some(Ok(())) => Ok(()),
            Some(Err(error)) if error.kind() == io::ErrorKind::UnexpectedEof => {
                let end = std::fs::metadata(self.path()).map_or(0, |metadata| metadata.len());
                Err(SourceError::Truncated { what: block_name(block), name: name(), end })
            }
            Some(Err(error)) => Err(SourceError::Io { what: block_name(block), name: name(), error }),
            None => {
                let count = self.model().block_id_count();
                Err(SourceError::NoSuchBlock { block, name: name(), count })
            }
        }
    }

    fn cut_cell(&self, cell: CellId) -> Result<Arc<[BlockEntry]>, LoadError> {
        LazyModel::cut_cell(self, cell).map_err(|error| LoadError::Cut(Box::new(error)))
    }
}
