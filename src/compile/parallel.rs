//! Buckets to blocks on any number of threads, written in one order.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc;

use super::blocks::{BlockMaker, BlockSettings, EncodedBucket};
use super::bucket::Bucket;
use super::clock::{Meter, Moment};
use super::point::Point;
use super::scatter::Scattered;
use crate::error::CompileError;

/// Time spent in the two halves of the work.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CutTime {
    pub(super) cut: Meter,
    pub(super) encode: Meter,
}

/// What one thread works with.
pub(super) struct Worker<P: Point> {
    pub(super) bucket: Bucket<P>,
    maker: BlockMaker<P>,
    time: CutTime,
}

impl<P: Point> Worker<P> {
    pub(super) fn new(settings: BlockSettings) -> Worker<P> {
        Worker { bucket: Bucket::new(), maker: BlockMaker::new(settings), time: CutTime::default() }
    }

    /// Makes the blocks of a cell of a working file, at most `blocks_max`, of which there must be enough for any triangles;
    /// false if the bytes are not the cell.
    pub(super) fn make_cell(
        &mut self,
        bytes: &[u8],
        (triangles, vertices): (usize, usize),
        blocks_max: usize,
        out: &mut EncodedBucket,
    ) -> Result<bool, CompileError> {
        if !self.bucket.load_cell(bytes, triangles, vertices) {
            return Ok(false);
        }
        self.maker.cut(&self.bucket);
        self.maker.encode(&self.bucket, out)?;
        if out.blocks.len() > blocks_max {
            self.maker.cut_evenly(&self.bucket);
            self.maker.encode(&self.bucket, out)?;
        }
        Ok(true)
    }

    fn make(
        &mut self,
        scattered: &Scattered<P>,
        index: usize,
        out: &mut EncodedBucket,
    ) -> Result<(), CompileError> {
        let start = Moment::now();
        self.bucket.load(&scattered.spills, &scattered.chunks[scattered.buckets[index].clone()])?;
        self.maker.cut(&self.bucket);
        let start = self.time.cut.add_since(start);
        self.maker.encode(&self.bucket, out)?;
        self.time.encode.add_since(start);
        Ok(())
    }
}

/// Encodes all buckets and gives them to `take` in order. With a pool, `workers` buckets are in work at once and the calling
/// thread only takes; without one it does everything.
pub(super) fn encode_buckets<P: Point>(
    scattered: &Scattered<P>,
    mut workers: Vec<Worker<P>>,
    pool: Option<&rayon::ThreadPool>,
    mut take: impl FnMut(&EncodedBucket) -> Result<(), CompileError>,
) -> Result<CutTime, CompileError> {
    if let Some(pool) = pool {
        return encode_in_pool(scattered, workers, pool, take);
    }
    let mut out = EncodedBucket::default();
    let worker = &mut workers[0];
    for index in 0..scattered.buckets.len() {
        worker.make(scattered, index, &mut out)?;
        take(&out)?;
    }
    Ok(worker.time)
}

fn encode_in_pool<P: Point>(
    scattered: &Scattered<P>,
    workers: Vec<Worker<P>>,
    pool: &rayon::ThreadPool,
    mut take: impl FnMut(&EncodedBucket) -> Result<(), CompileError>,
) -> Result<CutTime, CompileError> {
    let count = scattered.buckets.len();
    // One bucket more than workers, so that a worker does not wait for the one whose turn it is to be written.
    let mut spare: Vec<EncodedBucket> = (0..=workers.len()).map(|_| EncodedBucket::default()).collect();
    let next = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let total = Mutex::new(CutTime::default());
    let (done_sender, done) = mpsc::channel::<(usize, Result<EncodedBucket, CompileError>)>();
    let (spare_sender, spares) = mpsc::channel::<EncodedBucket>();
    let spares = Mutex::new(spares);
    for bucket in spare.drain(..) {
        // The receiver lives until the end of this function.
        let _ = spare_sender.send(bucket);
    }
    pool.in_place_scope(|scope| {
        for mut worker in workers {
            let done_sender = done_sender.clone();
            let (next, stop, total, spares) = (&next, &stop, &total, &spares);
            scope.spawn(move |_| {
                loop {
                    // A buffer first, then a number: so the lowest number that is not done always has a buffer, and the window
                    // of buckets that wait for it is bounded.
                    let (index, mut out) = {
                        let Ok(spares) = spares.lock() else { break };
                        let Ok(out) = spares.recv() else { break };
                        (next.fetch_add(1, Ordering::Relaxed), out)
                    };
                    if index >= count || stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let result = worker.make(scattered, index, &mut out).map(|()| out);
                    if done_sender.send((index, result)).is_err() {
                        break;
                    }
                }
                if let Ok(mut total) = total.lock() {
                    total.cut.merge(&worker.time.cut);
                    total.encode.merge(&worker.time.encode);
                }
            });
        }
        drop(done_sender);
        let mut waiting: Vec<(usize, EncodedBucket)> = Vec::new();
        let mut result = Ok(());
        let mut turn = 0;
        while turn < count && result.is_ok() {
            if let Some(at) = waiting.iter().position(|(index, _)| *index == turn) {
                let (_, bucket) = waiting.swap_remove(at);
                result = take(&bucket);
                turn += 1;
                let _ = spare_sender.send(bucket);
                continue;
            }
            match done.recv() {
                Ok((index, Ok(bucket))) => waiting.push((index, bucket)),
                Ok((_, Err(error))) => result = Err(error),
                // All workers are gone before the last bucket: one panicked, and the scope passes that on.
                Err(mpsc::RecvError) => break,
            }
        }
        stop.store(true, Ordering::Relaxed);
        // Workers that wait for a buffer must not wait for ever.
        drop(spare_sender);
        result
    })?;
    let total = *total.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    Ok(total)
}
