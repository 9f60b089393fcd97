//! Ids as runs of consecutive numbers: how many ids were skipped before a run, and its length.

use super::Fault;
use super::planes::{gather, width_of};

/// Runs of one block, for the encoder.
#[derive(Default)]
pub(super) struct Runs {
    /// Ids skipped before each run but the first.
    gaps: Vec<u64>,
    /// Length of each run less one; a block has at most 16,384 triangles.
    lengths: Vec<u16>,
}

impl Runs {
    /// Takes in the ids of one block (at least one). False if they do not ascend strictly.
    pub fn collect(&mut self, ids: &[u64]) -> bool {
        self.gaps.clear();
        self.lengths.clear();
        let (mut before, mut length) = (ids[0], 0);
        for id in &ids[1..] {
            if *id <= before {
                return false;
            }
            let skipped = id - before - 1;
            if skipped == 0 {
                length += 1;
            } else {
                self.gaps.push(skipped);
                self.lengths.push(length);
                length = 0;
            }
            before = *id;
        }
        self.lengths.push(length);
        true
    }

    pub fn count(&self) -> usize {
        self.lengths.len()
    }

    /// Appends the gaps in planes of the least width, then the lengths in two planes. Returns the width.
    pub fn put(&self, out: &mut Vec<u8>) -> u8 {
        let width = width_of(self.gaps.iter().fold(0, |bits, gap| bits | gap));
        for plane in 0..width {
            out.extend(self.gaps.iter().map(|gap| (gap >> (8 * plane)) as u8));
        }
        for plane in 0..2 {
            out.extend(self.lengths.iter().map(|length| (length >> (8 * plane)) as u8));
        }
        width
    }
}

/// Fills `ids`. `gaps` has `width` planes, `lengths` two planes of one byte for each run (at least one).
///
/// Errors carry offsets into the stream of gaps.
pub(super) fn decode(
    base: u64,
    width: u8,
    gaps: &[u8],
    lengths: &[u8],
    ids: &mut [u64],
) -> Result<(), Fault> {
    const OVERFLOW: Fault = Fault(0, "an id is out of range");
    let run_count = lengths.len() / 2;
    let (low, high) = lengths.split_at(run_count);
    let mut rest = ids;
    let mut next = base;
    for run in 0..run_count {
        if run > 0 {
            let gap = gather(gaps, width, run_count - 1, run - 1);
            // Runs that touch are one run, so that a block has one form.
            if gap == 0 {
                return Err(Fault(run - 1, "two runs of ids are not apart"));
            }
            next = next.checked_add(gap).ok_or(OVERFLOW)?;
        }
        let length = usize::from(u16::from_le_bytes([low[run], high[run]])) + 1;
        let (ids, after) =
            rest.split_at_mut_checked(length).ok_or(Fault(run, "a run of ids is longer than the block"))?;
        // The last id of the run, so that an id of u64::MAX is allowed but nothing after it.
        let last = next.checked_add(length as u64 - 1).ok_or(OVERFLOW)?;
        for (id, offset) in ids.iter_mut().zip(0..) {
            *id = next + offset;
        }
        rest = after;
        match last.checked_add(1) {
            Some(after_last) => next = after_last,
            None if rest.is_empty() => {}
            None => return Err(OVERFLOW),
        }
    }
    if rest.is_empty() { Ok(()) } else { Err(Fault(0, "its runs of ids do not cover its triangles")) }
}
