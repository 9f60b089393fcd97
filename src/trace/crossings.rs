//! Crossings: all hits of a ray without the doubles at shared edges and vertices, entries and exits in turn.

use std::ops::ControlFlow;

use super::all::Receiver;
use super::{Hit, Tracer};
use crate::error::TraceError;
use crate::geom::{Ray, RayFrame, Sense};

/// Where a ray goes through a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// The hit. At an edge or a vertex: on the one triangle that counts, whose material is the crossing's.
    pub hit: Hit,
    /// Against the triangle's normal, or along it.
    pub sense: Sense,
}

impl Tracer<'_> {
    /// Gives every crossing of each ray to `visit`, with the ray's index: the rays in their order, the crossings of each by
    /// `t`, up to the rounding of `t`. Otherwise as [`Tracer::all_hits`].
    ///
    /// A hit is a crossing if its triangle is crossed by the ray's line moved by an infinitesimal amount
    /// ([`RayFrame::crossing`]): a surface is crossed once where the ray meets an edge or a vertex of it, whatever the
    /// materials on both sides of the edge. Nothing is compared with a tolerance. A coincident second surface is a second
    /// crossing.
    ///
    /// # Guarantee
    /// For a line through closed, consistently oriented surfaces, whose hits all lie between the ray's ends, and a certified
    /// octree: entries and exits are equal in number. If no point is inside more than one of the surfaces and their normals point
    /// outward, they alternate, the first is an entry and the last an exit. For that, crossings closer together than `t` is known,
    /// a factor of `1 + 2^-38`, are put in an order in which they do, so that `t` may step back by that much; up to 32 of them at a
    /// time.
    ///
    /// A ray that touches an edge or a vertex from outside and does not go in crosses nothing, or enters and leaves at the
    /// same point up to rounding, as the moved line does. In the same way it may leave and enter where it touches one from
    /// inside. So lengths of paths inside come out right either way.
    ///
    /// A ray with an end inside sees the crossings between its ends. The ones that it meets first, if they are closer together
    /// than `t` is known, are put in order as if it began outside.
    ///
    /// # Errors
    /// As for [`Tracer::all_hits`], crossings in place of hits.
    pub fn crossings(
        &mut self,
        rays: &[Ray],
        visit: impl FnMut(usize, &Crossing) -> ControlFlow<()>,
    ) -> Result<(), TraceError> {
        let frame = RayFrame::new(&Ray::new([0.0; 3], [0.0; 3]));
        self.receive_hits(rays, |pending| Crossings { pending, frame, last: None, index: 0, visit })
    }
}

/// How many crossings are put in order together.
const PENDING_MAX: usize = 32;

/// Parameters further apart than this factor are in the order of the real ones: each is within a factor `1 +- 2^-40` of its own.
const APART: f64 = 1.0 + 1.0 / (1u64 << 38) as f64;

/// Crossings whose order is not certain yet.
pub(super) struct PendingCrossings {
    crossings: [Crossing; PENDING_MAX],
    len: usize,
}

impl PendingCrossings {
    pub fn new() -> PendingCrossings {
        let unset = Crossing { hit: Hit::UNSET, sense: Sense::Entry };
        PendingCrossings { crossings: [unset; _], len: 0 }
    }

    /// In which sense the first of them goes, if `last` was before.
    fn first_sense(&self, last: Option<Sense>) -> Sense {
        if let Some(last) = last {
            return last.opposite();
        }
        let entries = self.crossings[..self.len].iter().filter(|c| c.sense == Sense::Entry).count();
        // As many of each: they end where they began, and that is outside.
        if 2 * entries >= self.len { Sense::Entry } else { Sense::Exit }
    }

    /// Takes out the first that goes in this sense, or else the first. There is one at least.
    fn take(&mut self, sense: Sense) -> Crossing {
        let waiting = &mut self.crossings[..self.len];
        let index = waiting.iter().position(|crossing| crossing.sense == sense).unwrap_or(0);
        let crossing = waiting[index];
        waiting.copy_within(index + 1.., index);
        self.len -= 1;
        crossing
    }
}

/// Makes crossings of the hits of one ray after the other.
struct Crossings<'a, F> {
    pending: &'a mut PendingCrossings,
    /// The ray.
    frame: RayFrame,
    /// The sense of the crossing that was given away last.
    last: Option<Sense>,
    index: usize,
    visit: F,
}

impl<F: FnMut(usize, &Crossing) -> ControlFlow<()>> Crossings<'_, F> {
    /// Gives away what is pending.
    fn give(&mut self) -> ControlFlow<()> {
        let mut sense = self.pending.first_sense(self.last);
        while self.pending.len > 0 {
            let crossing = self.pending.take(sense);
            (self.last, sense) = (Some(crossing.sense), crossing.sense.opposite());
            (self.visit)(self.index, &crossing)?;
        }
        ControlFlow::Continue(())
    }
}

impl<F: FnMut(usize, &Crossing) -> ControlFlow<()>> Receiver for Crossings<'_, F> {
    fn begin(&mut self, index: usize, ray: &Ray) {
        (self.index, self.frame, self.last) = (index, RayFrame::new(ray), None);
        self.pending.len = 0;
    }

    fn hit(&mut self, hit: &Hit) -> ControlFlow<()> {
        let Some(sense) = self.frame.crossing(&hit.vertices) else { return ControlFlow::Continue(()) };
        if let Some(before) = self.pending.len.checked_sub(1) {
            // Tiny parameters are rounded as such.
            let apart = hit.t > self.pending.crossings[before].hit.t * APART + f64::MIN_POSITIVE;
            if apart || self.pending.len == PENDING_MAX {
                self.give()?;
            }
        }
        self.pending.crossings[self.pending.len] = Crossing { hit: *hit, sense };
        self.pending.len += 1;
        ControlFlow::Continue(())
    }

    fn end(&mut self) {
        if self.pending.len > 0 {
            // The ray is over whatever the answer.
            let _ = self.give();
        }
    }
}
