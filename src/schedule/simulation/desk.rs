//! What coordinators of both levels and their simulations have in common: events in the order of time, and a machine that serves
//! one message after the other.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use super::machine::ClusterModel;
use super::worker::nanos;

/// Events by time, then in the order in which they were made.
pub(super) struct Events<E> {
    heap: BinaryHeap<Reverse<(u64, u64, Ordered<E>)>>,
    sequence: u64,
}

impl<E> Events<E> {
    pub fn new() -> Events<E> {
        Events { heap: BinaryHeap::new(), sequence: 0 }
    }

    pub fn at(&mut self, time: u64, event: E) {
        self.heap.push(Reverse((time, self.sequence, Ordered(Box::new(event)))));
        self.sequence += 1;
    }

    /// The next one, and when.
    pub fn pop(&mut self) -> Option<(u64, E)> {
        self.heap.pop().map(|Reverse((time, _, event))| (time, *event.0))
    }
}

/// An event is ordered by what stands before it only.
struct Ordered<E>(Box<E>);

impl<E> PartialEq for Ordered<E> {
    fn eq(&self, _: &Ordered<E>) -> bool {
        true
    }
}

impl<E> Eq for Ordered<E> {}

impl<E> PartialOrd for Ordered<E> {
    fn partial_cmp(&self, other: &Ordered<E>) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<E> Ord for Ordered<E> {
    fn cmp(&self, _: &Ordered<E>) -> std::cmp::Ordering {
        std::cmp::Ordering::Equal
    }
}

pub(super) const IN: usize = 0;
pub(super) const OUT: usize = 1;

/// A coordinator's processor and connection.
pub(super) struct Desk<M> {
    /// What has arrived and waits.
    pub inbox: VecDeque<M>,
    /// Whether it was settled when the next message is taken up.
    pub is_planned: bool,
    /// When it has done what it has begun.
    pub free: u64,
    /// How long it was busy in all.
    pub busy: u64,
    /// What its connection carries in each direction.
    bytes_per_second: f64,
    /// When its connection is free, in and out.
    connection_free: [u64; 2],
    pub messages: u64,
    pub bytes: u64,
}

impl<M> Desk<M> {
    pub fn new(bytes_per_second: f64) -> Desk<M> {
        Desk {
            inbox: VecDeque::new(),
            is_planned: false,
            free: 0,
            busy: 0,
            bytes_per_second,
            connection_free: [0; 2],
            messages: 0,
            bytes: 0,
        }
    }

    /// When it is through with so many messages that say so many things.
    pub fn work(&mut self, now: u64, model: &ClusterModel, messages: usize, things: usize) -> u64 {
        let time =
            nanos(model.message_seconds) * messages as u64 + nanos(model.decision_seconds) * things as u64;
        self.busy += time;
        self.free = self.free.max(now) + time;
        self.free
    }

    /// When the connection has carried a message that is there at `from`.
    pub fn carry(&mut self, direction: usize, from: u64, bytes: f64) -> u64 {
        self.messages += 1;
        self.bytes += bytes as u64;
        let start = self.connection_free[direction].max(from);
        self.connection_free[direction] = start + nanos(bytes / self.bytes_per_second);
        self.connection_free[direction]
    }
}
