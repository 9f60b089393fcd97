//! The simulation: events in the order of time.

use std::time::Duration;

use super::cost_image::CostImage;
use super::desk::{Desk, Events, IN, OUT};
use super::machine::{ClusterModel, Machine};
use super::report::{SimulationReport, Totals};
use super::worker::{Bound, Spending, Told, Worker, nanos};
use crate::error::ScheduleError;
use crate::schedule::adaptive::AdaptiveScheduler;
use crate::schedule::options::SchedulerOptions;
use crate::schedule::scheduler::{Answer, Notice, TileScheduler};
use crate::units::WorkerId;

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
        events: Events::new(),
        now: 0,
        relays: (0..model.relays.map_or(0, |relays| relays.count)).map(|_| Relay::default()).collect(),
        desk: Desk::new(model.coordinator_bytes_per_second),
        outbox: Vec::new(),
        next_tick: None,
        spending: Spending::default(),
        counted_seconds: 0.0,
    };
    cluster.run()?;
    let totals = Totals {
        nanos: cluster.now,
        spending: cluster.spending,
        counted_seconds: cluster.counted_seconds,
        messages: cluster.desk.messages,
        bytes: cluster.desk.bytes,
        coordinator_busy: cluster.desk.busy,
        sub_coordinator_busy: 0,
        schedule: cluster.scheduler.progress(),
    };
    Ok(totals.report(model, costs, &cluster.workers))
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

struct Cluster<'a> {
    costs: &'a CostImage,
    model: &'a ClusterModel,
    scheduler: AdaptiveScheduler,
    workers: Vec<Worker>,
    events: Events<Event>,
    now: u64,
    relays: Vec<Relay>,
    desk: Desk<Vec<(u32, Bound)>>,
    /// What the coordinator has to say and has not sent.
    outbox: Vec<(u32, Told)>,
    next_tick: Option<u64>,
    spending: Spending,
    counted_seconds: f64,
}

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
            let Some((time, event)) = self.events.pop() else { break };
            self.now = time;
            self.happen(event)?;
            if self.scheduler.progress().workers == 0 && !self.scheduler.is_finished() {
                break;
            }
        }
        if self.scheduler.is_finished() {
            self.workers.iter().for_each(|worker| worker.stop_clock(self.now, &mut self.spending));
            return Ok(());
        }
        Err(ScheduleError::Option { what: "losses", reason: "no worker is left to end the render" })
    }

    fn at(&mut self, time: u64, event: Event) {
        self.events.at(time, event);
    }

    fn happen(&mut self, event: Event) -> Result<(), ScheduleError> {
        match event {
            Event::Gathered(worker, message) => self.gather(worker, message),
            Event::Forward(relay) => {
                let gathered = std::mem::take(&mut self.relays[relay].gathered);
                let time = nanos(self.model.message_seconds) * (gathered.len() as u64 + 1);
                self.relays[relay].free = self.relays[relay].free.max(self.now) + time;
                let bytes = gathered.iter().map(|(_, message)| message.bytes(self.model, self.costs)).sum();
                self.deliver(self.relays[relay].free, bytes, gathered);
            }
            Event::Arrived(messages) => {
                self.desk.inbox.push_back(messages);
                self.serve()?;
            }
            Event::Free => {
                self.desk.is_planned = false;
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
        if self.desk.free > self.now {
            self.plan_service();
            return Ok(());
        }
        let Some(messages) = self.desk.inbox.pop_front() else { return Ok(()) };
        self.desk.work(self.now, self.model, 1, messages.len());
        for (worker, message) in messages {
            self.handle(worker, message)?;
        }
        self.send_all();
        self.plan_service();
        Ok(())
    }

    /// If something waits, it is taken up when the coordinator is free.
    fn plan_service(&mut self) {
        if !self.desk.inbox.is_empty() && !self.desk.is_planned {
            self.desk.is_planned = true;
            self.at(self.desk.free, Event::Free);
        }
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
        let ready = self.desk.work(self.now, self.model, 1, things);
        let bytes = f64::from(self.model.message_bytes) * things as f64;
        self.desk.carry(OUT, ready, bytes) + nanos(self.model.latency_seconds)
    }

    /// From a worker to the coordinator, or to its relay.
    fn report(&mut self, message: Bound, worker: u32) {
        let bytes = message.bytes(self.model, self.costs);
        let sent = self.now + nanos(bytes / self.model.worker_bytes_per_second);
        if self.relays.is_empty() {
            self.deliver(sent, bytes, vec![(worker, message)]);
        } else {
            self.at(sent + nanos(self.model.latency_seconds), Event::Gathered(worker, message));
        }
    }

    fn deliver(&mut self, sent: u64, bytes: f64, messages: Vec<(u32, Bound)>) {
        let arrives = self.desk.carry(IN, sent + nanos(self.model.latency_seconds), bytes);
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
        if !state.is_lost {
            state.tell(told);
            self.go_on(worker);
        }
    }

    /// Begins with the next cell if the worker is idle.
    fn go_on(&mut self, worker: u32) {
        let state = &mut self.workers[worker as usize];
        if let Some(end) = state.begin(self.now, self.model, self.costs, &mut self.spending) {
            self.at(end, Event::CellDone(worker));
        }
        self.ask(worker);
    }

    fn end_cell(&mut self, worker: u32) {
        let state = &mut self.workers[worker as usize];
        if state.is_lost {
            return;
        }
        if let Some(message) = state.end_cell(self.now, self.model) {
            self.report(message, worker);
        }
        self.go_on(worker);
    }
}
