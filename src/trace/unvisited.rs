//! What a query that stopped for missing blocks has still to look at.

use crate::octree::Child;
use crate::units::BlockId;

/// The missing blocks that a query has come to, in the order of its way, which is nearly that of distance, and where its way through
/// the coarse tree stopped, if it did. The query has looked at all other blocks before that place that could matter: those that were
/// there need not be there again.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unvisited<const MAX: usize> {
    /// The first `count` are.
    blocks: [BlockId; MAX],
    count: u32,
    /// Where the way stopped because there was no room for one more block, or because a part of the model that was not cut into blocks
    /// yet came next, which what is missing may make needless.
    pub stopped_at: Option<BlockId>,
    /// Of an any-hit query: an ignored material was hit.
    pub filtered: bool,
}

/// Of a closest-hit query: longer lists are seldom, and make few loads needless.
pub(super) type UnvisitedClosest = Unvisited<20>;

/// Of an any-hit query: longer lists would take no memory, as closest-hit queries keep more, and make no loads needless.
pub(super) type UnvisitedAny = Unvisited<28>;

impl<const MAX: usize> Unvisited<MAX> {
    /// Of a query that has not begun.
    pub const UNSET: Unvisited<MAX> =
        Unvisited { blocks: [BlockId(0); _], count: 0, stopped_at: None, filtered: false };

    /// Begins a query, or goes on with the one that left this: gives where, and what is listed, to be looked at first, as leaves of a
    /// tree of their own.
    #[inline(always)]
    pub fn begin(&mut self, is_resumed: bool) -> (Child, Listed) {
        if !is_resumed {
            (self.count, self.stopped_at) = (0, None);
        }
        let count = self.take();
        let child = if count > 0 { Child::block(self.taken(0).0) } else { Child::COARSE_ROOT };
        (child, Listed { count, next: 1 })
    }

    /// The missing blocks.
    #[inline(always)]
    pub fn blocks(&self) -> &[BlockId] {
        &self.blocks[..self.count as usize]
    }

    /// Whether nothing was missing so far.
    #[inline(always)]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Begins to look at the blocks once more: gives how many there are. Those that are still missing are pushed again, after they were
    /// read with [`Unvisited::taken`].
    #[inline(always)]
    pub fn take(&mut self) -> u32 {
        std::mem::take(&mut self.count)
    }

    /// The block at a place below what [`Unvisited::take`] gave.
    #[inline(always)]
    pub fn taken(&self, place: u32) -> BlockId {
        self.blocks[place as usize]
    }

    /// Takes one more, behind the others. Gives whether there was room.
    #[inline(always)]
    pub fn push(&mut self, block: BlockId) -> bool {
        match self.blocks.get_mut(self.count as usize) {
            Some(place) => {
                *place = block;
                self.count += 1;
                true
            }
            None => false,
        }
    }
}

/// What was listed when a query went on, while it is looked at once more.
pub(super) struct Listed {
    count: u32,
    next: u32,
}

/// What a query comes to behind a leaf.
pub(super) enum Next {
    /// A block that was listed.
    Listed(Child),
    /// The place where the way through the coarse tree stopped, which goes on there.
    Stopped(BlockId),
    /// What waits on its stack.
    Waiting,
    /// Nothing more.
    End,
}

impl Listed {
    /// Goes on. What is still missing was pushed to `unvisited`, to places that were read already.
    #[inline(always)]
    pub fn next<const MAX: usize>(&mut self, unvisited: &mut Unvisited<MAX>) -> Next {
        if self.next < self.count {
            let block = unvisited.taken(self.next);
            self.next += 1;
            return Next::Listed(Child::block(block.0));
        }
        if std::mem::take(&mut self.count) == 0 {
            return Next::Waiting;
        }
        match unvisited.stopped_at.take() {
            Some(block) => Next::Stopped(block),
            None => Next::End,
        }
    }
}
