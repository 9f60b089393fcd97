//! The least loads that any policy could have done with.

use std::collections::BinaryHeap;

use super::AccessTrace;

const NEVER: u64 = u64::MAX;

/// Loads of `trace` with `slot_count` slots if the block that makes room is always the one whose next use is the farthest
/// away, which is the least of all policies that load a block when it is entered (Belady, "A study of replacement
/// algorithms for a virtual-storage computer", 1966, his MIN). Needs the future, so it is a bound and not a policy.
///
/// Takes 12 bytes for each access that is not of the block entered just before; `trace`'s streams are taken in the order
/// of the file.
pub fn optimum_loads(trace: &AccessTrace, slot_count: u32) -> u64 {
    let mut accesses = Vec::new();
    trace.visit_accesses(|_, block| {
        // An access of the block just entered is a hit with any policy and any slots.
        if slot_count == 0 || accesses.last() != Some(&block) {
            accesses.push(block);
        }
    });
    if slot_count == 0 {
        return accesses.len() as u64;
    }
    let mut following = vec![NEVER; trace.block_count() as usize];
    let mut next_uses = vec![NEVER; accesses.len()];
    for (time, block) in accesses.iter().enumerate().rev() {
        next_uses[time] = std::mem::replace(&mut following[*block as usize], time as u64);
    }
    // From here on `following` is the next use of a resident block, or 0 if it is not resident: time 0 is past after
    // the first access, so it is nobody's next use.
    following.fill(0);
    let (mut loads, mut resident) = (0, 0);
    // (next use, block); entries that `following` has outdated stay until they surface.
    let mut farthest: BinaryHeap<(u64, u32)> = BinaryHeap::new();
    for (block, next_use) in accesses.iter().zip(next_uses) {
        let known = &mut following[*block as usize];
        if *known == 0 {
            loads += 1;
            resident += 1;
        }
        *known = next_use;
        while resident > slot_count
            && let Some((time, victim)) = farthest.pop()
        {
            if following[victim as usize] == time && victim != *block {
                following[victim as usize] = 0;
                resident -= 1;
            }
        }
        farthest.push((next_use, *block));
        if farthest.len() > 4 * slot_count as usize + 1024 {
            farthest.retain(|(time, of)| following[*of as usize] == *time);
        }
    }
    loads
}
