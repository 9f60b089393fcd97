//! A cache as a list of blocks, least recently used first: what `SlotCache` must do, step by step, when one thread uses
//! it. With LRU the model also says which block makes room; with another policy it only asks that the one that does is
//! resident and not pinned. Shared by the property tests and the fuzz target.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::{Arc, Mutex};

use outcrop::MemoryBudget;
use outcrop::cache::{
    CacheStats, Clock, GeometryCache, Lru, Pin, Policy, ReplacementPolicy, S3Fifo, SlotCache,
};
use outcrop::error::LoadError;
use outcrop::units::{BlockId, Bytes};

const SLOT_BYTES: u64 = 128;

/// One step of a program.
#[derive(Clone, Copy, Debug)]
pub enum Op {
    /// Pin a block (modulo the block count) with a fill that succeeds, and hold the pin.
    Pin(u8),
    /// The same with a fill that fails.
    PinFails(u8),
    /// The same with a fill that panics.
    PinPanics(u8),
    /// Pin a block if it is resident, and hold the pin.
    TryPin(u8),
    /// Drop one of the pins that are held (modulo their number).
    Unpin(u8),
}

impl Op {
    /// Any two bytes are an operation.
    pub fn from_bytes(kind: u8, argument: u8) -> Op {
        match kind % 8 {
            0..=2 => Op::Pin(argument),
            3 => Op::PinFails(argument),
            4 => Op::PinPanics(argument),
            5 => Op::TryPin(argument),
            _ => Op::Unpin(argument),
        }
    }
}

/// A policy that tells which block it evicted.
struct Spy<P> {
    policy: P,
    blocks: Vec<u32>,
    evicted: Arc<Mutex<Option<u32>>>,
}

impl<P: ReplacementPolicy> ReplacementPolicy for Spy<P> {
    const BYTES_PER_SLOT: u64 = P::BYTES_PER_SLOT + 4;

    fn start(&mut self, slot_count: u32) {
        self.blocks = vec![u32::MAX; slot_count as usize];
        self.policy.start(slot_count);
    }

    fn admit(&mut self, slot: u32, block: BlockId) {
        self.blocks[slot as usize] = block.0;
        self.policy.admit(slot, block);
    }

    fn hit(&mut self, slot: u32) {
        self.policy.hit(slot);
    }

    fn victim(&mut self, evict: &mut dyn FnMut(u32) -> bool) {
        self.policy.victim(&mut |slot| {
            let taken = evict(slot);
            if taken {
                *self.evicted.lock().unwrap() = Some(self.blocks[slot as usize]);
            }
            taken
        });
    }

    fn is_resident(&self, slot: u32) -> bool {
        self.policy.is_resident(slot)
    }
}

struct Model {
    slots: usize,
    /// Resident blocks and their pins, least recently used first.
    resident: VecDeque<(u32, u32)>,
    stats: CacheStats,
}

impl Model {
    fn pins(&mut self, block: u32) -> Option<&mut u32> {
        self.resident.iter_mut().find(|entry| entry.0 == block).map(|entry| &mut entry.1)
    }

    /// Pins a resident block.
    fn hit(&mut self, block: u32) -> bool {
        let Some(index) = self.resident.iter().position(|entry| entry.0 == block) else { return false };
        let (_, pins) = self.resident.remove(index).unwrap();
        self.resident.push_back((block, pins + 1));
        self.stats.hits += 1;
        true
    }

    /// Whether a missing block can have a slot.
    fn has_room(&self) -> bool {
        self.resident.len() < self.slots || self.resident.iter().any(|entry| entry.1 == 0)
    }

    /// A missing block gets a slot, for which `evicted` made room.
    fn make_room(&mut self, evicted: Option<u32>, policy: Policy) {
        self.stats.misses += 1;
        assert_eq!(evicted.is_some(), self.resident.len() == self.slots, "evicts when all slots are taken");
        let Some(evicted) = evicted else { return };
        let idle = |entry: &(u32, u32)| entry.1 == 0;
        let victim = self.resident.iter().position(|entry| entry.0 == evicted && idle(entry));
        let victim = victim.unwrap_or_else(|| panic!("block {evicted} was evicted: not resident or pinned"));
        if policy == Policy::Lru {
            assert_eq!(self.resident.iter().position(idle), Some(victim), "another block was due");
        }
        self.resident.remove(victim);
        self.stats.evictions += 1;
    }

    fn fill(&mut self, block: u32) {
        self.resident.push_back((block, 1));
        self.stats.filled_bytes += SLOT_BYTES;
    }
}

fn contents(block: u32) -> [u8; SLOT_BYTES as usize] {
    [block as u8 ^ 0xa5; SLOT_BYTES as usize]
}

/// What `fill` answers when told to fail: an error that says by its number that it is this one.
const FILL_FAILED: LoadError = LoadError::NoSlot { slots: u32::MAX };

/// Runs `ops` on a cache with `policy` and on the model and compares them after every step.
///
/// # Panics
/// If they differ.
pub fn run(policy: Policy, slot_count: u32, block_count: u32, ops: &[Op]) {
    match policy {
        Policy::Lru => run_with(policy, Lru::new(), slot_count, block_count, ops),
        Policy::Clock => run_with(policy, Clock::new(), slot_count, block_count, ops),
        Policy::S3Fifo => run_with(policy, S3Fifo::new(), slot_count, block_count, ops),
        other => panic!("no model for {other:?}"),
    }
}

fn run_with<P: ReplacementPolicy>(kind: Policy, policy: P, slot_count: u32, block_count: u32, ops: &[Op]) {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let evicted = Arc::new(Mutex::new(None));
    let spy = Spy { policy, blocks: Vec::new(), evicted: Arc::clone(&evicted) };
    let cache =
        SlotCache::new(slot_count, Bytes(SLOT_BYTES), block_count, spy, &budget).expect("fits in 1 MiB");
    let mut model =
        Model { slots: slot_count as usize, resident: VecDeque::new(), stats: CacheStats::default() };
    let mut held: Vec<Pin<'_>> = Vec::new();
    for op in ops {
        match *op {
            Op::Pin(block) | Op::PinFails(block) | Op::PinPanics(block) => {
                let block = u32::from(block) % block_count;
                let expect_hit = model.hit(block);
                let expect_fill = !expect_hit && model.has_room();
                let mut filled = false;
                let mut fill = |slot: &mut [u8]| {
                    filled = true;
                    assert!(slot.as_ptr().addr().is_multiple_of(64));
                    slot.copy_from_slice(&contents(block));
                    match op {
                        Op::Pin(_) => Ok(()),
                        Op::PinFails(_) => Err(FILL_FAILED),
                        // Without the panic hook, which would print.
                        _ => resume_unwind(Box::new("fill")),
                    }
                };
                let pinned = catch_unwind(AssertUnwindSafe(|| cache.pin(BlockId(block), &mut fill)));
                assert_eq!(filled, expect_fill, "{op:?}");
                let evicted = evicted.lock().unwrap().take();
                if expect_fill {
                    model.make_room(evicted, kind);
                } else {
                    assert_eq!(evicted, None, "{op:?} evicts for nothing");
                }
                match (pinned, op) {
                    (Ok(Ok(pin)), _) => {
                        assert!(expect_hit || (expect_fill && matches!(op, Op::Pin(_))));
                        if expect_fill {
                            model.fill(block);
                        }
                        held.push(pin);
                    }
                    (Ok(Err(LoadError::NoSlot { slots })), _) if slots == slot_count => {
                        assert!(!expect_hit && !expect_fill);
                    }
                    (Ok(Err(LoadError::NoSlot { slots: u32::MAX })), Op::PinFails(_)) => assert!(expect_fill),
                    (Err(_), Op::PinPanics(_)) => assert!(expect_fill),
                    (other, _) => panic!("{op:?} gave {:?}", other.map(|pinned| pinned.err())),
                }
            }
            Op::TryPin(block) => {
                let block = u32::from(block) % block_count;
                let pin = cache.try_pin(BlockId(block));
                assert_eq!(pin.is_some(), model.hit(block), "{op:?}");
                held.extend(pin);
            }
            Op::Unpin(index) if !held.is_empty() => {
                let pin = held.swap_remove(usize::from(index) % held.len());
                *model.pins(pin.block().0).expect("what is pinned is resident") -= 1;
            }
            Op::Unpin(_) => {}
        }
        assert_eq!(cache.stats(), model.stats, "{op:?}");
        for pin in &held {
            assert_eq!(**pin, contents(pin.block().0), "{op:?}");
        }
        if let Err(reason) = cache.validate() {
            panic!("{op:?}: {reason}");
        }
    }
    drop(held);
    // No pin has leaked: all slots can be had at once.
    let all = 0..block_count.min(slot_count);
    let pins: Vec<_> = all.map(|block| cache.pin(BlockId(block), &mut |_| Ok(()))).collect();
    for pin in &pins {
        assert!(pin.is_ok(), "{:?}", pin.as_ref().err());
    }
}
