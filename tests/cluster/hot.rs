//! Blocks that everybody wants, and blocks that are damaged where they should be.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use outcrop::cluster::{Action, Message, Reader, ReaderCounters, RemoteOptions, RemoteSource};
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::transport::{LocalNetwork, PeerId, Transport, TransportEvent};
use outcrop::units::{BlockId, Bytes};
use outcrop::{BlockSource, MemoryBudget};

use super::support::{model, quick_roles};
use super::threads::Network;

/// A reader without a coordinator, until it is told to stop.
fn serve(transport: &dyn Transport, stop: &AtomicBool) -> ReaderCounters {
    let budget = MemoryBudget::new(Bytes::mib(16));
    let address = transport.address().unwrap();
    let file = Arc::new(model());
    let mut reader = Reader::new(file, &address, &address, Bytes::mib(8), &budget, quick_roles()).unwrap();
    let mut actions = Vec::new();
    while !stop.load(Ordering::Relaxed) {
        if let Some(event) = transport.receive(Duration::from_millis(5)).unwrap() {
            reader.handle(Duration::ZERO, event, &mut actions);
        }
        for action in actions.drain(..) {
            if let Action::Send { to, frame } = action {
                // Who is gone wants nothing.
                let _ = transport.send(to, frame);
            }
        }
    }
    reader.counters()
}

fn read_sound(source: &dyn BlockSource, block: BlockId) {
    let (mut bytes, mut expected) = (Vec::new(), Vec::new());
    source.read_block(block, &mut bytes).unwrap();
    model().read_block(block, &mut expected).unwrap();
    assert!(bytes == expected);
}

#[test]
fn readers_share_the_work_for_a_block_that_all_want() {
    const READERS: usize = 3;
    const WORKERS: usize = 4;
    const TIMES: usize = 60;
    let network = LocalNetwork::new();
    let blocks = model().model().blocks.len() as u32;
    assert!(blocks > 8, "most blocks are not hot");
    let stop = AtomicBool::new(false);
    let opened: Vec<_> = (0..READERS).map(|i| Network::open(&network, &format!("reader {i}"))).collect();
    let addresses: Vec<String> = opened.iter().map(|reader| reader.address().unwrap()).collect();
    let (readers, workers) = thread::scope(|scope| {
        let readers: Vec<_> =
            opened.iter().map(|transport| scope.spawn(|| serve(&**transport, &stop))).collect();
        let workers: Vec<_> = (0..WORKERS)
            .map(|i| {
                let transport = Network::open(&network, &format!("worker {i}"));
                let addresses = addresses.clone();
                scope.spawn(move || {
                    let options = RemoteOptions::default();
                    let source = RemoteSource::open(transport, addresses, options).unwrap();
                    (0..blocks).for_each(|block| read_sound(&source, BlockId(block)));
                    (0..TIMES).for_each(|_| read_sound(&source, BlockId(1)));
                    source.counters()
                })
            })
            .collect();
        let workers: Vec<_> = workers.into_iter().map(|worker| worker.join().unwrap()).collect();
        stop.store(true, Ordering::Relaxed);
        (readers.into_iter().map(|reader| reader.join().unwrap()).collect::<Vec<_>>(), workers)
    });
    let asked = (WORKERS * (blocks as usize + TIMES)) as u64;
    assert_eq!(readers.iter().map(|reader| reader.blocks_asked).sum::<u64>(), asked);
    // Without that, its owner alone would answer for it.
    let all = WORKERS as u64 * TIMES as u64;
    let own = u64::from(blocks) * WORKERS as u64 / READERS as u64;
    assert!(readers.iter().all(|reader| reader.blocks_asked < own + all * 3 / 4), "{readers:?}");
    assert!(workers.iter().all(|worker| worker.from_replica > TIMES as u64 / 4), "{workers:?}");
    assert!(workers.iter().all(|worker| worker.from_other == 0), "{workers:?}");
    // Once each, and the hot one on each reader.
    let from_disk: u64 = readers.iter().map(|reader| reader.blocks_from_disk).sum();
    assert!(from_disk < u64::from(blocks) + READERS as u64, "{readers:?}");
}

/// The node's own file is damaged, and the reader is gone for a while: it is waited for.
#[test]
fn a_damaged_file_waits_for_a_reader_to_come_back() {
    let network = LocalNetwork::new();
    let rates = FaultRates { bit_flips: 1.0, ..FaultRates::default() };
    let damaged = || Arc::new(FaultySource::new(model(), 3, rates));
    let options = RemoteOptions {
        retry_after: Duration::from_millis(20),
        patience: Duration::from_secs(60),
        ..RemoteOptions::default()
    };
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let worker = Network::open(&network, "worker");
        let source = RemoteSource::beside(damaged(), worker, vec!["late".to_owned()], options);
        let reading = scope.spawn(move || {
            read_sound(&source, BlockId(2));
            source.counters()
        });
        thread::sleep(Duration::from_millis(100));
        assert!(!reading.is_finished(), "there is nobody who has a sound block");
        let late = Network::open(&network, "late");
        let reader = scope.spawn(|| serve(&*{ late }, &stop));
        let counters = reading.join().unwrap();
        stop.store(true, Ordering::Relaxed);
        reader.join().unwrap();
        assert_eq!((counters.from_owner, counters.from_fallback, counters.damaged), (1, 0, 1));
    });
    // Nobody will ever have it: the damage comes through, and is found where blocks are decoded.
    let alone = RemoteSource::beside(damaged(), Network::open(&network, "alone"), Vec::new(), options);
    let (mut bytes, mut sound) = (Vec::new(), Vec::new());
    alone.read_block(BlockId(2), &mut bytes).unwrap();
    model().read_block(BlockId(2), &mut sound).unwrap();
    assert!(bytes != sound);
}

#[test]
fn a_coordinator_that_fell_silent_is_given_up() {
    let roles = quick_roles();
    let (budget, coordinator) = (MemoryBudget::new(Bytes::mib(16)), PeerId(7));
    let mut reader =
        Reader::new(Arc::new(model()), "reader", "reader", Bytes::mib(8), &budget, roles).unwrap();
    let mut actions = Vec::new();
    reader.connected(coordinator, Duration::ZERO, &mut actions);
    let alive = TransportEvent::Frame { peer: coordinator, bytes: Message::Alive.frame() };
    let heard = Duration::from_secs(3);
    reader.handle(heard, alive, &mut actions);
    assert!(reader.is_welcome());
    actions.clear();
    let limit = heard + roles.silence_max;
    reader.tick(limit - Duration::from_millis(1), &mut actions);
    assert!(reader.is_connected());
    assert!(
        actions.iter().all(|action| matches!(action, Action::Send { .. })),
        "it goes on telling that it is alive"
    );
    reader.tick(limit, &mut actions);
    assert!(!reader.is_connected());
    let ended = matches!(actions.last(), Some(Action::Disconnect { peer, .. }) if *peer == coordinator);
    assert!(ended, "{actions:?}");
}
