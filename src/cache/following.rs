//! A cache that takes what memory is free and gives it back when others need it.

use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::{CacheStats, GeometryCache, Lru, Pin, ReplacementPolicy, SlotCache};
use crate::error::LoadError;
use crate::free_memory::{FollowFreeMemory, FreeMemory, FreeMemoryReading};
use crate::units::{BlockId, Bytes};

/// Between two looks at the free memory.
const INTERVAL: Duration = Duration::from_millis(100);

/// From here on the cache does not grow, in percent of time that some process waits for memory.
const PRESSURE_MAX_PERCENT: f32 = 10.0;

/// A [`SlotCache`] whose number of usable slots follows the free memory, as the cache of the 2004 paper does: it grows as blocks are
/// loaded, up to the slots that it was made with, while enough stays free for others, and shrinks, giving pages back to the
/// operating system, when that falls short.
///
/// It looks when a block is loaded, at most every tenth of a second, on the thread that loads; or when it is told to by
/// [`FollowingCache::poll`]: there is no thread of its own (I8), so a cache that nobody uses or polls does not shrink. Hits and
/// images do not depend on it (I2), how often blocks are loaded does. The whole is taken from the
/// [`MemoryBudget`](crate::MemoryBudget) at once, which is the cap.
pub struct FollowingCache<P: ReplacementPolicy = Lru> {
    cache: SlotCache<P>,
    memory: Box<dyn FreeMemory>,
    follow: FollowFreeMemory,
    slots_min: u32,
    looked: Mutex<Option<Instant>>,
}

impl<P: ReplacementPolicy> FollowingCache<P> {
    /// Lets `cache` follow `memory`, and looks for the first time. It never gives up its last `slots_min` slots.
    pub fn new(
        cache: SlotCache<P>,
        memory: Box<dyn FreeMemory>,
        follow: FollowFreeMemory,
        slots_min: u32,
    ) -> FollowingCache<P> {
        let following = FollowingCache { cache, memory, follow, slots_min, looked: Mutex::new(None) };
        following.poll();
        following
    }

    /// Looks at the free memory now and adapts; the slots that may be in use from now on. Blocks that are pinned stay
    /// until the next look. Without a reading the limit stays as it is.
    pub fn poll(&self) -> u32 {
        if let Some(reading) = self.memory.read() {
            let used = self.cache.slots_used();
            self.cache.limit_slots(self.limit(reading, used));
        }
        self.cache.slot_limit()
    }

    /// How many slots may be in use, if now `used` are.
    fn limit(&self, reading: FreeMemoryReading, used: u32) -> u32 {
        let slot_bytes = self.cache.slot_bytes().0.max(1);
        let (available, keep_free) = (reading.available.0, self.follow.keep_free.0);
        let slots = |bytes: u64| u32::try_from(bytes).unwrap_or(u32::MAX);
        let limit = if available < keep_free {
            used.saturating_sub(slots((keep_free - available).div_ceil(slot_bytes)))
        } else if reading.pressure_percent >= PRESSURE_MAX_PERCENT {
            used
        } else {
            // The eighth keeps growing and shrinking apart.
            let room = available.saturating_sub(keep_free.saturating_add(keep_free / 8));
            used.saturating_add(slots(room / slot_bytes))
        };
        limit.max(self.slots_min).min(self.cache.slot_count())
    }

    /// See [`SlotCache::validate`].
    ///
    /// # Errors
    /// As there.
    pub fn validate(&self) -> Result<(), String> {
        self.cache.validate()
    }

    fn poll_if_due(&self) {
        // Whoever comes while another looks need not look.
        let Some(mut looked) = self.looked.try_lock() else { return };
        let now = Instant::now();
        if looked.is_none_or(|looked| now.duration_since(looked) >= INTERVAL) {
            *looked = Some(now);
            self.poll();
        }
    }
}

impl<P: ReplacementPolicy> GeometryCache for FollowingCache<P> {
    fn pin<'c>(
        &'c self,
        block: BlockId,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<(), LoadError>,
    ) -> Result<Pin<'c>, LoadError> {
        let mut has_loaded = false;
        let pinned = self.cache.pin(block, &mut |slot| {
            has_loaded = true;
            fill(slot)
        });
        if has_loaded {
            self.poll_if_due();
        }
        pinned
    }

    fn try_pin(&self, block: BlockId) -> Option<Pin<'_>> {
        self.cache.try_pin(block)
    }

    fn is_resident(&self, block: BlockId) -> bool {
        self.cache.is_resident(block)
    }

    fn slot_count(&self) -> u32 {
        self.cache.slot_count()
    }

    fn slot_limit(&self) -> u32 {
        self.cache.slot_limit()
    }

    fn slot_bytes(&self) -> Bytes {
        self.cache.slot_bytes()
    }

    fn stats(&self) -> CacheStats {
        self.cache.stats()
    }
}

impl<P: ReplacementPolicy> std::fmt::Debug for FollowingCache<P> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FollowingCache").finish_non_exhaustive()
    }
}
