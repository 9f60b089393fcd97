//! Rays that wait for blocks: records in a fixed number of places, one queue per missing block, and which queue is worth
//! loading for. Knows nothing of traversal; [`RayPool`](super::RayPool) puts it to use.

use super::Hit;
use super::unvisited::{UnvisitedAny, UnvisitedClosest};
use super::way::Way;
use crate::geom::Ray;
use crate::units::{BlockId, Bytes, TriangleId};

/// No place, no queue.
const NONE: u32 = u32::MAX;

/// A ray that waits, with what its query has found so far.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    pub ray: Ray,
    pub tag: u64,
    /// What loading the block that it waits for is worth to it.
    pub weight: u32,
    pub query: Query,
    /// The record behind it in its queue, or the next free place.
    next: u32,
}

/// A query on its way.
#[derive(Clone, Copy, Debug)]
pub(super) enum Query {
    Closest { after: Option<(f64, TriangleId)>, best: Option<Hit>, rest: UnvisitedClosest },
    Any(UnvisitedAny),
}

/// A place for a record, from [`SuspendedRays::take_place`] to [`SuspendedRays::free_place`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Place(u32);

/// What waits for one block. Closest-hit and any-hit queries are kept apart because different kernels run them.
#[derive(Clone, Copy, Debug)]
struct Queue {
    block: BlockId,
    closest: List,
    any: List,
    /// How many any-hit queries there are.
    any_count: u32,
    /// Sum of the records' weights.
    weight: u64,
    /// Where in the heap it is, or `NONE` while its block is on its way in; for a free queue, the next free one.
    heap_place: u32,
}

#[derive(Clone, Copy, Debug)]
struct List {
    first: u32,
    last: u32,
}

impl List {
    const EMPTY: List = List { first: NONE, last: NONE };
}

/// How far from the last choice the next is looked for: so that it takes less time than a load, however large the model.
const STEPS_MAX: u32 = 1 << 16;

/// See the module. Nothing is allocated after [`SuspendedRays::new`].
pub(super) struct SuspendedRays {
    records: Vec<Record>,
    capacity: u32,
    free_record: u32,
    count: u32,
    peak: u32,
    /// How many of those that wait in queues are any-hit queries.
    any_total: u32,
    queues: Vec<Queue>,
    free_queue: u32,
    /// By block.
    queue_of: Vec<u32>,
    /// Queues that hold something and whose block nobody is loading: a binary heap, the greatest weight first.
    heap: Vec<u32>,
    /// Blocks on their way in, whose queues are not in the heap.
    loading: Vec<BlockId>,
    /// Where there is less room, blocks are chosen by how many rays end there.
    kept_free: u32,
    /// Where the block that was chosen last lies, and which come next.
    way: Way,
}

impl SuspendedRays {
    /// Room for `capacity` rays, blocks whose numbers are below `block_count`, and `loading_max` of them on their way in.
    /// `kept_free`: places below which room is short. `way`: through all of these blocks.
    pub fn new(
        capacity: u32,
        block_count: usize,
        loading_max: u32,
        kept_free: u32,
        way: Way,
    ) -> SuspendedRays {
        SuspendedRays {
            records: Vec::with_capacity(capacity as usize),
            capacity,
            free_record: NONE,
            count: 0,
            peak: 0,
            any_total: 0,
            queues: Vec::with_capacity(capacity as usize),
            free_queue: NONE,
            queue_of: vec![NONE; block_count],
            heap: Vec::with_capacity(capacity as usize),
            loading: Vec::with_capacity(loading_max as usize),
            kept_free,
            way,
        }
    }

    /// What [`SuspendedRays::new`] and its way allocate.
    pub fn bytes_needed(capacity: u32, block_count: usize, loading_max: u32) -> Bytes {
        let per_ray = size_of::<Record>() + size_of::<Queue>() + size_of::<u32>();
        let per_load = size_of::<BlockId>() as u64 * u64::from(loading_max);
        let per_block = (block_count * size_of::<u32>()) as u64 + Way::bytes_needed(block_count);
        Bytes(u64::from(capacity) * per_ray as u64 + per_block + per_load)
    }

    /// How many rays wait.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// How many more can.
    pub fn room(&self) -> u32 {
        self.capacity - self.count
    }

    /// The most that ever waited.
    pub fn peak(&self) -> u32 {
        self.peak
    }

    /// A place for one more ray, unless all are taken.
    pub fn take_place(&mut self) -> Option<Place> {
        let place = if self.free_record != NONE {
            let place = self.free_record;
            self.free_record = self.records[place as usize].next;
            place
        } else if self.records.len() < self.capacity as usize {
            self.records.push(Record {
                ray: Ray::new([0.0; 3], [0.0; 3]),
                tag: 0,
                weight: 0,
                query: Query::Any(UnvisitedAny::UNSET),
                next: NONE,
            });
            self.records.len() as u32 - 1
        } else {
            return None;
        };
        self.count += 1;
        self.peak = self.peak.max(self.count);
        Some(Place(place))
    }

    /// Gives back a place that is in no queue.
    pub fn free_place(&mut self, place: Place) {
        self.records[place.0 as usize].next = self.free_record;
        self.free_record = place.0;
        self.count -= 1;
    }

    pub fn record(&self, place: Place) -> &Record {
        &self.records[place.0 as usize]
    }

    /// Puts a ray into `place`, which is in no queue, at the end of the queue of `block`.
    pub fn wait(&mut self, place: Place, block: BlockId, ray: Ray, tag: u64, weight: u32, query: Query) {
        self.records[place.0 as usize] = Record { ray, tag, weight, query, next: NONE };
        let index = match self.queue_of[block.0 as usize] {
            NONE => self.new_queue(block),
            index => index,
        };
        let is_closest = matches!(query, Query::Closest { .. });
        let queue = &mut self.queues[index as usize];
        queue.weight += u64::from(weight);
        queue.any_count += u32::from(!is_closest);
        self.any_total += u32::from(!is_closest);
        let list = if is_closest { &mut queue.closest } else { &mut queue.any };
        let last = list.last;
        list.last = place.0;
        match last {
            NONE => list.first = place.0,
            last => self.records[last as usize].next = place.0,
        }
        let heap_place = queue.heap_place;
        if heap_place != NONE {
            self.sift_up(heap_place);
        }
    }

    /// Takes the first closest-hit query from the queue of `block`.
    pub fn next_closest(&mut self, block: BlockId) -> Option<Place> {
        self.take_first(block, |queue| &mut queue.closest)
    }

    /// Takes the first any-hit query from the queue of `block`.
    pub fn next_any(&mut self, block: BlockId) -> Option<Place> {
        self.take_first(block, |queue| &mut queue.any)
    }

    fn take_first(&mut self, block: BlockId, list: impl Fn(&mut Queue) -> &mut List) -> Option<Place> {
        let index = self.queue_of[block.0 as usize];
        let queue = self.queues.get_mut(index as usize)?;
        let list = list(queue);
        let first = list.first;
        let record = self.records.get(first as usize)?;
        list.first = record.next;
        if record.next == NONE {
            list.last = NONE;
        }
        queue.weight -= u64::from(record.weight);
        let any = u32::from(matches!(record.query, Query::Any(_)));
        queue.any_count -= any;
        self.any_total -= any;
        if queue.closest.first == NONE && queue.any.first == NONE {
            self.drop_queue(index);
        } else if queue.heap_place != NONE {
            self.sift_down(self.queues[index as usize].heap_place);
        }
        Some(Place(first))
    }

    /// What loading `block` is worth to those that wait for it.
    pub fn weight(&self, block: BlockId) -> u64 {
        self.queues.get(self.queue_of[block.0 as usize] as usize).map_or(0, |queue| queue.weight)
    }

    /// Whether any-hit queries wait for another block than this one.
    pub fn any_elsewhere(&self, block: BlockId) -> bool {
        self.any_total > self.any_count(block)
    }

    /// How many any-hit queries wait for `block`.
    pub fn any_count(&self, block: BlockId) -> u32 {
        self.queues.get(self.queue_of[block.0 as usize] as usize).map_or(0, |queue| queue.any_count)
    }

    /// Whether any ray waits for `block`.
    pub fn is_awaited(&self, block: BlockId) -> bool {
        self.queue_of[block.0 as usize] != NONE
    }

    /// The block to load next, of those that rays wait for and that are not on their way in: the next one from the one chosen last, on
    /// the [`Way`], that is worth at least 1 / [`Way::share_min`] of what the best is worth. That is its weight, or, where
    /// little room is left, how many any-hit queries it has, as those lead to no others.
    ///
    /// Light queues are left for a later turn.
    pub fn choose(&mut self) -> Option<BlockId> {
        let heaviest = *self.heap.first()?;
        let is_short = self.room() < self.kept_free;
        let worth = |queue: &Queue| if is_short { u64::from(queue.any_count) } else { queue.weight };
        let queue = |index: u32| self.queues[index as usize];
        let best = if is_short {
            self.heap.iter().copied().max_by_key(|index| queue(*index).any_count)?
        } else {
            heaviest
        };
        let least = worth(&queue(best)).div_ceil(self.way.share_min());
        let best = queue(best).block;
        for _ in 0..self.way.steps().min(STEPS_MAX) {
            let block = self.way.step();
            if let Some(queue) = self.queues.get(self.queue_of[block.0 as usize] as usize)
                && queue.heap_place != NONE
                && worth(queue) >= least
            {
                return Some(block);
            }
        }
        Some(best)
    }

    /// From now on `block` is on its way in, whether rays wait for it or not.
    pub fn begin_load(&mut self, block: BlockId) {
        self.loading.push(block);
        if let Some(queue) = self.queues.get(self.queue_of[block.0 as usize] as usize) {
            let heap_place = queue.heap_place;
            self.leave_heap(heap_place);
            self.queues[self.queue_of[block.0 as usize] as usize].heap_place = NONE;
        }
    }

    /// `block`, which was on its way in, is so no more.
    pub fn end_load(&mut self, block: BlockId) {
        if let Some(place) = self.loading.iter().position(|loading| *loading == block) {
            self.loading.swap_remove(place);
            let index = self.queue_of[block.0 as usize];
            if index != NONE {
                self.enter_heap(index);
            }
        }
    }

    fn new_queue(&mut self, block: BlockId) -> u32 {
        let (closest, any) = (List::EMPTY, List::EMPTY);
        let queue = Queue { block, closest, any, any_count: 0, weight: 0, heap_place: NONE };
        let index = match self.free_queue {
            // Every queue holds a record, so there are never more of them.
            NONE => {
                self.queues.push(queue);
                self.queues.len() as u32 - 1
            }
            index => {
                self.free_queue = self.queues[index as usize].heap_place;
                self.queues[index as usize] = queue;
                index
            }
        };
        self.queue_of[block.0 as usize] = index;
        if !self.loading.contains(&block) {
            self.enter_heap(index);
        }
        index
    }

    fn enter_heap(&mut self, index: u32) {
        let heap_place = self.heap.len() as u32;
        self.queues[index as usize].heap_place = heap_place;
        self.heap.push(index);
        self.sift_up(heap_place);
    }

    fn leave_heap(&mut self, heap_place: u32) {
        self.heap.swap_remove(heap_place as usize);
        if let Some(moved) = self.heap.get(heap_place as usize).copied() {
            self.queues[moved as usize].heap_place = heap_place;
            self.sift_up(heap_place);
            self.sift_down(self.queues[moved as usize].heap_place);
        }
    }

    fn drop_queue(&mut self, index: u32) {
        let Queue { block, heap_place, .. } = self.queues[index as usize];
        self.queue_of[block.0 as usize] = NONE;
        if heap_place != NONE {
            self.leave_heap(heap_place);
        }
        self.queues[index as usize].heap_place = self.free_queue;
        self.free_queue = index;
    }

    fn weight_at(&self, heap_place: u32) -> u64 {
        self.queues[self.heap[heap_place as usize] as usize].weight
    }

    fn swap(&mut self, a: u32, b: u32) {
        self.heap.swap(a as usize, b as usize);
        self.queues[self.heap[a as usize] as usize].heap_place = a;
        self.queues[self.heap[b as usize] as usize].heap_place = b;
    }

    fn sift_up(&mut self, mut place: u32) {
        while place > 0 {
            let parent = (place - 1) / 2;
            if self.weight_at(parent) >= self.weight_at(place) {
                break;
            }
            self.swap(parent, place);
            place = parent;
        }
    }

    fn sift_down(&mut self, mut place: u32) {
        let count = self.heap.len() as u32;
        loop {
            let children = 2 * place + 1..count.min(2 * place + 3);
            let Some(child) = children.max_by_key(|child| self.weight_at(*child)) else { break };
            if self.weight_at(place) >= self.weight_at(child) {
                break;
            }
            self.swap(place, child);
            place = child;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, HashMap, HashSet, VecDeque};

    use super::*;

    /// Against lists and a search: thousands of arrivals and departures.
    #[test]
    fn queues_are_what_a_naive_twin_has() {
        for turns_back in [false, true] {
            beside_a_twin(turns_back);
        }
    }

    fn beside_a_twin(turns_back: bool) {
        const CAPACITY: u32 = 50;
        const BLOCKS: u32 = 12;
        const KEPT_FREE: u32 = 5;
        let mut suspended = SuspendedRays::new(
            CAPACITY,
            BLOCKS as usize,
            BLOCKS,
            KEPT_FREE,
            Way::of_file(BLOCKS as usize, turns_back),
        );
        // By block: (tag, weight) of closest-hit and any-hit queries.
        let mut twin: HashMap<u32, [VecDeque<(u64, u32)>; 2]> = HashMap::new();
        let mut state = 7u64;
        let mut below = |n: u32| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as u32 % n
        };
        let mut peak = 0;
        let mut loading: HashSet<u32> = HashSet::new();
        let (mut before, mut goes_back) = (0, false);
        let (mut passed_over, mut turned, mut short) = (0, 0, 0);
        for tag in 0..20_000 {
            // Loads begin, of blocks that rays wait for and of others, and end.
            let block = below(BLOCKS);
            if below(10) == 0 && loading.remove(&block) {
                suspended.end_load(BlockId(block));
            } else if below(20) == 0 && loading.insert(block) {
                suspended.begin_load(BlockId(block));
            }
            let count: usize = twin.values().flatten().map(VecDeque::len).sum();
            assert_eq!(suspended.count() as usize, count);
            peak = peak.max(count);
            // Fills up and runs empty in turn.
            let arrives = below(10) < if tag / 500 % 2 == 0 { 6 } else { 4 };
            if arrives {
                let Some(place) = suspended.take_place() else {
                    assert_eq!(count, CAPACITY as usize);
                    continue;
                };
                let (block, weight, kind) = (below(BLOCKS), 1 + below(4), below(2) as usize);
                let query = if kind == 0 {
                    Query::Closest { after: None, best: None, rest: UnvisitedClosest::UNSET }
                } else {
                    Query::Any(UnvisitedAny::UNSET)
                };
                let ray = Ray::new([0.0; 3], [1.0; 3]);
                suspended.wait(place, BlockId(block), ray, tag, weight, query);
                twin.entry(block).or_default()[kind].push_back((tag, weight));
                continue;
            }
            let weights: HashMap<u32, u64> = twin
                .iter()
                .map(|(block, lists)| {
                    (*block, lists.iter().flatten().map(|(_, weight)| u64::from(*weight)).sum())
                })
                .collect();
            for block in 0..BLOCKS {
                let weight = weights.get(&block).copied().unwrap_or(0);
                assert_eq!(suspended.weight(BlockId(block)), weight);
                assert_eq!(suspended.is_awaited(BlockId(block)), weight > 0);
                let any = twin.get(&block).map_or(0, |lists| lists[1].len());
                assert_eq!(suspended.any_count(BlockId(block)) as usize, any);
                let all: usize = twin.values().map(|lists| lists[1].len()).sum();
                assert_eq!(suspended.any_elsewhere(BlockId(block)), all > any);
            }
            let idle = weights.iter().filter(|(block, weight)| **weight > 0 && !loading.contains(*block));
            let idle: BTreeMap<u32, u64> = idle.map(|(block, weight)| (*block, *weight)).collect();
            // On to the end, and all the way back, or from the beginning.
            let mut way: Vec<(u32, bool)> = if goes_back {
                (0..before).rev().map(|block| (block, true)).collect()
            } else {
                (before + 1..BLOCKS).map(|block| (block, false)).collect()
            };
            let turned_back = turns_back != goes_back;
            let mut others: Vec<(u32, bool)> = (0..BLOCKS).map(|block| (block, turned_back)).collect();
            if turned_back {
                others.reverse();
            }
            way.append(&mut others);
            // What ends counts where there is little room.
            let is_short = CAPACITY as usize - count < KEPT_FREE as usize;
            let worth = |block: &u32| if is_short { twin[block][1].len() as u64 } else { idle[block] };
            let best = idle.keys().map(worth).max().unwrap_or(0);
            short += u32::from(is_short && best > 0);
            let share_min = suspended.way.share_min();
            let heavy =
                |(block, _): &(u32, bool)| idle.contains_key(block) && worth(block) * share_min >= best;
            let chosen = suspended.choose();
            let place = way.iter().position(heavy);
            assert_eq!(chosen.map(|block| block.0), place.map(|place| way[place].0));
            if let Some(place) = place {
                passed_over += u32::from(way[..place].iter().any(|(light, _)| idle.contains_key(light)));
                turned += u32::from(way[place].1 != goes_back);
                (before, goes_back) = way[place];
            }
            // Rays of a block on its way in may run too, if others brought it.
            let other = BlockId(below(BLOCKS));
            let block = chosen.filter(|_| below(4) > 0).unwrap_or(other);
            let kind = below(2) as usize;
            let taken = if kind == 0 { suspended.next_closest(block) } else { suspended.next_any(block) };
            let expected = twin.entry(block.0).or_default()[kind].pop_front();
            assert_eq!(taken.map(|place| suspended.record(place).tag), expected.map(|(tag, _)| tag));
            if let Some(place) = taken {
                suspended.free_place(place);
            }
        }
        assert_eq!(suspended.peak() as usize, peak);
        assert!(peak == CAPACITY as usize && passed_over > 0 && short > 0);
        assert_eq!(turned > 0, turns_back);
    }
}
