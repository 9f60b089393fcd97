//! How a node keeps connected to its coordinator.

use std::time::{Duration, Instant};

use super::RoleOptions;
use super::drive::NodeError;
use crate::error::TransportError;
use crate::transport::{PeerId, Transport};

/// How often a node tries to reach a coordinator that is gone, not yet there, or ends the connection each time.
const RETRY: Duration = Duration::from_millis(500);
/// The first of these waits, of which each is twice the one before: nodes of one job start together, and a small picture is soon over.
const RETRY_FIRST: Duration = Duration::from_millis(20);
/// So long, and a heartbeat longer, a coordinator may take to say something after it was reached, also if the node has no more patience.
const ANSWER: Duration = Duration::from_secs(2);

/// Keeps a node connected to its coordinator.
pub(super) struct Reconnect<'a> {
    transport: &'a dyn Transport,
    address: &'a str,
    patience: Duration,
    answer_time_max: Duration,
    /// Since when there is no connection in which the coordinator has said anything.
    lost: Option<Instant>,
    /// Whether a connection was tried since then.
    was_tried: bool,
    last_try: Option<Instant>,
    /// What came of it.
    reason: String,
    /// How long after the last try the next one is made.
    wait: Duration,
}

impl<'a> Reconnect<'a> {
    pub fn new(
        transport: &'a dyn Transport,
        address: &'a str,
        patience: Duration,
        roles: RoleOptions,
    ) -> Reconnect<'a> {
        Reconnect {
            transport,
            address,
            patience,
            answer_time_max: ANSWER + roles.heartbeat,
            lost: None,
            was_tried: false,
            last_try: None,
            reason: String::new(),
            wait: RETRY_FIRST,
        }
    }

    /// Where the coordinator is.
    pub fn address(&self) -> &'a str {
        self.address
    }

    /// To be called again and again: whether the coordinator is connected, and whether it has said anything since. A new connection if
    /// there was none and one could be made.
    ///
    /// # Errors
    /// [`NodeError::NoCoordinator`] when there has been none that said anything for as long as the node is patient.
    pub fn keep(&mut self, is_connected: bool, is_welcome: bool) -> Result<Option<PeerId>, NodeError> {
        let lasts = self.last_try.map(|last| last.elapsed());
        if is_welcome {
            self.lost = None;
            self.was_tried = false;
            // One that ends at once each time is not tried faster and faster.
            if lasts.is_some_and(|lasts| lasts >= RETRY) {
                self.wait = RETRY_FIRST;
            }
            return Ok(None);
        }
        let lost = *self.lost.get_or_insert_with(Instant::now);
        let has_patience = lost.elapsed() < self.patience || !self.was_tried;
        let may_answer = is_connected && lasts.is_some_and(|lasts| lasts < self.answer_time_max);
        if !has_patience && !may_answer {
            return Err(self.gives_up());
        }
        if is_connected || lasts.is_some_and(|lasts| lasts < self.wait) {
            return Ok(None);
        }
        if lasts.is_some() {
            self.wait = (2 * self.wait).min(RETRY);
        }
        let result = self.transport.connect(self.address);
        self.last_try = Some(Instant::now());
        self.was_tried = true;
        match result {
            Ok(peer) => {
                self.reason = "it ends connections, or says nothing".to_owned();
                Ok(Some(peer))
            }
            Err(TransportError::Closed) => Err(TransportError::Closed.into()),
            Err(error) => {
                self.reason = error.to_string();
                if lost.elapsed() >= self.patience { Err(self.gives_up()) } else { Ok(None) }
            }
        }
    }

    fn gives_up(&self) -> NodeError {
        NodeError::NoCoordinator {
            address: self.address.to_owned(),
            waited: self.patience,
            reason: self.reason.clone(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transport::LocalNetwork;

    #[test]
    fn a_connection_that_was_lost_is_tried_once_also_without_patience() {
        let network = LocalNetwork::new();
        let (_hub, node) = (network.open("coordinator"), network.open("node"));
        let mut reconnect = Reconnect::new(&node, "coordinator", Duration::ZERO, RoleOptions::default());
        assert!(reconnect.keep(false, false).unwrap().is_some());
        assert_eq!(reconnect.keep(true, true).unwrap(), None);
        std::thread::sleep(RETRY_FIRST);
        assert!(reconnect.keep(false, false).unwrap().is_some());
        // Nobody said anything in it.
        let refused = reconnect.keep(false, false);
        assert!(matches!(refused, Err(NodeError::NoCoordinator { .. })), "{refused:?}");
    }
}
