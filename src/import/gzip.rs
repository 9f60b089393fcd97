//! Compressed model files: gzip members one after the other (RFC 1952), and zeros behind them, with which tapes and block devices
//! fill up.

use std::io::{self, BufRead, Read};

use flate2::bufread::GzDecoder;

/// Reads what the members hold, one after the other.
pub(super) struct Members<R: BufRead> {
    /// The member at hand; nothing at the end.
    decoder: Option<GzDecoder<R>>,
}

impl<R: BufRead> Members<R> {
    pub fn new(reader: R) -> Members<R> {
        Members { decoder: Some(GzDecoder::new(reader)) }
    }
}

impl<R: BufRead> Read for Members<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(decoder) = &mut self.decoder {
            let count = decoder.read(buffer)?;
            if count > 0 || buffer.is_empty() {
                return Ok(count);
            }
            self.decoder = match self.decoder.take() {
                Some(decoder) => next_member(decoder.into_inner())?,
                None => None,
            };
        }
        Ok(0)
    }
}

/// The first byte of a member.
const MAGIC: u8 = 0x1f;

/// The member that begins here, unless the rest is nothing or zeros.
fn next_member<R: BufRead>(mut reader: R) -> io::Result<Option<GzDecoder<R>>> {
    let mut is_first = true;
    loop {
        let ahead = reader.fill_buf()?;
        match ahead.iter().find(|byte| **byte != 0) {
            _ if ahead.is_empty() => return Ok(None),
            Some(&MAGIC) if is_first && ahead[0] == MAGIC => return Ok(Some(GzDecoder::new(reader))),
            Some(_) => {
                let reason = "behind the end of the compressed data stands something that is not gzip";
                return Err(io::Error::new(io::ErrorKind::InvalidData, reason));
            }
            None => {
                let count = ahead.len();
                reader.consume(count);
                is_first = false;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    fn member(text: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(text).unwrap();
        encoder.finish().unwrap()
    }

    /// In pieces of `size` bytes.
    fn read(bytes: &[u8], size: usize) -> io::Result<String> {
        let mut text = String::new();
        Members::new(io::BufReader::with_capacity(size, bytes)).read_to_string(&mut text)?;
        Ok(text)
    }

    #[test]
    fn members_follow_each_other_and_zeros_may_follow_them() {
        let two = [member(b"one, "), member(b""), member(b"two")].concat();
        let padded = [two.clone(), vec![0; 1000]].concat();
        for size in [1, 7, 64, 4096] {
            assert_eq!(read(&two, size).unwrap(), "one, two");
            assert_eq!(read(&padded, size).unwrap(), "one, two");
            for garbage in [&b"x"[..], b"\0\0x", b"\0\x1f\x8b"] {
                let error = read(&[&two, garbage].concat(), size).unwrap_err();
                assert!(error.to_string().starts_with("behind the end"), "{error}");
            }
            for length in 0..two.len() {
                // Between two members there is nothing to tell that one is missing.
                let cut = read(&two[..length], size);
                assert!(
                    cut.is_err()
                        || length == member(b"one, ").len()
                        || length == two.len() - member(b"two").len()
                );
            }
        }
    }
}
