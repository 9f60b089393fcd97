//! Cost of the geometry cache itself: hits, misses with nothing to load, hits of two threads at once.

use std::hint::black_box;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use criterion::{Criterion, criterion_group, criterion_main};
use outcrop::MemoryBudget;
use outcrop::cache::{GeometryCache, Lru, SlotCache};
use outcrop::error::LoadError;
use outcrop::units::{BlockId, Bytes};

/// As many slots as a 64 MiB budget has.
const SLOTS: u32 = 340;
const BLOCKS: u32 = 4096;

fn stamp(block: u32) -> impl FnMut(&mut [u8]) -> Result<(), LoadError> {
    move |slot| {
        slot[..4].copy_from_slice(&block.to_le_bytes());
        Ok(())
    }
}

/// Pins `block` and checks that it is that block.
fn pin(cache: &dyn GeometryCache, block: u32) {
    let pin = cache.pin(BlockId(block), &mut stamp(block)).expect("nothing stays pinned");
    assert_eq!(pin[..4], block.to_le_bytes());
}

/// A cache with blocks `0 .. SLOTS` resident.
fn full_cache() -> SlotCache {
    let budget = MemoryBudget::new(Bytes::mib(128));
    let cache = SlotCache::new(SLOTS, Bytes::kib(190), BLOCKS, Lru::new(), &budget).expect("fits");
    (0..SLOTS).for_each(|block| pin(&cache, block));
    cache
}

/// Steps through all of `0 .. count` in an order without pattern.
fn scattered(step: &mut u32, count: u32) -> u32 {
    *step = step.wrapping_add(1);
    (step.wrapping_mul(0x9e37_79b9) >> 8) % count
}

fn hits(criterion: &mut Criterion) {
    let cache = full_cache();
    let mut step = 0;
    criterion.bench_function("cache/hit", |bencher| {
        bencher.iter(|| pin(&cache, black_box(scattered(&mut step, SLOTS))));
    });
    assert_eq!((cache.stats().misses, cache.stats().evictions), (u64::from(SLOTS), 0));
}

fn misses(criterion: &mut Criterion) {
    let cache = full_cache();
    let mut step = 0;
    criterion.bench_function("cache/miss", |bencher| {
        bencher.iter(|| {
            // In order of number: with LRU, and fewer slots than blocks, every one is a miss.
            step = (step + 1) % BLOCKS;
            pin(&cache, black_box(step));
        });
    });
    // The first round may still find some of the blocks that were there.
    assert!(cache.stats().hits < u64::from(SLOTS));
}

fn contended_hits(criterion: &mut Criterion) {
    for (name, blocks) in [("cache/hit, 2 threads, one block", 1), ("cache/hit, 2 threads, any block", SLOTS)]
    {
        let cache = full_cache();
        let done = AtomicBool::new(false);
        thread::scope(|scope| {
            scope.spawn(|| {
                let mut step = 12_345;
                while !done.load(Ordering::Relaxed) {
                    pin(&cache, scattered(&mut step, blocks));
                }
            });
            let mut step = 0;
            criterion.bench_function(name, |bencher| {
                bencher.iter(|| pin(&cache, black_box(scattered(&mut step, blocks))));
            });
            done.store(true, Ordering::Relaxed);
        });
        assert_eq!(cache.stats().misses, u64::from(SLOTS));
    }
}

criterion_group!(benches, hits, misses, contended_hits);
criterion_main!(benches);
