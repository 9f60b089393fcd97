//! The associative table: who loads, who waits, who makes room.
//!
//! Everything but a hit and the return of a pin happens under one lock, the ledger's, which is never held while a slot
//! is filled (I7) and for no more than a few writes, or a walk past pinned slots.

use std::sync::atomic::Ordering;

use crate::error::LoadError;
use crate::units::BlockId;

use super::arena::{Arena, FreeSlot, Loading};
use super::shim::{AtomicWord, Primitives};
use super::word::{Phase, Word};
use super::{CacheStats, Pin, PinOwner, ReplacementPolicy};

/// Threads that wait for a block wait on one of so many condition variables, by block.
const WAITING_ROOMS: usize = 16;

/// See [`SlotCache`](super::SlotCache), which is this on the machine's primitives.
pub(super) struct Table<P: ReplacementPolicy, S: Primitives> {
    arena: Arena<S>,
    slot_count: u32,
    ledger: S::Mutex<Ledger<P>>,
    /// Notified when a block that is loading becomes ready or absent.
    loaded: [S::Condvar; WAITING_ROOMS],
    /// Notified when a slot may have become available, or a load ended.
    slot_changed: S::Condvar,
    /// How many threads look for a slot after a first look was in vain. Nearly always 0, and then giving a pin back
    /// costs no more than reading it.
    seekers: Padded<S::Word>,
    /// Hits that found the ledger locked and left it alone.
    quiet_hits: Padded<S::Word>,
}

/// Keeps words that are written by different threads at different times off each other's cache line.
#[repr(align(64))]
struct Padded<T>(T);

/// What the lock protects.
struct Ledger<P> {
    policy: P,
    free: Vec<FreeSlot>,
    /// The block in each slot that is resident in the policy's eyes.
    blocks: Vec<BlockId>,
    /// Slots being filled.
    loading: u32,
    /// As many slots are to be in use at most, where pins allow it.
    limit: u32,
    /// Slots on their way from a block to `free`.
    returning: u32,
    stats: CacheStats,
}

impl<P: ReplacementPolicy, S: Primitives> Table<P, S> {
    /// Bytes that [`Table::new`] allocates, or `None` if no machine has so many.
    pub(super) fn bytes_needed(slot_count: u32, slot_bytes: usize, block_count: u32) -> Option<u64> {
        let per_slot = (size_of::<FreeSlot>() + size_of::<BlockId>()) as u64 + P::BYTES_PER_SLOT;
        Arena::<S>::bytes_needed(slot_count, slot_bytes, block_count)?
            .checked_add(u64::from(slot_count).checked_mul(per_slot)?)
    }

    /// `None` if the memory cannot be had.
    pub(super) fn new(
        slot_count: u32,
        slot_bytes: usize,
        block_count: u32,
        mut policy: P,
    ) -> Option<Table<P, S>> {
        let (arena, free) = Arena::new(slot_count, slot_bytes, block_count)?;
        policy.start(slot_count);
        let blocks = vec![BlockId(0); slot_count as usize];
        let word = || Padded(S::Word::new(0));
        let (limit, stats) = (slot_count, CacheStats::default());
        Some(Table {
            arena,
            slot_count,
            ledger: S::mutex(Ledger { policy, free, blocks, loading: 0, limit, returning: 0, stats }),
            loaded: std::array::from_fn(|_| S::condvar()),
            slot_changed: S::condvar(),
            seekers: word(),
            quiet_hits: word(),
        })
    }

    pub(super) fn slot_count(&self) -> u32 {
        self.slot_count
    }

    pub(super) fn slot_bytes(&self) -> usize {
        self.arena.slot_bytes()
    }

    /// See [`GeometryCache::try_pin`](super::GeometryCache::try_pin).
    pub(super) fn try_pin(&self, block: BlockId) -> Option<Pin<'_>> {
        let (slot, pin) = self.arena.pin(block, self)?;
        // A hit never waits: if the ledger is busy, the block's recency stays a little older than the truth.
        match S::try_lock(&self.ledger) {
            Some(mut ledger) => ledger.hit(slot),
            None => _ = self.quiet_hits.0.fetch_add(1, Ordering::Relaxed),
        }
        Some(pin)
    }

    /// See [`GeometryCache::is_resident`](super::GeometryCache::is_resident).
    pub(super) fn is_resident(&self, block: BlockId) -> bool {
        self.arena.peek(block).phase() == Phase::Ready
    }

    /// See [`GeometryCache::pin`](super::GeometryCache::pin).
    pub(super) fn pin(
        &self,
        block: BlockId,
        fill: &mut dyn FnMut(&mut [u8]) -> Result<(), LoadError>,
    ) -> Result<Pin<'_>, LoadError> {
        if let Some(pin) = self.try_pin(block) {
            return Ok(pin);
        }
        match self.pin_or_claim(block)? {
            Claim::Resident(pin) => Ok(pin),
            Claim::Mine(mut filling) => {
                fill(filling.bytes_mut())?;
                Ok(filling.publish())
            }
        }
    }

    /// Waits until `block` is resident or this thread is the one to load it. One fetch per missing block: of all
    /// threads that come here, one finds the word absent and changes that before it lets go of the ledger.
    fn pin_or_claim(&self, block: BlockId) -> Result<Claim<'_, P, S>, LoadError> {
        let mut ledger = S::lock(&self.ledger);
        let mut stalled = false;
        let mut seeker = None;
        loop {
            let waiting_room = match self.arena.peek(block).phase() {
                Phase::Ready => {
                    // T6 needs the ledger, so what is ready stays ready.
                    if let Some((slot, pin)) = self.arena.pin(block, self) {
                        ledger.hit(slot);
                        return Ok(Claim::Resident(pin));
                    }
                    continue;
                }
                Phase::Loading => self.waiting_room(block),
                Phase::Absent => match self.take_slot(&mut ledger, &mut seeker) {
                    Search::Found(slot) => {
                        ledger.blocks[slot.index() as usize] = block;
                        ledger.loading += 1;
                        ledger.stats.misses += 1;
                        let loading = Some(self.arena.claim(block, slot));
                        return Ok(Claim::Mine(Filling { table: self, loading }));
                    }
                    Search::AllPinned if ledger.loading + ledger.returning == 0 => {
                        return Err(LoadError::NoSlot { slots: self.slot_count });
                    }
                    Search::AllPinned => &self.slot_changed,
                },
            };
            if !stalled {
                stalled = true;
                ledger.stats.stalls += 1;
            }
            // Loads end, always, and then notify: so does this.
            ledger = S::wait(waiting_room, ledger);
        }
    }

    fn waiting_room(&self, block: BlockId) -> &S::Condvar {
        &self.loaded[block.0 as usize % WAITING_ROOMS]
    }

    /// A slot that is free or can be made free now. A first look in vain makes the caller a seeker, which it stays until
    /// it returns from [`Table::pin`].
    ///
    /// [`Search::AllPinned`] after the second look is certain, although others pin and unpin during it: whoever gives
    /// back the last pin of a slot that the look has passed sees a seeker and waits for the ledger, inside the drop of
    /// the pin. So each slot that was seen pinned stands for a pin of its own that was held until the look ended, if a
    /// pin counts as held until its drop returns.
    fn take_slot<'t>(&'t self, ledger: &mut Ledger<P>, seeker: &mut Option<Seeker<'t, S>>) -> Search {
        if ledger.used(self.slot_count) < ledger.limit
            && let Some(slot) = ledger.free.pop()
        {
            return Search::Found(slot);
        }
        // All that may be in use is pinned: beyond the limit rather than not at all.
        if let Some(slot) = self.evict(ledger).or_else(|| ledger.free.pop()) {
            return Search::Found(slot);
        }
        seeker.get_or_insert_with(|| Seeker::new(&self.seekers.0));
        self.evict(ledger).map_or(Search::AllPinned, Search::Found)
    }

    /// One look through the policy's slots, best victim first.
    fn evict(&self, ledger: &mut Ledger<P>) -> Option<FreeSlot> {
        let Ledger { policy, blocks, stats, .. } = ledger;
        let mut taken = None;
        // What the policy does with the answers is its own affair; here a slot is taken once, and only if T6 says so.
        policy.victim(&mut |slot| {
            if taken.is_none() {
                taken = blocks.get(slot as usize).and_then(|block| self.arena.evict(*block, slot));
                stats.evictions += u64::from(taken.is_some());
                taken.is_some()
            } else {
                false
            }
        });
        taken
    }

    /// See [`SlotCache::limit_slots`](super::SlotCache::limit_slots).
    pub(super) fn limit_slots(&self, limit: u32) {
        let mut ledger = S::lock(&self.ledger);
        ledger.limit = limit;
        while ledger.used(self.slot_count) > limit {
            let Some(mut slot) = self.evict(&mut ledger) else { return };
            ledger.returning += 1;
            drop(ledger);
            // Without the lock: the kernel takes its time for it.
            self.arena.discard(&mut slot);
            ledger = S::lock(&self.ledger);
            ledger.returning -= 1;
            ledger.free.push(slot);
            S::notify_all(&self.slot_changed);
        }
    }

    /// Slots that hold a block or will, and the limit.
    pub(super) fn slots_used(&self) -> (u32, u32) {
        let ledger = S::lock(&self.ledger);
        (ledger.used(self.slot_count), ledger.limit)
    }

    /// See [`CacheStats`].
    pub(super) fn stats(&self) -> CacheStats {
        let stats = S::lock(&self.ledger).stats;
        CacheStats { hits: stats.hits + self.quiet_hits.0.load(Ordering::Relaxed), ..stats }
    }

    /// See [`SlotCache::validate`](super::SlotCache::validate).
    pub(super) fn validate(&self) -> Result<(), String> {
        // Pins come and go meanwhile, but which block is where changes under the lock only.
        let ledger = S::lock(&self.ledger);
        let mut owners = vec![None; self.slot_count as usize];
        let mut loading = 0;
        for block in (0..self.arena.block_count()).map(|block| BlockId(block as u32)) {
            let word = self.arena.peek(block);
            let (phase, slot) = (word.phase(), word.slot());
            if phase == Phase::Absent {
                if word != Word::ABSENT {
                    return Err(format!("block {} is absent but its word is {:#x}", block.0, word.0));
                }
                continue;
            }
            loading += u32::from(phase == Phase::Loading);
            let Some(owner) = owners.get_mut(slot as usize) else {
                return Err(format!("block {} is in slot {slot} of {}", block.0, self.slot_count));
            };
            if let Some(other) = owner.replace(block) {
                return Err(format!("slot {slot} holds blocks {} and {}", other.0, block.0));
            }
            if ledger.blocks[slot as usize] != block {
                return Err(format!("slot {slot} holds block {}, but the ledger says otherwise", block.0));
            }
            if ledger.policy.is_resident(slot) != (phase == Phase::Ready) {
                return Err(format!("the policy is wrong about block {} in slot {slot}", block.0));
            }
        }
        if loading != ledger.loading {
            return Err(format!("{loading} blocks are loading, but the ledger counts {}", ledger.loading));
        }
        for slot in &ledger.free {
            let index = slot.index();
            if let Some(block) = owners[index as usize].replace(BlockId(u32::MAX)) {
                return Err(format!("free slot {index} holds block {} or is free twice", block.0));
            }
            if ledger.policy.is_resident(index) {
                return Err(format!("the policy has free slot {index}"));
            }
        }
        let lost = owners.iter().filter(|owner| owner.is_none()).count();
        if lost == ledger.returning as usize { Ok(()) } else { Err(format!("{lost} slots are lost")) }
    }
}

impl<P> Ledger<P> {
    /// Slots that are not free.
    fn used(&self, slot_count: u32) -> u32 {
        // There are no more free slots than slots, whose number is a u32.
        slot_count - self.free.len() as u32
    }
}

impl<P: ReplacementPolicy> Ledger<P> {
    fn hit(&mut self, slot: u32) {
        self.stats.hits += 1;
        self.policy.hit(slot);
    }
}

impl<P: ReplacementPolicy, S: Primitives> PinOwner for Table<P, S> {
    fn unpin(&self, block: BlockId) {
        // The order of the two is what `Arena::evict` explains.
        if self.arena.unpin(block) && self.seekers.0.load(Ordering::SeqCst) > 0 {
            // A seeker holds the ledger from its look to its wait, so taking it here means that no notice is lost.
            let _ledger = S::lock(&self.ledger);
            S::notify_all(&self.slot_changed);
        }
    }
}

/// What came of a look for a slot.
enum Search {
    Found(FreeSlot),
    AllPinned,
}

/// What came of asking for a block that was missing.
enum Claim<'t, P: ReplacementPolicy, S: Primitives> {
    Resident(Pin<'t>),
    Mine(Filling<'t, P, S>),
}

/// Announces that its owner looks for a slot.
struct Seeker<'t, S: Primitives> {
    seekers: &'t S::Word,
}

impl<'t, S: Primitives> Seeker<'t, S> {
    fn new(seekers: &'t S::Word) -> Seeker<'t, S> {
        seekers.fetch_add(1, Ordering::SeqCst);
        Seeker { seekers }
    }
}

impl<S: Primitives> Drop for Seeker<'_, S> {
    fn drop(&mut self) {
        self.seekers.fetch_sub(1, Ordering::SeqCst);
    }
}

/// A block on its way in. Dropped without [`Filling::publish`], by an error or a panic, it undoes the claim and lets
/// another thread try.
struct Filling<'t, P: ReplacementPolicy, S: Primitives> {
    table: &'t Table<P, S>,
    /// `None` once the load has ended.
    loading: Option<Loading<'t, S>>,
}

impl<'t, P: ReplacementPolicy, S: Primitives> Filling<'t, P, S> {
    fn bytes_mut(&mut self) -> &mut [u8] {
        self.loading.as_mut().map_or(&mut [], Loading::bytes_mut)
    }

    fn publish(mut self) -> Pin<'t> {
        let table = self.table;
        let mut ledger = S::lock(&table.ledger);
        // `loading` is taken here or in `drop`, and both end `self`.
        let loading = self.loading.take().expect("a load ends once");
        let (block, slot) = (loading.block(), loading.slot());
        let pin = loading.publish(table);
        ledger.loading -= 1;
        ledger.stats.filled_bytes += table.slot_bytes() as u64;
        ledger.policy.admit(slot, block);
        table.announce_end_of_load(block);
        drop(ledger);
        pin
    }
}

impl<P: ReplacementPolicy, S: Primitives> Drop for Filling<'_, P, S> {
    fn drop(&mut self) {
        if let Some(loading) = self.loading.take() {
            let block = loading.block();
            let mut ledger = S::lock(&self.table.ledger);
            ledger.free.push(loading.abandon());
            ledger.loading -= 1;
            self.table.announce_end_of_load(block);
        }
    }
}

impl<P: ReplacementPolicy, S: Primitives> Table<P, S> {
    /// Under the ledger: those who wait for this block look again, and so do seekers, who may have been waiting for
    /// nothing but the hope that this load would fail.
    fn announce_end_of_load(&self, block: BlockId) {
        S::notify_all(self.waiting_room(block));
        S::notify_all(&self.slot_changed);
    }
}
