//! The real state machines of coordinator and workers over a simulated network in simulated time, with seeded kills, hangs,
//! partitions, joins and coordinator restarts. Only rendering is made up: a pixel is a function of its place.

use std::collections::VecDeque;
use std::time::Duration;

use outcrop::MemoryBudget;
use outcrop::cluster::{
    Action, Coordinator, CoordinatorOptions, Job, Record, RoleOptions, Worker, WorkerAction, WorkerEvent,
};
use outcrop::render::{Region, RenderSettings};
use outcrop::scene::{Camera, Scene};
use outcrop::schedule::SchedulerOptions;
use outcrop::transport::{LinkModel, SimNetwork, SimTransport, Transport, TransportEvent};
use outcrop::units::Bytes;

use super::numbers::Random;

const SIZE: [u32; 2] = [171, 130];

fn job() -> Job {
    let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
    Job::new(Scene::new(camera), RenderSettings::new(SIZE[0], SIZE[1]), 7)
}

fn pixel(x: u32, y: u32) -> [f32; 3] {
    let hash = Random(u64::from(x) << 32 | u64::from(y)).bits();
    [hash as u8 as f32, (hash >> 8) as u16 as f32, (hash >> 24) as u16 as f32 / 7.0]
}

fn pixels(region: Region) -> Vec<[f32; 3]> {
    let rows = region.y..region.y + region.height;
    rows.flat_map(|y| (region.x..region.x + region.width).map(move |x| pixel(x, y))).collect()
}

fn options() -> CoordinatorOptions {
    let mut schedule = SchedulerOptions::new(3);
    schedule.lease_min = Duration::from_secs(15);
    CoordinatorOptions { roles: roles(), schedule, readers: 1 }
}

fn roles() -> RoleOptions {
    RoleOptions { heartbeat: Duration::from_secs(1), silence_max: Duration::from_secs(6) }
}

struct SimWorker {
    transport: SimTransport,
    worker: Worker,
    /// Seconds for each pixel.
    slowness: f64,
    /// What is being rendered, until when, by lane.
    rendering: Vec<(Duration, u16, Region)>,
    next_tick: Duration,
    next_try: Duration,
    hung_until: Duration,
    is_alive: bool,
}

impl SimWorker {
    fn new(network: &SimNetwork, number: usize, random: &mut Random, now: Duration) -> SimWorker {
        let lanes = 1 + random.below(2) as u16;
        SimWorker {
            transport: network.open(&format!("worker {number}")),
            worker: Worker::new(&format!("worker {number}"), lanes, Some(7), roles()),
            slowness: 1e-4 * (1.0 + 20.0 * random.unit() * random.unit()),
            rendering: Vec::new(),
            next_tick: now,
            next_try: now,
            hung_until: Duration::ZERO,
            is_alive: true,
        }
    }

    fn next(&self) -> Duration {
        let mut next = self.next_tick;
        if !self.worker.is_connected() {
            next = next.min(self.next_try);
        }
        let next = self.rendering.iter().map(|(end, ..)| *end).fold(next, Duration::min);
        next.max(self.hung_until)
    }

    fn run(&mut self, now: Duration, random: &mut Random) {
        if !self.is_alive || now < self.hung_until {
            return;
        }
        let mut events = VecDeque::new();
        if !self.worker.is_connected() && now >= self.next_try {
            self.next_try = now + Duration::from_millis(700);
            if let Ok(peer) = self.transport.connect("coordinator") {
                events.push_back(WorkerEvent::Connected(peer));
            }
        }
        while let Some(event) = self.transport.take_arrived() {
            events.push_back(WorkerEvent::Network(event));
        }
        let due = |item: &(Duration, u16, Region)| item.0 <= now;
        for (_, lane, region) in self.rendering.extract_if(.., |item| due(item)).collect::<Vec<_>>() {
            let time = Duration::from_secs_f64(self.slowness * region.pixels() as f64);
            let work = region.pixels() as f64;
            events.push_back(WorkerEvent::Rendered { lane, pixels: pixels(region), time, work });
        }
        let mut actions = Vec::new();
        if now >= self.next_tick {
            self.next_tick = now + Duration::from_millis(500);
            self.worker.tick(now, &mut actions);
        }
        loop {
            for action in std::mem::take(&mut actions) {
                match action {
                    WorkerAction::Network(Action::Send { to, frame }) => {
                        if let Err(error) = self.transport.send(to, frame) {
                            let reason = error.to_string();
                            events.push_back(WorkerEvent::Network(TransportEvent::Disconnected {
                                peer: to,
                                reason,
                            }));
                        }
                    }
                    WorkerAction::Network(Action::Disconnect { peer, .. }) => self.transport.disconnect(peer),
                    WorkerAction::Network(Action::Log(_)) | WorkerAction::Readers(_) => {}
                    WorkerAction::Open(_) => {
                        self.rendering.clear();
                        events.push_back(WorkerEvent::Opened);
                    }
                    WorkerAction::Render { lane, region } => {
                        assert!(
                            self.rendering.iter().all(|(_, other, _)| *other != lane),
                            "a lane does one thing"
                        );
                        let jitter = 0.5 + random.unit();
                        let time = self.slowness * jitter * region.pixels() as f64;
                        self.rendering.push((now + Duration::from_secs_f64(time), lane, region));
                    }
                }
            }
            let Some(event) = events.pop_front() else { break };
            self.worker.handle(now, event, &mut actions);
        }
        assert_eq!(self.worker.failure(), None);
    }
}

/// A coordinator while it lives, and what it leaves on disk.
struct SimCoordinator {
    alive: Option<(SimTransport, Coordinator)>,
    disk: Vec<Record>,
    /// Records that are not safe yet.
    unsafe_records: Vec<Record>,
    next_safe: Duration,
    back_at: Duration,
    restarts: u32,
}

impl SimCoordinator {
    fn start(&mut self, network: &SimNetwork) {
        let budget = MemoryBudget::new(Bytes::mib(4));
        let coordinator = Coordinator::restore(job(), options(), self.disk.iter().cloned(), &budget).unwrap();
        self.alive = Some((network.open("coordinator"), coordinator));
        self.unsafe_records.clear();
    }

    fn run(&mut self, network: &SimNetwork, now: Duration) {
        if self.alive.is_none() && now >= self.back_at {
            self.start(network);
        }
        let Some((transport, coordinator)) = &mut self.alive else { return };
        let mut actions = Vec::new();
        if now >= coordinator.next_tick() {
            coordinator.tick(now, &mut actions);
        }
        loop {
            while !actions.is_empty() {
                for action in std::mem::take(&mut actions) {
                    match action {
                        Action::Send { to, frame } => {
                            if let Err(error) = transport.send(to, frame) {
                                let reason = error.to_string();
                                let event = TransportEvent::Disconnected { peer: to, reason };
                                coordinator.handle(now, event, &mut actions);
                            }
                        }
                        Action::Disconnect { peer, .. } => transport.disconnect(peer),
                        Action::Log(_) => {}
                    }
                }
            }
            let Some(event) = transport.take_arrived() else { break };
            coordinator.handle(now, event, &mut actions);
        }
        self.unsafe_records.append(&mut coordinator.take_records());
        if now >= self.next_safe || coordinator.is_finished() {
            self.next_safe = now + Duration::from_secs(1);
            self.disk.append(&mut self.unsafe_records);
        }
    }
}

#[derive(Default, Debug, Clone, Copy, PartialEq, Eq)]
struct Faults {
    kills: u32,
    hangs: u32,
    partitions: u32,
    joins: u32,
    restarts: u32,
}

/// One run: the faults that struck, how long it took in simulated time, and what the last coordinator counted.
fn run(seed: u64) -> (Faults, Duration, u64) {
    let mut random = Random(seed);
    let link = LinkModel {
        latency_min: Duration::from_micros(50),
        latency_max: Duration::from_millis([1, 20, 400][random.below(3) as usize]),
        bytes_per_second: [1e6, 1e8][random.below(2) as usize],
    };
    let network = SimNetwork::new(seed ^ 0x5eed, link);
    let mut coordinator = SimCoordinator {
        alive: None,
        disk: Vec::new(),
        unsafe_records: Vec::new(),
        next_safe: Duration::ZERO,
        back_at: Duration::ZERO,
        restarts: 0,
    };
    coordinator.start(&network);
    let mut workers: Vec<SimWorker> = (0..1 + random.below(5) as usize)
        .map(|i| SimWorker::new(&network, i, &mut random, Duration::ZERO))
        .collect();
    let mut faults = Faults::default();
    // How eventful the run is, from none to a fault each 300 ms.
    let pause = [1e9, 3.0, 1.0, 0.3][random.below(4) as usize];
    let mut next_fault = Duration::from_secs_f64(0.5 * pause * random.unit());
    let mut heal_at = None;
    loop {
        let now = network.now();
        assert!(now < Duration::from_secs(3600), "seed {seed}: an hour and no picture; {faults:?}");
        if heal_at.is_some_and(|heal| now >= heal) {
            network.heal();
            heal_at = None;
        }
        if now >= next_fault {
            next_fault = now + Duration::from_secs_f64(pause * 2.0 * random.unit());
            let chosen = random.below(workers.len() as u64) as usize;
            let alive = workers.iter().filter(|worker| worker.is_alive).count();
            match random.below(6) {
                // Somebody must be left to finish.
                0 if alive > 1 && workers[chosen].is_alive => {
                    faults.kills += 1;
                    workers[chosen].is_alive = false;
                    workers[chosen].transport.close();
                }
                1 => {
                    faults.hangs += 1;
                    workers[chosen].hung_until = now + Duration::from_secs_f64(20.0 * random.unit());
                }
                2 if heal_at.is_none() => {
                    faults.partitions += 1;
                    let groups: Vec<(&SimTransport, u32)> =
                        workers.iter().map(|worker| (&worker.transport, random.below(2) as u32)).collect();
                    network.partition(&groups);
                    heal_at = Some(now + Duration::from_secs_f64(15.0 * random.unit()));
                }
                3 if workers.len() < 12 => {
                    faults.joins += 1;
                    let number = workers.len();
                    workers.push(SimWorker::new(&network, number, &mut random, now));
                }
                4 if coordinator.alive.is_some() && coordinator.restarts < 6 => {
                    faults.restarts += 1;
                    coordinator.restarts += 1;
                    // What was not safe is lost, and of what was being written, any part.
                    let written = random.below(coordinator.unsafe_records.len() as u64 + 1) as usize;
                    coordinator.disk.extend(coordinator.unsafe_records.drain(..written));
                    if let Some((transport, _)) = coordinator.alive.take() {
                        transport.close();
                    }
                    coordinator.back_at = now + Duration::from_secs_f64(5.0 * random.unit());
                }
                _ => {}
            }
        }
        coordinator.run(&network, now);
        for worker in &mut workers {
            worker.run(now, &mut random);
        }
        if let Some((_, coordinator)) = &coordinator.alive
            && coordinator.is_finished()
        {
            let film = coordinator.film();
            assert!(film.is_complete());
            for y in 0..SIZE[1] {
                for x in 0..SIZE[0] {
                    assert_eq!(film.pixel(x, y), pixel(x, y), "seed {seed} at {x}, {y}");
                }
            }
            return (faults, now, coordinator.counters().cells_repeated);
        }
        let mut next = next_fault;
        next = heal_at.map_or(next, |heal| next.min(heal));
        next = match &coordinator.alive {
            Some((_, coordinator)) => next.min(coordinator.next_tick()),
            None => next.min(coordinator.back_at),
        };
        for worker in workers.iter().filter(|worker| worker.is_alive) {
            next = next.min(worker.next());
        }
        next = network.next_arrival().map_or(next, |arrival| next.min(arrival));
        network.advance_to(next.max(now + Duration::from_micros(1)));
    }
}

fn run_many(seeds: std::ops::Range<u64>) {
    let mut all = Faults::default();
    let count = seeds.end - seeds.start;
    for seed in seeds {
        let (faults, ..) = run(seed);
        all.kills += faults.kills;
        all.hangs += faults.hangs;
        all.partitions += faults.partitions;
        all.joins += faults.joins;
        all.restarts += faults.restarts;
    }
    println!("{count} runs: {all:?}");
    // A run in which nothing happens shows little.
    let Faults { kills, hangs, partitions, joins, restarts } = all;
    for strikes in [kills, hangs, partitions, joins, restarts] {
        assert!(u64::from(strikes) > count / 8, "{all:?}");
    }
}

#[test]
fn whatever_fails_the_picture_is_the_same() {
    run_many(0..1000);
}

#[test]
fn the_same_seed_is_the_same_run() {
    for seed in [1, 2, 3] {
        assert_eq!(run(seed), run(seed));
    }
}
