//! The nodes of this process and their connections: what the threads that use them share with the one that calls MPI.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

use super::super::PeerId;
use super::super::mailbox::{Mailbox, WAITING_BYTES_MAX, room};
use super::letter::Letter;

/// Frames of a connection that may wait here for the peer to take what was sent before, in bytes; one frame always may.
const QUEUE_BYTES_MAX: usize = 16 << 20;

/// The peer is told what was taken when it is so much. Much less than what may be on the way at one time.
const TAKEN_BYTES: usize = WAITING_BYTES_MAX / 16;

/// How far a connection is.
#[derive(Debug, PartialEq, Eq)]
pub enum Phase {
    /// The other node has not answered.
    Connecting,
    /// It does not want it.
    Refused(String),
    Open,
    /// This side has ended it, and what was sent before is still to go out.
    Ending,
}

/// One end of a connection.
pub struct Way {
    pub node: u64,
    pub rank: i32,
    pub phase: Phase,
    /// The connection's number at its other end.
    theirs: u64,
    queue: VecDeque<Vec<u8>>,
    queue_bytes: usize,
    /// Bytes on their way, or received by the peer's process and not taken by its node.
    unacknowledged: usize,
    /// Bytes that the node here took since the peer was told.
    taken: usize,
}

/// As the mailbox at the other end counts, which must have room for what is sent.
fn weight(frame: &[u8]) -> usize {
    room(frame.len())
}

#[derive(Default)]
pub struct Nodes {
    pub mailboxes: HashMap<u64, Arc<Mailbox>>,
    by_name: HashMap<String, u64>,
    pub ways: HashMap<u64, Way>,
    last_number: u64,
    /// Letters that wait for nothing.
    letters: VecDeque<(i32, Letter)>,
    /// Ways that may have something to send.
    busy: VecDeque<u64>,
    /// The thread that calls MPI has something to do.
    pub is_called: bool,
    /// Barriers that were asked for, and that are through.
    pub barriers: [u64; 2],
    pub abort: Option<i32>,
    pub is_ending: bool,
}

impl Nodes {
    fn number(&mut self) -> u64 {
        self.last_number += 1;
        self.last_number
    }

    pub fn open_node(&mut self, name: &str) -> (u64, Arc<Mailbox>) {
        let (number, mailbox) = (self.number(), Arc::new(Mailbox::default()));
        self.by_name.insert(name.to_owned(), number);
        self.mailboxes.insert(number, Arc::clone(&mailbox));
        (number, mailbox)
    }

    pub fn close_node(&mut self, name: &str, node: u64) {
        let Some(mailbox) = self.mailboxes.remove(&node) else { return };
        self.by_name.retain(|other, number| other != name || *number != node);
        for peer in mailbox.close() {
            self.end(peer.0);
        }
        self.is_called = true;
    }

    /// The node's way of this number.
    pub fn way_of(&mut self, node: u64, number: u64) -> Option<&mut Way> {
        self.ways.get_mut(&number).filter(|way| way.node == node)
    }

    fn add_way(&mut self, node: u64, rank: i32, theirs: u64, phase: Phase) -> u64 {
        let number = self.number();
        let queue = VecDeque::new();
        let way = Way { node, rank, phase, theirs, queue, queue_bytes: 0, unacknowledged: 0, taken: 0 };
        self.ways.insert(number, way);
        number
    }

    /// Asks for a connection.
    pub fn connect(&mut self, node: u64, rank: i32, there: &str, name: &str) -> u64 {
        let number = self.add_way(node, rank, 0, Phase::Connecting);
        let letter = Letter::Connect { from: number, node: there.to_owned(), name: name.to_owned() };
        self.letters.push_back((rank, letter));
        self.is_called = true;
        number
    }

    /// Takes a frame for sending; gives it back if there is no room.
    pub fn send(&mut self, number: u64, frame: Vec<u8>) -> Result<(), Vec<u8>> {
        let Some(way) = self.ways.get_mut(&number) else { return Ok(()) };
        if !way.queue.is_empty() && way.queue_bytes + frame.len() > QUEUE_BYTES_MAX {
            return Err(frame);
        }
        way.queue_bytes += weight(&frame);
        way.queue.push_back(frame);
        self.busy.push_back(number);
        self.is_called = true;
        Ok(())
    }

    /// The node took a frame of so many bytes.
    pub fn took(&mut self, number: u64, bytes: usize) {
        let Some(way) = self.ways.get_mut(&number) else { return };
        way.taken += room(bytes);
        if way.taken >= TAKEN_BYTES {
            self.busy.push_back(number);
            self.is_called = true;
        }
    }

    /// Ends a connection from this side, after what was sent.
    pub fn end(&mut self, number: u64) {
        if let Some(way) = self.ways.get_mut(&number) {
            way.phase = Phase::Ending;
            self.drop_received(number);
        }
    }

    /// Whatever has come over a way that is ending counts as taken: else a peer that ends it too would keep what it has sent, waiting
    /// for room here, as long as this side does the same.
    fn drop_received(&mut self, number: u64) {
        if let Some(way) = self.ways.get_mut(&number) {
            // More than this is never on its way.
            way.taken = WAITING_BYTES_MAX;
            self.busy.push_back(number);
            self.is_called = true;
        }
    }

    /// What there is to send now.
    pub fn outgoing(&mut self, mut send: impl FnMut(i32, Vec<u8>)) {
        for (rank, letter) in self.letters.drain(..) {
            send(rank, letter.into_bytes());
        }
        while let Some(number) = self.busy.pop_front() {
            let Some(way) = self.ways.get_mut(&number) else { continue };
            if way.taken >= TAKEN_BYTES {
                let letter = Letter::Taken { to: way.theirs, bytes: way.taken as u64 };
                way.taken = 0;
                send(way.rank, letter.into_bytes());
            }
            while let Some(bytes) = way.queue.front().map(|frame| weight(frame))
                && (way.unacknowledged == 0 || way.unacknowledged + bytes <= WAITING_BYTES_MAX)
                && let Some(frame) = way.queue.pop_front()
            {
                way.queue_bytes -= bytes;
                way.unacknowledged += bytes;
                send(way.rank, Letter::Frame { to: way.theirs, bytes: frame }.into_bytes());
            }
            if way.phase == Phase::Ending && way.queue.is_empty() {
                let reason = "the peer ended the connection".to_owned();
                send(way.rank, Letter::End { to: way.theirs, reason }.into_bytes());
                self.ways.remove(&number);
            }
        }
    }

    /// Whether frames wait to be sent.
    pub fn has_queued(&self) -> bool {
        self.ways.values().any(|way| !way.queue.is_empty())
    }

    /// A letter from `rank` has come. Letters that make no sense are late ones of connections that have ended.
    pub fn deliver(&mut self, rank: i32, letter: Letter) {
        let to = match &letter {
            Letter::Connect { from, node, name } => return self.welcome(rank, *from, node, name),
            Letter::Accept { to, .. }
            | Letter::Refuse { to, .. }
            | Letter::Frame { to, .. }
            | Letter::Taken { to, .. }
            | Letter::End { to, .. } => *to,
        };
        let peer = PeerId(to);
        let way = self.ways.get_mut(&to).filter(|way| way.rank == rank);
        let mailbox = way.as_ref().and_then(|way| self.mailboxes.get(&way.node));
        match (letter, way) {
            (Letter::Accept { from, .. }, Some(way)) if way.phase == Phase::Connecting => {
                way.theirs = from;
                way.phase = Phase::Open;
                match mailbox {
                    Some(mailbox) => mailbox.open(peer, None),
                    None => self.end(to),
                }
            }
            (Letter::Accept { from, .. }, None) => {
                let reason = "the peer has given up waiting".to_owned();
                self.letters.push_back((rank, Letter::End { to: from, reason }));
            }
            (Letter::Refuse { reason, .. }, Some(way)) if way.phase == Phase::Connecting => {
                way.phase = Phase::Refused(reason);
            }
            (Letter::Frame { bytes, .. }, Some(way)) if way.phase == Phase::Open => {
                // There is room, since the peer waits for it. A node that has just left needs no frames.
                if let Some(mailbox) = mailbox
                    && mailbox.try_put_frame(peer, bytes).is_err()
                    && mailbox.is_open(peer)
                {
                    mailbox.end(peer, "the peer sent more than it may".to_owned());
                    self.end(to);
                }
            }
            (Letter::Frame { .. }, Some(way)) if way.phase == Phase::Ending => self.drop_received(to),
            (Letter::Taken { bytes, .. }, Some(way)) => {
                way.unacknowledged =
                    way.unacknowledged.saturating_sub(usize::try_from(bytes).unwrap_or(usize::MAX));
                self.busy.push_back(to);
            }
            (Letter::End { reason, .. }, Some(_)) => {
                let mailbox = mailbox.cloned();
                self.ways.remove(&to);
                if let Some(mailbox) = mailbox {
                    mailbox.end(peer, reason);
                }
            }
            _ => {}
        }
    }

    /// A node of another process, or of this one, wants to connect.
    fn welcome(&mut self, rank: i32, theirs: u64, node: &str, name: &str) {
        let number = self.by_name.get(node).copied();
        let mailbox = number.and_then(|number| self.mailboxes.get(&number)).cloned();
        let (Some(node), Some(mailbox)) = (number, mailbox) else {
            let reason = format!("there is no node `{node}` at that rank, or not yet");
            self.letters.push_back((rank, Letter::Refuse { to: theirs, reason }));
            return;
        };
        let number = self.add_way(node, rank, theirs, Phase::Open);
        mailbox.open(PeerId(number), Some(format!("{name}, rank {rank}")));
        self.letters.push_back((rank, Letter::Accept { to: theirs, from: number }));
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::transport::TransportEvent;

    /// Two processes of a job, rank 0 and rank 1.
    struct Job([Nodes; 2]);

    impl Job {
        /// Brings letters until none is left; how many there were.
        fn settle(&mut self) -> usize {
            let mut count = 0;
            loop {
                let mut letters = Vec::new();
                for (from, nodes) in (0..).zip(&mut self.0) {
                    nodes.outgoing(|to, bytes| letters.push((from, to, bytes)));
                }
                if letters.is_empty() {
                    return count;
                }
                count += letters.len();
                for (from, to, bytes) in letters {
                    self.0[to as usize].deliver(from, Letter::parse(bytes).unwrap());
                }
            }
        }
    }

    #[test]
    fn what_is_sent_to_one_who_ends_as_well_is_not_kept() {
        let mut job = Job([Nodes::default(), Nodes::default()]);
        let [(node, _), (_, mailbox)] = job.0.each_mut().map(|nodes| nodes.open_node("node"));
        let number = job.0[0].connect(node, 1, "node", "node");
        job.settle();
        let event = mailbox.take(Duration::ZERO).unwrap();
        let Some(TransportEvent::Connected { peer, .. }) = event else { panic!("{event:?}") };
        // More than may be on its way, in both directions, and nobody takes any.
        let numbers = [number, peer.0];
        for (nodes, number) in job.0.iter_mut().zip(numbers) {
            for _ in 0..8 {
                nodes.send(number, vec![0; WAITING_BYTES_MAX / 4]).unwrap();
            }
        }
        job.settle();
        assert!(job.0.iter().all(Nodes::has_queued));
        for (nodes, number) in job.0.iter_mut().zip(numbers) {
            let node = nodes.ways[&number].node;
            let mailbox = Arc::clone(&nodes.mailboxes[&node]);
            assert!(mailbox.forget(PeerId(number)));
            nodes.end(number);
        }
        job.settle();
        assert!(job.0.iter().all(|nodes| nodes.ways.is_empty() && !nodes.has_queued()));
    }
}
