//! Exact counters, kept per thread and summed at the end.

use serde::{Deserialize, Serialize};

/// What a run of queries did. All counts are exact; they depend on cache size and load order only where
/// the field says so, but for queries of a [`RayPool`](crate::trace::RayPool): how much they look at depends on what is resident behind a
/// block that they wait for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TraceCounters {
    /// Rays asked, closest hit and any hit together.
    pub rays: u64,
    /// Nodes visited (one 8-wide box test each), coarse and fine levels together.
    pub box_tests: u64,
    /// Triangles given to the f32 reject test (each lane of a packet that holds a triangle).
    pub triangle_tests: u64,
    /// Triangles that the reject test let through to the f64 decision.
    pub decisions: u64,
    /// Decisions that f64 left open and exact arithmetic settled.
    pub exact_fallbacks: u64,
    /// Entries of a ray into a block's fine octree.
    pub block_visits: u64,
    /// Blocks read, decoded and built by this thread (depends on cache size and thread count).
    pub blocks_loaded: u64,
    /// Stored bytes that were read: of those blocks, and of what a loader read ahead and others brought meanwhile (depends on cache size
    /// and thread count).
    pub bytes_read: u64,
    /// Triangles decoded with them (depends on cache size and thread count).
    pub triangles_decoded: u64,
    /// Most rays that waited for blocks at one time in one pool (depends on cache size and load order).
    pub suspended_peak: u64,
}

impl TraceCounters {
    /// Adds `other` to every field; of peaks, takes the greater.
    pub fn merge(&mut self, other: &TraceCounters) {
        let TraceCounters {
            rays,
            box_tests,
            triangle_tests,
            decisions,
            exact_fallbacks,
            block_visits,
            blocks_loaded,
            bytes_read,
            triangles_decoded,
            suspended_peak,
        } = other;
        self.rays += rays;
        self.box_tests += box_tests;
        self.triangle_tests += triangle_tests;
        self.decisions += decisions;
        self.exact_fallbacks += exact_fallbacks;
        self.block_visits += block_visits;
        self.blocks_loaded += blocks_loaded;
        self.bytes_read += bytes_read;
        self.triangles_decoded += triangles_decoded;
        self.suspended_peak = self.suspended_peak.max(*suspended_peak);
    }
}
