//! The simulation: events in the order of time.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::time::Duration;

use super::cost_image::CostImage;
use super::machine::{CellTime, ClusterModel, Machine, sequential};
use super::report::SimulationReport;
use crate::error::ScheduleError;
use crate::schedule::adaptive::AdaptiveScheduler;
use crate::schedule::grid::TileCells;
use crate::schedule::options::SchedulerOptions;
use crate::schedule::scheduler::{Answer, Assignment, Notice, Spent, TileResult, TileScheduler};
use crate::units::{Bytes, LeaseId, WorkerId};

/// Renders the image of `costs` on `workers` simulated machines, scheduled by a real [`AdaptiveScheduler`] with
/// `options`. Tile and cell sides are those of the costs. Exactly repeatable.
///
/// # Errors
/// [`ScheduleError::Option`] for options that make no sense, or if every worker is lost before the end.
pub fn simulate(
    costs: &CostImage,
    model: &ClusterModel,
    options: SchedulerOptions,
    workers: u32,
) -> Result<SimulationReport, ScheduleError> {
    let grid = costs.grid();
    let options = SchedulerOptions { tile_side: grid.tile_side(), cell_side: grid.cell_side(), ..options };
    let scheduler = AdaptiveScheduler::new(grid.width(), grid.height(), options)?;
    let mut cluster = Cluster {
        costs,
        model,
        scheduler,
        workers: (0..workers).map(|worker| Worker::new(Machine::new(model, costs, worker))).collect(),
        events: BinaryHeap::new(),
        sequence: 0,
        now: 0,
        relays: (0..model.relays.map_or(0, |relays| relays.count)).map(|_| Relay::default()).collect(),
        inbox: VecDeque::new(),
        is_service_planned: false,
        outbox: Vec::new(),
        connection_free: [0; 2],
        coordinator_free: 0,
        coordinator_busy: 0,
        next_tick: None,
        rendered_seconds: 0.0,
        load_seconds: 0.0,
        counted_seconds: 0.0,
        loads: 0,
        messages: 0,
        bytes: 0,
    };
    cluster.run()?;
    let alone = sequential(model, costs);
    let speeds: Vec<f64> = (0..workers).map(|worker| model.speed(worker)).collect();
    let speed: f64 = speeds.iter().sum();
    let fastest = speeds.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok(SimulationReport {
        workers,
        seconds: cluster.now as f64 * 1e-9,
        sequential_seconds: alone.seconds,
        speed,
        bound_seconds: (alone.seconds / speed).max(costs.longest_seconds().0 / fastest),
        render_seconds: cluster.counted_seconds,
        load_seconds: cluster.load_seconds,
        idle_at_start_seconds: cluster.idle(|worker| worker.first.unwrap_or(cluster.now)),
        idle_at_end_seconds: cluster.idle(|worker| cluster.now.saturating_sub(worker.last.min(cluster.now))),
        wasted_seconds: (cluster.rendered_seconds - cluster.counted_seconds).max(0.0),
        loads: cluster.loads,
        sequential_loads: alone.loads,
        messages: cluster.messages,
        bytes: Bytes(cluster.bytes),
        coordinator_load: cluster.coordinator_busy as f64 / cluster.now.max(1) as f64,
        schedule: cluster.scheduler.progress(),
    })
}

/// Cells that a worker was told to render.
struct Job {
    assignment: Assignment,
    /// What is still to be done.
    left: u64,
    done: u64,
    started: Option<u64>,
    /// Cost of what is done, in seconds at speed 1.
    work: f64,
}

struct Worker {
    machine: Machine,
    jobs: VecDeque<Job>,
    /// The cell of the first job that is being rendered, and what it takes in all.
    cell: Option<u32>,
    cell_time: CellTime,
    has_asked: bool,
    is_lost: bool,
    /// When its first cell began and its last one ended.
    first: Option<u64>,
    last: u64,
}

impl Worker {
    fn new(machine: Machine) -> Worker {
        Worker {
            machine,
            jobs: VecDeque::new(),
            cell: None,
            cell_time: CellTime::default(),
            has_asked: false,
            is_lost: false,
            first: None,
            last: 0,
        }
    }

    /// Whether it wants more now; then it has asked.
    fn asks(&mut self, model: &ClusterModel) -> bool {
        let wanted = if model.ask_ahead { 2 } else { 1 };
        let asks = !self.is_lost && !self.has_asked && self.jobs.len() < wanted;
        self.has_asked |= asks;
        asks
    }
}

#[derive(Debug)]
enum Event {
    /// Something has arrived at a relay.
    Gathered(u32, Bound),
    /// A relay sends on what it has gathered.
    Forward(usize),
    /// A message has arrived at the coordinator.
    Arrived(Vec<(u32, Bound)>),
    /// The coordinator is through with a message and its answers.
    Free,
    /// A message for some workers has arrived at their relay.
    Spread(Vec<(u32, Told)>),
    /// A message has arrived at a worker.
    Told(u32, Told),
    /// A worker is through with a cell.
    CellDone(u32),
    Tick,
    Vanished(u32),
    GivenUp(u32),
}

/// A machine of the second level.
#[derive(Default)]
struct Relay {
    gathered: Vec<(u32, Bound)>,
    /// When it is through with its messages.
    free: u64,
}

/// Bound for the coordinator.
#[derive(Clone, Copy, Debug)]
enum Bound {
    Request,
    /// A result, and whether the worker asks for more with it.
    Result {
        result: TileResult,
        asks: bool,
    },
}

/// Bound for a worker.
#[derive(Clone, Copy, Debug)]
enum Told {
    Assign(Assignment),
    Shorten(LeaseId, u64),
}

struct Cluster<'a> {
    costs: &'a CostImage,
    model: &'a ClusterModel,
    scheduler: AdaptiveScheduler,
    workers: Vec<Worker>,
    /// By time, then in the order in which they were made.
    events: BinaryHeap<Reverse<(u64, u64, Box<Ordered>)>>,
    sequence: u64,
    now: u64,
    relays: Vec<Relay>,
    /// What has arrived at the coordinator and waits.
    inbox: VecDeque<Vec<(u32, Bound)>>,
    is_service_planned: bool,
    /// What the coordinator has to say and has not sent.
    outbox: Vec<(u32, Told)>,
    /// When the coordinator's connection is free, in and out.
    connection_free: [u64; 2],
    coordinator_free: u64,
    coordinator_busy: u64,
    next_tick: Option<u64>,
    rendered_seconds: f64,
    load_seconds: f64,
    counted_seconds: f64,
    loads: u64,
    messages: u64,
    bytes: u64,
}

/// An event is ordered by what stands before it only.
#[derive(Debug)]
struct Ordered(Event);

impl PartialEq for Ordered {
    fn eq(&self, _: &Ordered) -> bool {
        true
    }
}

impl Eq for Ordered {}

impl PartialOrd for Ordered {
    fn partial_cmp(&self, other: &Ordered) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Ordered {
    fn cmp(&self, _: &Ordered) -> std::cmp::Ordering {
        std::cmp::Ordering::Equal
    }
}

const IN: usize = 0;
const OUT: usize = 1;

impl Cluster<'_> {
    fn run(&mut self) -> Result<(), ScheduleError> {
        for worker in 0..self.workers.len() as u32 {
            self.scheduler.join(WorkerId(worker.into()), Duration::ZERO);
        }
        for worker in 0..self.workers.len() as u32 {
            self.ask(worker);
        }
        for (seconds, worker) in self.model.losses.iter().copied() {
            if (worker as usize) < self.workers.len() {
                let vanished = nanos(seconds);
                self.at(vanished, Event::Vanished(worker));
                self.at(vanished + nanos(self.model.loss_noticed_seconds), Event::GivenUp(worker));
            }
        }
        while !self.scheduler.is_finished() {
            let Some(Reverse((time, _, event))) = self.events.pop() else { break };
            self.now = time;
            self.happen(event.0)?;
            if self.scheduler.progress().workers == 0 && !self.scheduler.is_finished() {
                break;
            }
        }
        if self.scheduler.is_finished() {
            self.stop_clocks();
            return Ok(());
        }
        Err(ScheduleError::Option { what: "losses", reason: "no worker is left to end the render" })
    }

    /// Cells are booked whole when they begin; takes back what those under way at the end had still to do.
    fn stop_clocks(&mut self) {
        for worker in &mut self.workers {
            let whole = worker.cell_time.render_seconds + worker.cell_time.load_seconds;
            let rest = worker.last.saturating_sub(self.now) as f64 * 1e-9;
            if worker.cell.is_some() && rest > 0.0 {
                let part = (rest / whole).min(1.0);
                self.rendered_seconds -= part * worker.cell_time.render_seconds;
                self.load_seconds -= part * worker.cell_time.load_seconds;
            }
        }
    }

    /// Sum over the workers, in seconds.
    fn idle(&self, nanos: impl Fn(&Worker) -> u64) -> f64 {
        self.workers.iter().map(|worker| nanos(worker) as f64 * 1e-9).sum()
    }

    fn at(&mut self, time: u64, event: Event) {
        self.events.push(Reverse((time, self.sequence, Box::new(Ordered(event)))));
        self.sequence += 1;
    }

    fn happen(&mut self, event: Event) -> Result<(), ScheduleError> {
        match event {
            Event::Gathered(worker, message) => self.gather(worker, message),
            Event::Forward(relay) => {
                let gathered = std::mem::take(&mut self.relays[relay].gathered);
                let time = nanos(self.model.message_seconds) * (gathered.len() as u64 + 1);
                self.relays[relay].free = self.relays[relay].free.max(self.now) + time;
                let bytes = gathered.iter().map(|(_, message)| self.bytes_of(message)).sum();
                self.deliver(self.relays[relay].free, bytes, gathered);
            }
            Event::Arrived(messages) => {
                self.inbox.push_back(messages);
                self.serve()?;
            }
            Event::Free => {
                self.is_service_planned = false;
                self.serve()?;
            }
            Event::Spread(messages) => {
                let latency = nanos(self.model.latency_seconds);
                for (worker, told) in messages {
                    let relay = self.relay_of(worker);
                    let free = self.relays[relay].free.max(self.now) + nanos(self.model.message_seconds);
                    self.relays[relay].free = free;
                    self.at(free + latency, Event::Told(worker, told));
                }
            }
            Event::Told(worker, told) => self.tell(worker, told),
            Event::CellDone(worker) => self.end_cell(worker),
            Event::Tick => {
                self.next_tick = None;
                self.scheduler.tick(Duration::from_nanos(self.now));
                self.deliver_notices()?;
            }
            Event::Vanished(worker) => self.workers[worker as usize].is_lost = true,
            Event::GivenUp(worker) => {
                self.scheduler.leave(WorkerId(worker.into()), Duration::from_nanos(self.now));
                self.deliver_notices()?;
            }
        }
        self.send_all();
        self.plan_tick();
        Ok(())
    }

    /// The coordinator takes the next message, if it is free: it works through it, then sends what there is to be said.
    fn serve(&mut self) -> Result<(), ScheduleError> {
        if self.coordinator_free > self.now {
            self.plan_service();
            return Ok(());
        }
        let Some(messages) = self.inbox.pop_front() else { return Ok(()) };
        self.work(1, messages.len());
        for (worker, message) in messages {
            self.handle(worker, message)?;
        }
        self.send_all();
        self.plan_service();
        Ok(())
    }

    /// If something waits, it is taken up when the coordinator is free.
    fn plan_service(&mut self) {
        if !self.inbox.is_empty() && !self.is_service_planned {
            self.is_service_planned = true;
            self.at(self.coordinator_free, Event::Free);
        }
    }

    /// When the coordinator is through with so many messages that say so many things.
    fn work(&mut self, messages: usize, things: usize) -> u64 {
        let time = nanos(self.model.message_seconds) * messages as u64
            + nanos(self.model.decision_seconds) * things as u64;
        self.coordinator_busy += time;
        self.coordinator_free = self.coordinator_free.max(self.now) + time;
        self.coordinator_free
    }

    fn handle(&mut self, worker: u32, message: Bound) -> Result<(), ScheduleError> {
        let asks = match message {
            Bound::Request => true,
            Bound::Result { result, asks } => {
                let now = Duration::from_nanos(self.now);
                let fresh = self.scheduler.complete(WorkerId(worker.into()), &result, now)?.fresh;
                let cells = (0..64).filter(|cell| fresh.cells & 1 << cell != 0);
                let work: f64 = cells.map(|cell| self.costs.seconds(fresh.tile, cell)).sum();
                self.counted_seconds += work / self.model.speed(worker);
                self.deliver_notices()?;
                asks
            }
        };
        if asks { self.answer(worker) } else { Ok(()) }
    }

    fn plan_tick(&mut self) {
        let Some(next) = self.scheduler.next_tick() else { return };
        let next = u64::try_from(next.as_nanos()).unwrap_or(u64::MAX).max(self.now);
        if self.next_tick.is_none_or(|planned| next < planned) {
            self.next_tick = Some(next);
            self.at(next, Event::Tick);
        }
    }

    /// The coordinator answers a worker that asks.
    fn answer(&mut self, worker: u32) -> Result<(), ScheduleError> {
        let now = Duration::from_nanos(self.now);
        match self.scheduler.request(WorkerId(worker.into()), now) {
            Ok(Answer::Assign(assignment)) => self.outbox.push((worker, Told::Assign(assignment))),
            Ok(Answer::Wait | Answer::Done) => {}
            // It was given up.
            Err(ScheduleError::UnknownWorker { .. }) => {}
            Err(error) => return Err(error),
        }
        self.deliver_notices()
    }

    fn deliver_notices(&mut self) -> Result<(), ScheduleError> {
        while let Some(notice) = self.scheduler.notice() {
            match notice {
                Notice::Shorten { worker, lease, keep } => {
                    self.outbox.push((worker.0 as u32, Told::Shorten(lease, keep.cells)));
                }
                Notice::Wake { worker } => self.answer(worker.0 as u32)?,
            }
        }
        Ok(())
    }

    /// From the coordinator to workers: each thing in a message of its own, or one message for all that go to the same relay.
    fn send_all(&mut self) {
        let mut outbox = std::mem::take(&mut self.outbox);
        if self.relays.is_empty() {
            for (worker, told) in outbox {
                let arrives = self.send(1);
                self.at(arrives, Event::Told(worker, told));
            }
            return;
        }
        // Stable: what goes to one worker stays in order.
        outbox.sort_by_key(|(worker, _)| self.relay_of(*worker));
        let groups: Vec<Vec<(u32, Told)>> = outbox
            .chunk_by(|(a, _), (b, _)| self.relay_of(*a) == self.relay_of(*b))
            .map(<[(u32, Told)]>::to_vec)
            .collect();
        for group in groups {
            let arrives = self.send(group.len());
            self.at(arrives, Event::Spread(group));
        }
    }

    /// When a message from the coordinator that says so many things arrives.
    fn send(&mut self, things: usize) -> u64 {
        let ready = self.work(1, things);
        let bytes = f64::from(self.model.message_bytes) * things as f64;
        self.carry(OUT, ready, bytes) + nanos(self.model.latency_seconds)
    }

    /// When the coordinator's connection has carried a message that is there at `from`.
    fn carry(&mut self, direction: usize, from: u64, bytes: f64) -> u64 {
        self.messages += 1;
        self.bytes += bytes as u64;
        let start = self.connection_free[direction].max(from);
        self.connection_free[direction] = start + nanos(bytes / self.model.coordinator_bytes_per_second);
        self.connection_free[direction]
    }

    fn bytes_of(&self, message: &Bound) -> f64 {
        let pixels = match message {
            Bound::Result { result, .. } => self.costs.grid().pixels(result.cells),
            Bound::Request => 0,
        };
        f64::from(self.model.message_bytes) + pixels as f64 * f64::from(self.model.pixel_bytes)
    }

    /// From a worker to the coordinator, or to its relay.
    fn report(&mut self, message: Bound, worker: u32) {
        let bytes = self.bytes_of(&message);
        let sent = self.now + nanos(bytes / self.model.worker_bytes_per_second);
        if self.relays.is_empty() {
            self.deliver(sent, bytes, vec![(worker, message)]);
        } else {
            self.at(sent + nanos(self.model.latency_seconds), Event::Gathered(worker, message));
        }
    }

    fn deliver(&mut self, sent: u64, bytes: f64, messages: Vec<(u32, Bound)>) {
        let arrives = self.carry(IN, sent + nanos(self.model.latency_seconds), bytes);
        self.at(arrives, Event::Arrived(messages));
    }

    fn relay_of(&self, worker: u32) -> usize {
        worker as usize * self.relays.len() / self.workers.len()
    }

    fn gather(&mut self, worker: u32, message: Bound) {
        let relay = self.relay_of(worker);
        self.relays[relay].gathered.push((worker, message));
        if self.relays[relay].gathered.len() == 1 {
            let gather = self.model.relays.map_or(0.0, |relays| relays.gather_seconds);
            self.at(self.now + nanos(gather), Event::Forward(relay));
        }
    }

    fn ask(&mut self, worker: u32) {
        if self.workers[worker as usize].asks(self.model) {
            self.report(Bound::Request, worker);
        }
    }

    fn tell(&mut self, worker: u32, told: Told) {
        let state = &mut self.workers[worker as usize];
        if state.is_lost {
            return;
        }
        match told {
            Told::Assign(assignment) => {
                state.has_asked = false;
                let left = assignment.cells.cells;
                let job = Job { assignment, left, done: 0, started: None, work: 0.0 };
                state.jobs.push_back(job);
            }
            Told::Shorten(lease, keep) => {
                let Some(at) = state.jobs.iter().position(|job| job.assignment.lease == lease) else {
                    return;
                };
                state.jobs[at].left &= keep;
                // One that has begun ends with the cell that it is at.
                if state.jobs[at].left == 0 && state.jobs[at].started.is_none() {
                    state.jobs.remove(at);
                }
            }
        }
        self.go_on(worker);
    }

    /// Begins with the next cell if the worker is idle.
    fn go_on(&mut self, worker: u32) {
        let state = &mut self.workers[worker as usize];
        if state.cell.is_none()
            && let Some(job) = state.jobs.front_mut()
        {
            job.started.get_or_insert(self.now);
            let cell = job.left.trailing_zeros();
            job.left &= job.left.wrapping_sub(1);
            let tile = job.assignment.cells.tile;
            let time = state.machine.render(self.model, self.costs, tile, cell);
            job.work += self.costs.seconds(tile, cell);
            state.cell = Some(cell);
            state.cell_time = time;
            self.rendered_seconds += time.render_seconds;
            self.load_seconds += time.load_seconds;
            self.loads += time.loads;
            let end = self.now + nanos(time.render_seconds + time.load_seconds);
            state.first.get_or_insert(self.now);
            state.last = end;
            self.at(end, Event::CellDone(worker));
        }
        self.ask(worker);
    }

    fn end_cell(&mut self, worker: u32) {
        let state = &mut self.workers[worker as usize];
        if state.is_lost {
            return;
        }
        let (Some(cell), Some(job)) = (state.cell.take(), state.jobs.front_mut()) else { return };
        job.done |= 1 << cell;
        let spent = Duration::from_nanos(self.now - job.started.unwrap_or(self.now));
        if job.left == 0 || spent >= job.assignment.stop_after {
            let result = TileResult {
                lease: job.assignment.lease,
                cells: TileCells { tile: job.assignment.cells.tile, cells: job.done },
                is_last: true,
                spent: Spent { seconds: spent.as_secs_f64(), work: job.work },
            };
            state.jobs.pop_front();
            let asks = state.asks(self.model);
            self.report(Bound::Result { result, asks }, worker);
        }
        self.go_on(worker);
    }
}

fn nanos(seconds: f64) -> u64 {
    // Saturates.
    (seconds * 1e9) as u64
}
