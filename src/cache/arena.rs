//! The slots' memory and the words that say who may touch it: the only unsafe code of the cache.
//!
//! At any time the right to a slot's bytes is in exactly one place: a [`FreeSlot`], a [`Loading`], or the word of the
//! ready block that is in it. The first two are values that cannot be copied, so holding one is an exclusive right.
//! From a ready word come shared rights, one per pin, and while there is a pin, T6 cannot turn the word back into a
//! [`FreeSlot`]. Transitions are numbered in [`Word`].

use std::alloc::{Layout, alloc_zeroed, dealloc};
use std::ptr::NonNull;
use std::sync::atomic::Ordering;

use crate::units::BlockId;

use super::shim::{AtomicWord, Primitives};
use super::word::{Phase, Word};
use super::{Pin, PinOwner};

/// Alignment of every slot: a cache line, and the widest vector load.
pub(super) const SLOT_ALIGNMENT: usize = 64;

/// All slots in one piece of memory, and one word per block.
pub(super) struct Arena<S: Primitives> {
    memory: NonNull<u8>,
    layout: Layout,
    first_slot: NonNull<u8>,
    slot_bytes: usize,
    slot_count: u32,
    words: Box<[S::Word]>,
}

// SAFETY: the arena owns `memory` (nothing else keeps a pointer to it), and what may be done with the bytes behind it
// from any thread is decided by values of this module and by the words, as the module's text says.
unsafe impl<S: Primitives> Send for Arena<S> {}
// SAFETY: as above.
unsafe impl<S: Primitives> Sync for Arena<S> {}

/// The exclusive right to the bytes of a slot that holds no block.
#[derive(Debug)]
pub(super) struct FreeSlot {
    index: u32,
    /// Address of the first slot of the arena that it belongs to.
    home: usize,
}

/// Lets the allocator give back what it holds but does not use, so that memory freed by an earlier job of this process
/// (compiling the model) and the arena do not add up beyond the budget (I1). Only glibc keeps so much, and only there does
/// this do anything.
fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the function takes a number, may be called at any time from any thread, and moves no allocation.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Asks for huge pages for `memory` where the operating system has them to spare: rays jump from slot to slot, and with small
/// pages wait for translations of addresses (measured: 5 to 13 % of the time of secondary rays). It costs no memory beyond the
/// slots: pages come when a slot is first written to, huge or not.
fn prefer_huge_pages(memory: NonNull<u8>, bytes: usize) {
    #[cfg(target_os = "linux")]
    {
        // Where the size of a huge page is another, the advice comes to nothing, or helps a little less.
        const HUGE_PAGE_BYTES: usize = 2 << 20;
        let before_page = memory.align_offset(HUGE_PAGE_BYTES);
        let whole_pages = bytes.saturating_sub(before_page) / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        if whole_pages > 0 {
            // SAFETY: `before_page + whole_pages` is at most `bytes`, so all is inside the allocation.
            let pages = unsafe { memory.add(before_page) };
            // SAFETY: the pages are private anonymous memory inside an allocation of the caller's; the advice changes nothing that
            // they hold. It stays with the addresses, as far as they are not unmapped, when the allocation is gone.
            let advised = unsafe {
                rustix::mm::madvise(pages.as_ptr().cast(), whole_pages, rustix::mm::Advice::LinuxHugepage)
            };
            // Refused where there are none.
            let _ = advised;
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = (memory, bytes);
}

impl FreeSlot {
    pub(super) fn index(&self) -> u32 {
        self.index
    }
}

impl<S: Primitives> Arena<S> {
    /// Bytes that [`Arena::new`] allocates, or `None` if no machine has so many.
    pub(super) fn bytes_needed(slot_count: u32, slot_bytes: usize, block_count: u32) -> Option<u64> {
        let words = u64::from(block_count).checked_mul(size_of::<S::Word>() as u64)?;
        (Self::layout(slot_count, slot_bytes)?.size() as u64).checked_add(words)
    }

    /// The allocation is asked for with a small alignment, and the first slot aligned by hand: an allocation that is
    /// both zeroed and strongly aligned would be zeroed by writing to it, which commits every page, while this one
    /// comes from the operating system as zero pages that cost nothing until they are used.
    fn layout(slot_count: u32, slot_bytes: usize) -> Option<Layout> {
        let slots = (slot_count as usize).checked_mul(slot_bytes)?;
        Layout::from_size_align(slots.checked_add(SLOT_ALIGNMENT)?, 1).ok()
    }

    /// All slots free and all blocks absent, or `None` if the memory cannot be had. `slot_bytes` is a multiple of
    /// [`SLOT_ALIGNMENT`].
    pub(super) fn new(
        slot_count: u32,
        slot_bytes: usize,
        block_count: u32,
    ) -> Option<(Arena<S>, Vec<FreeSlot>)> {
        assert!(slot_bytes.is_multiple_of(SLOT_ALIGNMENT));
        let layout = Self::layout(slot_count, slot_bytes)?;
        return_freed_memory();
        // SAFETY: the size is at least SLOT_ALIGNMENT, so not zero.
        let memory = NonNull::new(unsafe { alloc_zeroed(layout) })?;
        let padding = memory.align_offset(SLOT_ALIGNMENT);
        assert!(padding < SLOT_ALIGNMENT);
        // SAFETY: `padding` is below SLOT_ALIGNMENT, which the allocation has beyond the slots.
        let first_slot = unsafe { memory.add(padding) };
        prefer_huge_pages(first_slot, slot_count as usize * slot_bytes);
        let words = (0..block_count).map(|_| S::Word::new(Word::ABSENT.0)).collect();
        let home = first_slot.addr().get();
        let free = (0..slot_count).rev().map(|index| FreeSlot { index, home }).collect();
        Some((Arena { memory, layout, first_slot, slot_bytes, slot_count, words }, free))
    }

    pub(super) fn slot_bytes(&self) -> usize {
        self.slot_bytes
    }

    pub(super) fn block_count(&self) -> usize {
        self.words.len()
    }

    fn word(&self, block: BlockId) -> &S::Word {
        &self.words[block.0 as usize]
    }

    /// The word of `block`, out of date as soon as it is read unless the table's lock keeps it. `SeqCst` for
    /// [`Arena::evict`]'s sake: see there.
    pub(super) fn peek(&self, block: BlockId) -> Word {
        Word(self.word(block).load(Ordering::SeqCst))
    }

    /// Where a slot starts.
    fn slot(&self, index: u32) -> NonNull<u8> {
        assert!(index < self.slot_count);
        // SAFETY: the allocation holds `slot_count` slots from `first_slot` on, and `index` is below that.
        unsafe { self.first_slot.add(index as usize * self.slot_bytes) }
    }

    /// T1: `block`, which must be absent, will be loaded into `slot`. Under the table's lock.
    pub(super) fn claim(&self, block: BlockId, slot: FreeSlot) -> Loading<'_, S> {
        assert_eq!(slot.home, self.first_slot.addr().get(), "a slot of another arena");
        // Acquire is not needed: whoever gave the slot up has handed it over by T6 or under the lock. An absent word
        // changes by T1 only, so nothing can come between load and store while the lock is held.
        let word = Word::loading(slot.index);
        let before =
            self.word(block).compare_exchange(Word::ABSENT.0, word.0, Ordering::Relaxed, Ordering::Relaxed);
        assert!(before.is_ok(), "block {} is claimed twice", block.0);
        Loading { arena: self, block, slot }
    }

    /// T4: pins `block` if it is ready; its slot and the pin, which goes back to `owner`. The one atomic
    /// read-modify-write of a hit (more only if threads collide).
    ///
    /// # Panics
    /// If it has 2^30 - 1 pins: somebody forgets them instead of dropping them.
    pub(super) fn pin<'a>(&'a self, block: BlockId, owner: &'a dyn PinOwner) -> Option<(u32, Pin<'a>)> {
        let word = self.word(block);
        let mut seen = Word(word.load(Ordering::Relaxed));
        loop {
            if seen.phase() != Phase::Ready {
                return None;
            }
            assert!(seen.pins() < Word::PINS_MAX, "too many pins of block {}", block.0);
            let pinned = seen.0 + Word::ONE_PIN;
            // Acquire: pairs with the Release of T2, so that the filled bytes are seen.
            match word.compare_exchange(seen.0, pinned, Ordering::Acquire, Ordering::Relaxed) {
                Ok(_) => {
                    let bytes = self.pinned_bytes(seen.slot());
                    return Some((seen.slot(), Pin::new(owner, block, bytes)));
                }
                Err(now) => seen = Word(now),
            }
        }
    }

    /// The bytes of a slot whose block the caller has just pinned.
    fn pinned_bytes(&self, slot: u32) -> &[u8] {
        // SAFETY: the range is inside the allocation and initialised (zeroed at first). The block in the slot is ready
        // and has the caller's pin, so no FreeSlot and no Loading of this slot exists until the pin is given back (T6
        // needs 0 pins), and only those give `&mut`. The callers wrap the bytes in a `Pin`, which lends them for no longer
        // than it lives, and `unpin` is called only when one of these is dropped.
        unsafe { std::slice::from_raw_parts(self.slot(slot).as_ptr(), self.slot_bytes) }
    }

    /// T5: gives back a pin; whether it was the last. Only for the owners that pins were made with, when these call.
    pub(super) fn unpin(&self, block: BlockId) -> bool {
        // Release: what was read through the pin is read before T6 gives the slot away. SeqCst: see `evict`.
        let before = Word(self.word(block).fetch_sub(Word::ONE_PIN, Ordering::SeqCst));
        debug_assert!(before.phase() == Phase::Ready && before.pins() > 0);
        before.pins() == 1
    }

    /// T6: takes `slot` from `block` if it is ready there and not pinned. Under the table's lock.
    ///
    /// SeqCst throughout T5 and T6, because a thread that finds every slot pinned relies on this order: it announces
    /// itself, then looks at the words; a thread that gives a pin back changes the word, then looks for announcements.
    /// One of the two must see the other.
    pub(super) fn evict(&self, block: BlockId, slot: u32) -> Option<FreeSlot> {
        let idle = Word::ready(slot, 0).0;
        // Acquire (part of SeqCst): pairs with the Release of every T5 before it, as they are one release sequence.
        self.word(block)
            .compare_exchange(idle, Word::ABSENT.0, Ordering::SeqCst, Ordering::SeqCst)
            .ok()
            .map(|_| FreeSlot { index: slot, home: self.first_slot.addr().get() })
    }
}

impl<S: Primitives> Arena<S> {
    /// Gives the memory of a free slot back to the operating system, which hands out zeroed pages when the slot is next
    /// written to. Whole pages only: what a slot shares with its neighbours stays. Does nothing but on Linux.
    pub(super) fn discard(&self, slot: &mut FreeSlot) {
        #[cfg(target_os = "linux")]
        {
            assert_eq!(slot.home, self.first_slot.addr().get(), "a slot of another arena");
            let start = self.slot(slot.index);
            let page = rustix::param::page_size();
            let before_page = start.align_offset(page);
            let whole_pages = self.slot_bytes.saturating_sub(before_page) / page * page;
            if whole_pages > 0 {
                // SAFETY: `before_page + whole_pages` is at most the slot's size, so all is inside the slot.
                let pages = unsafe { start.add(before_page) };
                // SAFETY: the pages are inside the slot, to which `slot` is the exclusive right, so nothing reads or writes them
                // meanwhile. They are private anonymous memory of the allocator and read as zeros afterwards, or, if the kernel
                // refuses, as before: initialised both times. The allocation itself stays.
                let advised = unsafe {
                    rustix::mm::madvise(pages.as_ptr().cast(), whole_pages, rustix::mm::Advice::LinuxDontNeed)
                };
                // Refused for locked memory, say: then it stays, which is what its owner asked for.
                let _ = advised;
            }
        }
        #[cfg(not(target_os = "linux"))]
        let _ = slot;
    }
}

impl<S: Primitives> Drop for Arena<S> {
    fn drop(&mut self) {
        // SAFETY: allocated in `new` with this layout; nothing borrows from the arena any more.
        unsafe { dealloc(self.memory.as_ptr(), self.layout) };
    }
}

/// A block on its way in: the exclusive right to its slot's bytes. If this is dropped without
/// [`Loading::publish`] or [`Loading::abandon`], the block stays in the loading phase and the slot is lost.
pub(super) struct Loading<'a, S: Primitives> {
    arena: &'a Arena<S>,
    block: BlockId,
    slot: FreeSlot,
}

impl<'a, S: Primitives> Loading<'a, S> {
    pub(super) fn block(&self) -> BlockId {
        self.block
    }

    pub(super) fn slot(&self) -> u32 {
        self.slot.index
    }

    /// The slot, to be filled.
    pub(super) fn bytes_mut(&mut self) -> &mut [u8] {
        // SAFETY: the range is inside the allocation and initialised (zeroed at first). `self` holds the slot's FreeSlot,
        // so no other value gives access to these bytes: the block is not ready, so nobody can pin it.
        unsafe {
            std::slice::from_raw_parts_mut(self.arena.slot(self.slot.index).as_ptr(), self.arena.slot_bytes)
        }
    }

    /// T2: the block is ready, with one pin, which goes back to `owner`. Under the table's lock.
    pub(super) fn publish(self, owner: &'a dyn PinOwner) -> Pin<'a> {
        // Release: whoever sees the word as ready sees the filled bytes.
        self.arena.word(self.block).store(Word::ready(self.slot.index, 1).0, Ordering::Release);
        Pin::new(owner, self.block, self.arena.pinned_bytes(self.slot.index))
    }

    /// T3: the block is absent again. Under the table's lock.
    pub(super) fn abandon(self) -> FreeSlot {
        self.arena.word(self.block).store(Word::ABSENT.0, Ordering::Relaxed);
        self.slot
    }
}
