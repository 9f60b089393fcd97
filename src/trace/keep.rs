//! What a traversal in the order of distance keeps of the hits that it finds: the least one, or the least few.

use std::ops::ControlFlow;

use super::Hit;
use super::all::Receiver;
use crate::octree::QueryRay;
use crate::units::TriangleId;

/// Keeps hits, in whatever order they are found.
pub(super) trait Keep {
    /// Whether a hit there is to be kept.
    fn wants(&self, at: (f64, TriangleId)) -> bool;

    /// Where hits that it wants end, if they do before the ray.
    fn end(&self) -> Option<f64>;

    /// Keeps a hit that it wants. Gives the new end if there is one.
    fn keep(&mut self, hit: Hit) -> Option<f64>;

    /// Called before a block is entered. No hit still to come has a parameter whose [`QueryRay::local_high`] is below
    /// what `least_near` gives. Gives whether to go on.
    fn pass(&mut self, least_near: impl FnOnce() -> f32, query: &QueryRay) -> bool;
}

/// The least hit.
impl Keep for Option<Hit> {
    #[inline(always)]
    fn wants(&self, at: (f64, TriangleId)) -> bool {
        match self {
            Some(best) => at < (best.t, best.triangle),
            None => true,
        }
    }

    #[inline(always)]
    fn end(&self) -> Option<f64> {
        self.as_ref().map(|hit| hit.t)
    }

    #[inline(always)]
    fn keep(&mut self, hit: Hit) -> Option<f64> {
        *self = Some(hit);
        Some(hit.t)
    }

    #[inline(always)]
    fn pass(&mut self, _: impl FnOnce() -> f32, _: &QueryRay) -> bool {
        true
    }
}

/// How many hits wait at most.
pub(super) const WAITING_MAX: usize = 32;

/// The least hits of one ray that were not given away yet.
pub(super) struct WaitingHits {
    /// (t, triangle, place in `hits`) of those that wait, the least last.
    order: [(f64, TriangleId, u8); WAITING_MAX],
    len: usize,
    hits: [Hit; WAITING_MAX],
    /// The least hit for which there was no room: those before it are all found.
    bound: Option<(f64, TriangleId)>,
    /// The greatest hit that was given away: none that waits is before it.
    given: Option<(f64, TriangleId)>,
}

impl WaitingHits {
    pub fn new() -> WaitingHits {
        let unset = (0.0, TriangleId(0), 0);
        let mut waiting =
            WaitingHits { order: [unset; _], len: 0, hits: [Hit::UNSET; _], bound: None, given: None };
        waiting.clear();
        waiting
    }

    /// Forgets everything.
    pub fn clear(&mut self) {
        for (place, entry) in self.order.iter_mut().enumerate() {
            entry.2 = place as u8;
        }
        (self.len, self.bound, self.given) = (0, None, None);
    }

    /// After all were given away: the hit after which another traversal has to look for more, if one is needed.
    pub fn next_after(&mut self) -> Option<(f64, TriangleId)> {
        // There was no room, so at least one was given.
        self.bound.take().and(self.given)
    }

    /// Gives away, in order, the hits whose parameter is final.
    fn give(&mut self, is_final: impl Fn(f64) -> bool, receiver: &mut dyn Receiver) -> ControlFlow<()> {
        while self.len > 0 && is_final(self.order[self.len - 1].0) {
            self.len -= 1;
            let (t, triangle, place) = self.order[self.len];
            self.given = Some((t, triangle));
            receiver.hit(&self.hits[usize::from(place)])?;
        }
        ControlFlow::Continue(())
    }
}

/// [`WaitingHits`] that are given to a receiver as soon as they are final.
pub(super) struct Streamed<'a> {
    pub waiting: &'a mut WaitingHits,
    pub receiver: &'a mut dyn Receiver,
    /// The receiver wants no more.
    pub is_over: bool,
}

impl Streamed<'_> {
    /// Gives away a hit that comes after greater ones were given, which only tiers do whose `t` may be off by more than the boxes
    /// of blocks are. Were it to wait, it would be given as the last, and a traversal that goes on from there would find the
    /// greater ones again.
    #[cold]
    fn give_late(&mut self, hit: &Hit) {
        self.is_over = self.receiver.hit(hit).is_break();
    }

    /// Gives away all that waits, at the end of a traversal.
    pub fn finish(&mut self) {
        self.is_over = self.is_over || self.waiting.give(|_| true, self.receiver).is_break();
    }
}

impl Keep for Streamed<'_> {
    #[inline(always)]
    fn wants(&self, at: (f64, TriangleId)) -> bool {
        // Within a block, hits go on coming after a late one was the last that is wanted.
        !self.is_over && self.waiting.bound.is_none_or(|bound| at < bound)
    }

    #[inline(always)]
    fn end(&self) -> Option<f64> {
        self.waiting.bound.map(|(t, _)| t)
    }

    #[inline(always)]
    fn keep(&mut self, hit: Hit) -> Option<f64> {
        let WaitingHits { order, len, hits, bound, given } = &mut *self.waiting;
        let at = (hit.t, hit.triangle);
        if given.is_some_and(|given| at < given) {
            self.give_late(&hit);
            return None;
        }
        let mut end = None;
        if *len == WAITING_MAX {
            // The greatest, which is the first, makes room, unless it is the new one; from here on hits end there.
            let (t, triangle, _) = order[0];
            if at > (t, triangle) {
                *bound = Some(at);
                return Some(hit.t);
            }
            *bound = Some((t, triangle));
            end = Some(t);
            order.rotate_left(1);
            *len -= 1;
        }
        let place = order[*len].2;
        hits[usize::from(place)] = hit;
        let mut index = *len;
        while index > 0 && (order[index - 1].0, order[index - 1].1) < at {
            order[index] = order[index - 1];
            index -= 1;
        }
        order[index] = (hit.t, hit.triangle, place);
        *len += 1;
        end
    }

    #[inline(always)]
    fn pass(&mut self, least_near: impl FnOnce() -> f32, query: &QueryRay) -> bool {
        if self.waiting.len > 0 && !self.is_over {
            let near = least_near();
            self.is_over = self.waiting.give(|t| query.local_high(t) < near, self.receiver).is_break();
        }
        !self.is_over
    }
}
