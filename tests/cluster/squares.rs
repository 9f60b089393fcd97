//! How much a worker has its lane render at once.

use std::time::Duration;

use outcrop::access::BlockSketch;
use outcrop::cluster::{LeasedCells, Message, Worker, WorkerAction, WorkerEvent};
use outcrop::render::Region;
use outcrop::transport::{PeerId, TransportEvent};

use super::support::{job, quick_roles};

/// The sides of the squares that a worker renders of a tile, if each takes so long.
fn sides(mut worker: Worker, time: Duration) -> Vec<[u32; 2]> {
    let (peer, mut now) = (PeerId(1), Duration::ZERO);
    let hear =
        |message: Message| WorkerEvent::Network(TransportEvent::Frame { peer, bytes: message.frame() });
    let what = LeasedCells { lease: 1, tile: 0, cells: u64::MAX };
    let mut events = vec![
        WorkerEvent::Connected(peer),
        hear(Message::Job(Box::new(job()))),
        WorkerEvent::Opened,
        hear(Message::Assign { lane: 0, what, stop_after_us: u64::MAX }),
    ];
    let mut sides = Vec::new();
    while !events.is_empty() {
        let mut actions = Vec::new();
        events.drain(..).for_each(|event| worker.handle(now, event, &mut actions));
        for action in actions {
            if let WorkerAction::Render { lane, region } = action {
                let Region { width, height, .. } = region;
                sides.push([width, height]);
                let pixels = vec![[0.5; 3]; region.pixels() as usize];
                events.push(WorkerEvent::Rendered {
                    lane,
                    pixels,
                    time,
                    work: 1.0,
                    blocks: BlockSketch::default(),
                });
            }
        }
        now += time;
    }
    assert_eq!(sides.iter().map(|[width, height]| width * height).sum::<u32>(), 64 * 64);
    assert_eq!(worker.counters().cells, 64);
    sides
}

#[test]
fn squares_take_about_the_time_that_they_should() {
    let worker = || Worker::new("worker", 1, Some(7), quick_roles());
    let ms = Duration::from_millis;
    // A quarter of a tile to begin with.
    assert_eq!(sides(worker(), ms(100)), [[32; 2]; 4]);
    let slow = sides(worker(), ms(300));
    assert_eq!((slow[0], slow[1], slow[2]), ([32; 2], [16; 2], [8; 2]));
    assert_eq!(sides(worker().with_square_time(ms(1000)), ms(300)), [[32; 2]; 4]);
    let slow = sides(worker().with_square_time(ms(1000)), ms(2001));
    assert_eq!((slow[0], slow[1]), ([32; 2], [16; 2]));
}
