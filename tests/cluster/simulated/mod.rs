//! The real state machines of coordinator, workers and readers, and of the asking side of readers, over a simulated network in simulated
//! time, with seeded kills, hangs, partitions, joins and coordinator restarts, and with readers that are killed, hang, come late, refuse
//! blocks and send damaged ones. Only rendering is made up: a pixel is a function of its place and of the bytes of its blocks.

mod picture;
mod reader;
mod worker;

use std::time::Duration;

use outcrop::MemoryBudget;
use outcrop::cluster::{Action, Coordinator, CoordinatorOptions, Record, RemoteCounters, RoleOptions};
use outcrop::schedule::{PieceChoice, SchedulerOptions};
use outcrop::source::testing::FaultRates;
use outcrop::transport::{LinkModel, SimNetwork, SimTransport, Transport, TransportEvent};
use outcrop::units::Bytes;

use self::reader::{ReaderTotals, SimReader, Troubles};
use self::worker::{Fetched, SimWorker};
use super::numbers::Random;

fn options(readers: usize, choice: PieceChoice) -> CoordinatorOptions {
    let mut schedule = SchedulerOptions::new(3);
    // Which piece is taken over must not show; half of the runs have each way.
    schedule.piece_choice = choice;
    schedule.lease_min = Duration::from_secs(15);
    CoordinatorOptions { roles: roles(), schedule, readers }
}

fn roles() -> RoleOptions {
    RoleOptions { heartbeat: Duration::from_secs(1), silence_max: Duration::from_secs(6) }
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
    /// Readers over which blocks are shared out.
    readers: usize,
    choice: PieceChoice,
}

impl SimCoordinator {
    fn start(&mut self, network: &SimNetwork) {
        let budget = MemoryBudget::new(Bytes::mib(4));
        let coordinator = Coordinator::restore(
            picture::job(),
            options(self.readers, self.choice),
            self.disk.iter().cloned(),
            &budget,
        )
        .unwrap();
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
    reader_kills: u32,
    reader_hangs: u32,
    reader_joins: u32,
}

impl Faults {
    fn add(&mut self, other: &Faults) {
        self.kills += other.kills;
        self.hangs += other.hangs;
        self.partitions += other.partitions;
        self.joins += other.joins;
        self.restarts += other.restarts;
        self.reader_kills += other.reader_kills;
        self.reader_hangs += other.reader_hangs;
        self.reader_joins += other.reader_joins;
    }
}

/// What came of a run.
#[derive(Clone, Copy, Default, Debug, PartialEq, Eq)]
struct Outcome {
    faults: Faults,
    /// Simulated time.
    time: Duration,
    /// What the last coordinator counted.
    cells_repeated: u64,
    /// Of all workers.
    remote: RemoteCounters,
    fetched: Fetched,
    /// Of all readers.
    readers: ReaderTotals,
}

impl Outcome {
    fn add_worker(&mut self, remote: RemoteCounters, fetched: Fetched) {
        let sum = &mut self.remote;
        sum.from_owner += remote.from_owner;
        sum.from_other += remote.from_other;
        sum.from_replica += remote.from_replica;
        sum.from_fallback += remote.from_fallback;
        sum.from_copy += remote.from_copy;
        sum.bytes_received += remote.bytes_received;
        sum.damaged += remote.damaged;
        sum.readers_lost += remote.readers_lost;
        sum.requests += remote.requests;
        self.fetched.over_network += fetched.over_network;
        self.fetched.from_own += fetched.from_own;
        self.fetched.own_damaged += fetched.own_damaged;
        self.fetched.asked += fetched.asked;
    }

    /// Counters add up, whatever happened.
    fn check(&self, seed: u64) {
        let Outcome { remote, fetched, readers, .. } = self;
        assert_eq!(
            remote.from_owner + remote.from_other + remote.from_replica,
            fetched.over_network,
            "seed {seed}"
        );
        assert_eq!(remote.from_fallback + remote.from_copy, fetched.from_own, "seed {seed}");
        // Nothing is called damaged that was not.
        let damage = readers.frames_damaged + readers.disk_faults + fetched.own_damaged;
        assert!(remote.damaged <= damage, "seed {seed}: {self:?}");
        // Readers were asked for nothing that nobody asked for, and gave what came. (Two lanes may take what came once.)
        let ReaderTotals { counters, .. } = readers;
        assert!(counters.blocks_asked <= fetched.asked, "seed {seed}: {self:?}");
        assert!(remote.bytes_received <= counters.bytes_sent, "seed {seed}: {self:?}");
        assert!(counters.blocks_from_disk + counters.blocks_failed <= counters.blocks_asked, "seed {seed}");
        assert_eq!(counters.bad_frames, 0, "seed {seed}");
        if self.faults == Faults::default() && damage == 0 {
            assert_eq!((remote.readers_lost, remote.damaged), (0, 0), "seed {seed}");
        }
    }
}

/// One run.
fn run(seed: u64) -> Outcome {
    let mut random = Random(seed);
    let link = LinkModel {
        latency_min: Duration::from_micros(50),
        latency_max: Duration::from_millis([1, 20, 400][random.below(3) as usize]),
        bytes_per_second: [1e6, 1e8][random.below(2) as usize],
    };
    let network = SimNetwork::new(seed ^ 0x5eed, link);
    // Readers draw from numbers of their own.
    let mut numbers = Random(seed ^ 0x7ead);
    let disk = FaultRates { io_errors: numbers.pick(&[0.0, 0.0, 0.2]), ..FaultRates::default() };
    let disk = FaultRates { bit_flips: numbers.pick(&[0.0, 0.0, 0.2]), ..disk };
    let troubles = Troubles { disk, damaged_frames: numbers.pick(&[0.0, 0.01, 0.1]) };
    let own_damaged = numbers.pick(&[0.0, 0.1]);
    let mut readers: Vec<SimReader> = Vec::new();
    let mut add_reader = |readers: &mut Vec<SimReader>, now: Duration| {
        let memory = Bytes(numbers.pick(&[0, 16 << 10, 1 << 20]));
        readers.push(SimReader::new(readers.len(), memory, troubles, now));
    };
    let shares = 1 + random.below(3) as usize;
    (0..1 + random.below(shares as u64)).for_each(|_| add_reader(&mut readers, Duration::ZERO));
    let mut coordinator = SimCoordinator {
        alive: None,
        disk: Vec::new(),
        unsafe_records: Vec::new(),
        next_safe: Duration::ZERO,
        back_at: Duration::ZERO,
        restarts: 0,
        readers: shares,
        choice: [PieceChoice::Near, PieceChoice::Held][(seed % 2) as usize],
    };
    coordinator.start(&network);
    let mut workers: Vec<SimWorker> = (0..1 + random.below(5) as usize)
        .map(|i| SimWorker::new(&network, i, own_damaged, &mut random, Duration::ZERO))
        .collect();
    let mut faults = Faults::default();
    // How eventful the run is, from none to a fault each 200 ms.
    let pause = [1e9, 2.0, 0.7, 0.2][random.below(4) as usize];
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
            let reader = random.below(readers.len() as u64) as usize;
            match random.below(9) {
                // Somebody must be left to finish.
                0 if alive > 1 && workers[chosen].is_alive => {
                    faults.kills += 1;
                    workers[chosen].kill();
                }
                1 => {
                    faults.hangs += 1;
                    workers[chosen].hung_until = now + Duration::from_secs_f64(20.0 * random.unit());
                }
                2 if heal_at.is_none() => {
                    faults.partitions += 1;
                    let mut groups: Vec<(&SimTransport, u32)> = Vec::new();
                    for worker in &workers {
                        let group = random.below(2) as u32;
                        groups.extend([(&worker.control, group), (&worker.data, group)]);
                    }
                    for reader in readers.iter().filter_map(SimReader::transport) {
                        groups.push((reader, random.below(2) as u32));
                    }
                    network.partition(&groups);
                    heal_at = Some(now + Duration::from_secs_f64(15.0 * random.unit()));
                }
                3 if workers.len() < 12 => {
                    faults.joins += 1;
                    let number = workers.len();
                    workers.push(SimWorker::new(&network, number, own_damaged, &mut random, now));
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
                // One that is killed comes back, some time, with nothing in memory.
                5 if readers[reader].is_alive() => {
                    faults.reader_kills += 1;
                    readers[reader].kill(now + Duration::from_secs_f64(15.0 * random.unit()));
                }
                6 => {
                    faults.reader_hangs += 1;
                    readers[reader].hung_until = now + Duration::from_secs_f64(15.0 * random.unit());
                }
                7 if readers.len() < 4 => {
                    faults.reader_joins += 1;
                    add_reader(&mut readers, now);
                }
                _ => {}
            }
        }
        coordinator.run(&network, now);
        for reader in &mut readers {
            reader.run(&network, now, &mut random);
        }
        for worker in &mut workers {
            worker.run(now, &mut random);
        }
        if let Some((_, coordinator)) = &coordinator.alive
            && coordinator.is_finished()
        {
            let film = coordinator.film();
            assert!(film.is_complete());
            assert!(film.pixels() == picture::reference(), "seed {seed}: another picture");
            let cells_repeated = coordinator.counters().cells_repeated;
            let mut outcome = Outcome { faults, time: now, cells_repeated, ..Outcome::default() };
            for worker in &workers {
                let (remote, fetched) = worker.counters();
                outcome.add_worker(remote, fetched);
            }
            readers.iter().for_each(|reader| outcome.readers.add(&reader.totals()));
            outcome.check(seed);
            return outcome;
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
        for reader in &readers {
            next = next.min(reader.next());
        }
        next = network.next_arrival().map_or(next, |arrival| next.min(arrival));
        network.advance_to(next.max(now + Duration::from_micros(1)));
    }
}

fn run_many(seeds: std::ops::Range<u64>) {
    let mut all = Outcome::default();
    let count = seeds.end - seeds.start;
    for seed in seeds {
        let outcome = run(seed);
        all.faults.add(&outcome.faults);
        all.add_worker(outcome.remote, outcome.fetched);
        all.readers.add(&outcome.readers);
        all.cells_repeated += outcome.cells_repeated;
        all.time += outcome.time;
    }
    println!("{count} runs: {all:#?}");
    // A run in which nothing happens shows little.
    let Faults { kills, hangs, partitions, joins, restarts, reader_kills, reader_hangs, reader_joins } =
        all.faults;
    let of_readers = [reader_kills, reader_hangs, reader_joins];
    for strikes in [kills, hangs, partitions, joins, restarts].into_iter().chain(of_readers) {
        assert!(u64::from(strikes) > count / 8, "{all:?}");
    }
    // Nor does one in which blocks take only one way.
    let RemoteCounters { from_owner, from_other, from_replica, from_fallback, from_copy, .. } = all.remote;
    for blocks in [from_owner, from_other, from_fallback, from_copy] {
        assert!(blocks > count, "{all:?}");
    }
    // A picture of a few hundred cells makes few blocks hot.
    assert!(from_replica > count / 8, "{all:?}");
    for troubles in [all.remote.damaged, all.remote.readers_lost, all.readers.counters.blocks_failed] {
        assert!(troubles > count / 2, "{all:?}");
    }
}

#[test]
fn whatever_fails_the_picture_is_the_same() {
    run_many(0..1000);
}

#[test]
fn the_same_seed_is_the_same_run() {
    for seed in [1, 2, 3, 7] {
        assert_eq!(run(seed), run(seed));
    }
}
