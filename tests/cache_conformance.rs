//! What every `GeometryCache` must do, whatever is inside. A new implementation or policy adds a line at the end.

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Barrier;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::thread;

use outcrop::MemoryBudget;
use outcrop::cache::{Clock, FollowingCache, GeometryCache, Lru, ReplacementPolicy, S3Fifo, SlotCache};
use outcrop::error::LoadError;
use outcrop::free_memory::{FollowFreeMemory, FreeMemory, FreeMemoryReading};
use outcrop::units::{BlockId, Bytes};

/// Makes an empty cache of so many slots, of at least so many bytes, for so many blocks.
type Make<'m> = &'m dyn Fn(u32, u64, u32) -> Box<dyn GeometryCache>;

fn stamp(block: u32) -> impl FnMut(&mut [u8]) -> Result<(), LoadError> {
    move |slot| {
        slot.fill(block as u8);
        Ok(())
    }
}

fn never(_: &mut [u8]) -> Result<(), LoadError> {
    panic!("filled a resident block")
}

fn refuse(_: &mut [u8]) -> Result<(), LoadError> {
    Err(LoadError::NoSlot { slots: u32::MAX })
}

fn conforms(make: Make<'_>) {
    keeps_what_was_filled(make);
    slots_are_aligned_and_apart(make);
    evicts_only_what_is_not_pinned(make);
    failed_fills_leave_nothing_behind(make);
    try_pin_never_loads(make);
    statistics_add_up(make);
    one_fill_for_many_threads(make);
    the_next_thread_takes_over_a_failed_fill(make);
    a_fill_blocks_nobody_else(make);
    many_threads_see_only_their_blocks(make);
}

fn keeps_what_was_filled(make: Make<'_>) {
    let cache = make(3, 1000, 10);
    assert_eq!(cache.slot_count(), 3);
    assert!(cache.slot_bytes() >= Bytes(1000));
    for block in [7, 0, 9] {
        let pin = cache.pin(BlockId(block), &mut stamp(block)).unwrap();
        assert_eq!(pin.block(), BlockId(block));
        assert_eq!(pin.len() as u64, cache.slot_bytes().0);
    }
    for block in [9, 7, 0] {
        let pin = cache.pin(BlockId(block), &mut never).unwrap();
        assert!(pin.iter().all(|byte| *byte == block as u8));
    }
}

fn slots_are_aligned_and_apart(make: Make<'_>) {
    let cache = make(5, 65, 5);
    let pins: Vec<_> = (0..5).map(|block| cache.pin(BlockId(block), &mut stamp(block)).unwrap()).collect();
    for pin in &pins {
        assert!(pin.as_ptr().addr().is_multiple_of(64));
        assert!(pin.iter().all(|byte| *byte == pin.block().0 as u8), "slots overlap");
    }
}

fn evicts_only_what_is_not_pinned(make: Make<'_>) {
    let cache = make(2, 64, 5);
    let first = cache.pin(BlockId(0), &mut stamp(0)).unwrap();
    drop(cache.pin(BlockId(1), &mut stamp(1)).unwrap());
    let third = cache.pin(BlockId(2), &mut stamp(2)).unwrap();
    assert!(cache.try_pin(BlockId(1)).is_none(), "the only one that could go");
    match cache.pin(BlockId(3), &mut never) {
        Err(LoadError::NoSlot { slots: 2 }) => {}
        other => panic!("{:?}", other.err()),
    }
    // A second pin of one block holds it after the first is gone.
    let again = cache.try_pin(BlockId(0)).unwrap();
    drop(first);
    assert!(cache.pin(BlockId(3), &mut never).is_err());
    drop(again);
    drop(cache.pin(BlockId(3), &mut stamp(3)).unwrap());
    assert!(cache.try_pin(BlockId(0)).is_none());
    assert!(third.iter().all(|byte| *byte == 2));
    // A cache without slots refuses everything.
    assert!(matches!(make(0, 64, 1).pin(BlockId(0), &mut never), Err(LoadError::NoSlot { slots: 0 })));
}

fn failed_fills_leave_nothing_behind(make: Make<'_>) {
    let cache = make(1, 64, 3);
    for _ in 0..10 {
        assert!(matches!(cache.pin(BlockId(0), &mut refuse), Err(LoadError::NoSlot { slots: u32::MAX })));
        // Without the panic hook, which would print.
        let panicked = catch_unwind(AssertUnwindSafe(|| {
            cache.pin(BlockId(0), &mut |_| resume_unwind(Box::new(5))).is_ok()
        }));
        assert_eq!(panicked.unwrap_err().downcast_ref(), Some(&5), "the caller's own panic");
        assert!(cache.try_pin(BlockId(0)).is_none());
    }
    // A pin dropped by unwinding is given back.
    let unwound = catch_unwind(AssertUnwindSafe(|| {
        let _pin = cache.pin(BlockId(1), &mut stamp(1)).unwrap();
        resume_unwind(Box::new(()));
    }));
    assert!(unwound.is_err());
    drop(cache.pin(BlockId(2), &mut stamp(2)).unwrap());
}

fn try_pin_never_loads(make: Make<'_>) {
    let cache = make(2, 64, 2);
    assert!(cache.try_pin(BlockId(1)).is_none());
    drop(cache.pin(BlockId(1), &mut stamp(1)).unwrap());
    assert!(cache.try_pin(BlockId(0)).is_none());
    assert!(cache.try_pin(BlockId(1)).unwrap().iter().all(|byte| *byte == 1));
}

fn statistics_add_up(make: Make<'_>) {
    let cache = make(2, 64, 4);
    for block in [0, 1, 0, 2, 3, 3] {
        drop(cache.pin(BlockId(block), &mut stamp(block)).unwrap());
    }
    assert!(cache.pin(BlockId(0), &mut refuse).is_err());
    let stats = cache.stats();
    assert_eq!((stats.hits, stats.misses, stats.stalls), (2, 5, 0));
    // The failed fill had to evict as well.
    assert_eq!((stats.evictions, stats.filled_bytes), (3, 4 * cache.slot_bytes().0));
}

fn one_fill_for_many_threads(make: Make<'_>) {
    const THREADS: u32 = 4;
    let cache = make(8, 64, 8);
    let fills = AtomicU32::new(0);
    let start = Barrier::new(THREADS as usize);
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                for block in 0..8 {
                    start.wait();
                    let mut fill = |slot: &mut [u8]| {
                        fills.fetch_add(1, Ordering::Relaxed);
                        // Long enough for the others to come and wait.
                        thread::yield_now();
                        stamp(block)(slot)
                    };
                    let pin = cache.pin(BlockId(block), &mut fill).unwrap();
                    assert!(pin.iter().all(|byte| *byte == block as u8));
                }
            });
        }
    });
    assert_eq!(fills.into_inner(), 8);
    let stats = cache.stats();
    assert_eq!((stats.misses, stats.hits), (8, u64::from(THREADS - 1) * 8));
}

fn the_next_thread_takes_over_a_failed_fill(make: Make<'_>) {
    const THREADS: u32 = 4;
    let cache = make(1, 64, 1);
    let fills = AtomicU32::new(0);
    let served = AtomicU32::new(0);
    thread::scope(|scope| {
        for _ in 0..THREADS {
            scope.spawn(|| {
                // The first two fills fail, one of them by a panic.
                let mut fill = |slot: &mut [u8]| match fills.fetch_add(1, Ordering::Relaxed) {
                    0 => refuse(slot),
                    1 => resume_unwind(Box::new(())),
                    _ => stamp(0)(slot),
                };
                let pinned = catch_unwind(AssertUnwindSafe(|| cache.pin(BlockId(0), &mut fill).is_ok()));
                served.fetch_add(u32::from(pinned.unwrap_or(false)), Ordering::Relaxed);
            });
        }
    });
    assert_eq!((fills.into_inner(), served.into_inner()), (3, THREADS - 2));
}

/// While one thread is inside a fill, another gets its own blocks, resident and missing (I7).
fn a_fill_blocks_nobody_else(make: Make<'_>) {
    let cache = make(3, 64, 4);
    drop(cache.pin(BlockId(1), &mut stamp(1)).unwrap());
    let inside = Barrier::new(2);
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        scope.spawn(|| {
            let mut fill = |slot: &mut [u8]| {
                inside.wait();
                while !done.load(Ordering::Acquire) {
                    thread::yield_now();
                }
                stamp(0)(slot)
            };
            drop(cache.pin(BlockId(0), &mut fill).unwrap());
        });
        inside.wait();
        assert!(cache.try_pin(BlockId(0)).is_none());
        drop(cache.pin(BlockId(1), &mut never).unwrap());
        drop(cache.pin(BlockId(2), &mut stamp(2)).unwrap());
        // Has to evict, and not the block that is on its way in.
        drop(cache.pin(BlockId(3), &mut stamp(3)).unwrap());
        done.store(true, Ordering::Release);
    });
    assert!(cache.try_pin(BlockId(0)).unwrap().iter().all(|byte| *byte == 0));
}

/// With as many slots as the threads can pin at once, and far fewer than blocks, nobody is ever refused.
fn many_threads_see_only_their_blocks(make: Make<'_>) {
    const THREADS: u32 = 4;
    const PINS: u32 = 3;
    const BLOCKS: u32 = 40;
    let cache = make(THREADS * PINS, 256, BLOCKS);
    thread::scope(|scope| {
        for thread in 0..THREADS {
            let cache = &cache;
            scope.spawn(move || {
                let mut random = thread + 1;
                let mut held = Vec::new();
                for step in 0..4000 {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    let block = (random >> 16) % BLOCKS;
                    match cache.pin(BlockId(block), &mut |slot| {
                        if step % 7 == 0 { refuse(slot) } else { stamp(block)(slot) }
                    }) {
                        Ok(pin) => held.push(pin),
                        Err(LoadError::NoSlot { slots: u32::MAX }) => {}
                        Err(error) => panic!("{error}"),
                    }
                    for pin in &held {
                        assert!(pin.iter().all(|byte| *byte == pin.block().0 as u8), "another block's bytes");
                    }
                    if held.len() == PINS as usize {
                        held.swap_remove((random >> 8) as usize % held.len());
                    }
                }
            });
        }
    });
    // No pin has leaked: all slots can be had at once.
    let pins: Vec<_> =
        (0..THREADS * PINS).map(|block| cache.pin(BlockId(block), &mut stamp(block)).unwrap()).collect();
    assert_eq!(pins.len() as u32, cache.slot_count());
}

fn slot_cache<P: ReplacementPolicy + Default>(slots: u32, bytes: u64, blocks: u32) -> Box<dyn GeometryCache> {
    let budget = MemoryBudget::new(Bytes::mib(1));
    Box::new(SlotCache::new(slots, Bytes(bytes), blocks, P::default(), &budget).unwrap())
}

#[test]
fn slot_cache_with_lru() {
    conforms(&slot_cache::<Lru>);
}

#[test]
fn slot_cache_with_clock() {
    conforms(&slot_cache::<Clock>);
}

#[test]
fn slot_cache_with_s3_fifo() {
    conforms(&slot_cache::<S3Fifo>);
}

/// As much memory as anybody could want.
struct Ample;

impl FreeMemory for Ample {
    fn read(&self) -> Option<FreeMemoryReading> {
        Some(FreeMemoryReading { available: Bytes(u64::MAX), pressure_percent: 0.0 })
    }
}

#[test]
fn following_cache_with_ample_memory() {
    conforms(&|slots, bytes, blocks| {
        let budget = MemoryBudget::new(Bytes::mib(1));
        let cache = SlotCache::new(slots, Bytes(bytes), blocks, Lru::new(), &budget).unwrap();
        let follow = FollowFreeMemory { keep_free: Bytes::mib(64) };
        Box::new(FollowingCache::new(cache, Box::new(Ample), follow, 1))
    });
}

#[test]
fn a_cache_takes_its_footprint_from_the_budget_and_gives_it_back() {
    let bytes_needed = SlotCache::<Lru>::bytes_needed(7, Bytes(1000), 50);
    assert!(bytes_needed >= Bytes(7 * 1024 + 50 * 8));
    let budget = MemoryBudget::new(bytes_needed);
    let cache = SlotCache::new(7, Bytes(1000), 50, Lru::new(), &budget).unwrap();
    assert_eq!((budget.available(), cache.slot_bytes()), (Bytes(0), Bytes(1024)));
    drop(cache);
    assert_eq!(budget.used(), Bytes(0));
    let small = MemoryBudget::new(Bytes(bytes_needed.0 - 1));
    assert_eq!(SlotCache::new(7, Bytes(1000), 50, Lru::new(), &small).err().unwrap().needed, bytes_needed);
    // More than any address space.
    let endless = MemoryBudget::new(Bytes(u64::MAX));
    for slot_bytes in [Bytes(u64::MAX), Bytes(1 << 40)] {
        assert!(SlotCache::new(u32::MAX, slot_bytes, 1, Lru::new(), &endless).is_err());
    }
    assert_eq!(endless.used(), Bytes(0));
}
