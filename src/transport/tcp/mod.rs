//! Nodes on several machines: TCP, encrypted and authenticated with a [`SharedKey`] by the Noise protocol
//! (`Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s`, revision 34; Perrin 2018).
//!
//! `docs/cluster.md` has every byte. Two threads for each connection and one that accepts; all end with
//! [`Transport::close`].

mod connection;
mod handshake;
mod record;

use std::collections::HashMap;
use std::io;
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, ToSocketAddrs};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use parking_lot::Mutex;

use super::mailbox::Mailbox;
use super::{FRAME_BYTES_MAX, PeerId, SharedKey, Transport, TransportEvent};
use crate::error::TransportError;
use connection::Connection;
use handshake::Session;

pub use handshake::PROTOCOL_VERSION;
pub(super) use handshake::random_bytes;

/// What a caller can choose about a [`TcpTransport`].
#[derive(Clone, Debug)]
pub struct TcpOptions {
    /// What this node calls itself to others, for their logs; at most 64 bytes are used.
    pub name: String,
    /// Where to listen, as `127.0.0.1:7000`; port 0 lets the system choose one. `None`: only connect to others.
    pub listen: Option<String>,
    /// The longest frame, sent or received. The same for all nodes.
    pub frame_bytes_max: usize,
    /// Frames to one peer that may wait to be sent, in bytes.
    pub queue_bytes_max: usize,
    /// Most connections at one time.
    pub connections_max: usize,
    /// Most peers that may be in the middle of their handshake; more are turned away.
    pub handshakes_max: usize,
    /// How long a connection may take to be made, and a handshake from its first byte to its last.
    pub handshake_time_max: Duration,
    /// How long a frame may take from its first byte to its last, and all that is queued for a peer when its connection is to end.
    pub frame_time_max: Duration,
}

impl TcpOptions {
    /// A node that listens at a port of the loopback interface that the system chooses.
    pub fn loopback(name: &str) -> TcpOptions {
        TcpOptions { listen: Some("127.0.0.1:0".to_owned()), ..TcpOptions::connecting(name) }
    }

    /// A node that only connects to others.
    pub fn connecting(name: &str) -> TcpOptions {
        TcpOptions {
            name: name.to_owned(),
            listen: None,
            frame_bytes_max: FRAME_BYTES_MAX,
            queue_bytes_max: 16 << 20,
            connections_max: 1024,
            handshakes_max: 32,
            handshake_time_max: Duration::from_secs(5),
            frame_time_max: Duration::from_secs(20),
        }
    }
}

struct Shared {
    options: TcpOptions,
    key: SharedKey,
    mailbox: Mailbox,
    connections: Mutex<HashMap<PeerId, Arc<Connection>>>,
    /// Sockets in the middle of a handshake, so that closing ends them.
    shaking: Mutex<HashMap<u64, TcpStream>>,
    last_number: AtomicU64,
    stop: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

/// A node on a TCP network. Dropping it closes it.
pub struct TcpTransport {
    shared: Arc<Shared>,
    address: Option<SocketAddr>,
}

/// How often the thread that accepts looks whether it is to end.
const ACCEPT_INTERVAL: Duration = Duration::from_millis(20);

impl TcpTransport {
    /// Opens a node.
    ///
    /// # Errors
    /// [`TransportError::Listen`] if the address cannot be listened at, or the system gives no thread for that.
    pub fn open(key: SharedKey, options: TcpOptions) -> Result<TcpTransport, TransportError> {
        let listener = match &options.listen {
            None => None,
            Some(address) => {
                let failed = |error: io::Error| TransportError::Listen {
                    address: address.clone(),
                    reason: error.to_string(),
                };
                let listener = TcpListener::bind(address).map_err(failed)?;
                listener.set_nonblocking(true).map_err(failed)?;
                let local = listener.local_addr().map_err(failed)?;
                Some((listener, local))
            }
        };
        let shared = Arc::new(Shared {
            options,
            key,
            mailbox: Mailbox::default(),
            connections: Mutex::new(HashMap::new()),
            shaking: Mutex::new(HashMap::new()),
            last_number: AtomicU64::new(0),
            stop: AtomicBool::new(false),
            threads: Mutex::new(Vec::new()),
        });
        let mut address = None;
        if let Some((listener, local)) = listener {
            address = Some(local);
            let accepting = Arc::clone(&shared);
            shared.spawn(move || accepting.accept(&listener)).map_err(|error| TransportError::Listen {
                address: local.to_string(),
                reason: no_thread(&error),
            })?;
        }
        Ok(TcpTransport { shared, address })
    }
}

impl Shared {
    fn spawn(&self, run: impl FnOnce() + Send + 'static) -> io::Result<()> {
        let mut threads = self.threads.lock();
        threads.retain(|thread| !thread.is_finished());
        threads.push(thread::Builder::new().spawn(run)?);
        Ok(())
    }

    fn number(&self) -> u64 {
        self.last_number.fetch_add(1, Ordering::Relaxed) + 1
    }

    fn accept(self: &Arc<Shared>, listener: &TcpListener) {
        while !self.stop.load(Ordering::Relaxed) {
            let (stream, from) = match listener.accept() {
                Ok(accepted) => accepted,
                // Nobody there, or one who went away again, or no descriptors left: look again later.
                Err(_) => {
                    thread::sleep(ACCEPT_INTERVAL);
                    continue;
                }
            };
            let from = from.to_string();
            let shaking = self.shaking.lock().len();
            if shaking >= self.options.handshakes_max {
                self.mailbox.refuse(from, format!("{shaking} others are in the middle of their handshake"));
                continue;
            }
            if self.connections.lock().len() >= self.options.connections_max {
                self.mailbox.refuse(from, "there are as many connections as may be".to_owned());
                continue;
            }
            // On some systems an accepted socket inherits this from the listener.
            let Ok(registered) = stream.set_nonblocking(false).and_then(|()| stream.try_clone()) else {
                continue;
            };
            let number = self.number();
            self.shaking.lock().insert(number, registered);
            let (shared, stranger) = (Arc::clone(self), from.clone());
            let spawned = self.spawn(move || {
                let deadline = Instant::now() + shared.options.handshake_time_max;
                let session = handshake::accept(&stream, &shared.key, &shared.options.name, deadline);
                // Until here the number stands in `shaking`, so that the count of strangers stays bounded.
                shared.shaking.lock().remove(&number);
                match session {
                    Ok((session, name)) => {
                        let (peer, name) = (PeerId(number), format!("{name} at {from}"));
                        // If it fails, whoever receives here is told that it has ended.
                        let _ = shared.connected(peer, stream, session, Some(name));
                    }
                    Err(reason) => shared.mailbox.refuse(from, reason),
                }
            });
            if let Err(error) = spawned {
                // There may be one for the next that comes.
                self.shaking.lock().remove(&number);
                self.mailbox.refuse(stranger, no_thread(&error));
            }
        }
    }

    /// Starts the threads of a connection. If there are none for it, it ends.
    fn connected(
        self: &Arc<Shared>,
        peer: PeerId,
        stream: TcpStream,
        session: Session,
        name: Option<String>,
    ) -> io::Result<()> {
        let session = Arc::new(session);
        let TcpOptions { queue_bytes_max, frame_time_max, .. } = self.options;
        let connection = Arc::new(Connection::new(stream, queue_bytes_max, frame_time_max));
        {
            // Under the lock, so that a node which is being closed does not miss it.
            let mut connections = self.connections.lock();
            if self.stop.load(Ordering::Relaxed) {
                connection.end();
                return Ok(());
            }
            connections.insert(peer, Arc::clone(&connection));
        }
        let is_asked_for = name.is_none();
        self.mailbox.open(peer, name);
        let (writing, writer_session) = (Arc::clone(&connection), Arc::clone(&session));
        let (shared, reading) = (Arc::clone(self), Arc::clone(&connection));
        let spawned = self.spawn(move || writing.write(&writer_session)).and_then(|()| {
            self.spawn(move || {
                let options = &shared.options;
                let reason =
                    reading.read(&session, options.frame_bytes_max, options.frame_time_max, |frame| {
                        shared.mailbox.put_frame(peer, frame)
                    });
                reading.unread();
                shared.connections.lock().remove(&peer);
                shared.mailbox.end(peer, reason);
            })
        });
        if let Err(error) = &spawned {
            self.connections.lock().remove(&peer);
            connection.end();
            if is_asked_for {
                self.mailbox.forget(peer);
            } else {
                self.mailbox.end(peer, no_thread(error));
            }
        }
        spawned
    }
}

fn no_thread(error: &io::Error) -> String {
    format!("this node gets no thread for it: {error}")
}

impl Transport for TcpTransport {
    fn address(&self) -> Option<String> {
        self.address.map(|address| address.to_string())
    }

    fn connect(&self, address: &str) -> Result<PeerId, TransportError> {
        let shared = &self.shared;
        if shared.stop.load(Ordering::Relaxed) {
            return Err(TransportError::Closed);
        }
        let failed = |error: String| TransportError::Connect { address: address.to_owned(), reason: error };
        let deadline = Instant::now() + shared.options.handshake_time_max;
        let mut last = "the name has no address".to_owned();
        for candidate in address.to_socket_addrs().map_err(|error| failed(error.to_string()))? {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                last = "nobody answered in time".to_owned();
                break;
            }
            let stream = match TcpStream::connect_timeout(&candidate, left) {
                Ok(stream) => stream,
                Err(error) => {
                    last = error.to_string();
                    continue;
                }
            };
            let number = shared.number();
            let registered = stream.try_clone().map_err(|error| failed(error.to_string()))?;
            shared.shaking.lock().insert(number, registered);
            let session = handshake::connect(&stream, &shared.key, &shared.options.name, deadline);
            shared.shaking.lock().remove(&number);
            let session =
                session.map_err(|reason| TransportError::Refused { address: address.to_owned(), reason })?;
            shared
                .connected(PeerId(number), stream, session, None)
                .map_err(|error| failed(no_thread(&error)))?;
            return Ok(PeerId(number));
        }
        Err(failed(last))
    }

    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        let limit = self.shared.options.frame_bytes_max;
        if self.shared.stop.load(Ordering::Relaxed) {
            return Err(TransportError::Closed);
        }
        if frame.len() > limit {
            return Err(TransportError::FrameTooLong { bytes: frame.len(), limit });
        }
        let connection = self.shared.connections.lock().get(&to).cloned();
        connection.ok_or(TransportError::NotConnected { peer: to.0 })?.push(to, frame)
    }

    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        self.shared.mailbox.take(wait)
    }

    fn disconnect(&self, peer: PeerId) {
        self.shared.mailbox.forget(peer);
        let connection = self.shared.connections.lock().remove(&peer);
        if let Some(connection) = connection {
            connection.finish();
        }
    }

    fn frame_bytes_max(&self) -> usize {
        self.shared.options.frame_bytes_max
    }

    fn close(&self) {
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.mailbox.close();
        let connections: Vec<_> = self.shared.connections.lock().drain().collect();
        connections.iter().for_each(|(_, connection)| connection.finish());
        for stream in self.shared.shaking.lock().values() {
            // Fails only if the peer has hung up already.
            let _ = stream.shutdown(Shutdown::Both);
        }
        // A thread that is ended here may be one that is just starting another: look until there is none.
        loop {
            let threads = std::mem::take(&mut *self.shared.threads.lock());
            if threads.is_empty() {
                break;
            }
            for thread in threads {
                // A thread that panicked has nothing left to end.
                let _ = thread.join();
            }
        }
    }
}

impl Drop for TcpTransport {
    fn drop(&mut self) {
        self.close();
    }
}

impl std::fmt::Debug for TcpTransport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TcpTransport").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;
    use crate::without_threads::without_threads;

    #[test]
    fn a_node_that_gets_no_thread_says_so() {
        without_threads("transport::tcp::tests::a_node_that_gets_no_thread_says_so", || {
            let key = SharedKey::from_hex(&"07".repeat(32)).unwrap();
            let node = TcpTransport::open(key, TcpOptions::loopback("node"));
            assert!(matches!(node, Err(TransportError::Listen { .. })), "{node:?}");
        });
    }

    #[test]
    fn a_peer_that_takes_little_at_a_time_does_not_hold_up_the_end() {
        let key = || SharedKey::from_hex(&"07".repeat(32)).unwrap();
        let options = TcpOptions { frame_time_max: Duration::from_secs(1), ..TcpOptions::loopback("node") };
        let node = TcpTransport::open(key(), options).unwrap();
        let mut stream = TcpStream::connect(node.address().unwrap()).unwrap();
        let deadline = Instant::now() + Duration::from_secs(5);
        handshake::connect(&stream, &key(), "slow", deadline).unwrap();
        let event = node.receive(Duration::from_secs(5)).unwrap();
        let Some(TransportEvent::Connected { peer, .. }) = event else { panic!("{event:?}") };
        for _ in 0..15 {
            node.send(peer, vec![0; FRAME_BYTES_MAX]).unwrap();
        }
        let reader = thread::spawn(move || {
            let mut bytes = vec![0; 64 << 10];
            // It ends with the connection, whichever way that does.
            while stream.read(&mut bytes).is_ok_and(|count| count > 0) {
                thread::sleep(Duration::from_millis(100));
            }
        });
        let start = Instant::now();
        node.close();
        let took = start.elapsed();
        assert!(took < Duration::from_secs(10), "{took:?}");
        drop(reader);
    }
}
