//! All hits in order: a traversal in the order of distance gathers hits and gives each away once no block still to come can
//! hold one before it.
//!
//! Hits that wait lie in a buffer of fixed size. If more wait at a time than it holds, the traversal goes on with the least
//! of them, as in a k-nearest query, and another one starts behind the last (J. Amstutz, C. Gribble, J. Günther and I. Wald,
//! "An Evaluation of Multi-Hit Ray Traversal in a BVH using Existing First-Hit/Any-Hit Kernels", JCGT 4(4), 2015, compare the
//! two ways). With hits given away on the way that is rare: a block is entered once, however many hits the ray has, and a
//! ray that ends early enters no block behind its end.

use std::ops::ControlFlow;

use super::closest::{Prepared, Work, closest_hit};
use super::exact::RayError;
use super::keep::{Streamed, WaitingHits};
use super::policy::Policy;
use super::unvisited::UnvisitedClosest;
use super::{Hit, Tracer};
use crate::access::QueryKind;
use crate::error::TraceError;
use crate::geom::Ray;
use crate::simd::Simd;

/// Takes the hits of one ray after the other.
pub(super) trait Receiver {
    /// The hits of this ray follow.
    fn begin(&mut self, index: usize, ray: &Ray);

    /// The ray's next hit. After `Break` there are no more calls for this ray.
    fn hit(&mut self, hit: &Hit) -> ControlFlow<()>;

    /// The ray has no more hits.
    fn end(&mut self);
}

/// Gives all hits of `ray` to the receiver, in the order of (t, triangle id).
#[inline(always)]
pub(super) fn all_hits<S: Simd, P: Policy>(
    simd: S,
    work: &mut Work<'_, '_>,
    Prepared { group, lane, query, local }: Prepared<'_>,
    ray: &Ray,
    waiting: &mut WaitingHits,
    receiver: &mut dyn Receiver,
) -> Result<(), RayError> {
    waiting.clear();
    let (mut after, mut unvisited) = (None, UnvisitedClosest::UNSET);
    loop {
        work.pins.begin_query(QueryKind::Closest);
        let mut kept = Streamed { waiting: &mut *waiting, receiver: &mut *receiver, is_over: false };
        let prepared = Prepared { group, lane, query: &mut *query, local: &mut *local };
        // The pins of a tracer load: nothing is missing on the way.
        closest_hit::<S, P, _>(simd, work, prepared, ray, after, &mut unvisited, false, &mut kept)?;
        kept.finish();
        if kept.is_over {
            return Ok(());
        }
        after = waiting.next_after();
        if after.is_none() {
            receiver.end();
            return Ok(());
        }
    }
}

impl Tracer<'_> {
    /// Gives every hit of each ray to `visit`, with the ray's index: the rays in their order, the hits of each by
    /// (t, triangle id). These are the hits that repeated [`Tracer::closest_hits_after`] would find, in one traversal,
    /// which enters a block once; more often only where more than 32 hits lie in blocks that overlap. Tiers below the
    /// certified one keep the order up to their error in `t`. Where triangles share an edge or a vertex, all of them are
    /// hit; see [`Tracer::crossings`].
    ///
    /// `visit` may end a ray with `Break`; the next ray follows, and no block is entered that only what lies behind would
    /// need. Memory does not depend on the number of hits.
    ///
    /// # Errors
    /// As for [`Tracer::closest_hits`]. Hits that were given before the error stand, and are the ray's first ones.
    pub fn all_hits(
        &mut self,
        rays: &[Ray],
        visit: impl FnMut(usize, &Hit) -> ControlFlow<()>,
    ) -> Result<(), TraceError> {
        self.receive_hits(rays, |_| Visit { index: 0, visit })
    }
}

/// Hands everything on.
struct Visit<F> {
    index: usize,
    visit: F,
}

impl<F: FnMut(usize, &Hit) -> ControlFlow<()>> Receiver for Visit<F> {
    fn begin(&mut self, index: usize, _: &Ray) {
        self.index = index;
    }

    fn hit(&mut self, hit: &Hit) -> ControlFlow<()> {
        (self.visit)(self.index, hit)
    }

    fn end(&mut self) {}
}
