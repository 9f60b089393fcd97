//! The asking side of readers by itself, over a simulated network: whose share goes where, what ends a wait, and peers that say
//! what they like.

use std::sync::Arc;
use std::time::Duration;

use outcrop::cluster::{
    Action, BlockClient, Message, Need, OwnFile, Reader, ReaderCounters, RemoteOptions, RoleOptions,
    readers_of,
};
use outcrop::transport::{LinkModel, PeerId, SimNetwork, SimTransport, Transport, TransportEvent};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use super::numbers::Random;
use super::support::model;

const LATENCY: Duration = Duration::from_millis(1);

fn network() -> SimNetwork {
    let link = LinkModel { latency_min: LATENCY, latency_max: LATENCY, bytes_per_second: 1e9 };
    SimNetwork::new(1, link)
}

fn client(own: OwnFile, options: RemoteOptions) -> BlockClient {
    BlockClient::new(Arc::clone(model().model()), own, options)
}

/// Readers and one who asks them for one block after the other.
struct World {
    network: SimNetwork,
    transport: SimTransport,
    readers: Vec<(SimTransport, Reader)>,
    client: BlockClient,
}

impl World {
    fn new(readers: usize, own: OwnFile, options: RemoteOptions) -> World {
        let network = network();
        let budget = MemoryBudget::new(Bytes::mib(64));
        let open = |number| {
            let address = format!("reader {number}");
            let (file, memory, roles) = (Arc::new(model()), Bytes::mib(4), RoleOptions::default());
            let reader = Reader::new(file, &address, &address, memory, &budget, roles).unwrap();
            (network.open(&address), reader)
        };
        let readers: Vec<_> = (0..readers).map(open).collect();
        let addresses: Vec<String> = readers.iter().map(|(reader, _)| reader.address().unwrap()).collect();
        let mut world =
            World { transport: network.open("worker"), network, readers, client: client(own, options) };
        world.set_readers(&addresses);
        world
    }

    fn set_readers(&mut self, addresses: &[String]) {
        let mut actions = Vec::new();
        self.client.set_readers(addresses, self.network.now(), &mut actions);
        self.perform(actions);
    }

    fn perform(&mut self, mut actions: Vec<Action>) {
        while !actions.is_empty() {
            for action in std::mem::take(&mut actions) {
                match action {
                    Action::Send { to, frame } => {
                        if let Err(error) = self.transport.send(to, frame) {
                            let event = TransportEvent::Disconnected { peer: to, reason: error.to_string() };
                            self.client.handle(event, self.network.now(), &mut actions);
                        }
                    }
                    Action::Disconnect { peer, .. } => self.transport.disconnect(peer),
                    Action::Log(_) => {}
                }
            }
        }
    }

    fn receive(&mut self) {
        for (transport, reader) in &mut self.readers {
            let mut actions = Vec::new();
            while let Some(event) = transport.take_arrived() {
                reader.handle(Duration::ZERO, event, &mut actions);
            }
            for action in actions {
                if let Action::Send { to, frame } = action {
                    // Who is gone wants nothing.
                    let _ = transport.send(to, frame);
                }
            }
        }
        while let Some(event) = self.transport.take_arrived() {
            let mut actions = Vec::new();
            self.client.handle(event, self.network.now(), &mut actions);
            self.perform(actions);
        }
    }

    /// Waits for a block: whether it came, over the network or from the own file.
    fn read(&mut self, block: u32) -> bool {
        let mut actions = Vec::new();
        assert!(self.client.want(BlockId(block), self.network.now(), &mut actions));
        self.perform(actions);
        let mut sound = Vec::new();
        model().read_block(BlockId(block), &mut sound).unwrap();
        loop {
            let mut actions = Vec::new();
            let now = self.network.now();
            let need = self.client.need(BlockId(block), now, &mut actions);
            self.perform(actions);
            let mut actions = Vec::new();
            match need {
                Need::Take(bytes) => {
                    assert!(*bytes == sound);
                    return true;
                }
                Need::Connect { place, address } => {
                    let peer = self.transport.connect(&address).ok();
                    self.client.connected(place, &address, peer, now, &mut actions);
                }
                Need::ReadOwn => {
                    self.client.own_read(BlockId(block), true, now, &mut actions);
                    return true;
                }
                Need::Wait { until, .. } => {
                    let next = self.network.next_arrival().map_or(until, |arrival| arrival.min(until));
                    self.network.advance_to(next.max(now + Duration::from_nanos(1)));
                    self.receive();
                }
                Need::GiveUp => return false,
            }
            self.perform(actions);
        }
    }

    fn kill(&mut self, place: usize) {
        self.readers[place].0.close();
        self.network.advance_to(self.network.now() + 2 * LATENCY);
        self.receive();
    }

    fn asked(&self) -> Vec<u64> {
        self.readers.iter().map(|(_, reader)| reader.counters().blocks_asked).collect()
    }
}

#[test]
fn a_dead_readers_share_moves_to_the_others_and_then_to_the_own_disk() {
    const READERS: usize = 3;
    let blocks = model().model().blocks.len() as u32;
    let mut world = World::new(READERS, OwnFile::Last, RemoteOptions::default());
    assert!((0..blocks).all(|block| world.read(block)));
    let own =
        |place| (0..blocks).filter(|block| readers_of(*block, READERS).next() == Some(place)).count() as u64;
    let shares: Vec<u64> = (0..READERS).map(own).collect();
    assert_eq!(world.asked(), shares);
    assert_eq!(world.client.counters().from_owner, u64::from(blocks));
    // Whoever asks for a block of the dead one asks the next in its order; the others' shares stay where they are.
    world.kill(1);
    assert!((0..blocks).all(|block| world.read(block)));
    let counters = world.client.counters();
    assert_eq!((counters.from_other, counters.from_fallback), (shares[1], 0));
    let asked = world.asked();
    assert_eq!(asked[1], shares[1], "a dead one is asked for nothing");
    let more = [0, 2].map(|place| asked[place] - 2 * shares[place]);
    assert_eq!(more[0] + more[1], shares[1]);
    assert!(more[0].abs_diff(more[1]) <= 1, "{more:?}");
    // Nobody is left.
    world.kill(0);
    world.kill(2);
    assert!((0..blocks).all(|block| world.read(block)));
    let counters = world.client.counters();
    assert_eq!(counters.from_fallback, u64::from(blocks));
    assert_eq!(counters.from_owner + counters.from_other, 2 * u64::from(blocks));
    assert_eq!(world.client.outstanding(), (0, 0));
}

#[test]
fn a_wait_without_end_ends() {
    let options = RemoteOptions { patience: Duration::from_secs(60), ..RemoteOptions::default() };
    let mut world = World::new(2, OwnFile::Absent, options);
    world.kill(0);
    world.kill(1);
    assert!(!world.read(3));
    let waited = world.network.now();
    assert!(waited >= options.patience && waited < options.patience + Duration::from_secs(1), "{waited:?}");
    // Nobody needs it any more: at once.
    world.client.abandon();
    assert!(!world.read(4));
    assert!(world.network.now() < waited + Duration::from_secs(1));
    assert_eq!(world.client.outstanding(), (0, 0));
    // No reader at all, and a disk that is damaged: its bytes are all there is.
    let mut alone = client(OwnFile::Last, options);
    let (now, mut actions) = (Duration::ZERO, Vec::new());
    assert!(alone.want(BlockId(0), now, &mut actions));
    assert_eq!(alone.need(BlockId(0), now, &mut actions), Need::ReadOwn);
    alone.own_read(BlockId(0), false, now, &mut actions);
    assert_eq!(alone.need(BlockId(0), now, &mut actions), Need::GiveUp);
    assert!(!alone.want(BlockId(u32::MAX), now, &mut actions), "there is no such block");
    assert!(actions.is_empty());
}

/// A reader that does not answer is given up; what it says later is not heard.
#[test]
fn a_silent_reader_is_given_up_and_then_tried_again() {
    let options = RemoteOptions {
        answer_time_max: Duration::from_secs(3),
        retry_after: Duration::from_secs(5),
        ..RemoteOptions::default()
    };
    let mut client = client(OwnFile::Last, options);
    let addresses = ["one".to_owned()];
    let (mut now, mut actions) = (Duration::ZERO, Vec::new());
    let block = BlockId(2);
    client.set_readers(&addresses, now, &mut actions);
    client.want(block, now, &mut actions);
    let Need::Connect { place: 0, address } = client.need(block, now, &mut actions) else { panic!() };
    // Another who waits does not connect a second time.
    client.want(BlockId(3), now, &mut actions);
    assert!(matches!(client.need(BlockId(3), now, &mut actions), Need::Wait { for_answer: false, .. }));
    client.connected(0, &address, Some(PeerId(7)), now, &mut actions);
    let both =
        |actions: &[Action]| actions.iter().filter(|action| matches!(action, Action::Send { .. })).count();
    assert_eq!(both(&actions), 2, "both are asked for as soon as it is connected");
    let until = now + options.answer_time_max;
    assert_eq!(client.need(block, now, &mut actions), Need::Wait { until, for_answer: true });
    now = until;
    actions.clear();
    assert_eq!(client.need(block, now, &mut actions), Need::ReadOwn);
    assert!(matches!(&actions[..], [Action::Disconnect { peer: PeerId(7), .. }]));
    assert_eq!(client.need(BlockId(3), now, &mut actions), Need::ReadOwn);
    let mut stored = Vec::new();
    model().read_block(block, &mut stored).unwrap();
    let late = Message::Block { block: block.0, turn: 0 }.frame_with(&stored);
    client.handle(TransportEvent::Frame { peer: PeerId(7), bytes: late }, now, &mut actions);
    assert_eq!(client.need(block, now, &mut actions), Need::ReadOwn);
    client.own_read(block, true, now, &mut actions);
    client.own_read(BlockId(3), true, now, &mut actions);
    // Not yet, and then again.
    client.want(block, now, &mut actions);
    assert_eq!(client.need(block, now, &mut actions), Need::ReadOwn);
    client.own_read(block, true, now, &mut actions);
    now += options.retry_after;
    client.want(block, now, &mut actions);
    assert!(matches!(client.need(block, now, &mut actions), Need::Connect { place: 0, .. }));
    assert_eq!(client.counters().readers_lost, 1);
}

#[test]
fn what_is_asked_in_advance_is_bounded_and_used() {
    let sizes: Vec<u64> = model().model().blocks.iter().map(|entry| entry.stored_bytes.into()).collect();
    let ahead_bytes_max = sizes[..4].iter().sum();
    let mut world =
        World::new(1, OwnFile::Absent, RemoteOptions { ahead_bytes_max, ..RemoteOptions::default() });
    assert!(world.read(0), "it is connected now");
    let all: Vec<BlockId> = (0..sizes.len() as u32).map(BlockId).collect();
    let mut actions = Vec::new();
    for _ in 0..3 {
        world.client.will_need(&all, world.network.now(), &mut actions);
    }
    let (blocks, bytes) = world.client.outstanding();
    assert!(
        blocks >= 4 && blocks < sizes.len() && bytes <= ahead_bytes_max,
        "{blocks} blocks, {bytes} bytes"
    );
    assert_eq!(actions.len(), 1, "one message asks for all");
    world.perform(actions);
    assert!((0..sizes.len() as u32).all(|block| world.read(block)));
    assert_eq!(world.client.outstanding(), (0, 0));
    let ReaderCounters { blocks_asked, .. } = world.readers[0].1.counters();
    assert_eq!(blocks_asked, 1 + sizes.len() as u64, "none is asked for twice");
}

/// A reader that says what it likes: nothing is kept of what nobody asked for, and no wrong byte comes through.
#[test]
fn what_nobody_asked_for_leaves_no_trace() {
    let mut random = Random(4);
    let mut stored = Vec::new();
    model().read_block(BlockId(1), &mut stored).unwrap();
    let mut client = client(OwnFile::Last, RemoteOptions::default());
    let (now, mut actions) = (Duration::ZERO, Vec::new());
    client.set_readers(&["one".to_owned()], now, &mut actions);
    client.want(BlockId(1), now, &mut actions);
    let Need::Connect { address, .. } = client.need(BlockId(1), now, &mut actions) else { panic!() };
    let peer = PeerId(9);
    client.connected(0, &address, Some(peer), now, &mut actions);
    let sound = Message::Block { block: 1, turn: 3 }.frame_with(&stored);
    for _ in 0..2000 {
        let mut bytes = sound.clone();
        let from = if random.below(4) == 0 { PeerId(random.bits()) } else { peer };
        match random.below(6) {
            0 => bytes = Message::Block { block: random.bits() as u32 | 2, turn: 9 }.frame_with(&stored),
            1 => bytes = Message::NoBlock { block: random.bits() as u32 | 2, reason: String::new() }.frame(),
            2 => bytes = Message::Finished.frame(),
            3 => bytes.truncate(random.index(bytes.len())),
            4 => bytes.push(0),
            _ => random.flip(&mut bytes),
        }
        client.handle(TransportEvent::Frame { peer: from, bytes }, now, &mut actions);
        let (blocks, ahead) = client.outstanding();
        assert!(blocks <= 1 && ahead == 0);
        // It may have been given up by now: then it is the disk's turn, and the next one begins anew.
        let mut more = Vec::new();
        match client.need(BlockId(1), now, &mut more) {
            Need::Wait { .. } => {}
            Need::Take(bytes) => {
                assert!(*bytes == stored);
                client.want(BlockId(1), now, &mut actions);
            }
            Need::ReadOwn => {
                client.own_read(BlockId(1), true, now, &mut actions);
                client = self::client(OwnFile::Last, RemoteOptions::default());
                client.set_readers(&["one".to_owned()], now, &mut actions);
                client.want(BlockId(1), now, &mut actions);
                assert!(matches!(client.need(BlockId(1), now, &mut actions), Need::Connect { .. }));
                client.connected(0, "one", Some(peer), now, &mut actions);
            }
            other => panic!("{other:?}"),
        }
        actions.clear();
    }
}
