//! Nodes in one process: frames move from mailbox to mailbox without being copied.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;

use super::mailbox::Mailbox;
use super::{FRAME_BYTES_MAX, PeerId, Transport, TransportEvent};
use crate::error::TransportError;

/// A network of nodes in one process. Clones share it.
#[derive(Clone, Default)]
pub struct LocalNetwork {
    shared: Arc<Mutex<Nodes>>,
}

#[derive(Default)]
struct Nodes {
    by_address: HashMap<String, Arc<Mailbox>>,
    /// The other end of each connection.
    other_ends: HashMap<PeerId, (Arc<Mailbox>, PeerId)>,
    last_peer: u64,
}

impl LocalNetwork {
    /// A network without nodes.
    pub fn new() -> LocalNetwork {
        LocalNetwork::default()
    }

    /// A node that others reach under `address`. An earlier node of that address is not reached any more.
    pub fn open(&self, address: &str) -> LocalTransport {
        let mailbox = Arc::new(Mailbox::default());
        self.shared.lock().by_address.insert(address.to_owned(), Arc::clone(&mailbox));
        LocalTransport { network: self.clone(), address: address.to_owned(), mailbox }
    }
}

/// A node of a [`LocalNetwork`]. Dropping it closes it.
pub struct LocalTransport {
    network: LocalNetwork,
    address: String,
    mailbox: Arc<Mailbox>,
}

impl Transport for LocalTransport {
    fn address(&self) -> Option<String> {
        Some(self.address.clone())
    }

    fn connect(&self, address: &str) -> Result<PeerId, TransportError> {
        if self.mailbox.is_closed() {
            return Err(TransportError::Closed);
        }
        let mut nodes = self.network.shared.lock();
        let there = nodes.by_address.get(address).filter(|node| !node.is_closed()).cloned();
        let there = there.ok_or_else(|| TransportError::Connect {
            address: address.to_owned(),
            reason: "there is no such node in this process".to_owned(),
        })?;
        let (mine, theirs) = (PeerId(nodes.last_peer + 1), PeerId(nodes.last_peer + 2));
        nodes.last_peer += 2;
        nodes.other_ends.insert(mine, (Arc::clone(&there), theirs));
        nodes.other_ends.insert(theirs, (Arc::clone(&self.mailbox), mine));
        self.mailbox.open(mine, None);
        there.open(theirs, Some(self.address.clone()));
        Ok(mine)
    }

    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        if self.mailbox.is_closed() {
            return Err(TransportError::Closed);
        }
        if frame.len() > FRAME_BYTES_MAX {
            return Err(TransportError::FrameTooLong { bytes: frame.len(), limit: FRAME_BYTES_MAX });
        }
        if !self.mailbox.is_open(to) {
            return Err(TransportError::NotConnected { peer: to.0 });
        }
        let other = self.network.shared.lock().other_ends.get(&to).cloned();
        let (mailbox, theirs) = other.ok_or(TransportError::NotConnected { peer: to.0 })?;
        mailbox.try_put_frame(theirs, frame).map_err(|(_, error)| match error {
            TransportError::QueueFull { .. } => TransportError::QueueFull { peer: to.0 },
            _ => TransportError::NotConnected { peer: to.0 },
        })
    }

    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        self.mailbox.take(wait)
    }

    fn disconnect(&self, peer: PeerId) {
        if self.mailbox.forget(peer) {
            self.hang_up(peer, "the peer ended the connection");
        }
    }

    fn frame_bytes_max(&self) -> usize {
        FRAME_BYTES_MAX
    }

    fn close(&self) {
        for peer in self.mailbox.close() {
            self.hang_up(peer, "the peer closed");
        }
        let mut nodes = self.network.shared.lock();
        if nodes.by_address.get(&self.address).is_some_and(|node| Arc::ptr_eq(node, &self.mailbox)) {
            nodes.by_address.remove(&self.address);
        }
    }
}

impl LocalTransport {
    fn hang_up(&self, peer: PeerId, reason: &str) {
        let mut nodes = self.network.shared.lock();
        if let Some((mailbox, theirs)) = nodes.other_ends.remove(&peer) {
            nodes.other_ends.remove(&theirs);
            mailbox.end(theirs, reason.to_owned());
        }
    }
}

impl Drop for LocalTransport {
    fn drop(&mut self) {
        self.close();
    }
}

impl std::fmt::Debug for LocalNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LocalNetwork").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for LocalTransport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LocalTransport").finish_non_exhaustive()
    }
}
