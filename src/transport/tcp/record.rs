//! Records: what a frame is cut into, since a Noise message holds at most 65,535 bytes with its tag.
//!
//! `length of the ciphertext (u16) | ciphertext`; decrypted: `more or last (u8) | bytes of the frame`. A record that is not the
//! frame's last is full, so a frame cannot be spun out in empty ones. The length of a frame is never announced: memory
//! grows only with what has arrived.

use super::handshake::Session;

pub(super) const LAST: u8 = 0;
pub(super) const MORE: u8 = 1;

const MESSAGE_BYTES_MAX: usize = 65_535;
const TAG_BYTES: usize = 16;
/// Bytes of a frame in a full record.
pub(super) const DATA_BYTES_MAX: usize = MESSAGE_BYTES_MAX - TAG_BYTES - 1;

/// Appends the record of `kind` and `data` (at most [`DATA_BYTES_MAX`]) to `into`.
pub(super) fn write(
    session: &Session,
    nonce: u64,
    kind: &[u8; 1],
    data: &[u8],
    into: &mut Vec<u8>,
) -> Result<(), String> {
    let mut plain = Vec::with_capacity(1 + data.len());
    plain.extend_from_slice(kind);
    plain.extend_from_slice(data);
    let start = into.len();
    into.resize(start + 2 + plain.len() + TAG_BYTES, 0);
    let length =
        session.write_message(nonce, &plain, &mut into[start + 2..]).map_err(|error| error.to_string())?;
    // A Noise message is at most 65,535 bytes.
    into[start..start + 2].copy_from_slice(&(length as u16).to_le_bytes());
    Ok(())
}

/// Reads one record of at most `data_bytes_max` bytes of data through `read`, decrypted into `into` (the kind first).
pub(super) fn read(
    session: &Session,
    nonce: u64,
    data_bytes_max: usize,
    read: &mut dyn FnMut(&mut [u8]) -> Result<(), String>,
    into: &mut Vec<u8>,
) -> Result<(), String> {
    let mut length = [0; 2];
    read(&mut length)?;
    let length = usize::from(u16::from_le_bytes(length));
    if length < TAG_BYTES + 1 {
        return Err("a record is too short".to_owned());
    }
    if length > TAG_BYTES + 1 + data_bytes_max {
        return Err("a record is too long".to_owned());
    }
    let mut cipher = vec![0; length];
    read(&mut cipher)?;
    into.clear();
    into.resize(length, 0);
    let plain = session
        .read_message(nonce, &cipher, into)
        .map_err(|_| "a record is damaged or was not sealed with the connection's key".to_owned())?;
    into.truncate(plain);
    Ok(())
}
