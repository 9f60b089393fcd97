//! The roles in real time, over a real transport.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender, SyncSender};
use std::thread;
use std::time::{Duration, Instant};

use super::Action;
use super::block_client::RemoteCounters;
use super::checkpoint::Checkpoint;
use super::coordinator::{Coordinator, CoordinatorError};
use super::file_copy::{CopyCounters, FileCopy};
use super::message::Job;
use super::model_file::model_key;
use super::reader::{Reader, ReaderCounters};
use super::reconnect::Reconnect;
use super::remote_source::RemoteSource;
use super::worker::{Worker, WorkerAction, WorkerCounters, WorkerEvent};
use super::worker_options::WorkerOptions;
use crate::budget::{MemoryBudget, Reservation};
use crate::compile::Control;
use crate::error::{RenderError, SourceError, TransportError};
use crate::model::Model;
use crate::octree::{LazyOctree, OctreeOptions};
use crate::render::{Region, RegionCounters, RegionRenderer, RenderSettings, Renderer, WaitingRays};
use crate::source::{BlockSource, DiskSource};
use crate::stats::TraceCounters;
use crate::trace::LoadStats;
use crate::transport::{PeerId, Transport, TransportEvent};

/// How often a driver looks whether it is to stop.
const LOOK: Duration = Duration::from_millis(50);
/// How often the coordinator makes its checkpoint safe.
const SAFE: Duration = Duration::from_secs(1);

/// How long squares of pixels should take whose rays wait: the more samples are on their way, the more share a load. Not so long
/// that results come late.
const WAITING_SQUARE_TIME: Duration = Duration::from_secs(1);

/// A node ended before its work was done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NodeError {
    /// The transport failed.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The coordinator could not be reached for as long as the node was to wait.
    #[error("no coordinator at {address} for {} s: {reason}", waited.as_secs())]
    NoCoordinator {
        /// Where.
        address: String,
        /// How long.
        waited: Duration,
        /// What the last attempt said.
        reason: String,
    },
    /// The coordinator does not want this node, whenever it comes.
    #[error("refused by the coordinator at {address}: {reason}")]
    Refused {
        /// Where.
        address: String,
        /// What it says.
        reason: String,
    },
    /// There was no worker for as long as the coordinator was to wait.
    #[error("there has been no worker for {} s; the checkpoint, if there is one, holds what is done", waited.as_secs())]
    NoWorkers {
        /// How long.
        waited: Duration,
    },
    /// This node cannot render the picture.
    #[error("{reason}")]
    CannotRender {
        /// Why.
        reason: String,
    },
    /// The coordinator's own.
    #[error(transparent)]
    Coordinator(#[from] CoordinatorError),
}

/// Sends a frame; what the role has to know if it cannot be sent.
fn send(transport: &dyn Transport, to: PeerId, frame: Vec<u8>) -> Option<TransportEvent> {
    match transport.send(to, frame) {
        // Its end is on its way to the role already.
        Ok(()) | Err(TransportError::NotConnected { .. } | TransportError::Closed) => None,
        Err(error) => {
            transport.disconnect(to);
            Some(TransportEvent::Disconnected { peer: to, reason: error.to_string() })
        }
    }
}

/// Runs a coordinator until its picture is done or `observe`, which is called every now and then, cancels. `observe` also gets what
/// there is to log. Gives the coordinator with its picture, whole or not.
///
/// # Errors
/// [`NodeError::NoWorkers`] after `patience` without any; [`NodeError::Coordinator`] if the checkpoint cannot be written.
pub fn run_coordinator(
    transport: &dyn Transport,
    mut coordinator: Coordinator,
    mut checkpoint: Option<Checkpoint>,
    patience: Duration,
    observe: &mut dyn FnMut(&Coordinator, &[String]) -> Control,
) -> Result<Coordinator, NodeError> {
    let start = Instant::now();
    let mut actions = Vec::new();
    let mut log = Vec::new();
    let mut records = Vec::new();
    let (mut last_safe, mut last_look, mut last_worker) = (Duration::ZERO, Duration::ZERO, Duration::ZERO);
    loop {
        let now = start.elapsed();
        if now >= coordinator.next_tick() {
            coordinator.tick(now, &mut actions);
        }
        let mut is_over = coordinator.is_finished();
        if now >= last_look + LOOK || is_over {
            last_look = now;
            if observe(&coordinator, &log) == Control::Cancel && !is_over {
                is_over = true;
                coordinator.end(&mut actions);
            }
            log.clear();
        }
        perform(transport, &mut coordinator, now, &mut actions, &mut log);
        records.append(&mut coordinator.take_records());
        if let Some(checkpoint) = &mut checkpoint
            && (now >= last_safe + SAFE || is_over)
        {
            last_safe = now;
            checkpoint.append(&records)?;
            records.clear();
        } else if checkpoint.is_none() {
            records.clear();
        }
        if is_over {
            return Ok(coordinator);
        }
        if coordinator.members().0 > 0 {
            last_worker = now;
        } else if now.saturating_sub(last_worker) >= patience {
            if let Some(checkpoint) = &mut checkpoint {
                checkpoint.append(&records)?;
            }
            return Err(NodeError::NoWorkers { waited: patience });
        }
        let wait = coordinator.next_tick().saturating_sub(now).min(LOOK);
        let mut event = transport.receive(wait)?;
        // What has come by now is heard before anything else is done.
        while let Some(heard) = event {
            coordinator.handle(start.elapsed(), heard, &mut actions);
            perform(transport, &mut coordinator, start.elapsed(), &mut actions, &mut log);
            if coordinator.is_finished() {
                break;
            }
            event = transport.receive(Duration::ZERO)?;
        }
    }
}

fn perform(
    transport: &dyn Transport,
    coordinator: &mut Coordinator,
    now: Duration,
    actions: &mut Vec<Action>,
    log: &mut Vec<String>,
) {
    // Performing one can bring more.
    while !actions.is_empty() {
        for action in std::mem::take(actions) {
            match action {
                Action::Send { to, frame } => {
                    if let Some(event) = send(transport, to, frame) {
                        coordinator.handle(now, event, actions);
                    }
                }
                Action::Disconnect { peer, .. } => transport.disconnect(peer),
                Action::Log(line) => log.push(line),
            }
        }
    }
}

/// Runs a reader until the picture is done or `stop` is set. It connects to the coordinator at `address`, again and again if need
/// be, for at most `patience` without a connection in which the coordinator says anything.
///
/// # Errors
/// [`NodeError::NoCoordinator`], [`NodeError::Refused`], [`NodeError::Transport`].
pub fn run_reader(
    transport: &dyn Transport,
    mut reader: Reader,
    address: &str,
    patience: Duration,
    stop: &AtomicBool,
    log: &mut dyn FnMut(&str),
) -> Result<ReaderCounters, NodeError> {
    let start = Instant::now();
    let mut reconnect = Reconnect::new(transport, address, patience, reader.roles());
    let mut actions = Vec::new();
    while !reader.is_finished() && !stop.load(Ordering::Relaxed) {
        if let Some(peer) = reconnect.keep(reader.is_connected(), reader.is_welcome())? {
            reader.connected(peer, start.elapsed(), &mut actions);
        }
        match transport.receive(LOOK)? {
            Some(event) => reader.handle(start.elapsed(), event, &mut actions),
            None => reader.tick(start.elapsed(), &mut actions),
        }
        while !actions.is_empty() {
            for action in std::mem::take(&mut actions) {
                match action {
                    Action::Send { to, frame } => {
                        if let Some(event) = send(transport, to, frame) {
                            reader.handle(start.elapsed(), event, &mut actions);
                        }
                    }
                    Action::Disconnect { peer, reason } => {
                        transport.disconnect(peer);
                        log(&format!("connection {} ended: {reason}", peer.0));
                    }
                    Action::Log(line) => log(&line),
                }
            }
        }
        if let Some(reason) = reader.refusal() {
            return Err(NodeError::Refused { address: address.to_owned(), reason: reason.to_owned() });
        }
    }
    Ok(reader.counters())
}

/// What a worker did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WorkerReport {
    /// Cells and connections.
    pub worker: WorkerCounters,
    /// Work of the queries, of all lanes.
    pub trace: TraceCounters,
    /// How loads went, if rays waited for them; of times, the sum over lanes.
    pub loads: LoadStats,
    /// Blocks from readers, if there were any readers.
    pub remote: Option<RemoteCounters>,
    /// The copy of the file, if one was to be made.
    pub copy: Option<CopyCounters>,
}

/// Runs a worker until the picture is done or `stop` is set. `control` leads to the coordinator at `address`; `data` is used for
/// readers and nothing else.
///
/// # Errors
/// [`NodeError`].
pub fn run_worker(
    control: &dyn Transport,
    data: &Arc<dyn Transport>,
    address: &str,
    options: &WorkerOptions,
    stop: &AtomicBool,
    log: &mut dyn FnMut(&str),
) -> Result<WorkerReport, NodeError> {
    let model = options.file.as_ref().map(|file| model_key(file.model()));
    let is_over = AtomicBool::new(false);
    let (events_in, events) = mpsc::sync_channel(256);
    thread::scope(|scope| {
        let to_pump = events_in.clone();
        let pump = || {
            let to_pump = to_pump;
            pump(control, &to_pump, &is_over)
        };
        let refused = |error| NodeError::CannotRender { reason: no_thread(&error) };
        thread::Builder::new().spawn_scoped(scope, pump).map_err(refused)?;
        let (notes_in, notes) = mpsc::channel();
        let mut worker = Worker::new(&options.name, options.lanes, model, options.roles);
        if options.waiting != WaitingRays::Never {
            worker = worker.with_square_time(WAITING_SQUARE_TIME);
        }
        let mut engine = Engine {
            worker,
            reconnect: Reconnect::new(control, address, options.patience, options.roles),
            control,
            events,
            job: 0,
            start: Instant::now(),
            stop,
            log,
            waiting: VecDeque::new(),
            readers: Vec::new(),
            copied: None,
            notes_in,
            notes,
        };
        let result = engine.work(options, data, &events_in);
        is_over.store(true, Ordering::Relaxed);
        // Ends a pump that waits for room.
        drop(engine);
        result
    })
}

/// Brings what the transport receives to where the lanes' results go too.
fn pump(control: &dyn Transport, events: &SyncSender<Queued>, is_over: &AtomicBool) {
    while !is_over.load(Ordering::Relaxed) {
        match control.receive(LOOK) {
            Ok(Some(event)) => {
                if events.send((None, WorkerEvent::Network(event))).is_err() {
                    return;
                }
            }
            Ok(None) => {}
            Err(_) => return,
        }
    }
}

/// A worker and what drives it.
struct Engine<'a> {
    worker: Worker,
    reconnect: Reconnect<'a>,
    control: &'a dyn Transport,
    events: Receiver<Queued>,
    /// The number of the job whose lanes are heard.
    job: u64,
    start: Instant,
    stop: &'a AtomicBool,
    log: &'a mut dyn FnMut(&str),
    /// Actions that are not for the network.
    waiting: VecDeque<WorkerAction>,
    readers: Vec<String>,
    /// The copy that this node made of a model.
    copied: Option<Arc<dyn BlockSource>>,
    /// What the thread that copies has to log.
    notes_in: Sender<String>,
    notes: Receiver<String>,
}

/// An event, and the number of the job whose lane it came from, if it came from a lane: more of a job may be in the queue when the next
/// one begins.
type Queued = (Option<u64>, WorkerEvent);

/// How a job ended.
enum End {
    Over,
    Next(Box<Job>),
}

impl Engine<'_> {
    fn work(
        &mut self,
        options: &WorkerOptions,
        data: &Arc<dyn Transport>,
        events_in: &SyncSender<Queued>,
    ) -> Result<WorkerReport, NodeError> {
        let mut report = WorkerReport::default();
        let mut next: Option<Box<Job>> = None;
        let mut waits_since = Instant::now();
        if let (None, Some(copy)) = (&options.file, &options.copy) {
            // From an earlier job. If it is no model at all, the attempt to make one says so.
            let copied = DiskSource::open_with(&copy.path, copy.page_cache).ok();
            self.copied = copied.map(|copied| Arc::new(copied) as Arc<dyn BlockSource>);
        }
        while !self.is_over() {
            self.turn()?;
            while let Some(action) = self.waiting.pop_front() {
                match action {
                    WorkerAction::Open(job) => {
                        next = Some(job);
                        waits_since = Instant::now();
                    }
                    WorkerAction::Readers(readers) => self.readers = readers,
                    // Nothing is open.
                    WorkerAction::Render { .. } | WorkerAction::Network(_) => {}
                }
            }
            let Some(job) = next.take() else { continue };
            let source = match self.source(options, &job, data) {
                Ok(Some(source)) => source,
                Ok(None) if waits_since.elapsed() < options.patience => {
                    next = Some(job);
                    continue;
                }
                Ok(None) => return self.fail("this node does not have the model, and there is no reader"),
                // The reader may be gone by now; another may come.
                Err(_) if waits_since.elapsed() < options.patience => {
                    next = Some(job);
                    continue;
                }
                Err(error) => return self.fail(&error.to_string()),
            };
            let end = self.job(options, &job, &source, events_in, &mut report);
            if let Source::Remote(remote) = &source {
                report.remote = Some(remote.counters());
            }
            match end {
                Ok(End::Over) => break,
                Ok(End::Next(job)) => next = Some(job),
                Err(error) => return self.fail(&error.to_string()),
            }
            waits_since = Instant::now();
        }
        report.worker = self.worker.counters();
        let (failure, refusal) = (self.worker.failure(), self.worker.refusal());
        match (failure.map(str::to_owned), refusal.map(str::to_owned)) {
            (Some(reason), _) => Err(NodeError::CannotRender { reason }),
            (None, Some(reason)) => {
                Err(NodeError::Refused { address: self.reconnect.address().to_owned(), reason })
            }
            (None, None) => Ok(report),
        }
    }

    fn is_over(&self) -> bool {
        let is_of_no_use = self.worker.failure().is_some() || self.worker.refusal().is_some();
        self.worker.is_finished() || is_of_no_use || self.stop.load(Ordering::Relaxed)
    }

    /// Tells the coordinator, and gives up.
    fn fail(&mut self, reason: &str) -> Result<WorkerReport, NodeError> {
        self.handle(WorkerEvent::Failed { reason: reason.to_owned() });
        Err(NodeError::CannotRender { reason: reason.to_owned() })
    }

    /// Waits for the next event and lets the worker act on it.
    fn turn(&mut self) -> Result<(), NodeError> {
        let (is_connected, is_welcome) = (self.worker.is_connected(), self.worker.is_welcome());
        if let Some(peer) = self.reconnect.keep(is_connected, is_welcome)? {
            self.handle(WorkerEvent::Connected(peer));
        }
        match self.events.recv_timeout(LOOK) {
            // What a lane of another job left in the queue is nothing to this one.
            Ok((job, event)) if job.is_none_or(|job| job == self.job) => self.handle(event),
            Ok(_) => {}
            Err(RecvTimeoutError::Timeout) => {
                let mut actions = Vec::new();
                self.worker.tick(self.start.elapsed(), &mut actions);
                self.perform(actions);
            }
            // The engine holds a sender.
            Err(RecvTimeoutError::Disconnected) => return Err(TransportError::Closed.into()),
        }
        Ok(())
    }

    fn handle(&mut self, event: WorkerEvent) {
        let mut actions = Vec::new();
        self.worker.handle(self.start.elapsed(), event, &mut actions);
        self.perform(actions);
    }

    fn perform(&mut self, actions: Vec<WorkerAction>) {
        let mut todo = VecDeque::from(actions);
        while let Some(action) = todo.pop_front() {
            match action {
                WorkerAction::Network(Action::Send { to, frame }) => {
                    if let Some(event) = send(self.control, to, frame) {
                        let mut more = Vec::new();
                        let event = WorkerEvent::Network(event);
                        self.worker.handle(self.start.elapsed(), event, &mut more);
                        todo.extend(more);
                    }
                }
                WorkerAction::Network(Action::Disconnect { peer, reason }) => {
                    self.control.disconnect(peer);
                    (self.log)(&format!("connection {} ended: {reason}", peer.0));
                }
                WorkerAction::Network(Action::Log(line)) => (self.log)(&line),
                other => self.waiting.push_back(other),
            }
        }
    }

    /// Where blocks come from, as soon as there is such a place.
    fn source(
        &self,
        options: &WorkerOptions,
        job: &Job,
        data: &Arc<dyn Transport>,
    ) -> Result<Option<Source>, SourceError> {
        let has_readers = !self.readers.is_empty();
        let copied = self.copied.as_ref().filter(|copied| model_key(copied.model()) == job.model);
        let copied = copied.filter(|_| options.file.is_none());
        Ok(match options.file.as_ref().or(copied) {
            Some(file) if has_readers => {
                let (file, data, readers) = (Arc::clone(file), Arc::clone(data), self.readers.clone());
                let open = if copied.is_some() { RemoteSource::with_copy } else { RemoteSource::beside };
                Some(Source::Remote(Arc::new(open(file, data, readers, options.remote))))
            }
            Some(file) => Some(Source::File(Arc::clone(file))),
            None if self.readers.iter().any(|reader| !reader.is_empty()) => {
                let remote = RemoteSource::open_in(
                    Arc::clone(data),
                    self.readers.clone(),
                    options.remote,
                    &options.budget,
                )?;
                Some(Source::Remote(Arc::new(remote)))
            }
            None => None,
        })
    }

    /// Renders for one job until it is over or another comes.
    fn job(
        &mut self,
        options: &WorkerOptions,
        job: &Job,
        source: &Source,
        events_in: &SyncSender<Queued>,
        report: &mut WorkerReport,
    ) -> Result<End, RenderError> {
        let blocks = source.blocks();
        if model_key(blocks.model()) != job.model {
            let reason = "the model here is not the one that is rendered".to_owned();
            return Err(RenderError::Setting { what: "model", reason });
        }
        self.job += 1;
        let number = self.job;
        let lanes = options.lanes.max(1);
        let budget = &options.budget;
        let copying = self.copying(options, source);
        let settings = RenderSettings {
            waiting: options.waiting,
            loader_threads: options.loader_threads,
            ..job.settings
        };
        // The octree's cache takes what is left of the budget.
        let set_aside = set_aside(job, blocks.model(), &settings, lanes.into(), budget)?;
        let octree_options = OctreeOptions { tracers_max: u32::from(lanes), ..options.octree };
        let octree = LazyOctree::open(blocks, budget, octree_options)?;
        drop(set_aside);
        let renderer = Renderer::new(&octree, &job.scene, &settings, budget)?;
        let abort = AtomicBool::new(false);
        let (totals_in, totals) = mpsc::channel();
        let end = renderer.with_regions(lanes.into(), |regions_by| {
            thread::scope(|scope| {
                let mut to_lanes: Vec<Sender<Region>> = Vec::new();
                let mut failed = None;
                for lane in 0..lanes {
                    let (regions_in, regions) = mpsc::channel();
                    to_lanes.push(regions_in);
                    let abort = &abort;
                    let (events, totals) = (events_in.clone(), totals_in.clone());
                    // False if the engine is gone.
                    let tell = move |event| events.send((Some(number), event)).is_ok();
                    let spawned = thread::Builder::new().spawn_scoped(scope, move || {
                        let mut done = RegionCounters::default();
                        let result = regions_by.renderer(abort).and_then(|mut renderer| {
                            let result = serve(lane, &mut renderer, &regions, &tell);
                            done = renderer.counters();
                            result
                        });
                        if let Err(error) = result {
                            // The engine may be gone already.
                            let _ = tell(WorkerEvent::Failed { reason: error.to_string() });
                        }
                        let _ = totals.send(done);
                    });
                    if let Err(error) = spawned {
                        // As if the lane had begun and failed.
                        failed = Some(no_thread(&error));
                        let _ = totals_in.send(RegionCounters::default());
                    }
                }
                if let (Some((copy, _)), Source::Remote(remote)) = (&copying, source) {
                    let (abort, notes) = (&abort, self.notes_in.clone());
                    let told = notes.clone();
                    let copier = move || make_copy(copy, remote, abort, &notes);
                    if let Err(error) = thread::Builder::new().spawn_scoped(scope, copier) {
                        let _ = told.send(format!("{}; going on without a copy", no_thread(&error)));
                    }
                }
                self.handle(WorkerEvent::Opened);
                if let Some(reason) = failed {
                    self.handle(WorkerEvent::Failed { reason });
                }
                let end = self.render(source, &to_lanes);
                abort.store(true, Ordering::Relaxed);
                if let (Some(copy), false) = (&options.copy, matches!(end, Ok(End::Next(_)))) {
                    // Lets a copier go that waits for an answer.
                    copy.transport.close();
                }
                if let Source::Remote(remote) = source {
                    remote.abandon();
                }
                drop(to_lanes);
                // Lanes that wait for room are let go; what they have is of no use any more, what the network brings is.
                let mut kept = Vec::new();
                drop(totals_in);
                let mut left = usize::from(lanes);
                while left > 0 {
                    if let Ok(done) = totals.try_recv() {
                        report.trace.merge(&done.trace);
                        report.loads.merge(&done.loads);
                        left -= 1;
                    }
                    match self.events.recv_timeout(Duration::from_millis(1)) {
                        Ok((_, WorkerEvent::Network(event))) => kept.push(event),
                        Ok(_) | Err(RecvTimeoutError::Timeout) => {}
                        Err(RecvTimeoutError::Disconnected) => break,
                    }
                }
                for event in kept {
                    self.handle(WorkerEvent::Network(event));
                }
                end
            })
        })?;
        if let Some((copy, _)) = copying {
            report.copy = Some(copy.counters());
            if self.copied.is_none() {
                // Errors have been logged.
                self.copied =
                    copy.existing().ok().flatten().map(|copied| Arc::new(copied) as Arc<dyn BlockSource>);
            }
        }
        self.log_notes();
        end.map_err(|error| RenderError::Setting { what: "cluster", reason: error.to_string() })
    }

    /// The copy to make beside the job, with the memory for it.
    fn copying(&mut self, options: &WorkerOptions, source: &Source) -> Option<(FileCopy, Reservation)> {
        let (Some(copy), Source::Remote(remote), None) = (&options.copy, source, &options.file) else {
            return None;
        };
        if remote.has_copy() {
            return None;
        }
        match options.budget.reserve(FileCopy::bytes_needed(remote.model()), "a copy of the file") {
            Ok(memory) => Some((FileCopy::new(Arc::clone(remote.model()), copy.clone()), memory)),
            Err(error) => {
                (self.log)(&format!("{error}; going on without a copy"));
                None
            }
        }
    }

    fn log_notes(&mut self) {
        while let Ok(note) = self.notes.try_recv() {
            (self.log)(&note);
        }
    }

    fn render(&mut self, source: &Source, lanes: &[Sender<Region>]) -> Result<End, NodeError> {
        loop {
            self.log_notes();
            while let Some(action) = self.waiting.pop_front() {
                match action {
                    WorkerAction::Open(job) => return Ok(End::Next(job)),
                    WorkerAction::Readers(readers) => {
                        self.readers = readers;
                        if let Source::Remote(remote) = source {
                            remote.set_readers(self.readers.clone());
                        }
                    }
                    WorkerAction::Render { lane, region } => {
                        // A lane that has ended has said why.
                        let _ = lanes.get(usize::from(lane)).map(|lane| lane.send(region));
                    }
                    WorkerAction::Network(_) => {}
                }
            }
            if self.is_over() {
                return Ok(End::Over);
            }
            self.turn()?;
        }
    }
}

/// Sets aside what lanes will take beside the octree. Where it is left to the render whether rays wait, they do so in what there is.
fn set_aside(
    job: &Job,
    model: &Model,
    settings: &RenderSettings,
    lanes: u32,
    budget: &MemoryBudget,
) -> Result<Reservation, RenderError> {
    let reserve = |settings: &RenderSettings| -> Result<Reservation, RenderError> {
        let bytes = Renderer::regions_bytes(&job.scene, model, settings, lanes)?;
        Ok(budget.reserve(bytes, "the lanes' ray trees and pixels")?)
    };
    match reserve(settings) {
        Err(RenderError::Budget(_)) if settings.waiting == WaitingRays::Auto => {
            reserve(&RenderSettings { waiting: WaitingRays::Never, ..*settings })
        }
        result => result,
    }
}

/// A thread that makes a copy of the file beside the lanes.
fn make_copy(copy: &FileCopy, remote: &RemoteSource, stop: &AtomicBool, notes: &Sender<String>) {
    let note = match copy.run(&|| remote.readers(), stop) {
        Ok(Some(source)) => {
            remote.set_copy(Arc::new(source));
            "the copy of the file is complete; blocks come from there".to_owned()
        }
        Ok(None) => return,
        Err(error) => format!("{error}; going on without a copy"),
    };
    // The engine may be gone already.
    let _ = notes.send(note);
}

fn no_thread(error: &io::Error) -> String {
    format!("the system gives this node no more threads: {error}")
}

/// Where a worker's blocks come from.
enum Source {
    File(Arc<dyn BlockSource>),
    Remote(Arc<RemoteSource>),
}

impl Source {
    fn blocks(&self) -> Arc<dyn BlockSource> {
        match self {
            Source::File(file) => Arc::clone(file),
            Source::Remote(remote) => Arc::clone(remote) as Arc<dyn BlockSource>,
        }
    }
}

/// A lane's thread: renders what it is told to until nobody tells it any more.
fn serve(
    lane: u16,
    renderer: &mut RegionRenderer<'_>,
    regions: &Receiver<Region>,
    events: &dyn Fn(WorkerEvent) -> bool,
) -> Result<(), RenderError> {
    while let Ok(region) = regions.recv() {
        let (start, before) = (Instant::now(), work(&renderer.counters().trace));
        let Some(pixels) = renderer.render(region)?.map(<[_]>::to_vec) else { return Ok(()) };
        let blocks = renderer.take_touched();
        let work = work(&renderer.counters().trace) - before;
        let event = WorkerEvent::Rendered { lane, pixels, time: start.elapsed(), work, blocks };
        if !events(event) {
            return Ok(());
        }
    }
    Ok(())
}

/// What queries cost in nanoseconds of some machine, from their counters: the same on every machine, so that the schedule can tell a slow
/// machine from an expensive tile. Loads are not in it: they depend on what is in the cache.
fn work(counters: &TraceCounters) -> f64 {
    120.0 * counters.rays as f64
        + 15.0 * counters.box_tests as f64
        + 2.0 * counters.triangle_tests as f64
        + 30.0 * counters.decisions as f64
}

#[cfg(test)]
mod tests;
