//! In which order a pool comes to the blocks that its rays wait for.
//!
//! A ray that leaves a block mostly waits for a neighbour. On a way along which its next blocks come later it passes several in
//! one turn; chosen by weight alone, each makes it wait for half a turn. Nearness counts for less than going on in one direction: a
//! Hilbert curve takes more loads than the Morton order of the file, in which a ray that goes up all axes never goes back, and planes
//! that sweep the model fewer, where the way turns back at its ends (docs/results/suspension.md).

use crate::geom::Aabb;
use crate::octree::LazyOctree;
use crate::units::BlockId;

/// Across the planes: oblique, so that no layer of blocks that is parallel to two axes comes at once.
const ACROSS: [f64; 3] = [1.0, 0.6, 0.3];

/// Where few blocks are in memory, those for which little waits are left for a later turn.
const SHARE_MIN: u64 = 32;

/// Where an eighth of them are, a turn more costs more loads than they do.
const SHARE_MIN_AMPLE: u64 = 64;

/// The way through all blocks, over and over, and where it stands.
pub(super) struct Way {
    /// The blocks by their place on the way, in the low halves, sorted by the high ones; empty if that is the order of the file.
    order: Vec<u64>,
    block_count: u32,
    /// Whether it turns back at its ends, rather than to begin anew.
    turns_back: bool,
    /// See [`Way::share_min`].
    share_min: u64,
    place: u32,
    goes_back: bool,
}

impl Way {
    /// In the order of the file.
    pub fn of_file(block_count: usize, turns_back: bool) -> Way {
        Way {
            order: Vec::new(),
            block_count: block_count as u32,
            turns_back,
            share_min: SHARE_MIN,
            place: 0,
            goes_back: false,
        }
    }

    /// The best way through the blocks of `octree`.
    ///
    /// If a twelfth of them are in memory at once, it turns back at its ends, so that the blocks that come next are those that were
    /// loaded last; with fewer that is worth less than what it costs, that blocks near the ends come twice in a row. One that turns
    /// back goes by planes, if all blocks are known.
    pub fn through(octree: &LazyOctree) -> Way {
        let model = octree.model();
        let block_count = model.block_id_count() as usize;
        let in_memory = |part| octree.cache().slot_count() >= model.expected_block_count() / part;
        let turns_back = in_memory(12);
        let share_min = if in_memory(8) { SHARE_MIN_AMPLE } else { SHARE_MIN };
        let way = Way { share_min, ..Way::of_file(block_count, turns_back) };
        if !turns_back {
            return way;
        }
        let mut order = Vec::with_capacity(block_count);
        for block in 0..block_count as u32 {
            let Some(entry) = octree.entry(BlockId(block)) else { return way };
            order.push(u64::from(plane(&entry.bounds, &model.bounds)) << 32 | u64::from(block));
        }
        order.sort_unstable();
        Way { order, ..way }
    }

    /// What a way allocates.
    pub fn bytes_needed(block_count: usize) -> u64 {
        (block_count * size_of::<u64>()) as u64
    }

    /// A block is passed over while another is worth more than so many times as much.
    pub fn share_min(&self) -> u64 {
        self.share_min
    }

    /// How many steps at most lead past every block: once round, or to one end and then to the other.
    pub fn steps(&self) -> u32 {
        self.block_count.saturating_mul(2).saturating_sub(1)
    }

    /// Goes on to the next block. There must be one.
    pub fn step(&mut self) -> BlockId {
        let last = self.block_count - 1;
        if self.place == (if self.goes_back { 0 } else { last }) {
            if self.turns_back {
                self.goes_back = !self.goes_back;
            } else {
                self.place = 0;
            }
        } else if self.goes_back {
            self.place -= 1;
        } else {
            self.place += 1;
        }
        self.order.get(self.place as usize).map_or(BlockId(self.place), |block| BlockId(*block as u32))
    }
}

/// Which plane the middle of a block lies in, from 0 to 2^31.
fn plane(block: &Aabb, model: &Aabb) -> u32 {
    let (mut place, mut whole) = (0.0, 0.0);
    for (axis, across) in ACROSS.into_iter().enumerate() {
        place += across * (0.5 * block.min[axis] + 0.5 * block.max[axis] - model.min[axis]);
        whole += across * (model.max[axis] - model.min[axis]);
    }
    // 0 for a model that is a point, and where numbers leave their range.
    (place / whole * f64::from(1u32 << 31)) as u32
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::MemoryBudget;
    use crate::octree::OctreeOptions;
    use crate::source::BlockSource;
    use crate::trace::small_model::small_blocks;
    use crate::units::Bytes;

    fn blocks(way: &mut Way, count: usize) -> Vec<u32> {
        (0..count).map(|_| way.step().0).collect()
    }

    #[test]
    fn a_way_passes_every_block_and_turns_back_or_begins_anew() {
        let mut anew = Way::of_file(4, false);
        assert_eq!(blocks(&mut anew, 6), [1, 2, 3, 0, 1, 2]);
        let mut back = Way::of_file(4, true);
        assert_eq!(blocks(&mut back, 9), [1, 2, 3, 3, 2, 1, 0, 0, 1]);
        let order = vec![2, 0, 3, 1];
        let mut planes = Way { order, ..Way::of_file(4, true) };
        assert_eq!(blocks(&mut planes, 9), [0, 3, 1, 1, 3, 0, 2, 2, 0]);
        for way in [&mut anew, &mut back, &mut planes] {
            let steps = way.steps() as usize;
            let mut passed = blocks(way, steps);
            passed.sort_unstable();
            passed.dedup();
            assert_eq!(passed, [0, 1, 2, 3]);
        }
        assert_eq!(blocks(&mut Way::of_file(1, true), 3), [0, 0, 0]);
    }

    #[test]
    fn a_way_goes_by_planes_where_it_turns_back() {
        let source = Arc::new(small_blocks(4000, 5));
        let block_count = source.model().block_id_count();
        assert!(block_count > 24);
        for slots in [block_count / 12 - 1, block_count / 12, block_count / 8, block_count] {
            let budget = MemoryBudget::new(Bytes::mib(64));
            let options = OctreeOptions { slots_max: Some(slots), ..OctreeOptions::default() };
            let octree = LazyOctree::open(source.clone(), &budget, options).unwrap();
            let mut way = Way::through(&octree);
            assert_eq!(way.turns_back, slots >= block_count / 12);
            let is_ample = slots >= block_count / 8;
            assert_eq!(way.share_min(), if is_ample { SHARE_MIN_AMPLE } else { SHARE_MIN });
            let passed: Vec<BlockId> = (1..block_count).map(|_| way.step()).collect();
            let place = |block: &BlockId| match way.turns_back {
                true => plane(&octree.entry(*block).unwrap().bounds, &octree.model().bounds),
                false => block.0,
            };
            assert!(passed.iter().map(place).is_sorted(), "{slots} slots");
        }
    }

    #[test]
    fn planes_are_in_order_whatever_the_model() {
        let model = Aabb { min: [-1e6, 0.0, -3.0], max: [1e6, 0.0, 5.0] };
        let at = |x: f64| Aabb { min: [x, 0.0, 0.0], max: [x + 1.0, 0.0, 1.0] };
        let planes = [-1e6, -5.0, 0.0, 7e5, 999_999.0].map(|x| plane(&at(x), &model));
        assert!(planes.is_sorted() && planes[0] < planes[4], "{planes:?}");
        let point = Aabb { min: [2.0; 3], max: [2.0; 3] };
        assert_eq!(plane(&point, &point), 0);
        let vast = Aabb { min: [-f64::MAX; 3], max: [f64::MAX; 3] };
        assert_eq!(plane(&vast, &vast), 0);
    }
}
