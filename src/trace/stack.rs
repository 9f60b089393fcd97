//! The traversal stack of both levels.

use crate::octree::{Child, CoarseTree, LEVELS_MAX, STACK_MAX};
use crate::simd::{BoxRay, Interval, LANES, Simd};
use crate::units::BlockId;

/// A child that waits, with where the ray enters its box: the bits of that number above the child's. Parameters are not
/// negative, so that entries compare like them, and a comparison of two entries is one of integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry(u64);

impl Entry {
    #[inline(always)]
    fn new(near: f32, child: Child) -> Entry {
        Entry(u64::from(near.to_bits()) << 32 | u64::from(child.0))
    }

    #[inline(always)]
    fn child(self) -> Child {
        Child(self.0 as u32)
    }

    #[inline(always)]
    fn near(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }
}

/// The last entry that still matters to a query.
#[derive(Clone, Copy)]
pub(super) struct Limit(Entry);

impl Limit {
    /// All entries do.
    pub const NONE: Limit = Limit(Entry(u64::MAX));

    /// Those that begin at `high` (not negative) or before do.
    #[inline(always)]
    pub fn new(high: f32) -> Limit {
        Limit(Entry::new(high, Child::NONE))
    }

    /// Where the last entries begin that matter.
    #[inline(always)]
    pub fn high(self) -> f32 {
        self.0.near()
    }
}

/// Room for the children that wait in both levels.
pub(super) type Entries = [Entry; STACK_MAX];

/// What fills unused room.
pub(super) const UNUSED: Entry = Entry(0);

/// Lies below the children of one level: it begins before everything, and no tree has a leaf like it.
const END: Entry = Entry(Child::NONE.0 as u64);

/// Children that wait, the next one last. Trees are no deeper than [`STACK_MAX`] allows.
pub(super) struct Stack<'e> {
    entries: &'e mut Entries,
    len: usize,
}

impl<'e> Stack<'e> {
    /// A stack in `entries`, all of which are free.
    #[inline(always)]
    pub fn new(entries: &'e mut Entries) -> Stack<'e> {
        let mut stack = Stack { entries, len: 0 };
        stack.push(END);
        stack
    }

    /// A stack above the entries of this one.
    #[inline(always)]
    pub fn above(&mut self) -> Stack<'_> {
        let mut stack = Stack { entries: self.entries, len: self.len };
        stack.push(END);
        stack
    }

    #[inline(always)]
    fn push(&mut self, entry: Entry) {
        self.entries[self.len] = entry;
        self.len += 1;
    }

    /// The last child within `limit`; [`Child::NONE`] at the end.
    #[inline(always)]
    pub fn pop(&mut self, limit: Limit) -> Child {
        loop {
            // The end is never passed: it begins at 0.
            self.len -= 1;
            let entry = self.entries[self.len];
            if entry <= limit.0 {
                return entry.child();
            }
        }
    }

    /// The least distance at which a child begins: of those that wait, all pushed in order, and of those in `hits`.
    #[inline(always)]
    pub fn least_near<S: Simd>(&self, simd: S, near: S::F, hits: u32) -> f32 {
        let near = simd.to_array(near);
        let mut least = f32::INFINITY;
        let mut hits = hits;
        while hits != 0 {
            least = least.min(near[hits.trailing_zeros() as usize % LANES]);
            hits &= hits - 1;
        }
        // The first entry is the end.
        self.entries[1..self.len].iter().fold(least, |least, entry| least.min(entry.near()))
    }

    /// Returns the nearest child of those in `hits` (one at least) and pushes the others, nearest last. `prefetch` is told of
    /// each that is pushed.
    #[inline(always)]
    pub fn push_sorted<S: Simd>(
        &mut self,
        simd: S,
        children: &[Child; LANES],
        near: S::F,
        hits: u32,
        prefetch: impl Fn(Child),
    ) -> Child {
        let near = simd.to_array(near);
        let first = entry(children, &near, hits);
        let hits = hits & (hits - 1);
        if hits == 0 {
            return first.child();
        }
        let second = entry(children, &near, hits);
        // Selects, not branches: which one is nearer cannot be predicted.
        let mut nearest = first.min(second);
        let base = self.len;
        self.push(first.max(second));
        prefetch(first.max(second).child());
        let mut hits = hits & (hits - 1);
        while hits != 0 {
            let new = entry(children, &near, hits);
            hits &= hits - 1;
            let next = nearest.max(new);
            nearest = nearest.min(new);
            prefetch(next.child());
            // Insertion: what is nearer moves up.
            let mut place = self.len;
            self.push(next);
            while place > base && self.entries[place - 1] < next {
                self.entries[place] = self.entries[place - 1];
                place -= 1;
            }
            self.entries[place] = next;
        }
        nearest.child()
    }

    /// Makes the stack what it was before a traversal in sorted order popped the leaf of `block`, which `interval` meets: that leaf, and
    /// all that comes after it and that `interval` meets. What was pruned since then is left out where it is popped. A traversal that stopped
    /// there goes on without looking at anything twice, and nothing had to be kept for it.
    #[inline(always)]
    pub fn return_to<S: Simd>(
        &mut self,
        simd: S,
        coarse: &CoarseTree,
        block: BlockId,
        boxes: &BoxRay,
        interval: &Interval<S::F>,
    ) {
        let mut way = [Child::block(block.0); 2 * LEVELS_MAX + 2];
        let mut depth = 0;
        while let Some(parent) = coarse.parent(way[depth]) {
            depth += 1;
            way[depth] = parent;
        }
        for level in (1..=depth).rev() {
            if way[level].is_leaf() {
                // A cell: its root stands for it.
                continue;
            }
            let node = coarse.node(way[level]);
            let (near, hits) = boxes.test(simd, &node.bounds, interval.low, interval.high);
            self.push_sorted_from(simd, &node.children, near, hits, way[level - 1], level == 1);
        }
    }

    /// Pushes those of the children in `hits` that come after `child` in sorted order, nearest last, and `child` itself if `including`.
    #[inline(always)]
    fn push_sorted_from<S: Simd>(
        &mut self,
        simd: S,
        children: &[Child; LANES],
        near: S::F,
        hits: u32,
        child: Child,
        including: bool,
    ) {
        let near = simd.to_array(near);
        let lane = children.iter().position(|other| *other == child).unwrap_or(0);
        debug_assert!(children[lane] == child && hits >> lane & 1 == 1);
        let passed = Entry::new(near[lane], child);
        let base = self.len;
        let mut hits = hits;
        while hits != 0 {
            let new = entry(children, &near, hits);
            hits &= hits - 1;
            if new < passed || (new == passed && !including) {
                continue;
            }
            let mut place = self.len;
            self.push(new);
            while place > base && self.entries[place - 1] < new {
                self.entries[place] = self.entries[place - 1];
                place -= 1;
            }
            self.entries[place] = new;
        }
    }

    /// Returns one child of those in `hits` (one at least) and pushes the others, in no particular order.
    #[inline(always)]
    pub fn push_unsorted(&mut self, children: &[Child; LANES], hits: u32, prefetch: impl Fn(Child)) -> Child {
        let mut hits = hits;
        loop {
            let child = children[hits.trailing_zeros() as usize % LANES];
            hits &= hits - 1;
            if hits == 0 {
                return child;
            }
            prefetch(child);
            self.push(Entry::new(0.0, child));
        }
    }
}

/// The first child in `hits`.
#[inline(always)]
fn entry(children: &[Child; LANES], near: &[f32; LANES], hits: u32) -> Entry {
    let lane = hits.trailing_zeros() as usize % LANES;
    Entry::new(near[lane], children[lane])
}
