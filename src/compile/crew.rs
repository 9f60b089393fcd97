//! Scatter on several threads: each takes batches of triangles to buckets of its own, which are joined at the end.
//!
//! Which thread takes a batch decides in which chunk a triangle travels, and nothing else: the cut sees buckets as sets.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};

use super::clock::{Meter, Moment};
use super::lookup::Form;
use super::point::Point;
use super::scatter::{AddBatch, FinishScatter, Scatter, Scattered};
use super::vertices::VertexStore;
use crate::budget::Reservation;
use crate::error::CompileError;

/// Triangles that are handed over at once.
const BATCH_TRIANGLES: usize = 16 << 10;
/// Batches that may wait for each thread.
const BATCHES_WAITING: usize = 2;

/// Memory that the batches of `threads` threads take at most.
pub(super) fn batch_bytes(threads: usize) -> u64 {
    ((BATCHES_WAITING + 2) * threads * BATCH_TRIANGLES * size_of::<[u32; 3]>()) as u64
}

/// The answer to what comes after an error that lost something.
pub(super) fn ended() -> CompileError {
    CompileError::Limit { reason: "an earlier error has ended this compile".into() }
}

struct Batch {
    triangles: Vec<[u32; 3]>,
    material: u16,
    first_id: u64,
}

/// What a thread leaves: its buckets and its time, or why there are none.
type Outcome<P> = Result<Result<(Scattered<P>, Meter), CompileError>, Box<dyn Any + Send>>;

/// Threads at work. Dropping it waits until they have stopped.
pub(super) struct Crew<P: Point> {
    senders: Vec<SyncSender<Batch>>,
    outcomes: Receiver<Outcome<P>>,
    spare: Receiver<Vec<[u32; 3]>>,
    /// The batch that is being gathered.
    open: Batch,
    turn: usize,
    _memory: Reservation,
}

impl<P: Point> Crew<P> {
    /// Starts one thread of the pool for each scatter, of which there must be one. `store` must be resident; `memory`
    /// covers [`batch_bytes`].
    pub(super) fn start<F: Form<Point = P>>(
        pool: &rayon::ThreadPool,
        scatters: Vec<Scatter<P>>,
        memory: Reservation,
        store: &Arc<VertexStore>,
        form: F,
    ) -> Crew<P> {
        let (outcome_sender, outcomes) = channel();
        let (spare_sender, spare) = channel();
        let mut senders = Vec::new();
        for scatter in scatters {
            let (sender, batches) = sync_channel(BATCHES_WAITING);
            senders.push(sender);
            let (outcome_sender, spare_sender, store) =
                (outcome_sender.clone(), spare_sender.clone(), Arc::clone(store));
            pool.spawn(move || {
                // A panic would end the process here; the caller's thread is the one to unwind. What the closure owns is gone when
                // the outcome is sent, so whoever has all outcomes has all memory back.
                let work = AssertUnwindSafe(|| work(scatter, store, form, batches, spare_sender));
                let outcome = catch_unwind(work);
                let _ = outcome_sender.send(outcome);
            });
        }
        let open = Batch { triangles: Vec::new(), material: 0, first_id: 0 };
        Crew { senders, outcomes, spare, open, turn: 0, _memory: memory }
    }

    /// Hands triangles over. An error of a thread shows here or in [`Crew::finish`].
    pub(super) fn add(
        &mut self,
        mut triangles: &[[u32; 3]],
        material: u16,
        mut first_id: u64,
    ) -> Result<(), CompileError> {
        while !triangles.is_empty() {
            let next_id = self.open.first_id + self.open.triangles.len() as u64;
            if self.open.triangles.len() == BATCH_TRIANGLES
                || (self.open.material, next_id) != (material, first_id)
            {
                self.hand_over()?;
                (self.open.material, self.open.first_id) = (material, first_id);
            }
            let count = triangles.len().min(BATCH_TRIANGLES - self.open.triangles.len());
            self.open.triangles.extend_from_slice(&triangles[..count]);
            triangles = &triangles[count..];
            first_id += count as u64;
        }
        Ok(())
    }

    fn hand_over(&mut self) -> Result<(), CompileError> {
        if self.open.triangles.is_empty() {
            return Ok(());
        }
        self.require_whole()?;
        let triangles = self.spare.try_recv().unwrap_or_else(|_| Vec::with_capacity(BATCH_TRIANGLES));
        let batch = Batch { triangles: std::mem::replace(&mut self.open.triangles, triangles), ..self.open };
        self.turn = (self.turn + 1) % self.senders.len();
        match self.senders[self.turn].send(batch) {
            Ok(()) => Ok(()),
            // That thread has stopped before its time: it failed.
            Err(_) => Err(self.failure()),
        }
    }

    /// An error if a thread has failed before: what it had is lost, and the others have been sent home.
    fn require_whole(&self) -> Result<(), CompileError> {
        match self.senders.is_empty() {
            true => Err(ended()),
            false => Ok(()),
        }
    }

    /// Why a thread has stopped.
    fn failure(&mut self) -> CompileError {
        self.senders.clear();
        while let Ok(outcome) = self.outcomes.recv() {
            match outcome {
                Ok(Ok(_)) => {}
                Ok(Err(error)) => return error,
                Err(panic) => resume_unwind(panic),
            }
        }
        unreachable!("a thread stops early only with an error or a panic")
    }

    /// Waits for all threads and joins their buckets.
    pub(super) fn finish(mut self) -> Result<(Scattered<P>, Meter), CompileError> {
        self.hand_over()?;
        self.require_whole()?;
        self.senders.clear();
        let (mut parts, mut time) = (Vec::new(), Meter::default());
        while let Ok(outcome) = self.outcomes.recv() {
            let (part, spent) = outcome.unwrap_or_else(|panic| resume_unwind(panic))?;
            time.merge(&spent);
            parts.push(part);
        }
        Ok((Scattered::join(parts)?, time))
    }
}

impl<P: Point> Drop for Crew<P> {
    fn drop(&mut self) {
        self.senders.clear();
        while self.outcomes.recv().is_ok() {}
    }
}

fn work<F: Form>(
    mut scatter: Scatter<F::Point>,
    store: Arc<VertexStore>,
    form: F,
    batches: Receiver<Batch>,
    spare: Sender<Vec<[u32; 3]>>,
) -> Result<(Scattered<F::Point>, Meter), CompileError> {
    let mut time = Meter::default();
    for Batch { mut triangles, material, first_id } in batches {
        let start = Moment::now();
        let batch = AddBatch { scatter: &mut scatter, triangles: &triangles, material, first_id };
        store.serve_resident(&form, batch)?;
        time.add_since(start);
        triangles.clear();
        // Nobody needs it any more if the crew is gone.
        let _ = spare.send(triangles);
    }
    let start = Moment::now();
    let scattered = store.serve_resident(&form, FinishScatter(scatter))?;
    time.add_since(start);
    Ok((scattered, time))
}
