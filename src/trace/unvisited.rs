//! What a query that stopped for missing blocks has still to look at.

use crate::units::BlockId;

/// The missing blocks that a query has come to, in the order of its way, which is nearly that of distance, and where its way through the coarse tree stopped, if it did. The
/// query has looked at all other blocks before that place that could matter: those that were there need not be there again.
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

    /// Forgets the query before.
    #[inline(always)]
    pub fn begin(&mut self) {
        (self.count, self.stopped_at) = (0, None);
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
