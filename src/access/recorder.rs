//! Writing a trace while queries run.

use std::io::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use parking_lot::Mutex;

use super::bytes::{self, BLOCKS_MAX, Header, STREAMS_MAX};
use super::{AccessTotals, QueryKind};
use crate::error::AccessTraceError;
use crate::units::{BlockId, Bytes};

/// A log hands its bytes over when it holds so many.
const PAYLOAD_BYTES: usize = 16 << 10;

/// Takes down which blocks the queries of a run enter, one stream for each tracer, and writes that to a file or anything
/// else that can be written to. Shared by the threads of the run.
///
/// Order is kept within a stream. Between streams it is kept roughly: they write in turns of 16 KiB.
///
/// Memory outside the budget: 16 KiB, and twice four bytes for each block that one query enters, per stream.
pub struct AccessRecorder {
    block_count: u32,
    streams: AtomicU32,
    output: Mutex<Output>,
}

struct Output {
    writer: Box<dyn Write + Send>,
    totals: AccessTotals,
    /// The first failure; nothing is written after it.
    error: Option<io::Error>,
    is_sealed: bool,
}

impl AccessRecorder {
    /// Starts a trace of a run over a model of `block_count` blocks with cache slots of `slot_bytes`.
    ///
    /// # Errors
    /// [`AccessTraceError::Io`] if the header cannot be written, [`AccessTraceError::TooManyBlocks`] beyond 2^24 blocks.
    pub fn new(
        mut writer: Box<dyn Write + Send>,
        block_count: u32,
        slot_bytes: Bytes,
    ) -> Result<Arc<AccessRecorder>, AccessTraceError> {
        if block_count > BLOCKS_MAX {
            return Err(AccessTraceError::TooManyBlocks { block_count, limit: BLOCKS_MAX });
        }
        writer.write_all(&Header { block_count, slot_bytes }.to_bytes()).map_err(AccessTraceError::Io)?;
        let output = Output { writer, totals: AccessTotals::default(), error: None, is_sealed: false };
        Ok(Arc::new(AccessRecorder { block_count, streams: AtomicU32::new(0), output: Mutex::new(output) }))
    }

    /// A stream of its own for the calling thread, or for one that it is sent to. After 2^16 streams the last is used again.
    pub fn log(self: &Arc<Self>) -> AccessLog {
        AccessLog {
            stream: self.streams.fetch_add(1, Ordering::Relaxed).min(STREAMS_MAX - 1),
            recorder: Arc::clone(self),
            payload: Vec::with_capacity(PAYLOAD_BYTES),
            kind: None,
            blocks: Vec::new(),
            previous: Vec::new(),
            has_previous: false,
            repeats: None,
            totals: AccessTotals::default(),
        }
    }

    /// Seals the trace; how much it holds. A trace without its seal does not open. Logs that still live, and logs made
    /// later, add nothing more.
    ///
    /// # Errors
    /// [`AccessTraceError::Io`] if anything could not be written, then or before.
    pub fn finish(&self) -> Result<AccessTotals, AccessTraceError> {
        let mut output = self.output.lock();
        if let Some(error) = output.error.take() {
            return Err(AccessTraceError::Io(error));
        }
        let totals = output.totals;
        if !std::mem::replace(&mut output.is_sealed, true) {
            output.writer.write_all(&bytes::seal(totals)).map_err(AccessTraceError::Io)?;
            output.writer.flush().map_err(AccessTraceError::Io)?;
        }
        Ok(totals)
    }

    fn write(&self, stream: u32, payload: &[u8], totals: AccessTotals) {
        let mut output = self.output.lock();
        if output.error.is_some() || output.is_sealed {
            return;
        }
        match output.writer.write_all(&bytes::chunk(stream, payload)) {
            Ok(()) => {
                output.totals.queries += totals.queries;
                output.totals.accesses += totals.accesses;
            }
            Err(error) => output.error = Some(error),
        }
    }
}

/// One stream of a trace. Dropping it hands over what it still holds.
pub struct AccessLog {
    recorder: Arc<AccessRecorder>,
    stream: u32,
    payload: Vec<u8>,
    /// The query that runs.
    kind: Option<QueryKind>,
    /// The blocks that it entered so far.
    blocks: Vec<u32>,
    /// Those of the query before, if there is one in this chunk.
    previous: Vec<u32>,
    has_previous: bool,
    /// Repetitions not yet put into the payload.
    repeats: Option<(QueryKind, u64)>,
    /// What the payload and the repetitions hold.
    totals: AccessTotals,
}

impl AccessLog {
    /// The query before has ended, and another begins.
    pub fn begin(&mut self, kind: QueryKind) {
        self.end_query();
        self.kind = Some(kind);
    }

    /// The query enters `block`. Before the first query, and for a block that the model does not have, this does
    /// nothing.
    pub fn enter(&mut self, block: BlockId) {
        if self.kind.is_some() && block.0 < self.recorder.block_count {
            self.blocks.push(block.0);
        }
    }

    fn end_query(&mut self) {
        let Some(kind) = self.kind.take() else { return };
        self.totals.queries += 1;
        self.totals.accesses += self.blocks.len() as u64;
        if self.has_previous && self.blocks == self.previous {
            self.blocks.clear();
            match &mut self.repeats {
                Some((of, count)) if *of == kind => *count += 1,
                _ => {
                    self.put_repeats();
                    self.repeats = Some((kind, 1));
                }
            }
            return;
        }
        self.put_repeats();
        bytes::put_query(kind, &self.blocks, &self.previous, &mut self.payload);
        std::mem::swap(&mut self.blocks, &mut self.previous);
        self.blocks.clear();
        self.has_previous = true;
        if self.payload.len() >= PAYLOAD_BYTES {
            self.hand_over();
        }
    }

    fn put_repeats(&mut self) {
        if let Some((kind, count)) = self.repeats.take() {
            bytes::put_repeats(kind, count, &mut self.payload);
        }
    }

    fn hand_over(&mut self) {
        self.put_repeats();
        if !self.payload.is_empty() {
            self.recorder.write(self.stream, &self.payload, self.totals);
        }
        self.payload.clear();
        self.previous.clear();
        self.has_previous = false;
        self.totals = AccessTotals::default();
    }
}

impl Drop for AccessLog {
    fn drop(&mut self) {
        self.end_query();
        self.hand_over();
    }
}

impl std::fmt::Debug for AccessRecorder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AccessRecorder").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for AccessLog {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AccessLog").finish_non_exhaustive()
    }
}
