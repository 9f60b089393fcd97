//! A fixed buffer that slides over a byte stream; the only place of this room that reads.

use std::io::{self, Read};
use std::path::Path;

use super::meter::Meter;
use crate::error::ImportError;

/// Bytes that one read asks for, and the longest run of bytes (a text line, a header) that readers can see at once.
pub(super) const WINDOW_BYTES: usize = 1 << 20;

/// Newlines that stand behind the valid bytes, so that scanners need not look for the end at every byte and may
/// load eight bytes at once.
pub(super) const PADDING_BYTES: usize = 32;

/// A sliding view of the stream: `data()` is what has been read and not yet consumed.
pub(super) struct Window<'a> {
    reader: Box<dyn Read + 'a>,
    name: &'a Path,
    meter: Meter,
    bytes: Box<[u8]>,
    start: usize,
    end: usize,
    /// Offset in the stream of `bytes[0]`.
    base: u64,
    ended: bool,
}

impl<'a> Window<'a> {
    /// A window over `reader`; `name` is for messages.
    pub(super) fn new(reader: Box<dyn Read + 'a>, name: &'a Path, meter: Meter) -> Window<'a> {
        Window {
            reader,
            name,
            meter,
            bytes: vec![b'\n'; WINDOW_BYTES + PADDING_BYTES].into_boxed_slice(),
            start: 0,
            end: 0,
            base: 0,
            ended: false,
        }
    }

    /// Bytes read and not yet consumed.
    pub(super) fn data(&self) -> &[u8] {
        &self.bytes[self.start..self.end]
    }

    /// `data()` followed by at least [`PADDING_BYTES`] newlines.
    pub(super) fn padded(&self) -> &[u8] {
        &self.bytes[self.start..self.end + PADDING_BYTES]
    }

    /// Marks the first `count` bytes of `data()` as done.
    pub(super) fn consume(&mut self, count: usize) {
        debug_assert!(count <= self.end - self.start);
        self.start += count;
    }

    /// Offset in the stream of the first byte of `data()`.
    pub(super) fn offset(&self) -> u64 {
        self.base + self.start as u64
    }

    /// Whether the stream has no bytes beyond `data()`.
    pub(super) fn ended(&self) -> bool {
        self.ended
    }

    /// Moves what is left to the front and reads until the window is full or the stream ends.
    pub(super) fn refill(&mut self) -> Result<(), ImportError> {
        if self.ended {
            return Ok(());
        }
        self.bytes.copy_within(self.start..self.end, 0);
        self.base += self.start as u64;
        self.end -= self.start;
        self.start = 0;
        while self.end < WINDOW_BYTES {
            match self.reader.read(&mut self.bytes[self.end..WINDOW_BYTES]) {
                Ok(0) => {
                    self.ended = true;
                    break;
                }
                Ok(count) => self.end += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(ImportError::Io { path: self.name.to_path_buf(), error }),
            }
        }
        self.bytes[self.end..self.end + PADDING_BYTES].fill(b'\n');
        Ok(())
    }

    /// Consumes `count` bytes, wherever they end; false if the stream ends first.
    pub(super) fn skip(&mut self, mut count: u64) -> Result<bool, ImportError> {
        loop {
            let here = (self.end - self.start).min(usize::try_from(count).unwrap_or(usize::MAX));
            self.start += here;
            count -= here as u64;
            if count == 0 {
                return Ok(true);
            }
            if self.ended {
                return Ok(false);
            }
            self.refill()?;
        }
    }

    /// How far the source is read, and its size, for progress.
    pub(super) fn progress(&self) -> (u64, Option<u64>) {
        self.meter.progress(self.offset())
    }

    /// An error about a line.
    pub(super) fn line_error(&self, line: u64, reason: impl Into<String>) -> ImportError {
        ImportError::Line { path: self.name.to_path_buf(), line, reason: reason.into() }
    }

    /// An error about bytes.
    pub(super) fn byte_error(&self, offset: u64, reason: impl Into<String>) -> ImportError {
        ImportError::Byte { path: self.name.to_path_buf(), offset, reason: reason.into() }
    }
}
