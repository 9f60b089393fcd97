//! Loads part by part, on one thread: who reads, who builds, and that nothing is lost.

use std::sync::atomic::{AtomicU64, Ordering};

use super::*;
use crate::MemoryBudget;
use crate::error::SourceError;
use crate::model::Model;
use crate::octree::OctreeOptions;
use crate::source::MemorySource;
use crate::trace::small_model::small_blocks;

/// Counts reads; one of them may panic.
struct Counting {
    source: MemorySource,
    reads: AtomicU64,
    panics_at: u64,
}

impl BlockSource for Counting {
    fn model(&self) -> &Arc<Model> {
        self.source.model()
    }

    fn read_block(&self, block: BlockId, into: &mut Vec<u8>) -> Result<(), SourceError> {
        if self.reads.fetch_add(1, Ordering::Relaxed) == self.panics_at {
            // Without the panic hook, which would print.
            std::panic::resume_unwind(Box::new("a source that panics"));
        }
        self.source.read_block(block, into)
    }
}

fn counting(panics_at: u64) -> Arc<Counting> {
    Arc::new(Counting { source: small_blocks(1000, 3), reads: AtomicU64::new(0), panics_at })
}

fn open(source: &Arc<Counting>) -> LazyOctree {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = OctreeOptions { tracers_max: 4, ..OctreeOptions::default() };
    LazyOctree::open(source.clone(), &budget, options).unwrap()
}

/// Nothing is under way, and all buffers and scratches are back.
fn is_at_rest(loader: &BlockLoader<'_>) -> bool {
    let state = loader.shared.state.lock();
    assert!(state.buffers.iter().all(|buffer| buffer.capacity() > 0));
    let all = (state.buffers.len(), state.scratches.len() as u32);
    let waits = state.requests.len() + state.read.len() + state.under_way.len();
    all == (READ_AHEAD, loader.options().loads_at_once) && waits == 0 && state.reading == 0
}

#[test]
fn what_was_read_ahead_is_built_by_who_waits_and_not_read_again() {
    let source = counting(u64::MAX);
    let octree = open(&source);
    let loader = octree.block_loader(LoaderOptions::default()).unwrap();
    let queue = LoadQueue::new(&loader);
    (0..6).for_each(|block| queue.request(BlockId(block)));
    for reads in 1..=READ_AHEAD as u64 {
        assert!(loader.read_ahead());
        assert_eq!(source.reads.load(Ordering::Relaxed), reads);
    }
    assert!(!loader.read_ahead(), "there is no buffer left");
    // Also when no worker comes any more.
    loader.close();
    let mut counters = TraceCounters::default();
    for block in 0..6 {
        let (ended, _) = queue.wait();
        assert_eq!(ended.block, BlockId(block));
        assert!(ended.result.is_ok());
        counters.merge(&ended.counters);
        assert_eq!(source.reads.load(Ordering::Relaxed), u64::from(block + 1).max(READ_AHEAD as u64));
    }
    let stored = (0..6).map(|block| u64::from(octree.entry(BlockId(block)).unwrap().stored_bytes));
    assert_eq!((counters.blocks_loaded, counters.bytes_read), (6, stored.sum()));
    assert!(is_at_rest(&loader));
}

#[test]
fn a_block_that_two_pools_ask_for_is_read_once() {
    let source = counting(u64::MAX);
    let octree = open(&source);
    let loader = octree.block_loader(LoaderOptions::default()).unwrap();
    let queues = [LoadQueue::new(&loader), LoadQueue::new(&loader)];
    queues.iter().for_each(|queue| queue.request(BlockId(2)));
    assert!(loader.read_ahead());
    assert!(!loader.read_ahead(), "it is under way");
    let (first, _) = queues[0].wait();
    // It is there now.
    assert!(loader.read_ahead());
    let (second, _) = queues[1].wait();
    assert!(first.result.is_ok() && second.result.is_ok());
    assert_eq!(source.reads.load(Ordering::Relaxed), 1);
    // And one that a tracer has brought.
    queues[0].request(BlockId(3));
    octree.tracer().unwrap().slot(BlockId(3)).unwrap();
    assert!(loader.read_ahead());
    assert!(queues[0].collect().is_some_and(|ended| ended.result.is_ok()));
    assert_eq!(source.reads.load(Ordering::Relaxed), 2);
    assert!(is_at_rest(&loader));
}

#[test]
fn a_pool_that_goes_leaves_what_others_wait_for() {
    let source = counting(u64::MAX);
    let octree = open(&source);
    let loader = octree.block_loader(LoaderOptions::default()).unwrap();
    let [gone, stays] = [LoadQueue::new(&loader), LoadQueue::new(&loader)];
    (0..5).for_each(|block| gone.request(BlockId(block)));
    stays.request(BlockId(0));
    while loader.read_ahead() {}
    drop(gone);
    let (ended, _) = stays.wait();
    assert!(ended.block == BlockId(0) && ended.result.is_ok());
    drop((ended, stays));
    assert!(is_at_rest(&loader));
}

#[test]
fn a_read_ahead_that_panics_panics_where_it_was_asked_for() {
    let source = counting(1);
    let octree = open(&source);
    let loader = octree.block_loader(LoaderOptions::default()).unwrap();
    let queue = LoadQueue::new(&loader);
    (0..3).for_each(|block| queue.request(BlockId(block)));
    while loader.read_ahead() {}
    let mut blocks: Vec<(BlockId, bool)> = (0..3)
        .map(|_| queue.wait().0)
        .map(|ended| (ended.block, matches!(ended.result, Err(Failure::Panic(_)))))
        .collect();
    blocks.sort();
    assert_eq!(blocks, [(BlockId(0), false), (BlockId(1), true), (BlockId(2), false)]);
    assert!(is_at_rest(&loader));
}
