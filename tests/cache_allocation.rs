//! After start-up the cache allocates nothing, and its slots cost no memory until they are used. In a binary of its
//! own because it replaces the global allocator.

#[path = "support/counting_allocator.rs"]
mod counting_allocator;

use std::sync::Barrier;
use std::thread;
use std::time::Duration;

use counting_allocator::calls;
use outcrop::MemoryBudget;
use outcrop::cache::{GeometryCache, Lru, SlotCache};
use outcrop::error::LoadError;
use outcrop::units::{BlockId, Bytes};

/// Every way through the cache: hits, misses in free slots and with evictions, fills that fail, no slot, pins of
/// absent blocks.
fn use_everything(cache: &SlotCache, rounds: u32) {
    for round in 0..rounds {
        for block in 0..24 {
            let failing = (block + round) % 5 == 0;
            let fill = &mut |slot: &mut [u8]| {
                slot[0] = block as u8;
                if failing { Err(LoadError::NoSlot { slots: 0 }) } else { Ok(()) }
            };
            if let Ok(pin) = cache.pin(BlockId(block), fill) {
                assert_eq!(pin[0], block as u8);
                assert!(cache.try_pin(BlockId(block)).is_some());
            }
            assert!(cache.try_pin(BlockId(24)).is_none());
        }
    }
}

#[test]
fn one_thread_allocates_nothing() {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let cache = SlotCache::new(8, Bytes(256), 25, Lru::new(), &budget).unwrap();
    // From the very first call on.
    assert_eq!(calls(|| use_everything(&cache, 100)), 0);
    let pins: [_; 8] =
        std::array::from_fn(|block| cache.pin(BlockId(block as u32), &mut |_| Ok(())).unwrap());
    assert_eq!(calls(|| assert!(cache.pin(BlockId(9), &mut |_| Ok(())).is_err())), 0);
    drop(pins);
    let stats = cache.stats();
    assert!(stats.hits > 0 && stats.misses > 0 && stats.evictions > 0);
}

#[test]
fn threads_that_wait_for_each_other_allocate_nothing() {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let cache = SlotCache::new(8, Bytes(256), 25, Lru::new(), &budget).unwrap();
    let ready = Barrier::new(2);
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                // A thread's first wait on any lock makes its entry in parking_lot's table; that is its start-up.
                let mutex = parking_lot::Mutex::new(());
                parking_lot::Condvar::new().wait_for(&mut mutex.lock(), Duration::from_millis(1));
                ready.wait();
                assert_eq!(calls(|| use_everything(&cache, 200)), 0);
            });
        }
    });
}

/// Anonymous memory of this process in KiB, as Linux counts it.
#[cfg(target_os = "linux")]
fn anonymous_kib() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("RssAnon:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

#[test]
#[cfg(target_os = "linux")]
fn a_large_cache_costs_only_what_is_used() {
    const SLOT: u64 = 1 << 20;
    let budget = MemoryBudget::new(Bytes(2 << 30));
    let before = anonymous_kib();
    let cache = SlotCache::new(1000, Bytes(SLOT), 5000, Lru::new(), &budget).unwrap();
    let made = anonymous_kib();
    for block in 0..16 {
        let mut fill = |slot: &mut [u8]| {
            slot.fill(1);
            Ok(())
        };
        drop(cache.pin(BlockId(block), &mut fill).unwrap());
    }
    let used = anonymous_kib();
    // Generous: other tests run meanwhile, and huge pages may round up.
    assert!(made < before + 8 * 1024, "{} KiB for an empty cache", made - before);
    assert!(used >= made + 15 * 1024 && used < made + 32 * 1024, "{} KiB for 16 MiB", used - made);
}
