//! The simulation with sub-coordinators that decide.

use std::collections::HashMap;
use std::time::Duration;

use super::cost_image::CostImage;
use super::desk::{Desk, Events, IN, OUT};
use super::machine::{ClusterModel, Machine};
use super::report::{SimulationReport, Totals};
use super::worker::{Bound, Spending, Told, Worker, nanos};
use crate::error::ScheduleError;
use crate::schedule::options::SchedulerOptions;
use crate::schedule::parts::{PartNotice, PartOptions, PartReport, PartScheduler, SubScheduler};
use crate::schedule::scheduler::{Answer, Notice, ScheduleProgress, TileScheduler};
use crate::units::{SubCoordinatorId, TileId, WorkerId};

/// Sub-coordinators of a simulated cluster.
#[derive(Clone, Debug, PartialEq)]
pub struct SecondLevel {
    /// How many there are (`expected`), and how they work. Workers belong to them in turns of equal length.
    pub parts: PartOptions,
    /// What the connection of each carries in each direction, to its workers and to the top together.
    pub bytes_per_second: f64,
    /// Sub-coordinators that vanish: when, and which. They are given up as late as workers are; then their workers go to the others
    /// in turn.
    pub losses: Vec<(f64, u32)>,
}

impl SecondLevel {
    /// So many sub-coordinators on machines like those of the workers: 1 Gbit/s.
    pub fn new(count: u32) -> SecondLevel {
        let bytes_per_second = ClusterModel::default().worker_bytes_per_second;
        SecondLevel { parts: PartOptions::new(count), bytes_per_second, losses: Vec::new() }
    }
}

/// Renders the image of `costs` on `workers` simulated machines under sub-coordinators: a real [`PartScheduler`] at the top and a
/// real [`SubScheduler`] with `options` (see [`SchedulerOptions::for_sub_coordinator`]) for each. Every message costs what it costs
/// one coordinator; of a report, each tile counts as a decision. The model's relays are not used. Exactly repeatable.
///
/// # Errors
/// [`ScheduleError::Option`] for options that make no sense, or if every worker or every sub-coordinator is lost before the end.
pub fn simulate_two_levels(
    costs: &CostImage,
    model: &ClusterModel,
    options: SchedulerOptions,
    workers: u32,
    level: &SecondLevel,
) -> Result<SimulationReport, ScheduleError> {
    let grid = costs.grid();
    let options = SchedulerOptions { tile_side: grid.tile_side(), cell_side: grid.cell_side(), ..options };
    let top = PartScheduler::new(grid.clone(), level.parts)?;
    let subs = (0..level.parts.expected).map(|_| {
        let scheduler = SubScheduler::new(grid.width(), grid.height(), options, level.parts)?;
        let desk = Desk::new(level.bytes_per_second);
        Ok(Sub { scheduler, desk, outbox: Vec::new(), next_tick: None, is_lost: false })
    });
    let count = level.parts.expected;
    let mut cluster = Cluster {
        costs,
        model,
        level,
        top,
        top_desk: Desk::new(model.coordinator_bytes_per_second),
        top_tick: None,
        subs: subs.collect::<Result<_, ScheduleError>>()?,
        workers: (0..workers).map(|worker| Worker::new(Machine::new(model, costs, worker))).collect(),
        sub_of: (0..workers)
            .map(|worker| (u64::from(worker) * u64::from(count) / u64::from(workers)) as u32)
            .collect(),
        returned_by: HashMap::new(),
        events: Events::new(),
        now: 0,
        spending: Spending::default(),
        counted_seconds: 0.0,
        repeated: 0,
    };
    cluster.run()?;
    let progress = cluster.top.progress();
    let mut schedule = ScheduleProgress {
        cells: progress.cells,
        cells_done: progress.cells_done,
        cells_repeated: progress.cells_repeated + cluster.repeated,
        ..ScheduleProgress::default()
    };
    for sub in &cluster.subs {
        let own = sub.scheduler.progress();
        schedule.leases += own.leases;
        schedule.leases_lost += own.leases_lost;
        schedule.leases_cut += own.leases_cut;
        schedule.leases_raced += own.leases_raced;
        schedule.workers += if sub.is_lost { 0 } else { own.workers };
    }
    let totals = Totals {
        nanos: cluster.now,
        spending: cluster.spending,
        counted_seconds: cluster.counted_seconds,
        messages: cluster.top_desk.messages,
        bytes: cluster.top_desk.bytes,
        coordinator_busy: cluster.top_desk.busy,
        sub_coordinator_busy: cluster.subs.iter().map(|sub| sub.desk.busy).max().unwrap_or(0),
        schedule,
    };
    Ok(totals.report(model, costs, &cluster.workers))
}

/// Who serves messages.
#[derive(Clone, Copy, Debug)]
enum Place {
    Top,
    Sub(u32),
}

/// Bound for a sub-coordinator.
#[derive(Debug)]
enum ToSub {
    FromWorker(u32, Bound),
    FromTop(PartNotice),
}

enum Event {
    AtTop(u32, PartReport),
    AtSub(u32, ToSub),
    /// A coordinator is through with a message and its answers.
    Free(Place),
    Told(u32, Told),
    CellDone(u32),
    Tick(Place),
    Vanished(u32),
    GivenUp(u32),
    SubVanished(u32),
    SubGivenUp(u32),
}

struct Sub {
    scheduler: SubScheduler,
    desk: Desk<ToSub>,
    outbox: Vec<(u32, Told)>,
    next_tick: Option<u64>,
    is_lost: bool,
}

struct Cluster<'a> {
    costs: &'a CostImage,
    model: &'a ClusterModel,
    level: &'a SecondLevel,
    top: PartScheduler,
    top_desk: Desk<(u32, PartReport)>,
    top_tick: Option<u64>,
    subs: Vec<Sub>,
    workers: Vec<Worker>,
    sub_of: Vec<u32>,
    /// Who returned a cell last.
    returned_by: HashMap<(TileId, u32), u32>,
    events: Events<Event>,
    now: u64,
    spending: Spending,
    counted_seconds: f64,
    /// Cells that came back to a sub-coordinator twice.
    repeated: u64,
}

/// Bytes of a tile's set of cells and their cost in a message.
const TILE_BYTES: f64 = 20.0;

impl Cluster<'_> {
    fn run(&mut self) -> Result<(), ScheduleError> {
        for worker in 0..self.workers.len() as u32 {
            self.sub_of(worker).scheduler.join(WorkerId(worker.into()), Duration::ZERO);
        }
        for sub in 0..self.subs.len() as u32 {
            let workers = self.subs[sub as usize].scheduler.progress().workers;
            self.top.join(SubCoordinatorId(sub.into()), workers, Duration::ZERO);
        }
        self.send_from_top();
        for worker in 0..self.workers.len() as u32 {
            self.ask(worker);
        }
        let noticed = nanos(self.model.loss_noticed_seconds);
        let workers = self.model.losses.iter().filter(|(_, worker)| (*worker as usize) < self.workers.len());
        for (seconds, worker) in workers.copied() {
            self.events.at(nanos(seconds), Event::Vanished(worker));
            self.events.at(nanos(seconds) + noticed, Event::GivenUp(worker));
        }
        let subs = self.level.losses.iter().filter(|(_, sub)| (*sub as usize) < self.subs.len());
        for (seconds, sub) in subs.copied() {
            self.events.at(nanos(seconds), Event::SubVanished(sub));
            self.events.at(nanos(seconds) + noticed, Event::SubGivenUp(sub));
        }
        while !self.top.is_finished() {
            let Some((time, event)) = self.events.pop() else { break };
            self.now = time;
            let is_loss = matches!(event, Event::GivenUp(_) | Event::SubGivenUp(_));
            self.happen(event)?;
            // Those that are left would wait for ever.
            let works = |sub: &Sub| !sub.is_lost && sub.scheduler.progress().workers > 0;
            if is_loss && !self.subs.iter().any(works) {
                break;
            }
        }
        if self.top.is_finished() {
            self.workers.iter().for_each(|worker| worker.stop_clock(self.now, &mut self.spending));
            return Ok(());
        }
        Err(ScheduleError::Option { what: "losses", reason: "nobody is left to end the render" })
    }

    fn time(&self) -> Duration {
        Duration::from_nanos(self.now)
    }

    fn sub_of(&mut self, worker: u32) -> &mut Sub {
        &mut self.subs[self.sub_of[worker as usize] as usize]
    }

    fn happen(&mut self, event: Event) -> Result<(), ScheduleError> {
        match event {
            Event::AtTop(sub, report) => {
                self.top_desk.inbox.push_back((sub, report));
                self.serve(Place::Top)?;
            }
            Event::AtSub(sub, message) => {
                let state = &mut self.subs[sub as usize];
                if !state.is_lost {
                    state.desk.inbox.push_back(message);
                    self.serve(Place::Sub(sub))?;
                }
            }
            Event::Free(place) => {
                match place {
                    Place::Top => self.top_desk.is_planned = false,
                    Place::Sub(sub) => self.subs[sub as usize].desk.is_planned = false,
                }
                self.serve(place)?;
            }
            Event::Told(worker, told) => {
                let state = &mut self.workers[worker as usize];
                if !state.is_lost {
                    state.tell(told);
                    self.go_on(worker);
                }
            }
            Event::CellDone(worker) => {
                let state = &mut self.workers[worker as usize];
                if !state.is_lost {
                    if let Some(message) = state.end_cell(self.now, self.model) {
                        self.report(message, worker);
                    }
                    self.go_on(worker);
                }
            }
            Event::Tick(Place::Top) => {
                self.top_tick = None;
                self.top.tick(self.time());
                self.send_from_top();
            }
            Event::Tick(Place::Sub(sub)) => {
                let now = self.time();
                self.subs[sub as usize].next_tick = None;
                self.subs[sub as usize].scheduler.tick(now);
                self.settle(sub)?;
            }
            Event::Vanished(worker) => self.workers[worker as usize].is_lost = true,
            Event::GivenUp(worker) => {
                let now = self.time();
                self.sub_of(worker).scheduler.leave(WorkerId(worker.into()), now);
                self.settle(self.sub_of[worker as usize])?;
            }
            Event::SubVanished(sub) => self.subs[sub as usize].is_lost = true,
            Event::SubGivenUp(sub) => self.give_up(sub)?,
        }
        Ok(())
    }

    /// A sub-coordinator is given up; its workers go to the others.
    fn give_up(&mut self, sub: u32) -> Result<(), ScheduleError> {
        self.top.leave(SubCoordinatorId(sub.into()), self.time());
        self.send_from_top();
        let left: Vec<u32> =
            (0..self.subs.len() as u32).filter(|sub| !self.subs[*sub as usize].is_lost).collect();
        let orphans = (0..self.workers.len() as u32).filter(|worker| self.sub_of[*worker as usize] == sub);
        let orphans: Vec<u32> = orphans.filter(|worker| !self.workers[*worker as usize].is_lost).collect();
        if left.is_empty() {
            return Ok(());
        }
        for (number, worker) in orphans.into_iter().enumerate() {
            let other = left[number % left.len()];
            self.sub_of[worker as usize] = other;
            let now = self.time();
            self.subs[other as usize].scheduler.join(WorkerId(worker.into()), now);
            self.workers[worker as usize].change_coordinator();
            self.ask(worker);
        }
        left.into_iter().try_for_each(|sub| self.settle(sub))
    }

    /// A coordinator takes the next message, if it is free: it works through it, then sends what there is to be said.
    fn serve(&mut self, place: Place) -> Result<(), ScheduleError> {
        let free = match place {
            Place::Top => self.top_desk.free,
            Place::Sub(sub) => self.subs[sub as usize].desk.free,
        };
        if free <= self.now {
            match place {
                Place::Top => self.serve_top()?,
                Place::Sub(sub) => self.serve_sub(sub)?,
            }
        }
        // If something waits, it is taken up when the coordinator is free.
        let plan = match place {
            Place::Top => plan(&mut self.top_desk),
            Place::Sub(sub) => plan(&mut self.subs[sub as usize].desk),
        };
        if let Some(free) = plan {
            self.events.at(free, Event::Free(place));
        }
        Ok(())
    }

    fn serve_top(&mut self) -> Result<(), ScheduleError> {
        let Some((sub, report)) = self.top_desk.inbox.pop_front() else { return Ok(()) };
        self.top_desk.work(self.now, self.model, 1, things(&report));
        let fresh = self.top.report(SubCoordinatorId(sub.into()), &report, self.time())?;
        for cells in fresh {
            for cell in (0..64).filter(|cell| cells.cells & 1 << cell != 0) {
                let worker = self.returned_by.get(&(cells.tile, cell)).copied().unwrap_or(0);
                self.counted_seconds += self.costs.seconds(cells.tile, cell) / self.model.speed(worker);
            }
        }
        self.send_from_top();
        Ok(())
    }

    fn serve_sub(&mut self, sub: u32) -> Result<(), ScheduleError> {
        let now = self.time();
        let state = &mut self.subs[sub as usize];
        let Some(message) = state.desk.inbox.pop_front().filter(|_| !state.is_lost) else { return Ok(()) };
        state.desk.work(self.now, self.model, 1, 1);
        match message {
            ToSub::FromTop(notice) => state.scheduler.told(&notice, now),
            ToSub::FromWorker(worker, Bound::Request) => self.answer(sub, worker)?,
            ToSub::FromWorker(worker, Bound::Result { result, asks }) => {
                let receipt = state.scheduler.complete(WorkerId(worker.into()), &result, now)?;
                let part = result.cells.count() - receipt.fresh.count();
                self.repeated += u64::from(part.min(receipt.repeated));
                for cell in (0..64).filter(|cell| result.cells.cells & 1 << cell != 0) {
                    self.returned_by.insert((result.cells.tile, cell), worker);
                }
                self.listen(sub)?;
                if asks {
                    self.answer(sub, worker)?;
                }
            }
        }
        self.settle(sub)
    }

    /// A sub-coordinator answers a worker that asks.
    fn answer(&mut self, sub: u32, worker: u32) -> Result<(), ScheduleError> {
        let now = self.time();
        let state = &mut self.subs[sub as usize];
        match state.scheduler.request(WorkerId(worker.into()), now) {
            Ok(Answer::Assign(assignment)) => state.outbox.push((worker, Told::Assign(assignment))),
            Ok(Answer::Wait | Answer::Done) => {}
            // It was given up.
            Err(ScheduleError::UnknownWorker { .. }) => {}
            Err(error) => return Err(error),
        }
        self.listen(sub)
    }

    fn listen(&mut self, sub: u32) -> Result<(), ScheduleError> {
        while let Some(notice) = self.subs[sub as usize].scheduler.notice() {
            match notice {
                Notice::Shorten { worker, lease, keep } => {
                    let told = Told::Shorten(lease, keep.cells);
                    self.subs[sub as usize].outbox.push((worker.0 as u32, told));
                }
                Notice::Wake { worker } => self.answer(sub, worker.0 as u32)?,
            }
        }
        Ok(())
    }

    /// Sends what a sub-coordinator has to say to its workers and to the top, and plans its next appointment.
    fn settle(&mut self, sub: u32) -> Result<(), ScheduleError> {
        if self.subs[sub as usize].is_lost {
            return Ok(());
        }
        self.listen(sub)?;
        let now = self.time();
        let latency = nanos(self.model.latency_seconds);
        let state = &mut self.subs[sub as usize];
        for (worker, told) in std::mem::take(&mut state.outbox) {
            let ready = state.desk.work(self.now, self.model, 1, 1);
            let sent = state.desk.carry(OUT, ready, f64::from(self.model.message_bytes));
            self.events.at(sent + latency, Event::Told(worker, told));
        }
        while let Some(report) = state.scheduler.take_report(now) {
            let ready = state.desk.work(self.now, self.model, 1, things(&report));
            let pixels: u64 = report.done.iter().map(|part| self.costs.grid().pixels(part.cells)).sum();
            let tiles = report.done.len() + report.given_up.as_ref().map_or(0, Vec::len);
            let bytes = f64::from(self.model.message_bytes)
                + tiles as f64 * TILE_BYTES
                + pixels as f64 * f64::from(self.model.pixel_bytes);
            let sent = state.desk.carry(OUT, ready, bytes) + latency;
            let arrives = self.top_desk.carry(IN, sent, bytes);
            self.events.at(arrives, Event::AtTop(sub, report));
        }
        let state = &mut self.subs[sub as usize];
        let next = state.scheduler.next_tick().into_iter().chain(state.scheduler.report_at()).min();
        if let Some(next) = appointment(next, self.now, &mut state.next_tick) {
            self.events.at(next, Event::Tick(Place::Sub(sub)));
        }
        Ok(())
    }

    /// Sends what the top has to say, and plans its next appointment.
    fn send_from_top(&mut self) {
        while let Some((sub, notice)) = self.top.notice() {
            let tiles = if let PartNotice::Grant(cells) = &notice { cells.len() } else { 0 };
            let bytes = f64::from(self.model.message_bytes) + tiles as f64 * TILE_BYTES;
            let ready = self.top_desk.work(self.now, self.model, 1, 1);
            let sent = self.top_desk.carry(OUT, ready, bytes) + nanos(self.model.latency_seconds);
            let sub = sub.0 as u32;
            let arrives = self.subs[sub as usize].desk.carry(IN, sent, bytes);
            self.events.at(arrives, Event::AtSub(sub, ToSub::FromTop(notice)));
        }
        if let Some(next) = appointment(self.top.next_tick(), self.now, &mut self.top_tick) {
            self.events.at(next, Event::Tick(Place::Top));
        }
    }

    /// From a worker to its sub-coordinator.
    fn report(&mut self, message: Bound, worker: u32) {
        let bytes = message.bytes(self.model, self.costs);
        let sent = self.now + nanos(bytes / self.model.worker_bytes_per_second);
        let arrives = sent + nanos(self.model.latency_seconds);
        let sub = self.sub_of[worker as usize];
        let arrives = self.subs[sub as usize].desk.carry(IN, arrives, bytes);
        self.events.at(arrives, Event::AtSub(sub, ToSub::FromWorker(worker, message)));
    }

    fn ask(&mut self, worker: u32) {
        if self.workers[worker as usize].asks(self.model) {
            self.report(Bound::Request, worker);
        }
    }

    /// Begins with the next cell if the worker is idle.
    fn go_on(&mut self, worker: u32) {
        let state = &mut self.workers[worker as usize];
        if let Some(end) = state.begin(self.now, self.model, self.costs, &mut self.spending) {
            self.events.at(end, Event::CellDone(worker));
        }
        self.ask(worker);
    }
}

/// When a coordinator takes up the next message, if that is not settled yet.
fn plan<M>(desk: &mut Desk<M>) -> Option<u64> {
    let plans = !desk.inbox.is_empty() && !desk.is_planned;
    desk.is_planned |= plans;
    plans.then_some(desk.free)
}

/// When a new appointment is to be made, if an earlier one than is `planned`.
fn appointment(next: Option<Duration>, now: u64, planned: &mut Option<u64>) -> Option<u64> {
    let next = u64::try_from(next?.as_nanos()).unwrap_or(u64::MAX).max(now);
    if planned.is_some_and(|planned| planned <= next) {
        return None;
    }
    *planned = Some(next);
    Some(next)
}

/// Of how many things a report speaks: itself, each tile with results, what is given up, and that it asks.
fn things(report: &PartReport) -> usize {
    1 + report.done.len() + usize::from(report.given_up.is_some()) + usize::from(report.asks)
}
