//! What a caller can choose when an octree is opened.

use serde::{Deserialize, Serialize};

use crate::cache::Policy;
use crate::free_memory::FollowFreeMemory;
use crate::simd::SimdLevel;

/// How sure a hit is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Tier {
    /// Decided in f32 right in the kernel: no guarantee near edges, at grazing angles or far from the origin, and
    /// results may differ between instruction sets.
    Fast,
    /// Decided in f32 by the test of Woop, Benthin and Wald (2013): no ray passes between two triangles of one block that
    /// share an edge. Between blocks that holds if their vertices and the ray's origin are exact in f32 (models of
    /// `Precision::Float32`). `t`, and so the order of surfaces, and needles are as good as f32 lets them be.
    Watertight,
    /// f32 only rejects, with a proven bound; what is left is decided by Moeller and Trumbore's test in f64 without one
    /// ([`intersect_plain`](crate::geom::intersect_plain)): rays may leak at edges, rarely.
    Double,
    /// f32 only rejects, with a proven bound; what is left is decided in f64 and, where that is not enough, exactly (I2, I3).
    #[default]
    Certified,
    /// Every triangle of every leaf that a ray enters is decided exactly: the hits of `Certified`, bit for bit, without
    /// its f32 rejection and its f64 decisions. Slow; what `Certified` is checked against.
    Exact,
}

impl Tier {
    /// All tiers, from the fastest to the slowest.
    pub const ALL: [Tier; 5] = [Tier::Fast, Tier::Watertight, Tier::Double, Tier::Certified, Tier::Exact];

    /// Its name on command lines and in tables.
    pub fn name(self) -> &'static str {
        match self {
            Tier::Fast => "fast",
            Tier::Watertight => "watertight",
            Tier::Double => "double",
            Tier::Certified => "certified",
            Tier::Exact => "exact",
        }
    }
}

/// How the leaves of a block's fine tree hold triangles in the slot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum LeafLayout {
    /// `Expanded` if at least a quarter of the blocks fit the budget with it, else `Indexed`.
    #[default]
    Auto,
    /// Nine f32 per triangle in rows of eight lanes: fastest, about 245 KiB for a full block of 64 KiB.
    Expanded,
    /// Three u16 per triangle into the block's vertices: about 15 to 25 % slower rays, about 40 % of the memory.
    Indexed,
}

/// How much work goes into the tree inside a block, each time that the block is loaded. Hits do not depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum TreeQuality {
    /// Planes in the middle of the centres: much faster to build, somewhat slower to trace. Best where a loaded block
    /// is entered by few rays: for one small picture, or a cache that is much too small.
    Quick,
    /// Planes by the surface area heuristic, up to three at once.
    #[default]
    Best,
    /// One plane at a time: a block takes a quarter more time to load, and most rays 2 to 5 % less. For models that stay in memory and
    /// get many rays: it pays after some 20,000 rays for each block.
    Finest,
}

/// How an octree is opened. `..Default::default()` gives one tracer with certified hits and the best instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OctreeOptions {
    /// How many tracers may live at once; each needs its own scratch and at least one slot. A render takes one for each of its
    /// threads.
    pub tracers_max: u32,
    /// Layout of leaves.
    pub leaf_layout: LeafLayout,
    /// Instructions to use; `None` for the best that the CPU has.
    pub simd: Option<SimdLevel>,
    /// How sure hits are.
    pub tier: Tier,
    /// How much work goes into trees.
    pub quality: TreeQuality,
    /// Most cache slots to make, to leave memory to others or to measure small caches. `None`: as many as the budget
    /// holds, never more than there are blocks. Used by [`LazyOctree::open`](super::LazyOctree::open) only.
    pub slots_max: Option<u32>,
    /// Which block makes room for a missing one. Used by [`LazyOctree::open`](super::LazyOctree::open) only.
    pub policy: Policy,
    /// Lets the slots in use follow the free memory of the system, up to what the budget holds; see
    /// [`FollowingCache`](crate::cache::FollowingCache). Used by [`LazyOctree::open`](super::LazyOctree::open) only.
    pub follow_free_memory: Option<FollowFreeMemory>,
}

impl Default for OctreeOptions {
    fn default() -> OctreeOptions {
        OctreeOptions {
            tracers_max: 1,
            leaf_layout: LeafLayout::Auto,
            simd: None,
            tier: Tier::Certified,
            quality: TreeQuality::Best,
            slots_max: None,
            policy: Policy::Lru,
            follow_free_memory: None,
        }
    }
}
