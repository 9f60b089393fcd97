//! A buffered file whose errors name it.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::error::CompileError;

const BUFFER_BYTES: usize = 1 << 20;

pub(super) struct Out {
    path: PathBuf,
    file: BufWriter<File>,
}

impl Out {
    pub fn create(path: &Path) -> Result<Out, CompileError> {
        match File::create(path) {
            Ok(file) => {
                Ok(Out { path: path.to_path_buf(), file: BufWriter::with_capacity(BUFFER_BYTES, file) })
            }
            Err(error) => Err(CompileError::Write { path: path.to_path_buf(), error }),
        }
    }

    pub fn write(&mut self, bytes: &[u8]) -> Result<(), CompileError> {
        self.file.write_all(bytes).map_err(|error| CompileError::Write { path: self.path.clone(), error })
    }

    /// Must be called: dropping would lose the errors of the last writes.
    pub fn finish(mut self) -> Result<(), CompileError> {
        self.file.flush().map_err(|error| CompileError::Write { path: self.path, error })
    }
}

/// What a sink that only writes answers when it is asked for a vertex.
pub(super) fn keeps_no_vertices() -> CompileError {
    CompileError::Limit { reason: "a file writer keeps no vertices".to_string() }
}
