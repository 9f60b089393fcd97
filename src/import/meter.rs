//! How far a reader is, in bytes of the file on disk even when that is compressed.

use std::cell::Cell;
use std::io::{self, Read};
use std::rc::Rc;

/// Knows how far the source is read.
#[derive(Clone, Debug, Default)]
pub(super) struct Meter {
    /// Bytes taken from a compressed file; `None` where stream offsets are file offsets.
    taken: Option<Rc<Cell<u64>>>,
    /// Size of the source, if known.
    total_bytes: Option<u64>,
}

impl Meter {
    /// For a plain file of known size.
    pub(super) fn plain(total_bytes: u64) -> Meter {
        Meter { taken: None, total_bytes: Some(total_bytes) }
    }

    /// For a compressed file of known size: the bytes that `reader` gives are counted.
    #[cfg(feature = "gzip")]
    pub(super) fn compressed<R: Read>(reader: R, total_bytes: u64) -> (Meter, Counted<R>) {
        let taken = Rc::new(Cell::new(0));
        (Meter { taken: Some(taken.clone()), total_bytes: Some(total_bytes) }, Counted { reader, taken })
    }

    /// Bytes consumed and their total, given the offset in the (decompressed) stream.
    pub(super) fn progress(&self, stream_offset: u64) -> (u64, Option<u64>) {
        (self.taken.as_ref().map_or(stream_offset, |taken| taken.get()), self.total_bytes)
    }
}

/// A reader whose bytes are counted.
#[cfg_attr(not(feature = "gzip"), allow(dead_code))] // only compressed files are read through it
pub(super) struct Counted<R> {
    reader: R,
    taken: Rc<Cell<u64>>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.reader.read(buffer)?;
        self.taken.set(self.taken.get() + count as u64);
        Ok(count)
    }
}
