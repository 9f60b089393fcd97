//! A worker: asks for cells, has them rendered, returns them.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use super::message::{Job, LeasedCells, MESSAGE_VERSION, Message, Role, short};
use super::picture::put_pixels;
use super::{Action, RoleOptions};
use crate::access::BlockSketch;
use crate::render::Region;
use crate::schedule::{ImageGrid, TileCells};
use crate::transport::{PeerId, TransportEvent};
use crate::units::TileId;

/// What happens to a worker.
#[derive(Clone, Debug)]
pub enum WorkerEvent {
    /// On the network.
    Network(TransportEvent),
    /// A connection to the coordinator was made.
    Connected(PeerId),
    /// Scene and model of the job are open; lanes can render.
    Opened,
    /// They cannot be opened, or a lane cannot go on.
    Failed {
        /// Why.
        reason: String,
    },
    /// A lane has rendered what it was told to.
    Rendered {
        /// Which lane.
        lane: u16,
        /// The region's pixels, row by row.
        pixels: Vec<[f32; 3]>,
        /// How long it took.
        time: Duration,
        /// What it took in units of work; see [`schedule`](crate::schedule).
        work: f64,
        /// Which blocks rays entered, roughly.
        blocks: BlockSketch,
    },
}

/// What a worker wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum WorkerAction {
    /// On the network.
    Network(Action),
    /// Open the scene and the model of this job; what was open before is not needed any more. [`WorkerEvent::Opened`] or
    /// [`WorkerEvent::Failed`] follows.
    Open(Box<Job>),
    /// Use these readers from now on.
    Readers(Vec<String>),
    /// Let a lane render a region. [`WorkerEvent::Rendered`] or [`WorkerEvent::Failed`] follows.
    Render {
        /// Which lane.
        lane: u16,
        /// What.
        region: Region,
    },
}

/// The squares that are rendered at once should take about so long, if nobody says otherwise: short enough for a notice to be heard
/// in between.
const SQUARE_TIME: Duration = Duration::from_millis(100);

/// A result is sent when its lease is done, or after so long.
const REPORT_TIME: Duration = Duration::from_secs(1);

/// Assignments that a lane holds: one in hand, and one in advance, so that it does not wait for the network.
const HELD_MAX: usize = 2;

/// An assignment.
struct Held {
    lease: u64,
    tile: TileId,
    /// Cells still to render.
    todo: u64,
    stop_after: Duration,
    /// Time spent on it.
    spent: Duration,
    /// Cells that are rendered and were not returned, each with its pixels as they travel.
    ready: BTreeMap<u32, Vec<u8>>,
    ready_time: Duration,
    ready_work: f64,
    ready_blocks: BlockSketch,
}

#[derive(Default)]
struct Lane {
    held: VecDeque<Held>,
    /// What is being rendered: cells of the first that it holds.
    rendering: Option<u64>,
    asks: bool,
    /// Cells of a square.
    square_cells: u32,
    last_report: Duration,
}

/// What a worker did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkerCounters {
    /// Cells rendered.
    pub cells: u64,
    /// Assignments that were cut short by the coordinator.
    pub shortened: u64,
    /// Assignments that were cut short at their critical time.
    pub critical: u64,
    /// Times that it had to connect again.
    pub reconnected: u64,
}

/// The state machine of a worker: events in, actions out.
///
/// It goes on rendering what it holds when the coordinator is gone, and returns it to the next one: results are welcome at any
/// time.
pub struct Worker {
    name: String,
    model: Option<u64>,
    options: RoleOptions,
    square_time: Duration,
    coordinator: Option<PeerId>,
    /// Whether the coordinator has said that its job is the one that is open here. Before, it gets no results: they might be
    /// another picture's.
    is_confirmed: bool,
    last_heard: Duration,
    last_told: Duration,
    job: Option<Box<Job>>,
    grid: Option<ImageGrid>,
    is_open: bool,
    readers: Option<Vec<String>>,
    lanes: Vec<Lane>,
    /// Results that could not be sent; no more than what the lanes held.
    unsent: Vec<Vec<u8>>,
    counters: WorkerCounters,
    finished: bool,
    failed: Option<String>,
    /// Whether the coordinator has said anything in this connection.
    is_welcome: bool,
    refused: Option<String>,
}

impl Worker {
    /// A worker with `lanes` threads that has the model `model` on disk, if any.
    pub fn new(name: &str, lanes: u16, model: Option<u64>, options: RoleOptions) -> Worker {
        let lane = || Lane { square_cells: 16, ..Lane::default() };
        Worker {
            name: short(name),
            model,
            options,
            square_time: SQUARE_TIME,
            coordinator: None,
            is_confirmed: false,
            last_heard: Duration::ZERO,
            last_told: Duration::ZERO,
            job: None,
            grid: None,
            is_open: false,
            readers: None,
            lanes: (0..lanes.max(1)).map(|_| lane()).collect(),
            unsent: Vec::new(),
            counters: WorkerCounters::default(),
            finished: false,
            failed: None,
            is_welcome: false,
            refused: None,
        }
    }

    /// The same, whose squares of pixels take about so long each instead of a tenth of a second. What it is told while a lane
    /// renders one is heard after that.
    #[must_use]
    pub fn with_square_time(self, square_time: Duration) -> Worker {
        Worker { square_time, ..self }
    }

    /// Something happened.
    pub fn handle(&mut self, now: Duration, event: WorkerEvent, actions: &mut Vec<WorkerAction>) {
        match event {
            WorkerEvent::Connected(peer) => {
                self.counters.reconnected += u64::from(self.job.is_some());
                self.coordinator = Some(peer);
                (self.is_confirmed, self.is_welcome) = (false, false);
                (self.last_heard, self.last_told) = (now, now);
                // This connection's coordinator may not be the one that gave what is held.
                self.lanes.iter_mut().for_each(|lane| lane.asks = false);
                // At least one lane and at most 65,535.
                let role = Role::Worker { lanes: self.lanes.len() as u16 };
                let (name, model) = (self.name.clone(), self.model);
                let hello = Message::Hello { version: MESSAGE_VERSION, role, name, address: None, model };
                self.send(now, hello.frame(), actions);
            }
            WorkerEvent::Network(event) => self.hear(now, event, actions),
            WorkerEvent::Opened => {
                self.is_open = true;
                self.go_on(now, actions);
            }
            WorkerEvent::Failed { reason } => {
                let message = Message::Failed { reason: short(reason.clone()) };
                self.send(now, message.frame(), actions);
                self.failed = Some(reason);
            }
            WorkerEvent::Rendered { lane, pixels, time, work, blocks } => {
                self.rendered(lane, &pixels, time, work, &blocks);
                self.go_on(now, actions);
            }
        }
        self.tick(now, actions);
    }

    /// To be called at least every [`RoleOptions::heartbeat`].
    pub fn tick(&mut self, now: Duration, actions: &mut Vec<WorkerAction>) {
        let Some(peer) = self.coordinator else { return };
        if now.saturating_sub(self.last_heard) >= self.options.silence_max {
            let reason = "the coordinator is silent".to_owned();
            actions.push(WorkerAction::Network(Action::Disconnect { peer, reason }));
            self.coordinator = None;
        } else if now.saturating_sub(self.last_told) >= self.options.heartbeat {
            self.send(now, Message::Alive.frame(), actions);
        }
    }

    /// Whether the coordinator is connected; if not, the driver tries again.
    pub fn is_connected(&self) -> bool {
        self.coordinator.is_some()
    }

    /// Whether the coordinator is connected and has said something: the connection is of use.
    pub fn is_welcome(&self) -> bool {
        self.is_connected() && self.is_welcome
    }

    /// Why the coordinator does not want this worker, if it has said so; to try again is of no use.
    pub fn refusal(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// Whether the picture is done and the worker may end.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Why it cannot go on, if it cannot.
    pub fn failure(&self) -> Option<&str> {
        self.failed.as_deref()
    }

    /// What it did so far.
    pub fn counters(&self) -> WorkerCounters {
        self.counters
    }

    fn send(&mut self, now: Duration, frame: Vec<u8>, actions: &mut Vec<WorkerAction>) {
        if let Some(to) = self.coordinator {
            self.last_told = now;
            actions.push(WorkerAction::Network(Action::Send { to, frame }));
        }
    }

    fn hear(&mut self, now: Duration, event: TransportEvent, actions: &mut Vec<WorkerAction>) {
        match event {
            TransportEvent::Frame { peer, bytes } if Some(peer) == self.coordinator => {
                self.last_heard = now;
                let result = match Message::parse(&bytes) {
                    Ok((message, _)) => self.obey(message, now, actions),
                    Err(error) => Err(error.to_string()),
                };
                if let Err(reason) = result {
                    self.coordinator = None;
                    actions.push(WorkerAction::Network(Action::Disconnect { peer, reason }));
                }
            }
            TransportEvent::Disconnected { peer, reason } if Some(peer) == self.coordinator => {
                self.coordinator = None;
                let line = format!("the coordinator is gone: {reason}");
                actions.push(WorkerAction::Network(Action::Log(line)));
            }
            // Nobody else has any business here.
            TransportEvent::Connected { peer, .. } | TransportEvent::Frame { peer, .. } => {
                let reason = "it is not the coordinator".to_owned();
                actions.push(WorkerAction::Network(Action::Disconnect { peer, reason }));
            }
            TransportEvent::Disconnected { .. } => {}
            TransportEvent::Refused { from, reason } => {
                actions.push(WorkerAction::Network(Action::Log(format!("refused {from}: {reason}"))));
            }
        }
    }

    fn obey(
        &mut self,
        message: Message,
        now: Duration,
        actions: &mut Vec<WorkerAction>,
    ) -> Result<(), String> {
        self.is_welcome = !matches!(message, Message::Refused { .. });
        match message {
            Message::Alive => Ok(()),
            Message::Refused { reason } => {
                self.refused = Some(reason);
                Ok(())
            }
            Message::Finished => {
                self.finished = true;
                Ok(())
            }
            Message::Job(job) => self.take_job(job, now, actions),
            Message::Readers { addresses } => {
                if self.readers.as_ref() != Some(&addresses) {
                    self.readers = Some(addresses.clone());
                    actions.push(WorkerAction::Readers(addresses));
                }
                Ok(())
            }
            Message::Assign { lane, what, stop_after_us } => {
                let grid = self.grid.as_ref().ok_or("an assignment before the job")?;
                let exists = grid.cells_of(TileId(what.tile));
                if what.tile >= grid.tile_count() || what.cells & !exists != 0 {
                    return Err("an assignment of cells that the picture does not have".to_owned());
                }
                let lane = self.lanes.get_mut(usize::from(lane)).ok_or("an assignment for no lane")?;
                lane.asks = false;
                if lane.held.len() > 2 * HELD_MAX {
                    return Err("more assignments than were asked for".to_owned());
                }
                lane.held.push_back(Held {
                    lease: what.lease,
                    tile: TileId(what.tile),
                    todo: what.cells,
                    stop_after: Duration::from_micros(stop_after_us),
                    spent: Duration::ZERO,
                    ready: BTreeMap::new(),
                    ready_time: Duration::ZERO,
                    ready_work: 0.0,
                    ready_blocks: BlockSketch::default(),
                });
                self.go_on(now, actions);
                Ok(())
            }
            Message::Shorten { lane, what } => {
                self.shorten(lane, what);
                self.go_on(now, actions);
                Ok(())
            }
            _ => Err("a message that is not for a worker".to_owned()),
        }
    }

    fn take_job(
        &mut self,
        job: Box<Job>,
        now: Duration,
        actions: &mut Vec<WorkerAction>,
    ) -> Result<(), String> {
        self.is_confirmed = true;
        if self.job.as_ref() == Some(&job) {
            // A coordinator that was restarted, or a connection that was lost: what is done is for it.
            for frame in std::mem::take(&mut self.unsent) {
                self.send(now, frame, actions);
            }
            if self.is_open {
                self.go_on(now, actions);
            }
            return Ok(());
        }
        let settings = &job.settings;
        let grid = ImageGrid::new(settings.width, settings.height, job.tile_side, job.cell_side)
            .map_err(|error| error.to_string())?;
        self.grid = Some(grid);
        self.is_open = false;
        self.unsent.clear();
        for lane in &mut self.lanes {
            *lane = Lane { square_cells: lane.square_cells, ..Lane::default() };
        }
        self.job = Some(job.clone());
        actions.push(WorkerAction::Open(job));
        Ok(())
    }

    fn shorten(&mut self, lane: u16, what: LeasedCells) {
        let Some(lane) = self.lanes.get_mut(usize::from(lane)) else { return };
        let held = lane.held.iter_mut().find(|held| held.lease == what.lease && held.tile.0 == what.tile);
        if let Some(held) = held
            && held.todo & !what.cells != 0
        {
            held.todo &= what.cells;
            self.counters.shortened += 1;
        }
    }

    fn rendered(&mut self, lane: u16, pixels: &[[f32; 3]], time: Duration, work: f64, blocks: &BlockSketch) {
        let Some(grid) = &self.grid else { return };
        let Some(lane) = self.lanes.get_mut(usize::from(lane)) else { return };
        // A region of an earlier job is of no use.
        let (Some(cells), Some(held)) = (lane.rendering.take(), lane.held.front_mut()) else { return };
        let square = TileCells { tile: held.tile, cells };
        let squares = grid.squares(square, 64);
        let Some((_, whole)) = squares.first().filter(|(_, region)| region.pixels() == pixels.len() as u64)
        else {
            return;
        };
        for (cell, region) in grid.squares(square, 1) {
            let mut bytes = Vec::with_capacity(region.pixels() as usize * 12);
            for row in region.y - whole.y..region.y - whole.y + region.height {
                let start = (row * whole.width + region.x - whole.x) as usize;
                put_pixels(pixels[start..start + region.width as usize].iter().copied(), &mut bytes);
            }
            held.ready.insert(cell.cells.trailing_zeros(), bytes);
        }
        held.spent += time;
        held.ready_time += time;
        held.ready_work += work;
        held.ready_blocks.merge(blocks);
        self.counters.cells += u64::from(square.count());
        // Squares of a quarter or four times the size next time, if that is nearer to the wanted time.
        if time > 2 * self.square_time && lane.square_cells > 1 {
            lane.square_cells /= 4;
        } else if time < self.square_time / 8 && lane.square_cells < 64 && square.count() == lane.square_cells
        {
            lane.square_cells *= 4;
        }
    }

    /// Lets every lane do what comes next.
    fn go_on(&mut self, now: Duration, actions: &mut Vec<WorkerAction>) {
        if !self.is_open || self.finished || self.failed.is_some() {
            return;
        }
        for lane in 0..self.lanes.len() {
            self.step(lane, now, actions);
        }
    }

    fn step(&mut self, number: usize, now: Duration, actions: &mut Vec<WorkerAction>) {
        let (Some(job), Some(grid)) = (&self.job, &self.grid) else { return };
        // The scratch of a lane is made for so many pixels at once.
        let side = job.settings.tile_size / job.cell_side;
        let mut frames = Vec::new();
        let lane = &mut self.lanes[number];
        // At most 65,535 lanes.
        let id = number as u16;
        while lane.rendering.is_none() {
            let Some(held) = lane.held.front_mut() else { break };
            if held.todo != 0 && held.spent > Duration::ZERO && held.spent >= held.stop_after {
                self.counters.critical += 1;
                held.todo = 0;
            }
            let is_last = held.todo == 0;
            if is_last || !held.ready.is_empty() && now.saturating_sub(lane.last_report) >= REPORT_TIME {
                lane.last_report = now;
                frames.push(result(id, held, is_last));
            }
            if is_last {
                lane.held.pop_front();
                continue;
            }
            let cells = TileCells { tile: held.tile, cells: held.todo };
            let squares = grid.squares(cells, lane.square_cells.min(side * side).max(1));
            let Some((square, region)) = squares.first().copied() else {
                // Only cells that do not exist were left.
                held.todo = 0;
                continue;
            };
            held.todo &= !square.cells;
            lane.rendering = Some(square.cells);
            actions.push(WorkerAction::Render { lane: id, region });
        }
        let is_ready = self.coordinator.is_some() && self.is_confirmed;
        let asks = !lane.asks && lane.held.len() < HELD_MAX && is_ready;
        lane.asks |= asks;
        for frame in frames {
            if is_ready {
                self.send(now, frame, actions);
            } else {
                self.unsent.push(frame);
            }
        }
        if asks {
            self.send(now, Message::Request { lane: id }.frame(), actions);
        }
    }
}

/// The message that returns what is ready.
fn result(lane: u16, held: &mut Held, is_last: bool) -> Vec<u8> {
    let ready = std::mem::take(&mut held.ready);
    let cells = ready.keys().fold(0u64, |set, cell| set | 1 << cell);
    let what = LeasedCells { lease: held.lease, tile: held.tile.0, cells };
    let micros = u64::try_from(std::mem::take(&mut held.ready_time).as_micros()).unwrap_or(u64::MAX);
    let work = std::mem::take(&mut held.ready_work);
    let blocks = std::mem::take(&mut held.ready_blocks);
    let pixels: Vec<u8> = ready.into_values().flatten().collect();
    Message::Result { lane, what, is_last, micros, work, blocks }.frame_with(&pixels)
}

impl std::fmt::Debug for Worker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Worker").finish_non_exhaustive()
    }
}
