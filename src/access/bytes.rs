//! The bytes of a recorded trace. Numbers are little-endian; a *varint* has seven bits per byte, low ones first, and the
//! high bit set in all but the last.
//!
//! | part | bytes |
//! |---|---|
//! | signature | 12 |
//! | version, number of blocks of the model | 4, 4 |
//! | bytes of a cache slot in the recorded run | 8 |
//! | XXH3-64 of the above | 8 |
//! | chunks, each: stream, payload length (u32 each), XXH3-64 of these and the payload, payload | 16 + payload |
//! | seal: a chunk of stream 2^32 - 1 whose payload is queries, accesses (u64 each) | 32 |
//!
//! A chunk's payload is a sequence of queries of one stream, that is, one tracer. Each starts with a varint: bit 0 is the kind (0
//! closest, 1 occlusion), bit 1 whether it repeats. If not, the rest of the number is how many blocks the query
//! entered, and as many varints follow: each block, as a zigzag difference from the block at the same place of the query before, or
//! from the block before where that has no such place (0 at the chunk's start). If it repeats, the rest is how many further
//! queries of the kind entered exactly the blocks of the query before; at least 1, and never the first of a chunk.

use super::{AccessTotals, QueryKind};
use crate::block::checksum;
use crate::error::AccessTraceError;
use crate::units::Bytes;

pub(super) const SIGNATURE: [u8; 12] = *b"\x89access\x00\r\n\x1a\n";
pub(super) const VERSION: u32 = 1;
pub(super) const HEADER_BYTES: usize = 36;
pub(super) const CHUNK_HEADER_BYTES: usize = 16;
/// Most blocks of a model that a trace can be of, so that what is allocated for each of them has a bound (I5). With blocks of
/// the usual 64 KiB, these are a terabyte.
pub(super) const BLOCKS_MAX: u32 = 1 << 24;
/// Most streams, for the same reason.
pub(super) const STREAMS_MAX: u32 = 1 << 16;
/// Stream of the seal.
pub(super) const SEAL: u32 = u32::MAX;

/// What a trace says about the run it is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Header {
    pub block_count: u32,
    pub slot_bytes: Bytes,
}

impl Header {
    pub fn to_bytes(self) -> Vec<u8> {
        let mut out = Vec::with_capacity(HEADER_BYTES);
        out.extend_from_slice(&SIGNATURE);
        out.extend_from_slice(&VERSION.to_le_bytes());
        out.extend_from_slice(&self.block_count.to_le_bytes());
        out.extend_from_slice(&self.slot_bytes.0.to_le_bytes());
        out.extend_from_slice(&checksum(&out).to_le_bytes());
        out
    }

    pub fn parse(bytes: &[u8]) -> Result<Header, AccessTraceError> {
        if !bytes.starts_with(&SIGNATURE) {
            return Err(AccessTraceError::NotATrace);
        }
        let damaged = |offset, reason| AccessTraceError::Damaged { offset, reason };
        let header = bytes.get(..HEADER_BYTES).ok_or(damaged(bytes.len() as u64, "it ends in the header"))?;
        let version = u32_at(header, 12);
        if version != VERSION {
            return Err(AccessTraceError::Version { found: version, supported: VERSION });
        }
        if u64_at(header, 28) != checksum(&header[..28]) {
            return Err(damaged(28, "the header's checksum is wrong"));
        }
        if u32_at(header, 16) > BLOCKS_MAX {
            return Err(damaged(16, "it says that the model has more blocks than a trace can be of"));
        }
        Ok(Header { block_count: u32_at(header, 16), slot_bytes: Bytes(u64_at(header, 20)) })
    }
}

/// A chunk with its header.
pub(super) fn chunk(stream: u32, payload: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(CHUNK_HEADER_BYTES + payload.len());
    out.extend_from_slice(&stream.to_le_bytes());
    out.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    out.extend_from_slice(&chunk_checksum(stream, payload).to_le_bytes());
    out.extend_from_slice(payload);
    out
}

pub(super) fn chunk_checksum(stream: u32, payload: &[u8]) -> u64 {
    // The length is checked by the checksum of so many bytes; the stream by standing in its place.
    checksum(payload) ^ u64::from(stream).wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

/// The last chunk.
pub(super) fn seal(totals: AccessTotals) -> Vec<u8> {
    let payload = [totals.queries.to_le_bytes(), totals.accesses.to_le_bytes()].concat();
    chunk(SEAL, &payload)
}

/// The number at `at`, which the caller knows to be there.
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    bytes[at..at + 4].iter().rev().fold(0, |number, byte| number << 8 | u32::from(*byte))
}

/// The number at `at`, which the caller knows to be there.
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at + 4)) << 32 | u64::from(u32_at(bytes, at))
}

pub(super) fn put_varint(mut number: u64, out: &mut Vec<u8>) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

/// A number and the bytes after it, or `None` if there is no number below 2^63.
fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let mut number = 0;
    for (index, byte) in bytes.iter().enumerate().take(9) {
        number |= u64::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            return Some((number, &bytes[index + 1..]));
        }
    }
    None
}

/// The block before which a difference is taken.
fn expected(previous: &[u32], blocks: &[u32]) -> u32 {
    previous.get(blocks.len()).or(blocks.last()).copied().unwrap_or(0)
}

/// Appends a query that is not a repetition.
pub(super) fn put_query(kind: QueryKind, blocks: &[u32], previous: &[u32], out: &mut Vec<u8>) {
    put_varint((blocks.len() as u64) << 2 | kind_bit(kind), out);
    for (index, block) in blocks.iter().enumerate() {
        let difference = i64::from(*block) - i64::from(expected(previous, &blocks[..index]));
        put_varint((difference << 1 ^ difference >> 63) as u64, out);
    }
}

/// Appends `count` repetitions of the query before.
pub(super) fn put_repeats(kind: QueryKind, count: u64, out: &mut Vec<u8>) {
    put_varint(count << 2 | 2 | kind_bit(kind), out);
}

fn kind_bit(kind: QueryKind) -> u64 {
    match kind {
        QueryKind::Closest => 0,
        QueryKind::Occlusion => 1,
    }
}

/// A payload, taken apart query by query. Keeps the blocks of two queries.
#[derive(Default)]
pub(super) struct Decoder {
    blocks: Vec<u32>,
    previous: Vec<u32>,
    is_inside: bool,
}

/// Some queries in a row that entered the same blocks.
pub(super) struct Run<'d> {
    pub kind: QueryKind,
    pub blocks: &'d [u32],
    pub count: u64,
}

impl Decoder {
    /// At the start of a chunk.
    pub fn restart(&mut self) {
        self.blocks.clear();
        self.previous.clear();
        self.is_inside = false;
    }

    /// Takes the next run off the front of `bytes`, which are not empty; what is wrong, if they mean nothing. Allocates
    /// for no more blocks than there are bytes.
    pub fn next(&mut self, bytes: &mut &[u8], block_count: u32) -> Result<Run<'_>, &'static str> {
        let (head, mut rest) = varint(bytes).ok_or("a query has no sound number at its start")?;
        let kind = if head & 1 == 0 { QueryKind::Closest } else { QueryKind::Occlusion };
        let number = head >> 2;
        if head & 2 != 0 {
            if number == 0 || !self.is_inside {
                return Err("a repetition of nothing");
            }
            *bytes = rest;
            return Ok(Run { kind, blocks: &self.blocks, count: number });
        }
        std::mem::swap(&mut self.blocks, &mut self.previous);
        self.blocks.clear();
        for _ in 0..number {
            let (zigzag, after) = varint(rest).ok_or("a query has fewer blocks than it says")?;
            rest = after;
            let difference = (zigzag >> 1) as i64 ^ -((zigzag & 1) as i64);
            let block = i64::from(expected(&self.previous, &self.blocks)).checked_add(difference);
            let block =
                block.and_then(|block| u32::try_from(block).ok()).filter(|block| *block < block_count);
            self.blocks.push(block.ok_or("a block that the model does not have")?);
        }
        *bytes = rest;
        self.is_inside = true;
        Ok(Run { kind, blocks: &self.blocks, count: 1 })
    }
}
