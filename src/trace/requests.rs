//! What is asked of a pool of rays, and what it answers.

use super::{Hit, Occlusion};
use crate::geom::Ray;
use crate::units::TriangleId;

/// A ray whose first hit is asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosestRequest {
    /// The ray.
    pub ray: Ray,
    /// Only hits that are strictly greater than this by (t, triangle id) count; see
    /// [`Tracer::closest_hits_after`](super::Tracer::closest_hits_after).
    pub after: Option<(f64, TriangleId)>,
    /// Comes back with the answer.
    pub tag: u64,
}

/// A ray of which is asked whether anything lies between its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AnyRequest {
    /// The ray.
    pub ray: Ray,
    /// Comes back with the answer.
    pub tag: u64,
}

/// What a ray does when it reaches a block that is not resident.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OnMissing {
    /// The block is loaded at once and the ray goes on. Right for rays that follow each other through the same blocks:
    /// camera rays in the order of a space-filling curve, and their shadows.
    Load,
    /// The ray waits for the block with others. Right for rays that go anywhere.
    Wait {
        /// What the answer is worth: a block waits for a later turn if the sum over its rays is little beside another's. Rays
        /// whose answer leads to more rays should have more than rays that end a path, best for each ray that may still
        /// follow; at least 1.
        weight: u32,
    },
}

impl OnMissing {
    /// Whether to load, and the weight of a ray that waits all the same.
    pub(super) fn parts(self) -> (bool, u32) {
        match self {
            OnMissing::Load => (true, 1),
            OnMissing::Wait { weight } => (false, weight.max(1)),
        }
    }
}

/// The answers of a call, in no particular order.
#[derive(Clone, Debug, Default)]
pub struct Answers {
    /// Tag and first hit of each closest-hit query that ended.
    pub hits: Vec<(u64, Option<Hit>)>,
    /// Tag and answer of each any-hit query that ended.
    pub occlusions: Vec<(u64, Occlusion)>,
}

impl Answers {
    /// Room for the answers of a call with `request_count` requests, and of a resumption.
    pub fn with_capacity(request_count: usize) -> Answers {
        let count = request_count.max(super::RayPool::RESUMED_MAX);
        Answers { hits: Vec::with_capacity(count), occlusions: Vec::with_capacity(count) }
    }

    /// What [`Answers::with_capacity`] allocates.
    pub fn bytes_needed(request_count: usize) -> usize {
        let count = request_count.max(super::RayPool::RESUMED_MAX);
        count * (size_of::<(u64, Option<Hit>)>() + size_of::<(u64, Occlusion)>())
    }

    /// Forgets all answers.
    pub fn clear(&mut self) {
        self.hits.clear();
        self.occlusions.clear();
    }
}
