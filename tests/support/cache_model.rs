//! A cache as a list of blocks, least recently used first: what `SlotCache<Lru>` must do, step by step, when one
//! thread uses it. Shared by the property tests and the fuzz target.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use outcrop::MemoryBudget;
use outcrop::cache::{CacheStats, GeometryCache, Lru, Pin, SlotCache};
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

    /// Makes room for a missing block, if that is possible.
    fn make_room(&mut self) -> bool {
        if self.resident.len() == self.slots {
            let Some(victim) = self.resident.iter().position(|entry| entry.1 == 0) else { return false };
            self.resident.remove(victim);
            self.stats.evictions += 1;
        }
        self.stats.misses += 1;
        true
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

/// Runs `ops` on a cache and on the model and compares them after every step.
///
/// # Panics
/// If they differ.
pub fn run(slot_count: u32, block_count: u32, ops: &[Op]) {
    let budget = MemoryBudget::new(Bytes::mib(1));
    let cache = SlotCache::new(slot_count, Bytes(SLOT_BYTES), block_count, Lru::new(), &budget)
        .expect("fits in 1 MiB");
    let mut model =
        Model { slots: slot_count as usize, resident: VecDeque::new(), stats: CacheStats::default() };
    let mut held: Vec<Pin<'_>> = Vec::new();
    for op in ops {
        match *op {
            Op::Pin(block) | Op::PinFails(block) | Op::PinPanics(block) => {
                let block = u32::from(block) % block_count;
                let expect_hit = model.hit(block);
                let expect_fill = !expect_hit && model.make_room();
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
    // Evicting one by one shows the whole order, and that no pin has leaked.
    for _ in 0..model.resident.len() {
        let oldest = model.resident[0].0;
        let missing = (0..block_count).find(|block| model.pins(*block).is_none());
        let Some(missing) = missing.filter(|_| model.resident.len() == model.slots) else { break };
        drop(cache.pin(BlockId(missing), &mut |_| Ok(())).expect("nothing is pinned"));
        model.resident.pop_front();
        model.resident.push_back((missing, 0));
        assert!(cache.try_pin(BlockId(oldest)).is_none(), "block {oldest} was due");
    }
}
