//! The coordinator: who is there, who renders what, what is done.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;
use std::time::Duration;

use super::checkpoint::Record;
use super::message::{Job, LeasedCells, MESSAGE_VERSION, Message, Role, UnsendableError, short};
use super::picture::Picture;
use super::{Action, RoleOptions};
use crate::block::checksum;
use crate::budget::MemoryBudget;
use crate::error::{BudgetError, RenderError, ScheduleError};
use crate::render::Film;
use crate::schedule::{
    AdaptiveScheduler, Answer, Assignment, ImageGrid, Notice, ScheduleProgress, SchedulerOptions, Spent,
    TileCells, TileResult, TileScheduler,
};
use crate::transport::{PeerId, TransportEvent};
use crate::units::{LeaseId, TileId, WorkerId};

/// What can be chosen about a coordinator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoordinatorOptions {
    /// Heartbeats.
    pub roles: RoleOptions,
    /// How tiles are handed out. Its tile and cell sides are taken from the job.
    pub schedule: SchedulerOptions,
    /// Readers that are expected: over so many the blocks are shared out. More are kept in reserve.
    pub readers: usize,
}

/// What the coordinator did and saw.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CoordinatorCounters {
    /// Nodes that joined.
    pub joined: u64,
    /// Nodes that went or were given up.
    pub lost: u64,
    /// Of these, nodes that were given up because they were silent.
    pub silent: u64,
    /// Peers that were turned away or cut off because of what they sent.
    pub refused: u64,
    /// Messages received.
    pub messages: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Results that came.
    pub results: u64,
    /// Cells in them that were done already.
    pub cells_repeated: u64,
}

/// A lane that returned cells: a thread of a worker, in one connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LaneInfo {
    /// The worker's name, which its lanes share.
    pub worker: Arc<str>,
    /// Which of its lanes.
    pub lane: u16,
}

/// A stretch of time in which a lane rendered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Index into [`Coordinator::lanes`].
    pub lane: u32,
    /// From when, by the coordinator's clock.
    pub start: Duration,
    /// Until when.
    pub end: Duration,
    /// Cells that came of it.
    pub cells: u32,
}

/// A node after its first message.
enum Member {
    Worker { lanes: Vec<WorkerId> },
    Reader { address: String, place: Option<usize> },
}

struct Node {
    name: String,
    member: Option<Member>,
    last_heard: Duration,
    last_told: Duration,
}

/// A lane by its number in the schedule.
struct Lane {
    peer: PeerId,
    name: Arc<str>,
    lane: u16,
    /// Where it stands in the list of those that returned cells, from its first on.
    number: Option<u32>,
    /// Whether it waits for an answer to its request.
    asks: bool,
}

/// The state machine of a coordinator: events in, actions out.
///
/// It trusts nobody who has not said hello, and what members say only as far as it fits: a result of cells that the picture does
/// not have, or with a wrong number of pixels, ends the connection. Results count once, whoever sends them, however late.
pub struct Coordinator {
    job: Job,
    /// The message that gives it to workers.
    job_frame: Vec<u8>,
    options: CoordinatorOptions,
    scheduler: AdaptiveScheduler,
    picture: Picture,
    nodes: BTreeMap<PeerId, Node>,
    workers: HashMap<WorkerId, Lane>,
    lanes: Vec<LaneInfo>,
    /// Lanes that joined so far.
    joined_lanes: u64,
    places: Vec<Option<PeerId>>,
    spans: Vec<Span>,
    counters: CoordinatorCounters,
    records: Vec<Record>,
    finished: bool,
    now: Duration,
}

/// More are not kept: a picture that takes so many results needs no timeline of each.
const SPANS_MAX: usize = 1 << 20;

/// More lanes are not told apart: names of a kilobyte each are to stay within bounds, too.
const LANES_MAX: u32 = 1 << 16;

impl Coordinator {
    /// A coordinator of a picture of which nothing is done. The picture's memory comes from `budget`.
    ///
    /// # Errors
    /// [`CoordinatorError`] for options that make no sense, or if the picture does not fit in the budget.
    pub fn new(
        job: Job,
        options: CoordinatorOptions,
        budget: &MemoryBudget,
    ) -> Result<Coordinator, CoordinatorError> {
        let schedule =
            SchedulerOptions { tile_side: job.tile_side, cell_side: job.cell_side, ..options.schedule };
        let scheduler = AdaptiveScheduler::new(job.settings.width, job.settings.height, schedule)?;
        Coordinator::start(job, options, scheduler, budget)
    }

    /// Goes on from what an earlier coordinator of the same job recorded, in the order in which it did.
    ///
    /// # Errors
    /// As for [`Coordinator::new`]; records of another picture are an error too.
    pub fn restore(
        job: Job,
        options: CoordinatorOptions,
        records: impl IntoIterator<Item = Record>,
        budget: &MemoryBudget,
    ) -> Result<Coordinator, CoordinatorError> {
        let mut last = None;
        let mut results = Vec::new();
        for record in records {
            match record {
                Record::Start(checkpoint) => last = Some(checkpoint),
                Record::Result(frame) => results.push(frame),
            }
        }
        let Some(mut checkpoint) = last else { return Coordinator::new(job, options, budget) };
        let grid = checkpoint.grid();
        let sides = [job.settings.width, job.settings.height, job.tile_side, job.cell_side];
        if [grid.width(), grid.height(), grid.tile_side(), grid.cell_side()] != sides {
            return Err(CoordinatorError::OtherRecords);
        }
        // What counts is the pixels that are there.
        for tile in (0..grid.tile_count()).map(TileId) {
            checkpoint.forget(tile, u64::MAX);
        }
        let scheduler = AdaptiveScheduler::restore(&checkpoint, options.schedule)?;
        let mut coordinator = Coordinator::start(job, options, scheduler, budget)?;
        for frame in results {
            let Ok((Message::Result { what, micros, work, blocks, .. }, pixels)) = Message::parse(&frame)
            else {
                return Err(CoordinatorError::OtherRecords);
            };
            let cells = TileCells { tile: TileId(what.tile), cells: what.cells };
            if !coordinator.picture.fits(cells, pixels) {
                return Err(CoordinatorError::OtherRecords);
            }
            let spent = Spent { seconds: micros as f64 * 1e-6, work };
            let result = TileResult { lease: LeaseId(what.lease), cells, is_last: true, spent, blocks };
            let receipt = coordinator.scheduler.complete(WorkerId(u64::MAX), &result, Duration::ZERO)?;
            let owner = coordinator.restored();
            coordinator.picture.take(cells, pixels, receipt.fresh.cells, owner);
        }
        coordinator.finished = coordinator.scheduler.is_finished();
        Ok(coordinator)
    }

    fn start(
        job: Job,
        options: CoordinatorOptions,
        scheduler: AdaptiveScheduler,
        budget: &MemoryBudget,
    ) -> Result<Coordinator, CoordinatorError> {
        // Else each worker would refuse the job, and the coordinator wait for others.
        job.scene.validate()?;
        job.settings.validate()?;
        let picture = Picture::new(scheduler.grid().clone(), budget)?;
        let job_frame = Message::Job(Box::new(job.clone())).try_frame()?;
        let records = vec![Record::Start(scheduler.checkpoint())];
        Ok(Coordinator {
            job,
            job_frame,
            options,
            scheduler,
            picture,
            nodes: BTreeMap::new(),
            workers: HashMap::new(),
            lanes: Vec::new(),
            joined_lanes: 0,
            places: vec![None; options.readers],
            spans: Vec::new(),
            counters: CoordinatorCounters::default(),
            records,
            finished: false,
            now: Duration::ZERO,
        })
    }

    /// The lane to which cells from before a restart belong.
    fn restored(&mut self) -> u32 {
        if self.lanes.is_empty() {
            self.lanes.push(LaneInfo { worker: "before the restart".into(), lane: 0 });
        }
        0
    }

    /// Something happened.
    pub fn handle(&mut self, now: Duration, event: TransportEvent, actions: &mut Vec<Action>) {
        self.now = self.now.max(now);
        match event {
            TransportEvent::Connected { peer, name } => {
                let node = Node { name, member: None, last_heard: self.now, last_told: self.now };
                self.nodes.insert(peer, node);
            }
            TransportEvent::Frame { peer, bytes } => {
                self.counters.messages += 1;
                self.counters.bytes += bytes.len() as u64;
                if let Some(node) = self.nodes.get_mut(&peer) {
                    node.last_heard = self.now;
                    let result = match Message::parse(&bytes) {
                        Ok((message, tail)) => self.hear(peer, message, tail, actions),
                        Err(error) => Err(error.to_string()),
                    };
                    if let Err(reason) = result {
                        self.counters.refused += 1;
                        self.drop_node(peer, reason, actions);
                    }
                }
            }
            TransportEvent::Disconnected { peer, reason } => self.forget(peer, &reason, actions),
            TransportEvent::Refused { from, reason } => {
                self.counters.refused += 1;
                actions.push(Action::Log(format!("refused {from}: {reason}")));
            }
        }
        self.tell_notices(actions);
    }

    /// To be called at the time that [`Coordinator::next_tick`] gives, or a little later.
    pub fn tick(&mut self, now: Duration, actions: &mut Vec<Action>) {
        self.now = self.now.max(now);
        let RoleOptions { heartbeat, silence_max } = self.options.roles;
        let since = |time: Duration| self.now.saturating_sub(time);
        let silent: Vec<PeerId> = self
            .nodes
            .iter()
            .filter(|(_, node)| since(node.last_heard) >= silence_max)
            .map(|(peer, _)| *peer)
            .collect();
        for peer in silent {
            self.counters.silent += 1;
            self.drop_node(peer, format!("silent for {} s", silence_max.as_secs_f64()), actions);
        }
        for (peer, node) in &mut self.nodes {
            if self.now.saturating_sub(node.last_told) >= heartbeat {
                node.last_told = self.now;
                actions.push(Action::Send { to: *peer, frame: Message::Alive.frame() });
            }
        }
        self.scheduler.tick(self.now);
        self.tell_notices(actions);
    }

    /// When [`Coordinator::tick`] is to be called next.
    pub fn next_tick(&self) -> Duration {
        let RoleOptions { heartbeat, silence_max } = self.options.roles;
        let nodes =
            self.nodes.values().map(|node| (node.last_heard + silence_max).min(node.last_told + heartbeat));
        nodes.chain(self.scheduler.next_tick()).min().unwrap_or(self.now + heartbeat)
    }

    /// The coordinator ends, with or without its picture: tells everybody, so that they end too.
    pub fn end(&mut self, actions: &mut Vec<Action>) {
        for peer in self.nodes.keys() {
            actions.push(Action::Send { to: *peer, frame: Message::Finished.frame() });
        }
    }

    /// Whether every pixel is there.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// What is to be written to the checkpoint, since this was asked last.
    pub fn take_records(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.records)
    }

    /// A number that only the same job has: a checkpoint is of one job.
    pub fn job_digest(&self) -> u64 {
        checksum(&self.job_frame)
    }

    /// The picture so far; pixels that are not there are black and not finished.
    pub fn film(&self) -> &Film {
        self.picture.film()
    }

    /// The picture.
    pub fn into_film(self) -> Film {
        self.picture.into_film()
    }

    /// The cells of the picture.
    pub fn grid(&self) -> &ImageGrid {
        self.scheduler.grid()
    }

    /// By cell, along the curve of [`Coordinator::grid`]: who rendered it, as an index into [`Coordinator::lanes`].
    pub fn owners(&self) -> &[Option<u32>] {
        self.picture.owners()
    }

    /// The picture with every cell in the colour of the worker that rendered it (Figure 2 of the 2004 paper); brightness is the
    /// picture's. Its memory comes from `budget`.
    ///
    /// # Errors
    /// [`BudgetError`] if it does not fit.
    pub fn map(&self, budget: &MemoryBudget) -> Result<Film, BudgetError> {
        let mut names: Vec<&str> = Vec::new();
        let workers: Vec<usize> = self
            .lanes
            .iter()
            .map(|lane| {
                names.iter().position(|name| *name == &*lane.worker).unwrap_or_else(|| {
                    names.push(&lane.worker);
                    names.len() - 1
                })
            })
            .collect();
        self.picture.map(|lane| map_colour(workers[lane as usize]), budget)
    }

    /// Everybody who ever returned cells, at most 65,536; the last then stands for all that came later.
    pub fn lanes(&self) -> &[LaneInfo] {
        &self.lanes
    }

    /// When who rendered, in the order in which results came.
    pub fn spans(&self) -> &[Span] {
        &self.spans
    }

    /// How far it is.
    pub fn progress(&self) -> ScheduleProgress {
        self.scheduler.progress()
    }

    /// What it did and saw.
    pub fn counters(&self) -> CoordinatorCounters {
        self.counters
    }

    /// Workers and readers that are there now.
    pub fn members(&self) -> (usize, usize) {
        let count = |is: fn(&Member) -> bool| {
            self.nodes.values().filter(|node| node.member.as_ref().is_some_and(is)).count()
        };
        (
            count(|member| matches!(member, Member::Worker { .. })),
            count(|member| matches!(member, Member::Reader { .. })),
        )
    }

    /// A message of a node that is there; the reason to end the connection if it makes no sense.
    fn hear(
        &mut self,
        peer: PeerId,
        message: Message,
        tail: &[u8],
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        let Some(node) = self.nodes.get(&peer) else { return Ok(()) };
        match (&node.member, message) {
            (None, Message::Hello { version, role, name, address, model }) => {
                self.admit(peer, (version, role, name, address, model), actions)
            }
            (None, _) => Err("it did not say hello".to_owned()),
            (Some(_), Message::Alive) => Ok(()),
            (Some(Member::Worker { lanes }), Message::Request { lane }) => {
                let worker = *lanes.get(usize::from(lane)).ok_or("it has no such lane")?;
                self.ask(worker, actions)
            }
            (
                Some(Member::Worker { lanes }),
                Message::Result { lane, what, is_last, micros, work, blocks },
            ) => {
                let worker = *lanes.get(usize::from(lane)).ok_or("it has no such lane")?;
                let cells = TileCells { tile: TileId(what.tile), cells: what.cells };
                let spent = Spent { seconds: micros as f64 * 1e-6, work };
                let result = TileResult { lease: LeaseId(what.lease), cells, is_last, spent, blocks };
                self.result(worker, &result, micros, tail, actions)
            }
            (Some(_), Message::Failed { reason }) => Err(format!("it cannot go on: {reason}")),
            (Some(_), _) => Err("a message that is not for a coordinator".to_owned()),
        }
    }

    fn admit(
        &mut self,
        peer: PeerId,
        hello: (u16, Role, String, Option<String>, Option<u64>),
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        const WORKER_LANES_MAX: u16 = 1024;
        let (version, role, name, address, model) = hello;
        // Tells the node, so that it need not try again, and then the log.
        let mut refuse = |told: String, reason: String| {
            let frame = Message::Refused { reason: told }.frame();
            actions.push(Action::Send { to: peer, frame });
            Err(reason)
        };
        if version != MESSAGE_VERSION {
            return refuse(
                format!(
                    "the coordinator speaks version {MESSAGE_VERSION} of the messages, this node {version}"
                ),
                format!("it speaks version {version}, this node version {MESSAGE_VERSION}"),
            );
        }
        if model.is_some_and(|model| model != self.job.model) {
            return refuse("the coordinator has another model".to_owned(), "it has another model".to_owned());
        }
        let member = match role {
            Role::Worker { lanes } if !(1..=WORKER_LANES_MAX).contains(&lanes) => {
                let told = format!("a worker has 1 to {WORKER_LANES_MAX} lanes here, not {lanes}");
                return refuse(told, format!("it has {lanes} lanes"));
            }
            Role::Worker { lanes } => {
                let shared: Arc<str> = name.as_str().into();
                let lanes = (0..lanes).map(|lane| {
                    let worker = WorkerId(self.joined_lanes);
                    self.joined_lanes += 1;
                    let name = Arc::clone(&shared);
                    self.workers.insert(worker, Lane { peer, name, lane, number: None, asks: false });
                    self.scheduler.join(worker, self.now);
                    worker
                });
                Member::Worker { lanes: lanes.collect() }
            }
            Role::Reader => {
                let (Some(address), Some(_)) = (address, model) else {
                    let told = "a reader must have a model, and an address where others reach it";
                    return refuse(told.to_owned(), "a reader without an address or a model".to_owned());
                };
                let place = self.places.iter().position(Option::is_none);
                if let Some(place) = place {
                    self.places[place] = Some(peer);
                }
                Member::Reader { address, place }
            }
        };
        self.counters.joined += 1;
        let is_worker = matches!(member, Member::Worker { .. });
        if let Some(node) = self.nodes.get_mut(&peer) {
            actions.push(Action::Log(format!("{name} ({}) joins as a {}", node.name, role.name())));
            node.name = name;
            node.member = Some(member);
        }
        if self.finished {
            actions.push(Action::Send { to: peer, frame: Message::Finished.frame() });
        } else if is_worker {
            // The readers first: with the job the worker decides where its blocks come from.
            actions.push(Action::Send { to: peer, frame: self.readers().frame() });
            actions.push(Action::Send { to: peer, frame: self.job_frame.clone() });
        } else {
            self.tell_readers(actions);
        }
        Ok(())
    }

    fn readers(&self) -> Message {
        let address =
            |peer: &Option<PeerId>| match peer.and_then(|peer| self.nodes.get(&peer)?.member.as_ref()) {
                Some(Member::Reader { address, .. }) => short(address.clone()),
                _ => String::new(),
            };
        Message::Readers { addresses: self.places.iter().map(address).collect() }
    }

    /// Tells the workers where the readers are now.
    fn tell_readers(&self, actions: &mut Vec<Action>) {
        let frame = self.readers().frame();
        for (peer, node) in &self.nodes {
            if matches!(node.member, Some(Member::Worker { .. })) {
                actions.push(Action::Send { to: *peer, frame: frame.clone() });
            }
        }
    }

    /// Asks the schedule for a lane.
    fn ask(&mut self, worker: WorkerId, actions: &mut Vec<Action>) -> Result<(), String> {
        let answer = self.scheduler.request(worker, self.now).map_err(|error| error.to_string())?;
        let Some(lane) = self.workers.get_mut(&worker) else { return Ok(()) };
        lane.asks = matches!(answer, Answer::Wait);
        if let Answer::Assign(Assignment { lease, cells, stop_after }) = answer {
            let what = LeasedCells { lease: lease.0, tile: cells.tile.0, cells: cells.cells };
            let stop_after_us = u64::try_from(stop_after.as_micros()).unwrap_or(u64::MAX);
            let frame = Message::Assign { lane: lane.lane, what, stop_after_us }.frame();
            actions.push(Action::Send { to: lane.peer, frame });
        }
        Ok(())
    }

    fn result(
        &mut self,
        worker: WorkerId,
        result: &TileResult,
        micros: u64,
        pixels: &[u8],
        actions: &mut Vec<Action>,
    ) -> Result<(), String> {
        let cells = result.cells;
        if !self.picture.fits(cells, pixels) {
            return Err("it sent pixels that do not fit their cells".to_owned());
        }
        let receipt = self.scheduler.complete(worker, result, self.now).map_err(|error| error.to_string())?;
        self.counters.results += 1;
        self.counters.cells_repeated += u64::from(receipt.repeated);
        // One that has returned nothing yet takes up no room: anybody may say hello as often as it likes.
        let Some(owner) = (!cells.is_empty()).then(|| self.number(worker)) else {
            return self.finish_if_done(actions);
        };
        if !receipt.fresh.is_empty() {
            let kept = self.picture.take(cells, pixels, receipt.fresh.cells, owner);
            let what = LeasedCells { lease: result.lease.0, tile: cells.tile.0, cells: receipt.fresh.cells };
            let TileResult { spent: Spent { work, .. }, blocks, .. } = *result;
            let part = Message::Result { lane: 0, what, is_last: true, micros, work, blocks };
            self.records.push(Record::Result(part.frame_with(&kept)));
        }
        if self.spans.len() < SPANS_MAX {
            let start = self.now.saturating_sub(Duration::from_micros(micros));
            self.spans.push(Span { lane: owner, start, end: self.now, cells: cells.count() });
        }
        self.finish_if_done(actions)
    }

    fn finish_if_done(&mut self, actions: &mut Vec<Action>) -> Result<(), String> {
        if self.scheduler.is_finished() && !self.finished {
            self.finished = true;
            self.end(actions);
        }
        Ok(())
    }

    /// Where a lane that returns cells stands in the list.
    fn number(&mut self, worker: WorkerId) -> u32 {
        let lane = self.workers.get_mut(&worker);
        if let Some(number) = lane.as_ref().and_then(|lane| lane.number) {
            return number;
        }
        // Fewer than `LANES_MAX`.
        let next = self.lanes.len() as u32;
        let number = match &lane {
            Some(lane) if next < LANES_MAX - 1 => {
                self.lanes.push(LaneInfo { worker: Arc::clone(&lane.name), lane: lane.lane });
                next
            }
            _ => {
                if next < LANES_MAX {
                    self.lanes.push(LaneInfo { worker: "others".into(), lane: 0 });
                }
                LANES_MAX - 1
            }
        };
        if let Some(lane) = lane {
            lane.number = Some(number);
        }
        number
    }

    fn tell_notices(&mut self, actions: &mut Vec<Action>) {
        while let Some(notice) = self.scheduler.notice() {
            match notice {
                Notice::Shorten { worker, lease, keep } => {
                    if let Some(lane) = self.workers.get(&worker) {
                        let what = LeasedCells { lease: lease.0, tile: keep.tile.0, cells: keep.cells };
                        let frame = Message::Shorten { lane: lane.lane, what }.frame();
                        actions.push(Action::Send { to: lane.peer, frame });
                    }
                }
                Notice::Wake { worker } => {
                    if self.workers.get(&worker).is_some_and(|lane| lane.asks) {
                        // It joined, or it would not be on the list.
                        let _ = self.ask(worker, actions);
                    }
                }
            }
        }
    }

    /// Ends a connection from this side.
    fn drop_node(&mut self, peer: PeerId, reason: String, actions: &mut Vec<Action>) {
        self.forget(peer, &reason, actions);
        actions.push(Action::Disconnect { peer, reason });
    }

    /// A node is gone.
    fn forget(&mut self, peer: PeerId, reason: &str, actions: &mut Vec<Action>) {
        let Some(node) = self.nodes.remove(&peer) else { return };
        actions.push(Action::Log(format!("{} is gone: {reason}", node.name)));
        let Some(member) = node.member else { return };
        self.counters.lost += 1;
        match member {
            Member::Worker { lanes } => {
                for worker in lanes {
                    self.workers.remove(&worker);
                    self.scheduler.leave(worker, self.now);
                }
            }
            Member::Reader { place: Some(place), .. } => {
                self.places[place] = None;
                // One in reserve takes the place.
                let spare = self.nodes.iter_mut().find_map(|(peer, node)| match &mut node.member {
                    Some(Member::Reader { place: empty @ None, .. }) => Some((*peer, empty)),
                    _ => None,
                });
                if let Some((peer, empty)) = spare {
                    *empty = Some(place);
                    self.places[place] = Some(peer);
                }
                self.tell_readers(actions);
            }
            Member::Reader { place: None, .. } => {}
        }
    }
}

impl Role {
    fn name(self) -> &'static str {
        match self {
            Role::Worker { .. } => "worker",
            Role::Reader => "reader",
        }
    }
}

/// The colour of worker number `index` in [`Coordinator::map`]: linear RGB. The first eight are told apart also without colour vision
/// (Okabe and Ito 2008).
pub fn map_colour(index: usize) -> [f32; 3] {
    const COLOURS: [[u8; 3]; 8] = [
        [0, 114, 178],
        [230, 159, 0],
        [0, 158, 115],
        [204, 121, 167],
        [86, 180, 233],
        [213, 94, 0],
        [240, 228, 66],
        [120, 120, 120],
    ];
    let [r, g, b] = COLOURS[index % COLOURS.len()];
    // Later rounds are darker. The square is near enough to the curve of sRGB.
    let shade = 1.0 / (1.0 + 0.5 * (index / COLOURS.len()) as f32);
    [r, g, b].map(|channel| (f32::from(channel) / 255.0).powi(2) * shade)
}

/// A coordinator could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CoordinatorError {
    /// Options that make no sense.
    #[error(transparent)]
    Schedule(#[from] ScheduleError),
    /// Nobody can render the job: a number in its scene or its settings makes no sense.
    #[error(transparent)]
    Job(#[from] RenderError),
    /// The picture does not fit.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// Records belong to another picture.
    #[error(
        "what was recorded is of another picture; begin without it, or give the options that it was made with"
    )]
    OtherRecords,
    /// The checkpoint belongs to another picture.
    #[error(
        "the checkpoint {} belongs to another picture; remove it, or give the options that it was made with",
        path.display()
    )]
    OtherPicture {
        /// Its file.
        path: std::path::PathBuf,
    },
    /// The file is not a checkpoint, or nobody can tell whose.
    #[error(
        "{} is there and is no checkpoint that can be read: {reason}; it is left as it is: move it away, or let the checkpoint have another name",
        path.display()
    )]
    NoCheckpoint {
        /// The file.
        path: std::path::PathBuf,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Another coordinator writes to it.
    #[error("another coordinator is using the checkpoint {}; wait until that has ended, or let one of them have another name", path.display())]
    CheckpointInUse {
        /// Its file.
        path: std::path::PathBuf,
    },
    /// The checkpoint cannot be read or written.
    #[error("cannot read or write the checkpoint {}: {error}", path.display())]
    Checkpoint {
        /// Its file.
        path: std::path::PathBuf,
        /// The cause.
        #[source]
        error: std::io::Error,
    },
    /// The scene holds what does not travel.
    #[error(
        "the scene cannot be sent to workers: a picture as environment does not travel; render it on one machine, or surround the scene by a constant radiance"
    )]
    SceneStays(#[from] UnsendableError),
    /// The transport failed.
    #[error(transparent)]
    Transport(#[from] crate::error::TransportError),
}

impl std::fmt::Debug for Coordinator {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Coordinator").finish_non_exhaustive()
    }
}
