//! Buckets to blocks on any number of threads, written in one order.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
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

/// What comes of a bucket: its blocks, an error, or the panic of the thread that worked on it.
type Outcome = Result<Result<EncodedBucket, CompileError>, Box<dyn Any + Send>>;

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
    let (done_sender, done) = mpsc::channel::<(usize, Outcome)>();
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
                    // A panic must be heard of, and not only when the scope ends: its bucket would be waited for by the calling
                    // thread, and a buffer from that thread by the other workers.
                    let make = AssertUnwindSafe(|| worker.make(scattered, index, &mut out).map(|()| out));
                    if done_sender.send((index, catch_unwind(make))).is_err() {
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
                Ok((index, Ok(Ok(bucket)))) => waiting.push((index, bucket)),
                Ok((_, Ok(Err(error)))) => result = Err(error),
                Ok((_, Err(panic))) => {
                    stop.store(true, Ordering::Relaxed);
                    // Lets go of the buffers' sender, too.
                    resume_unwind(panic)
                }
                // All workers are gone before the last bucket, which none does without having said why.
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

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::time::Duration;

    use super::*;
    use crate::block::{BlockLimits, Codec};
    use crate::budget::MemoryBudget;
    use crate::compile::chunk::{ChunkRecord, ChunkWriter};
    use crate::compile::records::ChunkRecords;
    use crate::compile::spill::{Spill, SpillPlace};
    use crate::compile::temporary::DiskQuota;
    use crate::geom::Precision;
    use crate::units::Bytes;

    /// So many buckets of one triangle each.
    fn scattered(count: u32) -> Scattered<[f32; 3]> {
        let budget = MemoryBudget::new(Bytes::mib(16));
        let place = SpillPlace {
            dir: std::env::temp_dir(),
            name: "buckets".into(),
            quota: DiskQuota::new(None),
            budget: budget.clone(),
        };
        // All of it fits in memory, so no file is made.
        let mut spill = Spill::new(place, ".spill", 0).unwrap();
        let (mut writer, mut chunks) = (ChunkWriter::new(), ChunkRecords::new(&budget));
        for bucket in 0..count {
            let corner = |vertex| Ok([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]][vertex as usize]);
            let bytes = writer.write(&[[0, 1, 2, 0]], bucket.into(), &[[1, 0]], corner).unwrap();
            let (offset, bytes) = (spill.append(bytes).unwrap(), bytes.len() as u32);
            chunks.push(ChunkRecord { offset, bytes, bucket, spill: 0, triangles: 1, vertices: 3 }).unwrap();
        }
        let buckets = (0..count as usize).map(|bucket| bucket..bucket + 1).collect();
        Scattered { spills: vec![spill], chunks, buckets, skipped: 0, writer }
    }

    fn settings() -> BlockSettings {
        let limits = BlockLimits { block_bytes_max: 4096 };
        BlockSettings { precision: Precision::Float32, limits, codec: Codec::Raw }
    }

    #[test]
    fn a_worker_that_panics_ends_the_others() {
        let (sender, outcome) = mpsc::channel();
        // On a thread of its own: what waits for ever would be a test that never ends.
        std::thread::spawn(move || {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
            let mut scattered = scattered(40);
            // There is no such spill.
            scattered.chunks[2].spill = 9;
            let mut taken = 0;
            let result = catch_unwind(AssertUnwindSafe(|| {
                let workers = (0..3).map(|_| Worker::new(settings())).collect();
                encode_buckets(&scattered, workers, Some(&pool), |_| {
                    taken += 1;
                    Ok(())
                })
                .map(drop)
            }));
            sender.send((result.is_err(), taken)).unwrap();
        });
        assert_eq!(outcome.recv_timeout(Duration::from_secs(20)), Ok((true, 2)));
    }
}
