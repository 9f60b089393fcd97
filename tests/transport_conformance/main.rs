//! What every `Transport` has to do, run over all of them.

#[cfg(feature = "mpi")]
mod mpi;

use std::time::{Duration, Instant};

use outcrop::error::TransportError;
use outcrop::transport::{
    FRAME_BYTES_MAX, LinkModel, LocalNetwork, PeerId, SharedKey, SimNetwork, TcpOptions, TcpTransport,
    Transport, TransportEvent,
};

/// Long enough for any machine; nothing waits for it in vain.
const LONG: Duration = Duration::from_secs(30);
const SHORT: Duration = Duration::from_millis(20);

type Open<'a> = &'a dyn Fn(&str) -> Box<dyn Transport>;

fn next(transport: &dyn Transport) -> TransportEvent {
    transport.receive(LONG).unwrap().expect("an event should have come")
}

fn frame(transport: &dyn Transport) -> (PeerId, Vec<u8>) {
    match next(transport) {
        TransportEvent::Frame { peer, bytes } => (peer, bytes),
        other => panic!("{other:?}"),
    }
}

/// `a` connects to `b`: their numbers for it.
fn join(a: &dyn Transport, b: &dyn Transport) -> (PeerId, PeerId) {
    let mine = a.connect(&b.address().unwrap()).unwrap();
    match next(b) {
        TransportEvent::Connected { peer, name } => {
            assert!(!name.is_empty());
            (mine, peer)
        }
        other => panic!("{other:?}"),
    }
}

fn pattern(length: usize, seed: u8) -> Vec<u8> {
    (0..length).map(|i| (i * 31 + i / 251) as u8 ^ seed).collect()
}

/// The suite.
fn conforms(open: Open<'_>) {
    frames_arrive_whole_and_in_order(open);
    peers_are_told_apart(open);
    ends_are_seen(open);
    a_peer_that_does_not_listen_is_bounded(open);
    nobody_there(open);
}

fn frames_arrive_whole_and_in_order(open: Open<'_>) {
    let (a, b) = (open("a"), open("b"));
    let (to_b, to_a) = join(&*a, &*b);
    let limit = a.frame_bytes_max();
    let lengths = [0, 1, 2, 1000, 65_517, 65_518, 65_519, 65_535, 65_536, 131_036, limit - 1, limit];
    for (seed, length) in lengths.into_iter().enumerate() {
        a.send(to_b, pattern(length, seed as u8)).unwrap();
        assert_eq!(frame(&*b), (to_a, pattern(length, seed as u8)), "{length} bytes");
    }
    for seed in 0..100 {
        a.send(to_b, pattern(seed, seed as u8)).unwrap();
        b.send(to_a, pattern(2 * seed, seed as u8)).unwrap();
    }
    for seed in 0..100 {
        assert_eq!(frame(&*b), (to_a, pattern(seed, seed as u8)));
        assert_eq!(frame(&*a), (to_b, pattern(2 * seed, seed as u8)));
    }
    assert_eq!(a.receive(SHORT).unwrap(), None);
    assert_eq!(a.receive(Duration::ZERO).unwrap(), None);
    let too_long = a.send(to_b, vec![0; limit + 1]);
    assert_eq!(too_long, Err(TransportError::FrameTooLong { bytes: limit + 1, limit }));
    // The connection is as good as before.
    a.send(to_b, vec![1]).unwrap();
    assert_eq!(frame(&*b), (to_a, vec![1]));
}

fn peers_are_told_apart(open: Open<'_>) {
    let hub = open("hub");
    let nodes: Vec<_> = (0..5).map(|i| open(&format!("node {i}"))).collect();
    let ways: Vec<_> = nodes.iter().map(|node| join(&**node, &*hub)).collect();
    for (i, (node, (to_hub, _))) in nodes.iter().zip(&ways).enumerate() {
        for round in 0..10 {
            node.send(*to_hub, vec![i as u8, round]).unwrap();
        }
    }
    let mut rounds = [0; 5];
    for _ in 0..50 {
        let (peer, bytes) = frame(&*hub);
        let i = ways.iter().position(|(_, from)| *from == peer).unwrap();
        // Any order between peers, but for each its own.
        assert_eq!(bytes, [i as u8, rounds[i]]);
        rounds[i] += 1;
    }
    for (i, (_, from)) in ways.iter().enumerate() {
        hub.send(*from, vec![100 + i as u8]).unwrap();
    }
    for (i, (node, (to_hub, _))) in nodes.iter().zip(&ways).enumerate() {
        assert_eq!(frame(&**node), (*to_hub, vec![100 + i as u8]));
    }
    // A second connection between two nodes is another one.
    let (second, second_from) = join(&*nodes[0], &*hub);
    assert!(second != ways[0].0 && second_from != ways[0].1);
    nodes[0].send(second, vec![7]).unwrap();
    assert_eq!(frame(&*hub), (second_from, vec![7]));
}

fn disconnected(transport: &dyn Transport, peer: PeerId) {
    match next(transport) {
        TransportEvent::Disconnected { peer: found, reason } => {
            assert_eq!(found, peer);
            assert!(!reason.is_empty());
        }
        other => panic!("{other:?}"),
    }
}

fn ends_are_seen(open: Open<'_>) {
    let (a, b, c) = (open("a"), open("b"), open("c"));
    // What was sent before the end arrives before it.
    let (to_b, to_a) = join(&*a, &*b);
    a.send(to_b, vec![5; 100_000]).unwrap();
    a.disconnect(to_b);
    assert_eq!(a.send(to_b, vec![1]), Err(TransportError::NotConnected { peer: to_b.0 }));
    assert_eq!(frame(&*b), (to_a, vec![5; 100_000]));
    disconnected(&*b, to_a);
    assert_eq!(b.send(to_a, vec![1]), Err(TransportError::NotConnected { peer: to_a.0 }));
    b.disconnect(to_a);
    // The one who ended it is not told, and another connection gets another number.
    assert_eq!(a.receive(SHORT).unwrap(), None);
    let (again, again_from) = join(&*a, &*b);
    assert!(again != to_b && again_from != to_a);
    // Closing ends all of a node's connections.
    let (c_to_b, b_to_c) = join(&*c, &*b);
    b.close();
    disconnected(&*a, again);
    disconnected(&*c, c_to_b);
    for result in [b.send(b_to_c, vec![1]), b.connect(&a.address().unwrap()).map(|_| ())] {
        assert_eq!(result, Err(TransportError::Closed));
    }
    assert_eq!(b.receive(LONG), Err(TransportError::Closed));
    b.close();
    // A node that is dropped has ended too.
    let d = open("d");
    let (to_c, c_to_d) = join(&*d, &*c);
    assert!(d.send(to_c, vec![]).is_ok());
    drop(d);
    assert_eq!(frame(&*c), (c_to_d, vec![]));
    disconnected(&*c, c_to_d);
}

/// Sending never waits, and what cannot go is given back.
fn a_peer_that_does_not_listen_is_bounded(open: Open<'_>) {
    let (a, b) = (open("a"), open("b"));
    let (to_b, to_a) = join(&*a, &*b);
    let mut sent = 0usize;
    let big = FRAME_BYTES_MAX.min(a.frame_bytes_max());
    let refused = (0..1000).find_map(|i| match a.send(to_b, pattern(big, i as u8)) {
        Ok(()) => {
            sent += 1;
            None
        }
        Err(error) => Some(error),
    });
    assert_eq!(refused, Some(TransportError::QueueFull { peer: to_b.0 }));
    assert!(sent < 200, "{sent} MiB were taken");
    for i in 0..sent {
        assert_eq!(frame(&*b), (to_a, pattern(big, i as u8)));
    }
    a.send(to_b, vec![9]).unwrap();
    assert_eq!(frame(&*b), (to_a, vec![9]));
}

fn nobody_there(open: Open<'_>) {
    let (a, b) = (open("a"), open("b"));
    let address = b.address().unwrap();
    drop(b);
    assert!(matches!(a.connect(&address), Err(TransportError::Connect { .. })));
    assert!(matches!(a.send(PeerId(77), vec![]), Err(TransportError::NotConnected { peer: 77 })));
    a.disconnect(PeerId(77));
}

#[test]
fn local() {
    let network = LocalNetwork::new();
    conforms(&|name| Box::new(network.open(name)));
}

#[test]
fn simulated() {
    for seed in 0..5 {
        let network = SimNetwork::new(seed, LinkModel::default());
        conforms(&|name| Box::new(network.open(name)));
    }
}

#[test]
fn tcp() {
    let key = SharedKey::generate().unwrap();
    conforms(&|name| Box::new(TcpTransport::open(key.clone(), TcpOptions::loopback(name)).unwrap()));
}

#[test]
fn simulated_time_passes_only_when_asked_and_lines_have_a_speed() {
    let link = LinkModel {
        latency_min: Duration::from_millis(10),
        latency_max: Duration::from_millis(10),
        bytes_per_second: 1e6,
    };
    let network = SimNetwork::new(1, link);
    let (a, b) = (network.open("a"), network.open("b"));
    let (to_b, to_a) = join(&a, &b);
    let start = network.now();
    let real = Instant::now();
    for round in 0..3600 {
        a.send(to_b, vec![0; 1_000_000]).unwrap();
        if round >= 10 {
            assert_eq!(frame(&b).1.len(), 1_000_000);
        }
    }
    for _ in 0..10 {
        assert_eq!(frame(&b).1.len(), 1_000_000);
    }
    // An hour at a megabyte each second.
    let passed = network.now() - start;
    assert!(passed > Duration::from_secs(3599) && passed < Duration::from_secs(3602), "{passed:?}");
    assert!(real.elapsed() < passed);
    b.send(to_a, vec![1]).unwrap();
    assert_eq!(a.receive(Duration::from_millis(5)).unwrap(), None);
    assert_eq!(frame(&a), (to_b, vec![1]));
}

#[test]
fn partitions_hold_frames_up_and_hide_deaths() {
    let network = SimNetwork::new(3, LinkModel::default());
    let (a, b, c) = (network.open("a"), network.open("b"), network.open("c"));
    let (a_to_c, c_to_a) = join(&a, &c);
    let (b_to_c, c_to_b) = join(&b, &c);
    network.partition(&[(&a, 1)]);
    a.send(a_to_c, vec![1]).unwrap();
    a.send(a_to_c, vec![2]).unwrap();
    b.send(b_to_c, vec![3]).unwrap();
    assert_eq!(frame(&c), (c_to_b, vec![3]));
    assert!(matches!(a.connect("c"), Err(TransportError::Connect { .. })));
    assert_eq!(c.receive(Duration::from_secs(100)).unwrap(), None);
    network.heal();
    assert_eq!(frame(&c), (c_to_a, vec![1]));
    network.partition(&[(&a, 1)]);
    a.close();
    // On its way before the cut.
    assert_eq!(frame(&c), (c_to_a, vec![2]));
    assert_eq!(c.receive(Duration::from_secs(100)).unwrap(), None);
    network.heal();
    disconnected(&c, c_to_a);
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let run = |seed| {
        let network = SimNetwork::new(seed, LinkModel::default());
        let hub = network.open("hub");
        let nodes: Vec<_> = (0..4).map(|i| network.open(&format!("{i}"))).collect();
        let ways: Vec<_> = nodes.iter().map(|node| join(node, &hub).0).collect();
        for round in 0..20u8 {
            for (node, way) in nodes.iter().zip(&ways) {
                node.send(*way, vec![round]).unwrap();
            }
        }
        (0..80).map(|_| (frame(&hub), network.now())).collect::<Vec<_>>()
    };
    assert_eq!(run(1), run(1));
    // Peers overtake each other differently.
    assert_ne!(
        run(1).iter().map(|e| e.0.0).collect::<Vec<_>>(),
        run(2).iter().map(|e| e.0.0).collect::<Vec<_>>()
    );
}
