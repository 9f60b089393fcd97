//! Any bytes as a frame: parsed, and given to each role as if a member had sent it.
#![no_main]

use std::sync::{Arc, OnceLock};
use std::time::Duration;

use libfuzzer_sys::fuzz_target;
use outcrop::MemoryBudget;
use outcrop::block::{BlockLimits, Codec};
use outcrop::cluster::{
    Coordinator, CoordinatorOptions, Job, MESSAGE_VERSION, Message, Reader, Role, RoleOptions, Worker, WorkerEvent,
};
use outcrop::geom::Precision;
use outcrop::render::RenderSettings;
use outcrop::scene::{Camera, Scene};
use outcrop::schedule::SchedulerOptions;
use outcrop::source::MemorySource;
use outcrop::source::testing::memory_model;
use outcrop::transport::{PeerId, TransportEvent};
use outcrop::units::Bytes;

fn file() -> Arc<[u8]> {
    static FILE: OnceLock<Arc<[u8]>> = OnceLock::new();
    let triangles = [[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]];
    let limits = BlockLimits { block_bytes_max: 4096 };
    let make = || memory_model(&triangles, limits, Codec::Raw, Precision::Float32).expect("a sound triangle").into();
    Arc::clone(FILE.get_or_init(make))
}

fuzz_target!(|input: &[u8]| {
    if let Ok((message, tail)) = Message::parse(input) {
        let again = message.frame_with(tail);
        // Not all numbers have one form only, but what is written is read.
        assert!(Message::parse(&again).is_ok());
    }
    let budget = MemoryBudget::new(Bytes::mib(16));
    let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).expect("a sound camera");
    let job = Job::new(Scene::new(camera), RenderSettings::new(70, 40), 7);
    let (peer, now) = (PeerId(1), Duration::from_secs(1));
    let frame = |bytes: &[u8]| TransportEvent::Frame { peer, bytes: bytes.to_vec() };
    let mut actions = Vec::new();

    let options = CoordinatorOptions {
        roles: RoleOptions::default(),
        schedule: SchedulerOptions::new(2),
        readers: 1,
    };
    let mut coordinator = Coordinator::new(job.clone(), options, &budget).expect("a sound job");
    coordinator.handle(now, TransportEvent::Connected { peer, name: "fuzz".to_owned() }, &mut actions);
    coordinator.handle(now, frame(input), &mut actions);
    coordinator.handle(now, TransportEvent::Connected { peer, name: "fuzz".to_owned() }, &mut actions);
    let hello = Message::Hello {
        version: MESSAGE_VERSION,
        role: Role::Worker { lanes: 2 },
        name: "fuzz".to_owned(),
        address: None,
        model: None,
    };
    coordinator.handle(now, frame(&hello.frame()), &mut actions);
    coordinator.handle(now, frame(input), &mut actions);
    coordinator.tick(2 * now, &mut actions);

    let mut worker = Worker::new("fuzz", 2, None, RoleOptions::default());
    let mut actions = Vec::new();
    worker.handle(now, WorkerEvent::Connected(peer), &mut actions);
    for bytes in [&Message::Job(Box::new(job)).frame()[..], input] {
        worker.handle(now, WorkerEvent::Network(frame(bytes)), &mut actions);
        worker.handle(now, WorkerEvent::Opened, &mut actions);
    }

    let source = Arc::new(MemorySource::new(file()).expect("a sound file"));
    let mut reader =
        Reader::new(source, "fuzz", "nowhere", Bytes::mib(1), &budget, RoleOptions::default()).expect("it fits");
    reader.handle(now, frame(input), &mut Vec::new());
});
