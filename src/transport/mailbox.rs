//! Events on their way to the one who receives them, bounded for each peer.

use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::{PeerId, TransportEvent};
use crate::error::TransportError;

/// Frames of one peer that may wait, in bytes; one frame always may.
pub(super) const WAITING_BYTES_MAX: usize = 4 << 20;

/// Room that a frame of so many bytes takes while it waits: one of no bytes takes some too.
pub(super) fn room(frame_bytes: usize) -> usize {
    frame_bytes.max(64)
}

#[derive(Default)]
struct State {
    events: VecDeque<TransportEvent>,
    /// Bytes of waiting frames by peer; a peer without an entry is not connected, and nothing of it is taken.
    waiting: HashMap<PeerId, usize>,
    closed: bool,
}

/// A queue of events that several threads fill.
#[derive(Default)]
pub(super) struct Mailbox {
    state: Mutex<State>,
    arrived: Condvar,
    taken: Condvar,
}

impl Mailbox {
    /// Lets events of `peer` in; `name` if the owner is to be told.
    pub fn open(&self, peer: PeerId, name: Option<String>) {
        let mut state = self.state.lock();
        state.waiting.insert(peer, 0);
        if let Some(name) = name {
            state.events.push_back(TransportEvent::Connected { peer, name });
            self.arrived.notify_one();
        }
    }

    /// Adds a frame; waits while too much of the same peer waits. False if nothing of the peer is taken any more.
    #[cfg(feature = "tcp")]
    pub fn put_frame(&self, peer: PeerId, bytes: Vec<u8>) -> bool {
        let mut state = self.state.lock();
        loop {
            match state.waiting.get_mut(&peer) {
                None => return false,
                Some(waiting) if *waiting == 0 || *waiting + room(bytes.len()) <= WAITING_BYTES_MAX => {
                    *waiting += room(bytes.len());
                    break;
                }
                Some(_) => self.taken.wait(&mut state),
            }
        }
        state.events.push_back(TransportEvent::Frame { peer, bytes });
        self.arrived.notify_one();
        true
    }

    /// As [`Mailbox::put_frame`], but instead of waiting gives the frame back.
    pub fn try_put_frame(&self, peer: PeerId, bytes: Vec<u8>) -> Result<(), (Vec<u8>, TransportError)> {
        let mut state = self.state.lock();
        match state.waiting.get_mut(&peer) {
            None => return Err((bytes, TransportError::NotConnected { peer: peer.0 })),
            Some(waiting) if *waiting == 0 || *waiting + room(bytes.len()) <= WAITING_BYTES_MAX => {
                *waiting += room(bytes.len());
            }
            Some(_) => return Err((bytes, TransportError::QueueFull { peer: peer.0 })),
        }
        state.events.push_back(TransportEvent::Frame { peer, bytes });
        self.arrived.notify_one();
        Ok(())
    }

    /// Takes nothing more of `peer`, and tells the owner why, if he still thinks it connected.
    pub fn end(&self, peer: PeerId, reason: String) {
        let mut state = self.state.lock();
        if state.waiting.remove(&peer).is_some() {
            state.events.push_back(TransportEvent::Disconnected { peer, reason });
            self.arrived.notify_one();
            self.taken.notify_all();
        }
    }

    /// Takes nothing more of `peer` and drops what waits, silently. False if it was not connected.
    pub fn forget(&self, peer: PeerId) -> bool {
        let mut state = self.state.lock();
        let was_open = state.waiting.remove(&peer).is_some();
        state.events.retain(|event| match event {
            TransportEvent::Connected { peer: other, .. }
            | TransportEvent::Frame { peer: other, .. }
            | TransportEvent::Disconnected { peer: other, .. } => *other != peer,
            TransportEvent::Refused { .. } => true,
        });
        self.taken.notify_all();
        was_open
    }

    /// Notes a refusal, unless so many wait that nobody can be reading them.
    #[cfg(feature = "tcp")]
    pub fn refuse(&self, from: String, reason: String) {
        const REFUSALS_MAX: usize = 256;
        let mut state = self.state.lock();
        let is_refusal = |event: &&TransportEvent| matches!(event, TransportEvent::Refused { .. });
        if state.events.iter().filter(is_refusal).count() < REFUSALS_MAX {
            state.events.push_back(TransportEvent::Refused { from, reason });
            self.arrived.notify_one();
        }
    }

    /// The next event; see [`super::Transport::receive`].
    pub fn take(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        let deadline = Instant::now().checked_add(wait);
        let mut state = self.state.lock();
        loop {
            if state.closed {
                return Err(TransportError::Closed);
            }
            if let Some(event) = state.events.pop_front() {
                if let TransportEvent::Frame { peer, bytes } = &event
                    && let Some(waiting) = state.waiting.get_mut(peer)
                {
                    *waiting -= room(bytes.len());
                    self.taken.notify_all();
                }
                return Ok(Some(event));
            }
            match deadline {
                Some(deadline) => {
                    if self.arrived.wait_until(&mut state, deadline).timed_out() && state.events.is_empty() {
                        return if state.closed { Err(TransportError::Closed) } else { Ok(None) };
                    }
                }
                None => self.arrived.wait(&mut state),
            }
        }
    }

    /// Whether events of `peer` are taken.
    pub fn is_open(&self, peer: PeerId) -> bool {
        self.state.lock().waiting.contains_key(&peer)
    }

    pub fn is_closed(&self) -> bool {
        self.state.lock().closed
    }

    /// Drops everything and ends every wait. Gives the peers that were connected.
    pub fn close(&self) -> Vec<PeerId> {
        let mut state = self.state.lock();
        state.closed = true;
        state.events.clear();
        let peers = state.waiting.drain().map(|(peer, _)| peer).collect();
        self.arrived.notify_all();
        self.taken.notify_all();
        peers
    }
}

#[cfg(all(test, feature = "tcp"))]
mod tests {
    use super::*;

    #[test]
    fn small_frames_take_the_room_that_they_take() {
        let (mailbox, peer) = (Mailbox::default(), PeerId(1));
        mailbox.open(peer, None);
        let mut count = 0;
        while count < WAITING_BYTES_MAX && mailbox.try_put_frame(peer, Vec::new()).is_ok() {
            count += 1;
        }
        // Each is an event in the queue, however few bytes it has.
        assert!(count * size_of::<TransportEvent>() <= 2 * WAITING_BYTES_MAX, "{count} frames");
        for _ in 0..count {
            mailbox.take(Duration::ZERO).unwrap();
        }
        assert!(mailbox.try_put_frame(peer, vec![0; WAITING_BYTES_MAX]).is_ok());
    }
}
