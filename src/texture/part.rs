//! A part of a file as a file of its own, for decoders that read from the beginning to the end.

use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

/// Bytes `place` of a file, or of what is read as one.
#[derive(Debug)]
pub(super) struct Part<F> {
    file: F,
    place: Range<u64>,
    /// Of the next byte, from the beginning of the part.
    position: u64,
}

impl<F: Read + Seek> Part<F> {
    /// `place` must lie inside the file.
    pub fn new(mut file: F, place: Range<u64>) -> io::Result<Part<F>> {
        file.seek(SeekFrom::Start(place.start))?;
        Ok(Part { file, place, position: 0 })
    }

    /// Its length in bytes.
    pub fn len(&self) -> u64 {
        self.place.end.saturating_sub(self.place.start)
    }
}

impl<F: Read + Seek> Read for Part<F> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let left = self.len().saturating_sub(self.position);
        let most = usize::try_from(left).unwrap_or(usize::MAX).min(into.len());
        let count = self.file.read(&mut into[..most])?;
        self.position += count as u64;
        Ok(count)
    }
}

impl<F: Read + Seek> Seek for Part<F> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(offset) => self.len().checked_add_signed(offset),
            SeekFrom::Current(offset) => self.position.checked_add_signed(offset),
        };
        let position = position.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        let start = self.place.start.checked_add(position);
        let start = start.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        self.file.seek(SeekFrom::Start(start))?;
        self.position = position;
        Ok(position)
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_part_is_a_file_of_its_own() {
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(b"0123456789").unwrap();
        let mut part = Part::new(file, 3..8).unwrap();
        let mut text = String::new();
        part.read_to_string(&mut text).unwrap();
        assert_eq!(text, "34567");
        let mut rest = |part: &mut Part<std::fs::File>| {
            text.clear();
            part.read_to_string(&mut text).unwrap();
            text.clone()
        };
        assert_eq!((part.seek(SeekFrom::End(-2)).unwrap(), rest(&mut part)), (3, "67".to_owned()));
        assert_eq!((part.seek(SeekFrom::Current(-1)).unwrap(), rest(&mut part)), (4, "7".to_owned()));
        // Beyond the end there is nothing; before the beginning is no place.
        assert_eq!((part.seek(SeekFrom::Start(9)).unwrap(), rest(&mut part)), (9, String::new()));
        assert!(part.seek(SeekFrom::End(-6)).is_err());
        assert!(part.seek(SeekFrom::Start(u64::MAX)).is_err());
    }
}
