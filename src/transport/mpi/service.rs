//! The one thread that calls MPI.
//!
//! MPI has no way to sleep until a message comes, and its blocking calls burn a core. So this thread asks and sleeps in turn, for
//! an eighth of the time since something happened last, and only after 60 µs: an answer that takes a millisecond is found within
//! about 1.2, and a quiet node asks 250 times a second.

use std::collections::{HashMap, VecDeque};
use std::sync::mpsc::Sender;
use std::time::{Duration, Instant};

use ::mpi::Threading;
use ::mpi::collective::CommunicatorCollectives;
use ::mpi::point_to_point::Source;
use ::mpi::request::{Request, StaticScope};
use ::mpi::topology::{Communicator, SimpleCommunicator};

use super::Shared;
use super::flight::{Flight, TAG};
use super::letter::{LETTER_BYTES_MAX, Letter};

/// Shortest and longest sleep.
const SLEEP: [Duration; 2] = [Duration::from_micros(20), Duration::from_millis(4)];
/// So long it asks again at once after something happened, and only lets others run in between: a sleep would take as long.
const EAGER: Duration = Duration::from_micros(60);
/// How long a node that ends waits for its peers to take what it has sent.
const LINGER: Duration = Duration::from_secs(5);
/// Letters that are taken in before anything else is looked at.
const ARRIVALS_MAX: usize = 64;

/// Rank and number of ranks, or why MPI cannot be used.
type Start = Result<(i32, i32), String>;

/// Starts MPI, serves until the job ends here, and ends MPI.
pub fn serve(shared: &Shared, started: &Sender<Start>) {
    let threading = ::mpi::environment::Threading::Funneled;
    let Some((universe, provided)) = ::mpi::initialize_with_threading(threading) else {
        // Who waits for it has not gone away.
        let _ = started.send(Err("it was started before, and can be only once in a process".to_owned()));
        return;
    };
    let world = universe.world();
    if provided == Threading::Single {
        let _ = started.send(Err("this MPI library does not work in a process with threads".to_owned()));
        return;
    }
    let guard = EndsAll(&world);
    let _ = started.send(Ok((world.rank(), world.size())));
    Service::new(&world, shared).run();
    drop(guard);
    drop(world);
    // Finalizes.
    drop(universe);
}

/// A panic of this thread must not leave the other ranks waiting.
struct EndsAll<'a>(&'a SimpleCommunicator);

impl Drop for EndsAll<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.abort(1);
        }
    }
}

struct Service<'a> {
    world: &'a SimpleCommunicator,
    shared: &'a Shared,
    /// By rank, in the order in which they were sent.
    arriving: HashMap<i32, VecDeque<Flight>>,
    leaving: Vec<Flight>,
    barrier: Option<Request<'static, (), StaticScope>>,
    last_event: Instant,
}

impl<'a> Service<'a> {
    fn new(world: &'a SimpleCommunicator, shared: &'a Shared) -> Service<'a> {
        Service {
            world,
            shared,
            arriving: HashMap::new(),
            leaving: Vec::new(),
            barrier: None,
            last_event: Instant::now(),
        }
    }

    fn run(&mut self) {
        let mut ending: Option<Instant> = None;
        let mut is_last_barrier = false;
        loop {
            let mut has_worked = self.receive();
            has_worked |= self.send();
            has_worked |= self.meet();
            let mut nodes = self.shared.nodes.lock();
            if let Some(code) = nodes.abort {
                self.world.abort(code);
            }
            if nodes.is_ending {
                let since = *ending.get_or_insert_with(Instant::now);
                let is_through = nodes.barriers[0] == nodes.barriers[1];
                let is_sent = !nodes.has_queued() && self.leaving.is_empty();
                if is_through && (is_sent || since.elapsed() >= LINGER) {
                    if is_last_barrier {
                        return;
                    }
                    // All ranks end together: who is still there gets answers until then.
                    is_last_barrier = true;
                    nodes.barriers[0] += 1;
                    ending = None;
                    has_worked = true;
                }
            }
            if has_worked || std::mem::take(&mut nodes.is_called) {
                self.last_event = Instant::now();
                continue;
            }
            let quiet = self.last_event.elapsed();
            if quiet < EAGER {
                drop(nodes);
                std::thread::yield_now();
                continue;
            }
            let sleep = (quiet / 8).clamp(SLEEP[0], SLEEP[1]);
            self.shared.called.wait_for(&mut nodes, sleep);
        }
    }

    /// Takes in what has come.
    fn receive(&mut self) -> bool {
        let mut has_worked = false;
        for _ in 0..ARRIVALS_MAX {
            let Some(status) = self.world.any_process().immediate_probe_with_tag(TAG) else { break };
            let from = status.source_rank();
            // A letter that is longer comes from another program; MPI ends the job when it does not fit.
            let length = usize::try_from(status.count(u8_type())).unwrap_or(0).min(LETTER_BYTES_MAX);
            self.arriving.entry(from).or_default().push_back(Flight::receive(self.world, from, length));
            has_worked = true;
        }
        for (from, flights) in &mut self.arriving {
            while flights.front_mut().is_some_and(Flight::is_done) {
                let letter = flights.pop_front().and_then(Flight::into_bytes).and_then(Letter::parse);
                if let Some(letter) = letter {
                    self.shared.nodes.lock().deliver(*from, letter);
                    self.shared.answered.notify_all();
                }
                has_worked = true;
            }
        }
        has_worked
    }

    /// Sends what may be sent.
    fn send(&mut self) -> bool {
        let before = self.leaving.len();
        let (world, leaving) = (self.world, &mut self.leaving);
        self.shared.nodes.lock().outgoing(|to, bytes| leaving.push(Flight::send(world, to, bytes)));
        let mut has_worked = leaving.len() > before;
        leaving.retain_mut(|flight| {
            let is_done = flight.is_done();
            has_worked |= is_done;
            !is_done
        });
        has_worked
    }

    /// Barriers, one after the other.
    fn meet(&mut self) -> bool {
        let Some(barrier) = self.barrier.take() else {
            let nodes = self.shared.nodes.lock();
            if nodes.barriers[0] > nodes.barriers[1] {
                self.barrier = Some(self.world.immediate_barrier());
            }
            return self.barrier.is_some();
        };
        match barrier.test() {
            Ok(_) => {
                self.shared.nodes.lock().barriers[1] += 1;
                self.shared.answered.notify_all();
                true
            }
            Err(barrier) => {
                self.barrier = Some(barrier);
                false
            }
        }
    }
}

fn u8_type() -> ::mpi::datatype::SystemDatatype {
    <u8 as ::mpi::datatype::Equivalence>::equivalent_datatype()
}
