//! What goes from rank to rank: a body, and after it 17 bytes that say what it is. At the end, so that a frame is
//! sent from where it lies and arrives where it stays.

use super::super::FRAME_BYTES_MAX;

/// One message of MPI.
#[derive(Debug, PartialEq, Eq)]
pub enum Letter {
    /// A node wants to connect to the node `node` of the rank that gets this.
    Connect { from: u64, node: String, name: String },
    /// Connection `to` of the rank that gets this is open; it is called `from` at this end.
    Accept { to: u64, from: u64 },
    /// Connection `to` is not made.
    Refuse { to: u64, reason: String },
    /// A frame of connection `to`.
    Frame { to: u64, bytes: Vec<u8> },
    /// So many bytes that came over the connection were received by the node; as many more may be sent.
    Taken { to: u64, bytes: u64 },
    /// Connection `to` has ended.
    End { to: u64, reason: String },
}

const TRAILER_BYTES: usize = 17;

/// Longest letter.
pub const LETTER_BYTES_MAX: usize = FRAME_BYTES_MAX + TRAILER_BYTES;

impl Letter {
    pub fn into_bytes(self) -> Vec<u8> {
        let (kind, to, from, mut bytes) = match self {
            Letter::Connect { from, node, name } => {
                // Two texts always encode.
                (0, 0, from, postcard::to_allocvec(&(node, name)).unwrap_or_default())
            }
            Letter::Accept { to, from } => (1, to, from, Vec::new()),
            Letter::Refuse { to, reason } => (2, to, 0, reason.into_bytes()),
            Letter::Frame { to, bytes } => (3, to, 0, bytes),
            Letter::Taken { to, bytes } => (4, to, bytes, Vec::new()),
            Letter::End { to, reason } => (5, to, 0, reason.into_bytes()),
        };
        bytes.reserve_exact(TRAILER_BYTES);
        bytes.push(kind);
        bytes.extend_from_slice(&to.to_le_bytes());
        bytes.extend_from_slice(&from.to_le_bytes());
        bytes
    }

    /// `None` if it is no letter.
    pub fn parse(mut bytes: Vec<u8>) -> Option<Letter> {
        let (body, trailer) = bytes.split_last_chunk::<TRAILER_BYTES>()?;
        let (kind, numbers) = trailer.split_first()?;
        let (to, from) = numbers.split_first_chunk::<8>()?;
        let (to, from) = (u64::from_le_bytes(*to), u64::from_le_bytes(from.try_into().ok()?));
        let (kind, length) = (*kind, body.len());
        bytes.truncate(length);
        let is_bare = bytes.is_empty();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).ok();
        Some(match kind {
            0 if to == 0 => {
                let ((node, name), rest) = postcard::take_from_bytes::<(String, String)>(&bytes).ok()?;
                rest.is_empty().then_some(Letter::Connect { from, node, name })?
            }
            1 if is_bare => Letter::Accept { to, from },
            2 if from == 0 => Letter::Refuse { to, reason: text(bytes)? },
            3 if from == 0 => Letter::Frame { to, bytes },
            4 if is_bare => Letter::Taken { to, bytes: from },
            5 if from == 0 => Letter::End { to, reason: text(bytes)? },
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_survive_and_other_bytes_are_none() {
        let text = || "text".to_owned();
        let letters = || {
            [
                Letter::Connect { from: 7, node: text(), name: String::new() },
                Letter::Accept { to: 1, from: u64::MAX },
                Letter::Refuse { to: 2, reason: text() },
                Letter::Frame { to: 3, bytes: vec![] },
                Letter::Frame { to: 3, bytes: vec![9; 1000] },
                Letter::Taken { to: 4, bytes: 1 << 40 },
                Letter::End { to: 5, reason: text() },
            ]
        };
        for (letter, same) in letters().into_iter().zip(letters()) {
            let bytes = letter.into_bytes();
            for length in 0..TRAILER_BYTES {
                assert_eq!(Letter::parse(bytes[..length].to_vec()), None);
            }
            // Whatever a flip makes of it, it is read in the one way that writes these bytes.
            for bit in 0..8 * bytes.len() {
                let mut flipped = bytes.clone();
                flipped[bit / 8] ^= 1 << (bit % 8);
                if let Some(other) = Letter::parse(flipped.clone()) {
                    assert_eq!(other.into_bytes(), flipped);
                }
            }
            assert_eq!(Letter::parse(bytes), Some(same));
        }
        assert_eq!(Letter::parse(vec![6; TRAILER_BYTES]), None);
    }
}
