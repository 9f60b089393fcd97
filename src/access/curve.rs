//! LRU with every number of slots in one pass.

use super::AccessTrace;
use crate::cache::Policy;
use crate::units::Bytes;

/// Loads against slots for LRU, exact for every number of slots (Mattson, Gecsei, Slutz and Traiger, "Evaluation techniques
/// for storage hierarchies", 1970: an access hits if fewer distinct blocks than slots were entered since the last entry into its block).
///
/// One pass over the trace and a logarithm of the number of blocks for each access. The cache is taken to see every
/// entry; what a tracer's pins hide from it makes a run's loads differ a little (`docs/results/policies.md`).
///
/// ```no_run
/// use outcrop::access::{AccessTrace, MissRatioCurve};
/// let trace = AccessTrace::open("view.accesses")?;
/// let curve = MissRatioCurve::of(&trace);
/// if let Some(need) = curve.memory_need(1.1) {
///     println!("{} for at most 1.1 loads of each block that is touched", need.bytes);
/// }
/// # Ok::<(), outcrop::error::AccessTraceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct MissRatioCurve {
    /// Loads with 0, 1, 2 ... slots; the last is with as many as there are blocks touched.
    loads: Vec<u64>,
    slot_bytes: Bytes,
    block_count: u32,
}

/// An answer to "how much memory would this need".
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemoryNeed {
    /// Cache slots.
    pub slots: u32,
    /// What an LRU cache of so many slots takes, with slots as large as in the run that was recorded.
    pub bytes: Bytes,
}

impl MissRatioCurve {
    /// The curve of a trace; streams are taken in the order of the file.
    pub fn of(trace: &AccessTrace) -> MissRatioCurve {
        let mut stack = Distances::new(trace.block_count() as usize);
        trace.visit_accesses(|_, block| stack.access(block));
        let touched = stack.resident;
        let mut loads = vec![0; touched + 1];
        loads[touched] = touched as u64;
        // An access at distance d misses with d slots or fewer.
        for slots in (0..touched).rev() {
            loads[slots] = loads[slots + 1] + stack.histogram[slots];
        }
        MissRatioCurve { loads, slot_bytes: trace.slot_bytes(), block_count: trace.block_count() }
    }

    /// Entries into blocks.
    pub fn accesses(&self) -> u64 {
        self.loads[0]
    }

    /// Distinct blocks entered: the loads that no cache avoids.
    pub fn touched(&self) -> u64 {
        self.loads.len() as u64 - 1
    }

    /// Loads with LRU and `slots` slots.
    pub fn loads(&self, slots: u32) -> u64 {
        self.loads[(slots as usize).min(self.loads.len() - 1)]
    }

    /// Loads per touched block with `slots` slots; 0 if nothing was touched.
    pub fn loads_per_touched_block(&self, slots: u32) -> f64 {
        if self.touched() == 0 { 0.0 } else { self.loads(slots) as f64 / self.touched() as f64 }
    }

    /// The least memory with which each touched block is loaded at most `loads_per_touched_block` times on average, or
    /// `None` if that is less than the one time that each needs.
    pub fn memory_need(&self, loads_per_touched_block: f64) -> Option<MemoryNeed> {
        let target = loads_per_touched_block * self.touched() as f64;
        // More slots never load more.
        let slots = self.loads.partition_point(|loads| *loads as f64 > target);
        // Slots are counted in u32, as blocks are.
        let slots = u32::try_from(slots).ok().filter(|_| slots < self.loads.len())?;
        Some(MemoryNeed { slots, bytes: Policy::Lru.bytes_needed(slots, self.slot_bytes, self.block_count) })
    }
}

/// How many distinct blocks lie between two entries into one block: the blocks in order of last use, kept as marks on a
/// time line whose sums a Fenwick tree has.
struct Distances {
    /// When each block was entered last; [`NEVER`] if it was not.
    last: Vec<usize>,
    /// Which block each time marks, if it is that block's last.
    marks: Vec<u32>,
    /// Fenwick tree over the marks, counted from 1.
    sums: Vec<u32>,
    now: usize,
    resident: usize,
    newest: u32,
    /// Accesses by distance.
    histogram: Vec<u64>,
}

const NEVER: usize = usize::MAX;
const NO_BLOCK: u32 = u32::MAX;

impl Distances {
    fn new(block_count: usize) -> Distances {
        let times = 2 * block_count + 64;
        Distances {
            last: vec![NEVER; block_count],
            marks: vec![NO_BLOCK; times],
            sums: vec![0; times + 1],
            now: 0,
            resident: 0,
            newest: NO_BLOCK,
            histogram: vec![0; block_count],
        }
    }

    fn access(&mut self, block: u32) {
        if block == self.newest {
            self.histogram[0] += 1;
            return;
        }
        self.newest = block;
        if self.now == self.marks.len() {
            self.start_again();
        }
        let time = std::mem::replace(&mut self.last[block as usize], self.now);
        if time == NEVER {
            self.resident += 1;
        } else {
            let older_or_same = self.sum(time + 1);
            self.histogram[self.resident - older_or_same as usize] += 1;
            self.marks[time] = NO_BLOCK;
            self.add(time, u32::MAX);
        }
        self.marks[self.now] = block;
        self.add(self.now, 1);
        self.now += 1;
    }

    /// Marks before `time`.
    fn sum(&self, time: usize) -> u32 {
        let (mut at, mut sum) = (time, 0u32);
        while at > 0 {
            sum = sum.wrapping_add(self.sums[at]);
            at &= at - 1;
        }
        sum
    }

    /// Adds a number, or the wrapped form of a negative one.
    fn add(&mut self, time: usize, number: u32) {
        let mut at = time + 1;
        while let Some(sum) = self.sums.get_mut(at) {
            *sum = sum.wrapping_add(number);
            at += at & at.wrapping_neg();
        }
    }

    /// Moves the marks to the start of the time line, which leaves at least half of it.
    fn start_again(&mut self) {
        self.sums.fill(0);
        self.now = 0;
        for time in 0..self.marks.len() {
            let block = std::mem::replace(&mut self.marks[time], NO_BLOCK);
            if block != NO_BLOCK {
                self.marks[self.now] = block;
                self.last[block as usize] = self.now;
                self.add(self.now, 1);
                self.now += 1;
            }
        }
    }
}
