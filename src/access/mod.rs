//! Recorded block accesses: which blocks each query of a run entered, and what that says about memory.
//!
//! An [`AccessRecorder`] writes down the queries of an octree's tracers
//! ([`LazyOctree::record_accesses`](crate::LazyOctree::record_accesses)). An [`AccessTrace`] reads that back and, without
//! any geometry, runs it through any replacement policy and number of slots ([`replay`]), through the best that any
//! policy could do ([`optimum_loads`]), or through LRU with all numbers of slots at once ([`MissRatioCurve`]): "how much
//! memory would this view need".

mod bytes;
mod curve;
mod optimum;
mod recorder;
mod replay;
mod sketch;
mod trace;

pub use curve::{MemoryNeed, MissRatioCurve};
pub use optimum::optimum_loads;
pub use recorder::{AccessLog, AccessRecorder};
pub use replay::{ReplayCounts, replay, replay_with};
pub use sketch::BlockSketch;
pub use trace::{AccessQuery, AccessTrace};

/// What kind of query entered the blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QueryKind {
    /// The closest hit, or the closest after a known one.
    Closest,
    /// Whether anything is in the way.
    Occlusion,
}

/// How much a trace holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AccessTotals {
    /// Queries, those that entered no block included.
    pub queries: u64,
    /// Entries of a query into a block.
    pub accesses: u64,
}
