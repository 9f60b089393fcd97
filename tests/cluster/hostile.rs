//! Peers that mean no good, in the middle of a render over TCP: refused with a line in the log, and the picture does not notice.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use outcrop::MemoryBudget;
use outcrop::access::BlockSketch;
use outcrop::cluster::{
    Coordinator, LeasedCells, MESSAGE_VERSION, Message, Role, run_coordinator, run_worker,
};
use outcrop::compile::Control;
use outcrop::error::TransportError;
use outcrop::transport::{SharedKey, TcpOptions, TcpTransport, Transport, TransportEvent};
use outcrop::units::Bytes;

use super::numbers::Random;
use super::support::{coordinator_options, job, model, reference, worker_options};

const GREETING: &[u8; 12] = b"\x89ocnet\r\n\x01\x00\x00\x00";

fn tcp(key: &SharedKey, options: TcpOptions) -> TcpTransport {
    TcpTransport::open(key.clone(), options).unwrap()
}

/// Waits for a refusal and gives its reason.
fn refusal(transport: &TcpTransport) -> String {
    let deadline = Instant::now() + Duration::from_secs(60);
    while Instant::now() < deadline {
        match transport.receive(Duration::from_millis(100)).unwrap() {
            Some(TransportEvent::Refused { reason, .. }) => return reason,
            None => {}
            Some(other) => panic!("{other:?}"),
        }
    }
    panic!("nobody was refused");
}

fn stranger(transport: &TcpTransport, bytes: &[u8]) -> TcpStream {
    let mut stream = TcpStream::connect(transport.address().unwrap()).unwrap();
    let _ = stream.write_all(bytes);
    stream
}

fn hung_up(mut stream: TcpStream) {
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    // The end, or a reset.
    while let Ok(count) = stream.read(&mut [0; 64]) {
        if count == 0 {
            break;
        }
    }
}

#[test]
fn strangers_are_refused() {
    let key = SharedKey::generate().unwrap();
    let quick = TcpOptions { handshake_time_max: Duration::from_millis(400), ..TcpOptions::loopback("node") };
    let node = tcp(&key, quick);

    // Another key.
    let other = tcp(&SharedKey::generate().unwrap(), TcpOptions::connecting("other"));
    let error = other.connect(&node.address().unwrap()).unwrap_err();
    assert!(matches!(error, TransportError::Refused { .. }), "{error}");
    assert!(refusal(&node).contains("does not hold the key"));

    // Another version, which is told so.
    let mut greeting = *GREETING;
    greeting[8] = 9;
    let mut stream = stranger(&node, &greeting);
    let mut answer = [0; 12];
    stream.read_exact(&mut answer).unwrap();
    assert_eq!((&answer[..10], answer[10]), (&GREETING[..10], 1));
    assert!(refusal(&node).contains("version 9"));

    // A port scanner, in several tongues.
    for probe in [
        &b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"[..],
        b"SSH-2.0-scan\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        &[0; 500],
    ] {
        hung_up(stranger(&node, probe));
        let reason = refusal(&node);
        assert!(reason.contains("protocol") || reason.contains("too long"), "{reason}");
    }

    // Nothing but a connection; a greeting cut short; a greeting and no more; one byte now and then.
    let idle = stranger(&node, b"");
    assert!(refusal(&node).contains("too long"));
    drop(idle);
    drop(stranger(&node, &GREETING[..7]));
    assert!(refusal(&node).contains("hung up"));
    let half = stranger(&node, GREETING);
    assert!(refusal(&node).contains("too long"));
    drop(half);
    let mut slow = stranger(&node, b"");
    for byte in GREETING {
        let _ = slow.write_all(&[*byte]);
        thread::sleep(Duration::from_millis(60));
    }
    assert!(refusal(&node).contains("too long"));

    // A message longer than any handshake's, and random ones.
    hung_up(stranger(&node, &[&GREETING[..], &[0xff; 4000]].concat()));
    assert!(refusal(&node).contains("key"));
    let mut random = Random(3);
    for length in [48u16, 48, 100] {
        let mut bytes = [&GREETING[..], &length.to_le_bytes()].concat();
        bytes.extend((0..length).map(|_| random.bits() as u8));
        hung_up(stranger(&node, &bytes));
        assert!(refusal(&node).contains("key"));
    }

    // After all this, one who holds the key is welcome.
    let friend = tcp(&key, TcpOptions::connecting("friend"));
    let peer = friend.connect(&node.address().unwrap()).unwrap();
    friend.send(peer, vec![1, 2, 3]).unwrap();
    assert!(matches!(node.receive(Duration::from_secs(30)).unwrap(),
        Some(TransportEvent::Connected { name, .. }) if name.starts_with("friend at 127.")));
    assert!(matches!(node.receive(Duration::from_secs(30)).unwrap(), Some(TransportEvent::Frame { .. })));
}

#[test]
fn a_crowd_of_strangers_is_bounded() {
    let key = SharedKey::generate().unwrap();
    let node = tcp(&key, TcpOptions { handshakes_max: 4, ..TcpOptions::loopback("node") });
    let crowd: Vec<TcpStream> = (0..40).map(|_| stranger(&node, &GREETING[..3])).collect();
    assert!(refusal(&node).contains("in the middle of their handshake"));
    drop(crowd);
}

/// A peer that recorded a handshake and plays it again gets no further than message 2.
#[test]
fn a_recording_is_refused() {
    let key = SharedKey::generate().unwrap();
    let quick = TcpOptions { handshake_time_max: Duration::from_millis(500), ..TcpOptions::loopback("node") };
    let node = tcp(&key, quick);
    // A relay that records what a friend sends.
    let relay = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let relay_address = relay.local_addr().unwrap().to_string();
    let node_address = node.address().unwrap();
    let recorder = thread::spawn(move || {
        let (mut friend, _) = relay.accept().unwrap();
        let mut node = TcpStream::connect(node_address).unwrap();
        let mut recorded = vec![0; 12 + 2 + 48];
        friend.read_exact(&mut recorded).unwrap();
        node.write_all(&recorded).unwrap();
        let mut answer = vec![0; 12 + 2];
        node.read_exact(&mut answer).unwrap();
        let mut message = vec![0; usize::from(answer[12]) + 256 * usize::from(answer[13])];
        node.read_exact(&mut message).unwrap();
        friend.write_all(&[answer, message].concat()).unwrap();
        let mut proof = vec![0; 2 + 16 + 1 + "friend".len()];
        friend.read_exact(&mut proof).unwrap();
        node.write_all(&proof).unwrap();
        (recorded, proof, node)
    });
    let friend = tcp(&key, TcpOptions::connecting("friend"));
    friend.connect(&relay_address).unwrap();
    let (recorded, proof, relayed) = recorder.join().unwrap();
    assert!(matches!(node.receive(Duration::from_secs(30)).unwrap(), Some(TransportEvent::Connected { .. })));
    // A flipped bit on the way ends the connection, and the frame does not arrive.
    let mut broken = relayed;
    broken.write_all(&[20, 0]).unwrap();
    broken.write_all(&[7; 20]).unwrap();
    match node.receive(Duration::from_secs(30)).unwrap() {
        Some(TransportEvent::Disconnected { reason, .. }) => assert!(reason.contains("damaged"), "{reason}"),
        other => panic!("{other:?}"),
    }
    hung_up(stranger(&node, &[recorded.clone(), proof].concat()));
    assert!(refusal(&node).contains("does not hold the key"));
    drop(stranger(&node, &recorded));
    assert!(!refusal(&node).is_empty());
}

/// Carries what a peer sends on to `address`, but no more than `bytes` of it; then the line is as good as dead, and open.
fn stalling_relay(address: String, bytes: usize) -> String {
    let relay = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let relay_address = relay.local_addr().unwrap().to_string();
    thread::spawn(move || {
        let (mut peer, _) = relay.accept().unwrap();
        let mut node = TcpStream::connect(address).unwrap();
        let (mut back, mut from_node) = (peer.try_clone().unwrap(), node.try_clone().unwrap());
        thread::spawn(move || std::io::copy(&mut from_node, &mut back));
        let (mut left, mut buffer) = (bytes, [0; 1000]);
        while let Ok(count @ 1..) = peer.read(&mut buffer) {
            let passed = count.min(left);
            left -= passed;
            let _ = node.write_all(&buffer[..passed]);
        }
    });
    relay_address
}

/// Those who hold the key are bounded, too: in the length of a frame, and in its time.
#[test]
fn frames_of_members_are_bounded() {
    let key = SharedKey::generate().unwrap();
    let frame_time_max = Duration::from_millis(500);
    let node =
        tcp(&key, TcpOptions { frame_bytes_max: 100_000, frame_time_max, ..TcpOptions::loopback("node") });
    let next = || node.receive(Duration::from_secs(30)).unwrap();
    let long = tcp(&key, TcpOptions::connecting("long"));
    let peer = long.connect(&node.address().unwrap()).unwrap();
    assert!(matches!(next(), Some(TransportEvent::Connected { .. })));
    long.send(peer, vec![1; 100_000]).unwrap();
    assert!(matches!(next(), Some(TransportEvent::Frame { bytes, .. }) if bytes == vec![1; 100_000]));
    // Silence between frames is no fault.
    thread::sleep(2 * frame_time_max);
    long.send(peer, vec![1; 100_001]).unwrap();
    match next() {
        Some(TransportEvent::Disconnected { reason, .. }) => {
            assert!(reason.contains("more than 100000 bytes"))
        }
        other => panic!("{other:?}"),
    }
    // The first record of the frame comes whole, the second one never.
    let slow = tcp(&key, TcpOptions::connecting("slow"));
    let peer = slow.connect(&stalling_relay(node.address().unwrap(), 80_000)).unwrap();
    assert!(matches!(next(), Some(TransportEvent::Connected { .. })));
    let start = Instant::now();
    slow.send(peer, vec![2; 90_000]).unwrap();
    match next() {
        Some(TransportEvent::Disconnected { reason, .. }) => {
            assert!(reason.contains("took too long"), "{reason}")
        }
        other => panic!("{other:?}"),
    }
    assert!(start.elapsed() >= frame_time_max);
}

/// What somebody who holds the key can do by mistake, or a broken program.
fn bad_members(key: &SharedKey, address: &str) -> u32 {
    let hello = Message::Hello {
        version: MESSAGE_VERSION,
        role: Role::Worker { lanes: 1 },
        name: "bad".to_owned(),
        address: None,
        model: None,
    };
    let result = |tile, cells, tail: usize| {
        let what = LeasedCells { lease: 1, tile, cells };
        Message::Result { lane: 0, what, is_last: true, micros: 1, work: 1.0, blocks: BlockSketch::default() }
            .frame_with(&vec![0; tail])
    };
    let wrong_version = {
        let mut frame = hello.frame();
        // The version follows the variant's number.
        frame[1] = 99;
        frame
    };
    let sequences: Vec<Vec<Vec<u8>>> = vec![
        vec![vec![]],
        vec![vec![0xff; 1000]],
        vec![Message::Request { lane: 0 }.frame()],
        vec![wrong_version],
        vec![hello.frame(), Message::Request { lane: 7 }.frame()],
        vec![hello.frame(), result(u32::MAX, 1, 768)],
        // Nothing of a tile that does not exist: the picture has twelve.
        vec![hello.frame(), result(u32::MAX, 0, 0)],
        vec![hello.frame(), result(12, 0, 0)],
        vec![hello.frame(), result(0, 1, 767)],
        vec![hello.frame(), result(0, u64::MAX, 12)],
        vec![hello.frame(), Message::Finished.frame()],
        vec![hello.frame(), hello.frame()],
        vec![hello.frame(), vec![0; 1 << 20]],
    ];
    let count = sequences.len() as u32;
    for frames in sequences {
        let node = tcp(key, TcpOptions::connecting("bad"));
        let peer = node.connect(address).unwrap();
        for frame in frames {
            let _ = node.send(peer, frame);
        }
        // The coordinator ends it.
        let deadline = Instant::now() + Duration::from_secs(60);
        loop {
            assert!(Instant::now() < deadline, "a bad member is still connected");
            match node.receive(Duration::from_millis(100)).unwrap() {
                Some(TransportEvent::Disconnected { .. }) => break,
                _ => continue,
            }
        }
    }
    count
}

#[test]
fn a_render_does_not_notice_them() {
    let key = SharedKey::generate().unwrap();
    let hub = tcp(
        &key,
        TcpOptions { handshake_time_max: Duration::from_millis(500), ..TcpOptions::loopback("hub") },
    );
    let address = hub.address().unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    let coordinator = Coordinator::new(job(), coordinator_options(1, 0), &budget).unwrap();
    let (stop, attacked) = (AtomicBool::new(false), AtomicBool::new(false));
    thread::scope(|scope| {
        let attack = scope.spawn(|| {
            for probe in [&b"GET / HTTP/1.0\r\n\r\n"[..], GREETING, b""] {
                let mut stream = TcpStream::connect(&address).unwrap();
                let _ = stream.write_all(probe);
                hung_up(stream);
            }
            let other = tcp(&SharedKey::generate().unwrap(), TcpOptions::connecting("other"));
            assert!(other.connect(&address).is_err());
            let count = bad_members(&key, &address);
            attacked.store(true, Ordering::Relaxed);
            count
        });
        scope.spawn(|| {
            // The worker comes when all is over, so that the attack does meet a render.
            while !attacked.load(Ordering::Relaxed) {
                thread::sleep(Duration::from_millis(10));
            }
            let control = tcp(&key, TcpOptions::connecting("worker"));
            let data: Arc<dyn Transport> = Arc::new(tcp(&key, TcpOptions::connecting("data")));
            let options = worker_options("worker", 1, Some(Arc::new(model())));
            run_worker(&control, &data, &address, &options, &stop, &mut |_| {}).unwrap();
        });
        let mut lines = Vec::new();
        let mut observe = |_: &Coordinator, log: &[String]| {
            lines.extend_from_slice(log);
            Control::Continue
        };
        let patience = Duration::from_secs(120);
        let done = run_coordinator(&hub, coordinator, None, patience, &mut observe).unwrap();
        assert!(done.film().pixels() == &reference()[..]);
        let refused = done.counters().refused;
        assert!(refused >= u64::from(attack.join().unwrap()) + 4, "{refused}");
        assert!(lines.iter().filter(|line| line.starts_with("refused")).count() >= 4, "{lines:#?}");
        // Each for what it did: one by its version, the others got beyond that.
        let told = |reason: &str| lines.iter().filter(|line| line.contains(reason)).count();
        assert_eq!(told("it speaks version 99"), 1, "{lines:#?}");
        assert_eq!(told("it has no such lane"), 1, "{lines:#?}");
        assert_eq!(told("joins as a worker"), 10, "{lines:#?}");
        assert_eq!(told("pixels that do not fit"), 5, "{lines:#?}");
    });
}
