//! Faces in no order over vertices that do not fit in memory.
//!
//! Looking vertices up one by one would fetch a page for almost every corner. Instead triangles are gathered into batches
//! as large as memory allows; for a batch the vertices that it needs are marked in a bit map, the vertex file is swept
//! once from front to back, and what is marked is kept, packed. A vertex's place among the packed ones is its rank in the bit map. So
//! the disk sees sequential reads only, nothing is sorted, and nothing is written; the cost is one sweep of the vertices per batch.

use super::lookup::{Fault, Lookup, Work};
use super::point::Point;
use super::scatter::Scatter;
use super::vertices::VertexStore;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::{BudgetError, CompileError};
use crate::units::Bytes;

/// Triangles between two looks at the number of fetched pages.
const WATCHED_TRIANGLES: u64 = 1 << 16;
/// Pages fetched in that time beyond which faces have no order worth the name: one per 64 triangles. Faces in the order of
/// a generator or a scanner fetch one in thousands.
const FETCHES_MAX: u64 = WATCHED_TRIANGLES / 64;
/// Fewest triangles that are worth a sweep.
const BATCH_TRIANGLES_MIN: u64 = 1 << 14;

/// Triangles of a batch for each run of equal materials that it has room for: with shorter runs than that it is full sooner.
const TRIANGLES_PER_RUN: u64 = 8;

/// Material, first id and length of a run of triangles.
type Run = (u16, u64, usize);

/// Sees when looking up page by page goes wrong.
#[derive(Debug, Default)]
pub(super) struct FetchWatch {
    triangles: u64,
    fetches: u64,
}

impl FetchWatch {
    /// After `triangles` more were placed: whether too many pages were fetched for them.
    pub(super) fn is_thrashing(&mut self, triangles: usize, store: &VertexStore) -> bool {
        self.triangles += triangles as u64;
        if self.triangles < WATCHED_TRIANGLES {
            return false;
        }
        let fetched = store.fetches() - self.fetches;
        let thrashing = fetched > FETCHES_MAX * (self.triangles / WATCHED_TRIANGLES);
        *self = FetchWatch { triangles: 0, fetches: store.fetches() };
        thrashing
    }
}

/// A batch of triangles, and the vertices that it needs.
#[derive(Debug)]
pub(super) struct Gather<P> {
    triangles: Vec<[u32; 3]>,
    /// Those of `triangles`.
    runs: Vec<Run>,
    points: Vec<P>,
    ranks: Ranks,
    capacity: usize,
    _memory: Reservation,
}

impl<P: Point> Gather<P> {
    /// A batch as large as the budget allows if `headroom` bytes are left to others.
    ///
    /// # Errors
    /// The budget does not hold a batch of useful size.
    pub(super) fn new(
        vertex_count: usize,
        budget: &MemoryBudget,
        headroom: u64,
    ) -> Result<Gather<P>, BudgetError> {
        let per_run = (size_of::<Run>() as u64).div_ceil(TRIANGLES_PER_RUN);
        let per_triangle = (size_of::<[u32; 3]>() + 3 * size_of::<P>()) as u64 + per_run;
        let ranks_bytes = Ranks::bytes_needed(vertex_count);
        let spare = budget.available().0.saturating_sub(headroom + ranks_bytes);
        let capacity = (spare / per_triangle).max(BATCH_TRIANGLES_MIN);
        let memory =
            budget.reserve(Bytes(capacity * per_triangle + ranks_bytes), "joining faces and vertices")?;
        Ok(Gather {
            triangles: Vec::new(),
            runs: Vec::new(),
            points: Vec::new(),
            ranks: Ranks::new(vertex_count),
            capacity: capacity as usize,
            _memory: memory,
        })
    }

    /// Takes as many of the triangles as fit and returns how many: none only if there are some already.
    pub(super) fn push(&mut self, triangles: &[[u32; 3]], material: u16, first_id: u64) -> usize {
        if self.triangles.capacity() == 0 {
            self.triangles.reserve_exact(self.capacity);
            self.points.reserve_exact(3 * self.capacity);
            self.runs.reserve_exact(self.capacity / TRIANGLES_PER_RUN as usize);
        }
        let count = triangles.len().min(self.capacity - self.triangles.len());
        let has_room = self.runs.len() < self.runs.capacity();
        match self.runs.last_mut() {
            Some((last, first, len)) if *last == material && *first + *len as u64 == first_id => {
                *len += count
            }
            _ if !has_room => return 0,
            _ => self.runs.push((material, first_id, count)),
        }
        self.triangles.extend_from_slice(&triangles[..count]);
        count
    }
}

/// Placing a gathered batch, and all that is in buckets from it.
pub(super) struct PlaceGathered<'a, P> {
    pub(super) gather: &'a mut Gather<P>,
    pub(super) scatter: &'a mut Scatter<P>,
}

impl<P: Point> Work<P> for PlaceGathered<'_, P> {
    type Output = Result<(), CompileError>;

    fn run<L: Lookup<Point = P>>(self, lookup: &mut L) -> Self::Output {
        let PlaceGathered { gather, scatter } = self;
        let Gather { triangles, runs, points, ranks, .. } = gather;
        ranks.clear();
        triangles.as_flattened().iter().for_each(|vertex| ranks.mark(*vertex));
        ranks.count();
        points.clear();
        // In ascending order: each page is fetched at most once.
        ranks.for_each(|vertex| {
            points.push(lookup.get(vertex)?);
            Ok(())
        })?;
        for vertex in triangles.as_flattened_mut() {
            *vertex = ranks.rank(*vertex);
        }
        let mut gathered = Gathered { points, ranks, lookup };
        let mut start = 0;
        for &(material, first_id, len) in runs.iter() {
            scatter.add(&triangles[start..start + len], material, first_id, &mut gathered)?;
            start += len;
        }
        // Buckets name vertices by their ranks, which mean nothing after this batch.
        scatter.flush_all(&mut gathered)?;
        triangles.clear();
        runs.clear();
        Ok(())
    }
}

/// Flushing what is in buckets.
pub(super) struct FlushAll<'a, P>(pub(super) &'a mut Scatter<P>);

impl<P: Point> Work<P> for FlushAll<'_, P> {
    type Output = Result<(), CompileError>;

    fn run<L: Lookup<Point = P>>(self, lookup: &mut L) -> Self::Output {
        self.0.flush_all(lookup)
    }
}

/// Looks vertices up by rank.
struct Gathered<'a, P, L> {
    points: &'a [P],
    ranks: &'a Ranks,
    lookup: &'a mut L,
}

impl<P: Point, L: Lookup<Point = P>> Lookup for Gathered<'_, P, L> {
    type Point = P;

    #[inline]
    fn get(&mut self, vertex: u32) -> Result<P, CompileError> {
        Ok(self.points[vertex as usize])
    }

    fn fault(&mut self, triangle: [u32; 3]) -> Result<Fault, CompileError> {
        self.lookup.fault(triangle.map(|rank| self.ranks.select(rank)))
    }
}

/// A set of vertices that knows how many members are below one of them.
#[derive(Debug)]
struct Ranks {
    words: Vec<u64>,
    /// Members before each word.
    before: Vec<u32>,
}

impl Ranks {
    fn bytes_needed(vertex_count: usize) -> u64 {
        vertex_count.div_ceil(64) as u64 * 12
    }

    fn new(vertex_count: usize) -> Ranks {
        let words = vertex_count.div_ceil(64);
        Ranks { words: vec![0; words], before: vec![0; words] }
    }

    fn clear(&mut self) {
        self.words.fill(0);
    }

    #[inline]
    fn mark(&mut self, vertex: u32) {
        self.words[vertex as usize / 64] |= 1 << (vertex % 64);
    }

    /// To be called between the last `mark` and the first `rank`.
    fn count(&mut self) {
        let mut sum = 0;
        for (before, word) in self.before.iter_mut().zip(&self.words) {
            *before = sum;
            sum += word.count_ones();
        }
    }

    /// How many members are below a member.
    #[inline]
    fn rank(&self, vertex: u32) -> u32 {
        let word = vertex as usize / 64;
        let below = self.words[word] & ((1 << (vertex % 64)) - 1);
        self.before[word] + below.count_ones()
    }

    /// The member with that many below it.
    fn select(&self, rank: u32) -> u32 {
        let word = self.before.partition_point(|before| *before <= rank) - 1;
        let mut bits = self.words[word];
        for _ in self.before[word]..rank {
            bits &= bits - 1;
        }
        word as u32 * 64 + bits.trailing_zeros()
    }

    /// All members in ascending order.
    fn for_each(&self, mut take: impl FnMut(u32) -> Result<(), CompileError>) -> Result<(), CompileError> {
        for (word, bits) in (0_u32..).zip(&self.words) {
            let mut bits = *bits;
            while bits != 0 {
                take(word * 64 + bits.trailing_zeros())?;
                bits &= bits - 1;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_and_members_belong_together() {
        let members = [0, 1, 63, 64, 127, 200, 640, 641, 999];
        let mut ranks = Ranks::new(1000);
        members.iter().rev().for_each(|member| ranks.mark(*member));
        ranks.count();
        for (rank, member) in (0..).zip(members) {
            assert_eq!((ranks.rank(member), ranks.select(rank)), (rank, member));
        }
        let mut seen = Vec::new();
        ranks
            .for_each(|member| {
                seen.push(member);
                Ok(())
            })
            .unwrap();
        assert_eq!(seen, members);
    }

    /// Each run takes memory; with a change of material at every triangle there are as many.
    #[test]
    fn a_batch_is_full_when_its_runs_are() {
        let budget = MemoryBudget::new(Bytes::mib(2));
        let mut gather = Gather::<[f32; 3]>::new(1000, &budget, 0).unwrap();
        let room = gather.capacity / TRIANGLES_PER_RUN as usize;
        let mut id = 0;
        while gather.push(&[[0, 1, 2]], (id % 2) as u16, id) == 1 {
            id += 1;
        }
        assert_eq!((id as usize, gather.triangles.len()), (room, room));
        assert!(gather.runs.capacity() <= room + 1);
        // The run at hand may go on.
        assert_eq!(gather.push(&[[0, 1, 2]; 3], ((id - 1) % 2) as u16, id), 3);
    }
}
