//! A cache that follows the free memory, on a made-up system.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::thread;

use outcrop::MemoryBudget;
use outcrop::cache::{FollowingCache, GeometryCache, Lru, Pin, SlotCache};
use outcrop::error::LoadError;
use outcrop::free_memory::{FollowFreeMemory, FreeMemory, FreeMemoryReading};
use outcrop::units::{BlockId, Bytes};

const SLOT_BYTES: u64 = 64 << 10;
const SLOTS: u32 = 20;
const BLOCKS: u32 = 100;

/// A system in which what the cache holds is not free.
#[derive(Clone, Default)]
struct Fake {
    /// What would be free if the cache held nothing, in eighths of a slot.
    eighths: Arc<AtomicU64>,
    is_pressed: Arc<AtomicBool>,
    is_blind: Arc<AtomicBool>,
    cache: Arc<OnceLock<Weak<FollowingCache>>>,
}

impl Fake {
    fn set(&self, eighths: u64) {
        self.eighths.store(eighths, Ordering::Relaxed);
    }
}

impl FreeMemory for Fake {
    fn read(&self) -> Option<FreeMemoryReading> {
        let held = self.cache.get().and_then(Weak::upgrade).map_or(0, |cache| {
            let stats = cache.stats();
            stats.misses - stats.evictions
        });
        let available = self.eighths.load(Ordering::Relaxed).saturating_sub(8 * held);
        let pressure_percent = if self.is_pressed.load(Ordering::Relaxed) { 30.0 } else { 0.0 };
        let is_blind = self.is_blind.load(Ordering::Relaxed);
        (!is_blind)
            .then_some(FreeMemoryReading { available: Bytes(available * SLOT_BYTES / 8), pressure_percent })
    }
}

/// Keeps eight slots' worth free.
fn following(fake: &Fake, slots_min: u32) -> Arc<FollowingCache> {
    let budget = MemoryBudget::new(Bytes::mib(4));
    let cache = SlotCache::new(SLOTS, Bytes(SLOT_BYTES), BLOCKS, Lru::new(), &budget).unwrap();
    let follow = FollowFreeMemory { keep_free: Bytes(8 * SLOT_BYTES) };
    let cache = Arc::new(FollowingCache::new(cache, Box::new(fake.clone()), follow, slots_min));
    assert!(fake.cache.set(Arc::downgrade(&cache)).is_ok());
    cache
}

/// Each look gives back what is missing then, here eight slots at most.
fn poll_until_settled(cache: &FollowingCache) -> u32 {
    (0..SLOTS).map(|_| cache.poll()).last().unwrap()
}

fn stamp(block: u32) -> impl FnMut(&mut [u8]) -> Result<(), LoadError> {
    move |slot| {
        slot.fill(1 + block as u8);
        Ok(())
    }
}

fn pin(cache: &dyn GeometryCache, block: u32) -> Pin<'_> {
    let pin = cache.pin(BlockId(block), &mut stamp(block)).unwrap();
    assert!(pin.iter().all(|byte| *byte == 1 + block as u8), "another block's bytes");
    pin
}

fn resident(cache: &dyn GeometryCache) -> Vec<u32> {
    (0..BLOCKS).filter(|block| cache.try_pin(BlockId(*block)).is_some()).collect()
}

#[test]
fn grows_up_to_what_is_free_and_shrinks_when_it_is_not() {
    let fake = Fake::default();
    // Nine slots' worth are kept when growing, so five may be used.
    fake.set(8 * 14);
    let cache = following(&fake, 2);
    assert_eq!((cache.slot_limit(), cache.slot_count()), (5, SLOTS));
    (0..12).for_each(|block| drop(pin(&*cache, block)));
    assert_eq!(resident(&*cache), [7, 8, 9, 10, 11], "the least recently used made room");

    assert_eq!(cache.poll(), 5);
    fake.set(8 * 13 + 1);
    assert_eq!(cache.poll(), 5, "between the marks nothing changes");
    fake.set(8 * 11);
    assert_eq!(cache.poll(), 3, "two slots are missing to eight");
    assert_eq!(resident(&*cache), [9, 10, 11]);
    cache.validate().unwrap();
    fake.set(0);
    assert_eq!(cache.poll(), 2, "never fewer than the least");
    fake.set(8 * 1000);
    assert_eq!(cache.poll(), SLOTS, "never more than the cap");
    (0..BLOCKS).for_each(|block| drop(pin(&*cache, block)));
    assert_eq!(resident(&*cache).len() as u32, SLOTS);
    cache.validate().unwrap();
}

#[test]
fn pressure_stops_growth_and_blindness_changes_nothing() {
    let fake = Fake::default();
    fake.set(8 * 13);
    let cache = following(&fake, 1);
    (0..4).for_each(|block| drop(pin(&*cache, block)));
    fake.set(8 * 1000);
    fake.is_pressed.store(true, Ordering::Relaxed);
    assert_eq!(cache.poll(), 4);
    fake.is_blind.store(true, Ordering::Relaxed);
    fake.set(0);
    assert_eq!(cache.poll(), 4);
    fake.is_blind.store(false, Ordering::Relaxed);
    fake.set(8 * 1000);
    fake.is_pressed.store(false, Ordering::Relaxed);
    assert_eq!(cache.poll(), SLOTS);
}

/// The promise of `GeometryCache::pin` holds for all slots, however few are to be used: pins go beyond the limit.
#[test]
fn pinned_blocks_stay_and_no_pin_is_refused_below_the_cap() {
    let fake = Fake::default();
    let cache = following(&fake, 0);
    assert_eq!(cache.slot_limit(), 0);
    let pins: Vec<_> = (0..SLOTS).map(|block| pin(&*cache, block)).collect();
    cache.poll();
    assert_eq!(cache.stats().evictions, 0);
    assert!(matches!(cache.pin(BlockId(50), &mut stamp(50)), Err(LoadError::NoSlot { slots: SLOTS })));
    drop(pins);
    assert_eq!(poll_until_settled(&cache), 0);
    assert_eq!(resident(&*cache), [0_u32; 0]);
    cache.validate().unwrap();
}

/// What is evicted goes back to the operating system: when its slot is used again, whole pages are zero.
#[test]
#[cfg(target_os = "linux")]
fn pages_are_given_back() {
    let fake = Fake::default();
    fake.set(8 * 1000);
    let cache = following(&fake, 0);
    (0..SLOTS).for_each(|block| drop(pin(&*cache, block)));
    fake.set(0);
    assert_eq!(poll_until_settled(&cache), 0);
    let mut zeros = 0;
    for block in 0..SLOTS {
        let mut fill = |slot: &mut [u8]| {
            zeros += slot.iter().filter(|byte| **byte == 0).count() as u64;
            Ok(())
        };
        cache.pin(BlockId(block), &mut fill).map(drop).unwrap();
        cache.poll();
    }
    // All but the pages that a slot shares with its neighbours; pages of up to 16 KiB.
    assert!(zeros >= u64::from(SLOTS) * (SLOT_BYTES - (32 << 10)), "{zeros} bytes are zero");
}

#[test]
fn threads_see_their_blocks_while_memory_comes_and_goes() {
    const THREADS: u32 = 3;
    let fake = Fake::default();
    let cache = following(&fake, 1);
    let running = AtomicU64::new(u64::from(THREADS));
    thread::scope(|scope| {
        for thread in 0..THREADS {
            let (cache, running) = (&*cache, &running);
            scope.spawn(move || {
                let mut random = thread + 1;
                let mut held = None;
                for _ in 0..400 {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    held = Some(pin(cache, (random >> 16) % BLOCKS));
                }
                drop(held);
                running.fetch_sub(1, Ordering::Relaxed);
            });
        }
        let mut step = 0u64;
        while running.load(Ordering::Relaxed) > 0 {
            step += 1;
            fake.set(step.wrapping_mul(0x9e37_79b9) % (8 * 40));
            assert!((1..=SLOTS).contains(&cache.poll()));
        }
    });
    cache.validate().unwrap();
    fake.set(0);
    assert_eq!(poll_until_settled(&cache), 1);
    assert!(resident(&*cache).len() <= 1);
}
