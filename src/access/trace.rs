//! A trace that was read back.

use std::path::Path;

use super::bytes::{
    self, CHUNK_HEADER_BYTES, Decoder, HEADER_BYTES, Header, SEAL, STREAMS_MAX, u32_at, u64_at,
};
use super::{AccessTotals, QueryKind};
use crate::error::AccessTraceError;
use crate::units::Bytes;

/// A recorded trace, checked whole when it was opened and kept as compact as it came: two bytes or so for each entry
/// into a block, much less where neighbouring queries enter the same.
#[derive(Clone, Debug)]
pub struct AccessTrace {
    header: Header,
    bytes: Vec<u8>,
    totals: AccessTotals,
    streams: u32,
}

/// Queries in a row, of one kind, that entered the same blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct AccessQuery<'t> {
    /// Which tracer asked; counted from 0 in the order in which they were made.
    pub stream: u32,
    /// What was asked.
    pub kind: QueryKind,
    /// Numbers of the blocks entered, in order.
    pub blocks: &'t [u32],
    /// How many such queries there were; at least 1.
    pub count: u64,
}

impl AccessTrace {
    /// Reads a trace from a file.
    ///
    /// # Errors
    /// [`AccessTraceError::Io`], or as for [`AccessTrace::from_bytes`].
    pub fn open(path: impl AsRef<Path>) -> Result<AccessTrace, AccessTraceError> {
        AccessTrace::from_bytes(std::fs::read(path).map_err(AccessTraceError::Io)?)
    }

    /// Takes over and checks the bytes that an [`AccessRecorder`](super::AccessRecorder) wrote. They are not trusted (I5): every
    /// length and number is checked here, so nothing later can fail.
    ///
    /// # Errors
    /// What is wrong with them, and where.
    pub fn from_bytes(bytes: Vec<u8>) -> Result<AccessTrace, AccessTraceError> {
        let header = Header::parse(&bytes)?;
        let damaged = |at: usize, reason| AccessTraceError::Damaged { offset: at as u64, reason };
        let (mut totals, mut streams) = (AccessTotals::default(), 0);
        let mut decoder = Decoder::default();
        let mut at = HEADER_BYTES;
        loop {
            let rest = &bytes[at..];
            if rest.len() < CHUNK_HEADER_BYTES {
                return Err(damaged(bytes.len(), "it ends without its seal: the recording was not finished"));
            }
            let (stream, length) = (u32_at(rest, 0), u32_at(rest, 4) as usize);
            let Some(payload) = rest[CHUNK_HEADER_BYTES..].get(..length) else {
                return Err(damaged(at, "it ends inside a chunk"));
            };
            if u64_at(rest, 8) != bytes::chunk_checksum(stream, payload) {
                return Err(damaged(at, "a chunk's checksum is wrong"));
            }
            let start = at + CHUNK_HEADER_BYTES;
            at = start + length;
            if stream == SEAL {
                if length != 16
                    || (u64_at(payload, 0), u64_at(payload, 8)) != (totals.queries, totals.accesses)
                {
                    return Err(damaged(start, "the seal counts something else than the trace holds"));
                }
                if at != bytes.len() {
                    return Err(damaged(at, "there are bytes after the seal"));
                }
                return Ok(AccessTrace { header, bytes, totals, streams });
            }
            if stream >= STREAMS_MAX {
                return Err(damaged(start - CHUNK_HEADER_BYTES, "a stream beyond the greatest"));
            }
            streams = streams.max(stream + 1);
            decoder.restart();
            let mut queries = payload;
            while !queries.is_empty() {
                let offset = start + length - queries.len();
                let run = decoder
                    .next(&mut queries, header.block_count)
                    .map_err(|reason| damaged(offset, reason))?;
                // Sums that no machine could have recorded would overflow.
                let accesses = run.count.checked_mul(run.blocks.len() as u64);
                let sums = accesses.and_then(|accesses| {
                    Some((totals.queries.checked_add(run.count)?, totals.accesses.checked_add(accesses)?))
                });
                let (queries, accesses) = sums.ok_or(damaged(offset, "a count is beyond all bounds"))?;
                totals = AccessTotals { queries, accesses };
            }
        }
    }

    /// How many blocks the model had.
    pub fn block_count(&self) -> u32 {
        self.header.block_count
    }

    /// Size of a cache slot in the run that was recorded.
    pub fn slot_bytes(&self) -> Bytes {
        self.header.slot_bytes
    }

    /// How many queries and accesses there are.
    pub fn totals(&self) -> AccessTotals {
        self.totals
    }

    /// How many tracers were recorded: one more than the greatest stream.
    pub fn stream_count(&self) -> u32 {
        self.streams
    }

    /// Calls `visit` with all queries in the order of the file.
    pub fn visit(&self, mut visit: impl FnMut(AccessQuery<'_>)) {
        let mut decoder = Decoder::default();
        let mut rest = &self.bytes[HEADER_BYTES..];
        // All this was checked when the trace was opened: neither a chunk nor a query can be unsound.
        while rest.len() >= CHUNK_HEADER_BYTES {
            let (stream, length) = (u32_at(rest, 0), u32_at(rest, 4) as usize);
            let (chunk, after) = rest.split_at(CHUNK_HEADER_BYTES + length);
            rest = after;
            let mut queries = if stream == SEAL { &[] } else { &chunk[CHUNK_HEADER_BYTES..] };
            decoder.restart();
            while !queries.is_empty() {
                let Ok(run) = decoder.next(&mut queries, self.header.block_count) else { return };
                visit(AccessQuery { stream, kind: run.kind, blocks: run.blocks, count: run.count });
            }
        }
    }

    /// Calls `visit` with (stream, block) for every access, repeated queries one by one.
    pub fn visit_accesses(&self, mut visit: impl FnMut(u32, u32)) {
        self.visit(|query| {
            for _ in 0..query.count {
                query.blocks.iter().for_each(|block| visit(query.stream, *block));
            }
        });
    }
}
