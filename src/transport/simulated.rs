//! A network in simulated time: seeded latency, bandwidth, deaths, partitions.
//!
//! Nothing here waits. Time passes only when somebody asks for the next event, so a run of hours takes milliseconds and
//! the same seed gives the same run.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, HashMap, HashSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use parking_lot::Mutex;

use super::{FRAME_BYTES_MAX, PeerId, Transport, TransportEvent};
use crate::error::TransportError;
use crate::procedural::random::Random;

/// How long a frame is on its way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinkModel {
    /// Least latency.
    pub latency_min: Duration,
    /// Greatest latency; each frame draws its own, but does not overtake others of its connection.
    pub latency_max: Duration,
    /// What a node's line carries in one direction.
    pub bytes_per_second: f64,
}

impl Default for LinkModel {
    /// Gigabit Ethernet in one room.
    fn default() -> LinkModel {
        LinkModel {
            latency_min: Duration::from_micros(50),
            latency_max: Duration::from_micros(500),
            bytes_per_second: 117e6,
        }
    }
}

/// A node of the simulated network, by the order in which they were opened.
type Node = usize;

struct Endpoint {
    address: String,
    is_alive: bool,
    inbox: VecDeque<TransportEvent>,
    /// When its line is free to send again.
    line_free: Duration,
}

/// One direction of a connection.
struct Way {
    to: Node,
    /// The number of the connection at its far end.
    theirs: PeerId,
    from: Node,
    last_arrival: Duration,
    /// Frames that a partition holds up.
    held: VecDeque<TransportEvent>,
    /// Bytes of frames that were sent and not received.
    waiting_bytes: usize,
}

/// Most of those, unless it is a single frame.
const WAITING_BYTES_MAX: usize = 16 << 20;

struct World {
    now: Duration,
    random: Random,
    link: LinkModel,
    nodes: Vec<Endpoint>,
    ways: HashMap<PeerId, Way>,
    last_peer: u64,
    /// By time and then in the order of sending.
    flying: BinaryHeap<Reverse<(Duration, u64)>>,
    letters: HashMap<u64, (Node, TransportEvent)>,
    sequence: u64,
    /// Nodes of different groups do not hear each other; absent means group 0.
    groups: BTreeMap<Node, u32>,
    /// Connections open at each end.
    open: HashSet<PeerId>,
}

/// A network in simulated time. Clones share it.
#[derive(Clone)]
pub struct SimNetwork {
    world: Arc<Mutex<World>>,
}

impl SimNetwork {
    /// A network without nodes at time zero.
    pub fn new(seed: u64, link: LinkModel) -> SimNetwork {
        let world = World {
            now: Duration::ZERO,
            random: Random::new(seed),
            link,
            nodes: Vec::new(),
            ways: HashMap::new(),
            last_peer: 0,
            flying: BinaryHeap::new(),
            letters: HashMap::new(),
            sequence: 0,
            groups: BTreeMap::new(),
            open: HashSet::new(),
        };
        SimNetwork { world: Arc::new(Mutex::new(world)) }
    }

    /// A node that others reach under `address`.
    pub fn open(&self, address: &str) -> SimTransport {
        let mut world = self.world.lock();
        let inbox = VecDeque::new();
        let address = address.to_owned();
        world.nodes.push(Endpoint { address, is_alive: true, inbox, line_free: Duration::ZERO });
        SimTransport { network: self.clone(), node: world.nodes.len() - 1 }
    }

    /// Simulated time since the start.
    pub fn now(&self) -> Duration {
        self.world.lock().now
    }

    /// When the next event arrives anywhere.
    pub fn next_arrival(&self) -> Option<Duration> {
        self.world.lock().flying.peek().map(|Reverse((time, _))| *time)
    }

    /// Lets time pass up to `time`, delivering what arrives until then.
    pub fn advance_to(&self, time: Duration) {
        let mut world = self.world.lock();
        while world.deliver_one(time) {}
        world.now = world.now.max(time);
    }

    /// Cuts the network: nodes hear only those of their own group. Frames between groups wait until the partition ends,
    /// as TCP would send them again. Nodes that are not named are in group 0.
    pub fn partition(&self, groups: &[(&SimTransport, u32)]) {
        let mut world = self.world.lock();
        world.groups = groups.iter().map(|(transport, group)| (transport.node, *group)).collect();
        world.release();
    }

    /// Ends every partition.
    pub fn heal(&self) {
        self.partition(&[]);
    }
}

impl World {
    fn hear_each_other(&self, a: Node, b: Node) -> bool {
        let group = |node| self.groups.get(&node).copied().unwrap_or(0);
        group(a) == group(b)
    }

    /// Sends `event`, in which the peer is the far end's number, along the way of `mine`.
    fn post(&mut self, mine: PeerId, event: TransportEvent) {
        let Some(way) = self.ways.get(&mine) else { return };
        let (from, to) = (way.from, way.to);
        if !self.hear_each_other(from, to) || !way.held.is_empty() {
            if let Some(way) = self.ways.get_mut(&mine) {
                way.held.push_back(event);
            }
            return;
        }
        let bytes = if let TransportEvent::Frame { bytes, .. } = &event { bytes.len() } else { 0 };
        let LinkModel { latency_min, latency_max, bytes_per_second } = self.link;
        let latency = latency_min + latency_max.saturating_sub(latency_min).mul_f64(self.random.unit());
        let sent = self.nodes[from].line_free.max(self.now)
            + Duration::from_secs_f64((bytes as f64 / bytes_per_second).min(1e9));
        self.nodes[from].line_free = sent;
        let sequence = self.sequence;
        self.sequence += 1;
        if let Some(way) = self.ways.get_mut(&mine) {
            way.last_arrival = way.last_arrival.max(sent + latency);
            self.flying.push(Reverse((way.last_arrival, sequence)));
        }
        self.letters.insert(sequence, (to, event));
    }

    /// Sends what partitions held up and do not hold up any more.
    fn release(&mut self) {
        let mut peers: Vec<PeerId> =
            self.ways.iter().filter(|(_, way)| !way.held.is_empty()).map(|(peer, _)| *peer).collect();
        // The order of a hash map must not show.
        peers.sort_unstable();
        for peer in peers {
            let Some(way) = self.ways.get_mut(&peer) else { continue };
            let (from, to) = (way.from, way.to);
            let held = std::mem::take(&mut way.held);
            if self.hear_each_other(from, to) {
                held.into_iter().for_each(|event| self.post(peer, event));
            } else if let Some(way) = self.ways.get_mut(&peer) {
                way.held = held;
            }
        }
    }

    /// Delivers the next event if it arrives by `time`.
    fn deliver_one(&mut self, time: Duration) -> bool {
        let Some(Reverse((arrival, sequence))) = self.flying.peek().copied() else { return false };
        if arrival > time {
            return false;
        }
        self.flying.pop();
        self.now = self.now.max(arrival);
        let Some((to, event)) = self.letters.remove(&sequence) else { return true };
        if !self.nodes[to].is_alive {
            return true;
        }
        match &event {
            TransportEvent::Connected { peer, .. } => {
                self.open.insert(*peer);
            }
            TransportEvent::Frame { peer, .. } if !self.open.contains(peer) => return true,
            // It ended from this side before.
            TransportEvent::Disconnected { peer, .. } if !self.open.remove(peer) => return true,
            _ => {}
        }
        self.nodes[to].inbox.push_back(event);
        true
    }

    /// The next event that has arrived at `node`.
    fn take(&mut self, node: Node) -> Option<TransportEvent> {
        let event = self.nodes[node].inbox.pop_front()?;
        if let TransportEvent::Frame { peer, bytes } = &event
            && let Some(mine) = self.ways.get(peer).map(|way| way.theirs)
            && let Some(way) = self.ways.get_mut(&mine)
        {
            way.waiting_bytes -= bytes.len();
        }
        Some(event)
    }

    fn hang_up(&mut self, mine: PeerId, reason: &str) {
        self.open.remove(&mine);
        if let Some(theirs) = self.ways.get(&mine).map(|way| way.theirs) {
            self.post(mine, TransportEvent::Disconnected { peer: theirs, reason: reason.to_owned() });
        }
    }
}

/// A node of a [`SimNetwork`]. [`Transport::close`] is its death: the others learn of it unless a partition hides it.
pub struct SimTransport {
    network: SimNetwork,
    node: Node,
}

impl SimTransport {
    /// The next event that has arrived; time does not pass.
    pub fn take_arrived(&self) -> Option<TransportEvent> {
        self.network.world.lock().take(self.node)
    }

    /// Whether an event has arrived.
    pub fn has_arrived(&self) -> bool {
        !self.network.world.lock().nodes[self.node].inbox.is_empty()
    }
}

impl Transport for SimTransport {
    fn address(&self) -> Option<String> {
        Some(self.network.world.lock().nodes[self.node].address.clone())
    }

    /// Connects at once if the node lives and no partition lies between; the other side learns of it later.
    fn connect(&self, address: &str) -> Result<PeerId, TransportError> {
        let mut world = self.network.world.lock();
        if !world.nodes[self.node].is_alive {
            return Err(TransportError::Closed);
        }
        let there = world.nodes.iter().rposition(|node| node.is_alive && node.address == address);
        let there = there.filter(|there| world.hear_each_other(self.node, *there));
        let there = there.ok_or_else(|| TransportError::Connect {
            address: address.to_owned(),
            reason: "nobody answers there".to_owned(),
        })?;
        let (mine, theirs) = (PeerId(world.last_peer + 1), PeerId(world.last_peer + 2));
        world.last_peer += 2;
        let now = world.now;
        let way = |from, to, theirs| {
            let held = VecDeque::new();
            Way { to, theirs, from, last_arrival: now, held, waiting_bytes: 0 }
        };
        world.ways.insert(mine, way(self.node, there, theirs));
        world.ways.insert(theirs, way(there, self.node, mine));
        world.open.insert(mine);
        let name = world.nodes[self.node].address.clone();
        world.post(mine, TransportEvent::Connected { peer: theirs, name });
        Ok(mine)
    }

    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        let mut world = self.network.world.lock();
        if !world.nodes[self.node].is_alive {
            return Err(TransportError::Closed);
        }
        if frame.len() > FRAME_BYTES_MAX {
            return Err(TransportError::FrameTooLong { bytes: frame.len(), limit: FRAME_BYTES_MAX });
        }
        let is_open = world.open.contains(&to);
        let way = world.ways.get_mut(&to).filter(|way| way.from == self.node && is_open);
        let way = way.ok_or(TransportError::NotConnected { peer: to.0 })?;
        if way.waiting_bytes > 0 && way.waiting_bytes + frame.len() > WAITING_BYTES_MAX {
            return Err(TransportError::QueueFull { peer: to.0 });
        }
        way.waiting_bytes += frame.len();
        let peer = way.theirs;
        world.post(to, TransportEvent::Frame { peer, bytes: frame });
        Ok(())
    }

    /// Lets time pass until something arrives here, or until `wait` is over.
    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        let mut world = self.network.world.lock();
        let deadline = world.now.saturating_add(wait);
        loop {
            if !world.nodes[self.node].is_alive {
                return Err(TransportError::Closed);
            }
            if let Some(event) = world.take(self.node) {
                return Ok(Some(event));
            }
            if !world.deliver_one(deadline) {
                world.now = deadline;
                return Ok(None);
            }
        }
    }

    fn disconnect(&self, peer: PeerId) {
        let mut world = self.network.world.lock();
        if world.ways.get(&peer).is_some_and(|way| way.from == self.node) && world.open.contains(&peer) {
            world.hang_up(peer, "the peer ended the connection");
            world.nodes[self.node].inbox.retain(|event| match event {
                TransportEvent::Connected { peer: other, .. }
                | TransportEvent::Frame { peer: other, .. }
                | TransportEvent::Disconnected { peer: other, .. } => *other != peer,
                TransportEvent::Refused { .. } => true,
            });
        }
    }

    fn frame_bytes_max(&self) -> usize {
        FRAME_BYTES_MAX
    }

    fn close(&self) {
        let mut world = self.network.world.lock();
        if !world.nodes[self.node].is_alive {
            return;
        }
        let mut peers: Vec<PeerId> = world
            .ways
            .iter()
            .filter(|(peer, way)| way.from == self.node && world.open.contains(peer))
            .map(|(peer, _)| *peer)
            .collect();
        peers.sort_unstable();
        peers.into_iter().for_each(|peer| world.hang_up(peer, "the peer closed"));
        world.nodes[self.node].is_alive = false;
        world.nodes[self.node].inbox.clear();
    }
}

impl Drop for SimTransport {
    fn drop(&mut self) {
        self.close();
    }
}

impl std::fmt::Debug for SimNetwork {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimNetwork").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for SimTransport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SimTransport").finish_non_exhaustive()
    }
}
