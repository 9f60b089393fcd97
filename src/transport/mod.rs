//! Frames between nodes: in one process, over TCP, over MPI, or simulated. What is in a frame is the caller's affair.
//!
//! A node opens one [`Transport`]; others [`connect`](Transport::connect) to its address. Everything that happens to it
//! comes out of [`receive`](Transport::receive), one event at a time, so that a role can be a plain loop, and the same loop
//! runs over threads ([`LocalNetwork`]), machines (`TcpTransport`, feature `tcp`; `MpiTransport`, feature `mpi`)
//! and in simulated time ([`SimNetwork`]).

#[cfg(feature = "tcp")]
mod key;
mod local;
mod mailbox;
#[cfg(feature = "mpi")]
mod mpi;
mod simulated;
#[cfg(feature = "tcp")]
mod tcp;

use std::time::Duration;

use crate::error::TransportError;

#[cfg(feature = "tcp")]
pub use key::SharedKey;
pub use local::{LocalNetwork, LocalTransport};
#[cfg(feature = "mpi")]
pub use mpi::{MpiJob, MpiTransport};
pub use simulated::{LinkModel, SimNetwork, SimTransport};
#[cfg(feature = "tcp")]
pub use tcp::{PROTOCOL_VERSION, TcpOptions, TcpTransport};

/// A connection of one transport; counted up, never used again after the connection ended. The two ends of a connection
/// each have their own number for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PeerId(pub u64);

/// What happens to a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TransportEvent {
    /// A peer connected and, where the transport has keys, proved that it holds the key. Not sent for connections that this
    /// node made itself.
    Connected {
        /// Its connection.
        peer: PeerId,
        /// What it calls itself and where it is. For logs: authenticated only as "holds the key".
        name: String,
    },
    /// A peer sent a frame.
    Frame {
        /// Who.
        peer: PeerId,
        /// The frame as it was sent.
        bytes: Vec<u8>,
    },
    /// A connection ended, after all frames that arrived before were given out. Also sent for connections that this node
    /// made itself, but not for those that it ended by [`Transport::disconnect`].
    Disconnected {
        /// Which.
        peer: PeerId,
        /// Why.
        reason: String,
    },
    /// Somebody tried to connect and was turned away. For logs.
    Refused {
        /// Where from.
        from: String,
        /// Why.
        reason: String,
    },
}

/// One node's place in a network. Shared by threads.
///
/// Guaranteed: a frame arrives whole and unchanged, once or not at all; frames of one connection arrive in the order in which they
/// were sent; if one is lost, so are all after it, and [`TransportEvent::Disconnected`] says so. Not guaranteed: any order
/// between connections; that a frame that was sent arrives; that a silent peer is noticed (roles send heartbeats).
///
/// Memory is bounded for each peer, whatever it sends: a peer that sends faster than frames are received is made to wait.
pub trait Transport: Send + Sync {
    /// Where others connect to; `None` if this transport only connects itself.
    fn address(&self) -> Option<String>;

    /// Connects to the node at `address` and waits until it answered, up to a limit of the transport's own.
    ///
    /// # Errors
    /// [`TransportError::Connect`] if nobody answers there, [`TransportError::Refused`] if the node there does not accept this one
    /// (another key, another version), [`TransportError::Closed`].
    fn connect(&self, address: &str) -> Result<PeerId, TransportError>;

    /// Hands a frame over for sending. Never waits for the peer.
    ///
    /// # Errors
    /// [`TransportError::FrameTooLong`]; [`TransportError::NotConnected`] if the connection has ended;
    /// [`TransportError::QueueFull`] if the peer has not taken what was sent before: the frame is not sent, and the caller decides
    /// whether to wait or to disconnect; [`TransportError::Closed`].
    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError>;

    /// The next event, waiting for at most `wait`; `None` if there was none.
    ///
    /// # Errors
    /// [`TransportError::Closed`] after [`Transport::close`].
    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError>;

    /// Ends a connection at once; frames of it that were not received yet are dropped, those sent before are still delivered
    /// if the peer takes them. Does nothing if it has ended already.
    fn disconnect(&self, peer: PeerId);

    /// The longest frame.
    fn frame_bytes_max(&self) -> usize;

    /// Ends all connections and refuses new ones; further calls fail.
    fn close(&self);
}

/// The longest frame unless chosen otherwise: a stored block of the largest size fits, and a tile of 256 x 256 pixels.
pub const FRAME_BYTES_MAX: usize = 1 << 20;
