//! What one member's messages can do to the state machines of others.

use std::time::Duration;

use outcrop::MemoryBudget;
use outcrop::access::BlockSketch;
use outcrop::cluster::{
    Action, Coordinator, CoordinatorError, LeasedCells, MESSAGE_VERSION, Message, Record, Role, Worker,
    WorkerAction, WorkerEvent,
};
use outcrop::scene::Light;
use outcrop::transport::{PeerId, TransportEvent};
use outcrop::units::Bytes;

use super::support::{coordinator_options, job, quick_roles};

const NOW: Duration = Duration::from_secs(1);

fn coordinator() -> Coordinator {
    Coordinator::new(job(), coordinator_options(1, 1), &MemoryBudget::new(Bytes::mib(16))).unwrap()
}

fn hello(role: Role, model: Option<u64>, version: u16) -> Message {
    Message::Hello { version, role, name: "n".repeat(1000), address: None, model }
}

/// What the coordinator does about a node that connects and says this.
fn say(coordinator: &mut Coordinator, peer: PeerId, frames: &[Vec<u8>]) -> Vec<Action> {
    let mut actions = Vec::new();
    coordinator.handle(NOW, TransportEvent::Connected { peer, name: "node".to_owned() }, &mut actions);
    for bytes in frames {
        coordinator.handle(NOW, TransportEvent::Frame { peer, bytes: bytes.clone() }, &mut actions);
    }
    actions
}

fn result(tile: u32, cells: u64, pixels: usize) -> Vec<u8> {
    let what = LeasedCells { lease: 1, tile, cells };
    let blocks = BlockSketch::default();
    Message::Result { lane: 0, what, is_last: true, micros: 1, work: 1.0, blocks }
        .frame_with(&vec![0; 12 * pixels])
}

#[test]
fn a_job_that_nobody_can_render_is_refused_before_workers_come() {
    let refused = |job| {
        let budget = MemoryBudget::new(Bytes::mib(16));
        let error = Coordinator::new(job, coordinator_options(1, 1), &budget).map(drop).unwrap_err();
        assert!(matches!(error, CoordinatorError::Job(_)), "{error}");
        error.to_string()
    };
    let mut without_samples = job();
    without_samples.settings.samples_per_pixel = 0;
    assert!(refused(without_samples).contains("samples per pixel"));
    let mut too_dark = job();
    too_dark.scene = too_dark.scene.with_light(Light::point([0.0; 3], [-1.0; 3]));
    assert!(refused(too_dark).contains("light"));
}

#[test]
fn one_that_says_hello_for_ever_takes_up_no_room() {
    let mut coordinator = coordinator();
    let worker = hello(Role::Worker { lanes: 1024 }, None, MESSAGE_VERSION).frame();
    for peer in 0..100 {
        let peer = PeerId(peer);
        say(&mut coordinator, peer, &[worker.clone(), result(0, 0, 0)]);
        assert_eq!(coordinator.members().0, 1);
        let reason = "enough".to_owned();
        coordinator.handle(NOW, TransportEvent::Disconnected { peer, reason }, &mut Vec::new());
    }
    assert_eq!((coordinator.counters().joined, coordinator.counters().results), (100, 100));
    assert!(coordinator.lanes().is_empty());
    // Who returns cells is on the list, once, and they are known as its own.
    say(&mut coordinator, PeerId(100), &[worker, result(0, 1, 64), result(0, 2, 64), result(0, 2, 64)]);
    let lanes: Vec<_> = coordinator.lanes().iter().map(|lane| (lane.worker.len(), lane.lane)).collect();
    assert_eq!(lanes, [(1000, 0)]);
    assert_eq!(coordinator.owners().iter().flatten().collect::<Vec<_>>(), [&0, &0]);
    assert_eq!(coordinator.spans().len(), 3);
}

#[test]
fn nodes_that_are_not_wanted_are_told_why() {
    let worker = Role::Worker { lanes: 1 };
    let other = job().model ^ 1;
    for (hello, told) in [
        (hello(worker, Some(other), MESSAGE_VERSION), "another model"),
        (hello(Role::Reader, Some(other), MESSAGE_VERSION), "another model"),
        (hello(worker, None, MESSAGE_VERSION + 1), "version"),
        (hello(Role::Worker { lanes: 0 }, None, MESSAGE_VERSION), "lanes"),
        (hello(Role::Reader, Some(job().model), MESSAGE_VERSION), "address"),
        (hello(Role::Reader, None, MESSAGE_VERSION), "must have a model"),
    ] {
        let actions = say(&mut coordinator(), PeerId(1), &[hello.frame()]);
        let refusal = actions.iter().position(|action| match action {
            Action::Send { frame, .. } => {
                matches!(Message::parse(frame), Ok((Message::Refused { reason }, _)) if reason.contains(told))
            }
            _ => false,
        });
        let end = actions.iter().position(|action| matches!(action, Action::Disconnect { .. }));
        assert!(refusal.is_some() && refusal < end, "{hello:?}: {actions:?}");
    }
}

#[test]
fn a_record_of_a_tile_that_does_not_exist_is_another_pictures() {
    let mut first = coordinator();
    let worker = hello(Role::Worker { lanes: 1 }, None, MESSAGE_VERSION).frame();
    say(&mut first, PeerId(1), &[worker, result(0, 1, 64)]);
    let mut records = first.take_records();
    let restore = |records: &[Record]| {
        let budget = MemoryBudget::new(Bytes::mib(16));
        Coordinator::restore(job(), coordinator_options(1, 1), records.iter().cloned(), &budget)
    };
    assert_eq!(restore(&records).unwrap().progress().cells_done, 1);
    for tile in [12, u32::MAX] {
        records.push(Record::Result(result(tile, 0, 0)));
        assert!(matches!(restore(&records), Err(CoordinatorError::OtherRecords)));
        records.pop();
    }
}

#[test]
fn a_worker_takes_no_tile_that_does_not_exist() {
    for (tile, is_there) in [(11, true), (12, false), (u32::MAX, false)] {
        let peer = PeerId(1);
        let mut worker = Worker::new("worker", 1, None, quick_roles());
        let what = LeasedCells { lease: 1, tile, cells: 0 };
        let mut actions = Vec::new();
        worker.handle(NOW, WorkerEvent::Connected(peer), &mut actions);
        assert!(!worker.is_welcome());
        for message in
            [Message::Job(Box::new(job())), Message::Assign { lane: 0, what, stop_after_us: u64::MAX }]
        {
            let event = TransportEvent::Frame { peer, bytes: message.frame() };
            worker.handle(NOW, WorkerEvent::Network(event), &mut actions);
        }
        let ends = |action: &WorkerAction| matches!(action, WorkerAction::Network(Action::Disconnect { .. }));
        assert_eq!(!actions.iter().any(ends), is_there, "tile {tile}: {actions:?}");
        assert_eq!(worker.is_welcome(), is_there);
    }
}
