//! Where chunks are: a list that is counted in the budget as far as that has room (I1). There is one record for some hundred
//! triangles, so that the list of a billion triangles takes more than a hundred megabytes.

use std::ops::{Deref, DerefMut};

use super::chunk::ChunkRecord;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::BudgetError;
use crate::units::Bytes;

/// Records that are added at once at least.
const STEP: usize = 4096;

/// See the module's text.
#[derive(Debug)]
pub(super) struct ChunkRecords {
    records: Vec<ChunkRecord>,
    budget: MemoryBudget,
    memory: Vec<Reservation>,
}

impl ChunkRecords {
    pub(super) fn new(budget: &MemoryBudget) -> ChunkRecords {
        ChunkRecords { records: Vec::new(), budget: budget.clone(), memory: Vec::new() }
    }

    /// Memory of a list of `count` records at most.
    pub(super) fn bytes_needed(count: u64) -> u64 {
        (count + count / 8 + STEP as u64) * size_of::<ChunkRecord>() as u64
    }

    /// # Errors
    /// The budget does not hold the list any more.
    #[inline]
    pub(super) fn push(&mut self, record: ChunkRecord) -> Result<(), BudgetError> {
        if self.records.len() == self.records.capacity() {
            self.grow(1)?;
        }
        self.records.push(record);
        Ok(())
    }

    pub(super) fn extend(
        &mut self,
        records: impl ExactSizeIterator<Item = ChunkRecord>,
    ) -> Result<(), BudgetError> {
        if self.records.capacity() - self.records.len() < records.len() {
            self.grow(records.len())?;
        }
        self.records.extend(records);
        Ok(())
    }

    /// Makes room for `count` more. By a part of what there is, not to twice its size.
    #[cold]
    fn grow(&mut self, count: usize) -> Result<(), BudgetError> {
        let count = count.max(STEP).max(self.records.len() / 8);
        let bytes = (count * size_of::<ChunkRecord>()) as u64;
        // Where the spill has left no room the list grows uncounted: a compile that has come so far is not refused for it.
        self.memory.extend(self.budget.reserve(Bytes(bytes), "the list of chunks").ok());
        self.records.reserve_exact(count);
        Ok(())
    }

    /// Brings the records from `start` on into the order of their buckets. Those of one bucket keep their order, which is that of
    /// their places in the spills.
    pub(super) fn sort_by_bucket(&mut self, start: usize) {
        // In place: a stable sort would take half of the list again.
        self.records[start..].sort_unstable_by_key(|chunk| (chunk.bucket, chunk.spill, chunk.offset));
    }
}

impl Deref for ChunkRecords {
    type Target = [ChunkRecord];

    fn deref(&self) -> &[ChunkRecord] {
        &self.records
    }
}

impl DerefMut for ChunkRecords {
    fn deref_mut(&mut self) -> &mut [ChunkRecord] {
        &mut self.records
    }
}
