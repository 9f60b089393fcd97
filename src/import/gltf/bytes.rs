//! The bytes of buffers, wherever they are.

use std::fs::File;
use std::io::{ErrorKind, Read, Seek, SeekFrom};
use std::path::PathBuf;

use gltf::buffer::Source;

use super::data_uri;
use super::document::Opened;
use crate::error::ImportError;

/// Where one buffer is.
enum Place {
    /// Part of a file.
    File { path: PathBuf, file: File, start: u64 },
    /// It stood in the document.
    Memory(Vec<u8>),
}

struct OpenBuffer {
    place: Place,
    length: u64,
}

/// Reads from the buffers of a document; the one that was read last stays open.
pub(super) struct Bytes<'o> {
    opened: &'o Opened,
    last: Option<(usize, OpenBuffer)>,
}

impl<'o> Bytes<'o> {
    pub fn new(opened: &'o Opened) -> Bytes<'o> {
        Bytes { opened, last: None }
    }

    /// Fills `into` with the bytes of buffer `index` from `offset` on.
    pub fn read(&mut self, index: usize, offset: u64, into: &mut [u8]) -> Result<(), ImportError> {
        let opened = self.opened;
        let buffer = match self.last.take() {
            Some((last, buffer)) if last == index => buffer,
            _ => open(opened, index)?,
        };
        let (_, buffer) = self.last.insert((index, buffer));
        let name = || format!("buffers[{index}]");
        let end = offset.checked_add(into.len() as u64);
        if end.is_none_or(|end| end > buffer.length) {
            return Err(opened.error(name(), format!("it has {} bytes and more are named", buffer.length)));
        }
        match &mut buffer.place {
            Place::Memory(bytes) => {
                match bytes.get(offset as usize..).and_then(|rest| rest.get(..into.len())) {
                    Some(bytes) => into.copy_from_slice(bytes),
                    None => return Err(opened.error(name(), format!("only {} bytes are there", bytes.len()))),
                }
            }
            Place::File { path, file, start } => {
                let io = |error| ImportError::Io { path: path.clone(), error };
                file.seek(SeekFrom::Start(*start + offset)).map_err(io)?;
                file.read_exact(into).map_err(io)?;
            }
        }
        Ok(())
    }
}

fn open(opened: &Opened, index: usize) -> Result<OpenBuffer, ImportError> {
    let name = || format!("buffers[{index}]");
    let Some(buffer) = opened.document.buffers().nth(index) else {
        return Err(opened.error(name(), "it is not there"));
    };
    let length = buffer.length() as u64;
    let file = |path: PathBuf, start: u64, room: Option<u64>| {
        let io = |error| ImportError::Io { path: path.clone(), error };
        // Opening a pipe would wait for whoever writes to it.
        if !path.metadata().map_err(io)?.is_file() {
            return Err(io(std::io::Error::new(ErrorKind::InvalidInput, "it is not a file")));
        }
        let file = File::open(&path).map_err(io)?;
        let there = match room {
            Some(room) => room,
            None => file.metadata().map_err(io)?.len(),
        };
        if there < length {
            let reason = format!("{} has {there} bytes of it and should have {length}", path.display());
            return Err(opened.error(name(), reason));
        }
        Ok(OpenBuffer { place: Place::File { path, file, start }, length })
    };
    match buffer.source() {
        Source::Bin => match &opened.chunk {
            Some(chunk) => file(opened.path().to_path_buf(), chunk.start, Some(chunk.end - chunk.start)),
            None => Err(opened.error(name(), "it has no uri and the file has no binary chunk")),
        },
        // The document is of limited length, and so is what stands in it.
        Source::Uri(uri) if data_uri::is_data(uri) => {
            let bytes = data_uri::text(uri).and_then(|text| data_uri::decode(text.as_bytes()));
            let bytes = bytes.ok_or_else(|| opened.error(name(), "its data is not in base64"))?;
            Ok(OpenBuffer { place: Place::Memory(bytes), length })
        }
        Source::Uri(uri) => match opened.file_beside(uri) {
            Some(path) => file(path, 0, None),
            None => Err(opened.error(name(), "its uri names no file beside this one")),
        },
    }
}
