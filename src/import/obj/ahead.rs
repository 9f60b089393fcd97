//! Chunks parsed by other threads while the calling thread reads on, in bounded number.

use std::any::Any;
use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};

use super::chunk::Chunk;

/// Most threads that are given work: one parses faster than the calling thread can take it from four.
const THREADS_MAX: usize = 4;
/// Chunks on their way beside those that are being parsed.
const CHUNKS_WAITING: usize = 2;

/// A chunk that was parsed, or the panic of that.
type Parsed = (u64, Result<Chunk, Box<dyn Any + Send>>);

/// Chunks on their way through the threads of a pool.
pub(super) struct Ahead {
    pool: Arc<rayon::ThreadPool>,
    sender: Sender<Parsed>,
    parsed: Receiver<Parsed>,
    /// Those that are done before their turn.
    early: VecDeque<(u64, Chunk)>,
    spare: Vec<Chunk>,
    given: u64,
    taken: u64,
}

impl Ahead {
    pub(super) fn new(pool: Arc<rayon::ThreadPool>) -> Ahead {
        let (sender, parsed) = channel();
        Ahead { pool, sender, parsed, early: VecDeque::new(), spare: Vec::new(), given: 0, taken: 0 }
    }

    /// Whether one more chunk may be given.
    pub(super) fn has_room(&self) -> bool {
        let threads = self.pool.current_num_threads().min(THREADS_MAX);
        self.given - self.taken < (threads + CHUNKS_WAITING) as u64
    }

    /// A chunk to be filled with text.
    pub(super) fn spare(&mut self) -> Chunk {
        self.spare.pop().unwrap_or_default()
    }

    /// Takes back a chunk that is done with.
    pub(super) fn give_back(&mut self, chunk: Chunk) {
        self.spare.push(chunk);
    }

    /// Has the text of a chunk parsed.
    pub(super) fn give(&mut self, mut chunk: Chunk, check_digits: bool, with_attributes: bool) {
        let (sender, turn) = (self.sender.clone(), self.given);
        self.given += 1;
        self.pool.spawn(move || {
            // A panic would end the process here; the calling thread is the one to unwind.
            let parsed = catch_unwind(AssertUnwindSafe(|| {
                chunk.parse(check_digits, with_attributes);
                chunk
            }));
            // Nobody waits for it any more if the reader has failed.
            let _ = sender.send((turn, parsed));
        });
    }

    /// The next chunk in the order in which they were given; `None` if all were taken.
    pub(super) fn take(&mut self) -> Option<Chunk> {
        if self.taken == self.given {
            return None;
        }
        let turn = self.taken;
        self.taken += 1;
        loop {
            if let Some(at) = self.early.iter().position(|(early, _)| *early == turn) {
                return self.early.remove(at).map(|(_, chunk)| chunk);
            }
            // `self` has a sender, so this does not fail.
            let (done, chunk) = self.parsed.recv().ok()?;
            self.early.push_back((done, chunk.unwrap_or_else(|panic| resume_unwind(panic))));
        }
    }
}
