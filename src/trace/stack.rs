//! The traversal stack of both levels.

use crate::octree::{Child, Node, STACK_MAX};
use crate::simd::{LANES, Simd};

/// A child that waits.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(16))]
pub(super) struct Entry {
    /// Where the ray enters its box.
    pub near: f32,
    pub child: Child,
    /// See [`Node::edges`].
    pub edge: f32,
}

/// Room for the children that wait in both levels.
pub(super) type Entries = [Entry; STACK_MAX];

/// What fills unused room.
pub(super) const UNUSED: Entry = Entry { near: 0.0, child: Child(0), edge: 0.0 };

/// Children that wait, the next one last. Trees are no deeper than [`STACK_MAX`] allows.
pub(super) struct Stack<'e> {
    entries: &'e mut Entries,
    len: usize,
}

impl<'e> Stack<'e> {
    #[inline(always)]
    pub fn new(entries: &'e mut Entries) -> Stack<'e> {
        Stack { entries, len: 0 }
    }

    #[inline(always)]
    pub fn len(&self) -> usize {
        self.len
    }

    #[inline(always)]
    fn push(&mut self, entry: Entry) {
        self.entries[self.len] = entry;
        self.len += 1;
    }

    /// The last entry above `floor` that begins at `high` or before.
    #[inline(always)]
    pub fn pop(&mut self, floor: usize, high: f32) -> Option<Entry> {
        while self.len > floor {
            self.len -= 1;
            let entry = self.entries[self.len];
            if entry.near <= high {
                return Some(entry);
            }
        }
        None
    }

    /// Returns the nearest child of those in `hits` and pushes the others, nearest last.
    #[inline(always)]
    pub fn push_sorted<S: Simd>(&mut self, simd: S, node: &Node, near: S::F, hits: u32) -> Option<Entry> {
        if hits == 0 {
            return None;
        }
        let near = simd.to_array(near);
        let entry = |lane: u32| {
            let lane = lane as usize % LANES;
            Entry { near: near[lane], child: node.children[lane], edge: node.edges[lane] }
        };
        let first = entry(hits.trailing_zeros());
        let hits = hits & (hits - 1);
        if hits == 0 {
            return Some(first);
        }
        let second = entry(hits.trailing_zeros());
        let mut hits = hits & (hits - 1);
        let (nearer, farther) = if second.near < first.near { (second, first) } else { (first, second) };
        if hits == 0 {
            self.push(farther);
            return Some(nearer);
        }
        let base = self.len;
        self.push(farther);
        self.push(nearer);
        while hits != 0 {
            let new = entry(hits.trailing_zeros());
            hits &= hits - 1;
            // Insertion: what is nearer moves up.
            let mut place = self.len;
            self.push(new);
            while place > base && self.entries[place - 1].near < new.near {
                self.entries[place] = self.entries[place - 1];
                place -= 1;
            }
            self.entries[place] = new;
        }
        self.len -= 1;
        Some(self.entries[self.len])
    }

    /// Returns one child of those in `hits` and pushes the others, in no particular order.
    #[inline(always)]
    pub fn push_unsorted<S: Simd>(&mut self, simd: S, node: &Node, near: S::F, hits: u32) -> Option<Entry> {
        if hits == 0 {
            return None;
        }
        let near = simd.to_array(near);
        let mut hits = hits;
        loop {
            let lane = hits.trailing_zeros() as usize % LANES;
            let entry = Entry { near: near[lane], child: node.children[lane], edge: node.edges[lane] };
            hits &= hits - 1;
            if hits == 0 {
                return Some(entry);
            }
            self.push(entry);
        }
    }
}
