//! Whole clusters in one process: every transport, several mixes of roles, with and without faults. The picture is always that of one
//! machine, bit for bit.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use outcrop::cluster::{
    Coordinator, CoordinatorCounters, CoordinatorError, NodeError, Reader, ReaderCounters, RemoteCounters,
    WorkerOptions, WorkerReport, run_coordinator, run_reader, run_worker,
};
use outcrop::compile::Control;
use outcrop::render::WaitingRays;
use outcrop::scene::{Environment, EnvironmentImage};
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::transport::{LocalNetwork, SharedKey, TcpOptions, TcpTransport, Transport, TransportEvent};
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

use super::support::{coordinator_options, job, model, quick_roles, reference, worker_options};

const PATIENCE: Duration = Duration::from_secs(120);

/// Opens nodes of one network.
pub trait Network: Sync {
    fn open(&self, name: &str) -> Arc<dyn Transport>;
}

impl Network for LocalNetwork {
    fn open(&self, name: &str) -> Arc<dyn Transport> {
        Arc::new(LocalNetwork::open(self, name))
    }
}

pub struct Tcp(pub SharedKey);

impl Network for Tcp {
    fn open(&self, name: &str) -> Arc<dyn Transport> {
        Arc::new(TcpTransport::open(self.0.clone(), TcpOptions::loopback(name)).unwrap())
    }
}

/// A mix of roles.
struct Mix {
    /// Lanes of each worker, and whether it has the file.
    workers: Vec<(u16, bool)>,
    readers: usize,
    /// Readers that are there but give damaged blocks now and then.
    faulty_readers: bool,
    /// After so many cells, one reader and one worker end as if they had been killed.
    kills_after: Option<u64>,
    /// Rays of a worker that may wait, and threads that load for them.
    waiting: (WaitingRays, u32),
}

struct Outcome {
    coordinator: CoordinatorCounters,
    workers: Vec<Result<WorkerReport, NodeError>>,
    readers: Vec<ReaderCounters>,
}

/// A faulty file that can still be read as a whole.
struct FaultyFile {
    faulty: FaultySource<outcrop::source::MemorySource>,
    whole: outcrop::source::MemorySource,
}

impl BlockSource for FaultyFile {
    fn model(&self) -> &Arc<outcrop::model::Model> {
        self.whole.model()
    }

    fn read_block(
        &self,
        block: outcrop::units::BlockId,
        into: &mut Vec<u8>,
    ) -> Result<(), outcrop::error::SourceError> {
        self.faulty.read_block(block, into)
    }
}

impl outcrop::cluster::ModelFile for FaultyFile {
    fn file_bytes(&self) -> std::io::Result<u64> {
        self.whole.file_bytes()
    }

    fn read_range(&self, offset: u64, into: &mut [u8]) -> std::io::Result<()> {
        self.whole.read_range(offset, into)
    }
}

fn reader_of(transport: &dyn Transport, name: &str, faulty: bool) -> Reader {
    // Not so often that every worker gives every reader up.
    let rates = FaultRates { bit_flips: 0.1, short_reads: 0.05, io_errors: 0.05 };
    let rates = if faulty { rates } else { FaultRates::default() };
    let file = FaultyFile { faulty: FaultySource::new(model(), 5, rates), whole: model() };
    let budget = MemoryBudget::new(Bytes::mib(16));
    let address = transport.address().unwrap();
    // A faulty reader keeps nothing, or it would keep damaged blocks.
    let memory = if faulty { Bytes(0) } else { Bytes::mib(8) };
    Reader::new(Arc::new(file), name, &address, memory, &budget, quick_roles()).unwrap()
}

fn render(network: &dyn Network, mix: &Mix) -> Outcome {
    let hub = network.open("coordinator");
    let address = hub.address().unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = coordinator_options(mix.workers.len() as u32, mix.readers);
    let coordinator = Coordinator::new(job(), options, &budget).unwrap();
    let (never, kill) = (AtomicBool::new(false), AtomicBool::new(false));
    // Workers begin when all readers are there.
    let gathered = AtomicBool::new(mix.readers == 0);
    thread::scope(|scope| {
        let readers: Vec<_> = (0..mix.readers)
            .map(|i| {
                let address = &address;
                let stop = if i == 0 { &kill } else { &never };
                scope.spawn(move || {
                    let name = format!("reader {i}");
                    let transport = network.open(&name);
                    let reader = reader_of(&*transport, &name, mix.faulty_readers);
                    run_reader(&*transport, reader, address, PATIENCE, stop, &mut |_| {}).unwrap()
                })
            })
            .collect();
        let workers: Vec<_> = mix
            .workers
            .iter()
            .enumerate()
            .map(|(i, (lanes, has_file))| {
                let (address, gathered) = (&address, &gathered);
                let stop = if i == 0 && mix.workers.len() > 1 { &kill } else { &never };
                scope.spawn(move || {
                    let start = Instant::now();
                    while !gathered.load(Ordering::Relaxed) && start.elapsed() < PATIENCE {
                        thread::sleep(Duration::from_millis(1));
                    }
                    let name = format!("worker {i}");
                    let (control, data) = (network.open(&name), network.open(&format!("{name}, data")));
                    let file = has_file.then(|| Arc::new(model()) as Arc<dyn BlockSource>);
                    let (waiting, loader_threads) = mix.waiting;
                    let options =
                        WorkerOptions { waiting, loader_threads, ..worker_options(&name, *lanes, file) };
                    run_worker(&*control, &data, address, &options, stop, &mut |_| {})
                })
            })
            .collect();
        let mut observe = |coordinator: &Coordinator, _: &[String]| {
            if coordinator.members().1 >= mix.readers {
                gathered.store(true, Ordering::Relaxed);
            }
            if mix.kills_after.is_some_and(|cells| coordinator.progress().cells_done >= cells) {
                kill.store(true, Ordering::Relaxed);
            }
            Control::Continue
        };
        let done = run_coordinator(&*hub, coordinator, None, PATIENCE, &mut observe).unwrap();
        assert!(done.film().is_complete());
        assert!(done.film().pixels() == &reference()[..], "the picture is another one");
        let counters = done.counters();
        assert!(done.owners().iter().flatten().count() as u64 == done.progress().cells);
        hub.close();
        Outcome {
            coordinator: counters,
            workers: workers.into_iter().map(|worker| worker.join().unwrap()).collect(),
            readers: readers.into_iter().map(|reader| reader.join().unwrap()).collect(),
        }
    })
}

fn mix(workers: &[(u16, bool)], readers: usize) -> Mix {
    Mix {
        workers: workers.to_vec(),
        readers,
        faulty_readers: false,
        kills_after: None,
        waiting: (WaitingRays::Never, 0),
    }
}

/// The suite: every mix over one kind of network. `open` gives a new network each time.
fn every_mix(open: &dyn Fn() -> Box<dyn Network>) {
    for workers in [&[(1, true)][..], &[(1, true), (1, true), (1, true)], &[(3, true), (1, true)]] {
        let outcome = render(&*open(), &mix(workers, 0));
        assert_eq!(outcome.coordinator.lost, 0);
        for worker in outcome.workers {
            assert_eq!(worker.unwrap().remote, None);
        }
    }
    // Workers with the file that hold a part of the blocks for each other: none asks its own disk.
    let outcome = render(&*open(), &mix(&[(1, true), (2, true), (1, true)], 3));
    let remotes: Vec<_> = outcome.workers.into_iter().filter_map(|worker| worker.unwrap().remote).collect();
    let from_disk: u64 = outcome.readers.iter().map(|reader| reader.blocks_from_disk).sum();
    assert!(remotes.iter().any(|remote| remote.from_owner > 0), "{remotes:?}");
    assert!(remotes.iter().all(|remote| (remote.from_other, remote.from_fallback) == (0, 0)), "{remotes:?}");
    assert!(from_disk > 0 && from_disk <= model().model().blocks.len() as u64, "{:?}", outcome.readers);
    // Sharing: nobody but the readers has the file.
    for readers in [1, 3] {
        let outcome = render(&*open(), &mix(&[(1, false), (2, false)], readers));
        let mut received = 0;
        for worker in outcome.workers {
            // One that came late may have had nothing to do.
            let remote = worker.unwrap().remote.unwrap_or_default();
            assert_eq!((remote.from_fallback, remote.damaged), (0, 0), "{remote:?}");
            received += remote.from_owner + remote.from_other;
        }
        let sum = |count: fn(&ReaderCounters) -> u64| outcome.readers.iter().map(count).sum::<u64>();
        assert!(received > 0 && received <= sum(|reader| reader.blocks_asked));
        // Each block leaves the disk once.
        let blocks = model().model().blocks.len() as u64;
        assert!(sum(|reader| reader.blocks_from_disk) <= blocks);
        assert!(outcome.readers.iter().all(|reader| reader.blocks_asked > 0), "{:?}", outcome.readers);
    }
}

#[test]
fn in_one_process() {
    every_mix(&|| Box::new(LocalNetwork::new()));
}

#[test]
fn over_tcp() {
    every_mix(&|| Box::new(Tcp(SharedKey::generate().unwrap())));
}

/// Rays that wait for blocks, in workers with the file and without, with and without others that load for them.
#[test]
fn rays_of_workers_wait() {
    for (rays, loaders) in [(200, 0), (3000, 3)] {
        for readers in [0, 2] {
            let mut mix = mix(&[(1, readers == 0), (2, readers == 0)], readers);
            mix.waiting = (WaitingRays::Count(rays), loaders);
            let outcome = render(&LocalNetwork::new(), &mix);
            assert_eq!(outcome.coordinator.lost, 0);
            let reports: Vec<_> = outcome.workers.into_iter().map(Result::unwrap).collect();
            assert!(reports.iter().any(|report| report.trace.suspended_peak > 0), "{reports:?}");
            // Several blocks are asked for at one time, where others than the lanes ask.
            let in_flight = reports.iter().map(|report| report.loads.in_flight_peak).max().unwrap();
            assert!(if loaders > 0 { in_flight > 1 } else { in_flight == 0 }, "{reports:?}");
        }
    }
    // The render decides for itself; here nothing but mirrors and glass, for which it does not pay.
    let mut mix = mix(&[(2, false)], 1);
    mix.waiting = (WaitingRays::Auto, 1);
    let outcome = render(&LocalNetwork::new(), &mix);
    assert!(outcome.workers.iter().all(|report| report.as_ref().unwrap().trace.suspended_peak == 0));
}

#[test]
fn a_reader_and_a_worker_end_in_mid_render() {
    for file in [true, false] {
        let kills_after = Some(100);
        let outcome =
            render(&LocalNetwork::new(), &Mix { kills_after, ..mix(&[(1, file), (2, file), (1, file)], 2) });
        assert_eq!(outcome.workers.iter().filter(|worker| worker.is_ok()).count(), 3);
        assert!(outcome.coordinator.lost >= 1, "{:?}", outcome.coordinator);
    }
}

#[test]
fn damaged_blocks_are_asked_for_again_and_counted() {
    // The file is there as the last resort.
    let mix = Mix { faulty_readers: true, ..mix(&[(2, true), (1, true)], 2) };
    let outcome = render(&Tcp(SharedKey::generate().unwrap()), &mix);
    // One that came late may have had nothing to do.
    let remotes: Vec<_> = outcome.workers.into_iter().filter_map(|worker| worker.unwrap().remote).collect();
    let sum = |count: fn(&RemoteCounters) -> u64| remotes.iter().map(count).sum::<u64>();
    assert!(sum(|remote| remote.damaged) > 0, "{remotes:?}");
    assert!(sum(|remote| remote.from_owner) > 0, "{remotes:?}");
}

#[test]
fn a_worker_with_another_model_is_turned_away() {
    let network = LocalNetwork::new();
    let hub = Network::open(&network, "coordinator");
    let budget = MemoryBudget::new(Bytes::mib(64));
    let mut wrong = job();
    wrong.model ^= 1;
    let coordinator = Coordinator::new(wrong, coordinator_options(1, 0), &budget).unwrap();
    let stop = AtomicBool::new(false);
    thread::scope(|scope| {
        let worker = scope.spawn(|| {
            let (control, data) = (Network::open(&network, "worker"), Network::open(&network, "data"));
            let options = worker_options("worker", 1, Some(Arc::new(model())));
            run_worker(&*control, &data, "coordinator", &options, &stop, &mut |_| {}).map(drop)
        });
        let reader = scope.spawn(|| {
            let transport = Network::open(&network, "reader");
            let reader = reader_of(&*transport, "reader", false);
            run_reader(&*transport, reader, "coordinator", PATIENCE, &stop, &mut |_| {}).map(drop)
        });
        let mut lines = Vec::new();
        let mut observe = |_: &Coordinator, log: &[String]| {
            lines.extend_from_slice(log);
            Control::Continue
        };
        let result = run_coordinator(&*hub, coordinator, None, Duration::from_millis(700), &mut observe);
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(result, Err(NodeError::NoWorkers { .. })));
        assert!(lines.iter().any(|line| line.contains("another model")), "{lines:?}");
        // Each was told once, and did not come again.
        assert_eq!(lines.iter().filter(|line| line.contains("another model")).count(), 2, "{lines:?}");
        for node in [worker, reader] {
            let error = node.join().unwrap().unwrap_err();
            assert!(matches!(error, NodeError::Refused { .. }), "{error}");
            assert!(error.to_string().contains("the coordinator has another model"), "{error}");
        }
    });
}

/// A coordinator that takes connections and says nothing, or ends each of them, is none.
#[test]
fn patience_is_for_a_coordinator_that_says_something() {
    let patience = Duration::from_millis(300);
    for hangs_up in [false, true] {
        let network = LocalNetwork::new();
        let hub = Network::open(&network, "coordinator");
        let (never, over) = (AtomicBool::new(false), AtomicBool::new(false));
        let connections = thread::scope(|scope| {
            let hub = scope.spawn(|| {
                let mut connections = 0;
                while !over.load(Ordering::Relaxed) {
                    if let Some(TransportEvent::Connected { peer, .. }) =
                        hub.receive(Duration::from_millis(5)).unwrap()
                    {
                        connections += 1;
                        if hangs_up {
                            hub.disconnect(peer);
                        }
                    }
                }
                connections
            });
            let worker = scope.spawn(|| {
                let (control, data) = (Network::open(&network, "worker"), Network::open(&network, "data"));
                let options = WorkerOptions { patience, ..worker_options("worker", 1, None) };
                run_worker(&*control, &data, "coordinator", &options, &never, &mut |_| {}).map(drop)
            });
            let reader = scope.spawn(|| {
                let transport = Network::open(&network, "reader");
                let reader = reader_of(&*transport, "reader", false);
                run_reader(&*transport, reader, "coordinator", patience, &never, &mut |_| {}).map(drop)
            });
            for node in [worker, reader] {
                let error = node.join().unwrap().unwrap_err();
                assert!(matches!(error, NodeError::NoCoordinator { .. }), "{error}");
                assert!(error.to_string().contains("says nothing"), "{error}");
            }
            over.store(true, Ordering::Relaxed);
            hub.join().unwrap()
        });
        // Waits double, from 20 ms on.
        assert!(if hangs_up { (4..=12).contains(&connections) } else { connections == 2 }, "{connections}");
    }
}

#[test]
fn a_scene_that_cannot_travel_is_an_error_at_once() {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let image = EnvironmentImage::new(4, 2, vec![[1.0; 3]; 8], &budget).unwrap();
    let mut job = job();
    job.scene = job.scene.with_environment(Environment::image(Arc::new(image)));
    let error = Coordinator::new(job, coordinator_options(1, 0), &budget).map(drop).unwrap_err();
    assert!(matches!(error, CoordinatorError::SceneStays(_)), "{error:?}");
    assert!(error.to_string().contains("environment"), "{error}");
}
