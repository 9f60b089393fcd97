//! Nodes that a launcher started together: MPI, through the crate `mpi` (rsmpi). Works with Open MPI and MPICH.
//!
//! One thread makes all calls of MPI (`MPI_THREAD_FUNNELED` is all that is asked for), so the threads of a node never wait
//! inside the library. What arrives is held by the same bounded mailboxes as in the other transports; a peer sends no more than
//! fits there. `docs/cluster.md` has the bytes.
//!
//! The network of an MPI job is trusted: nothing is encrypted, and who may join is the launcher's affair. The job ends as a
//! whole: with the first rank that dies, everywhere.

mod flight;
mod letter;
mod nodes;
mod service;

use std::sync::{Arc, mpsc};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use parking_lot::{Condvar, Mutex};

use super::mailbox::Mailbox;
use super::{FRAME_BYTES_MAX, PeerId, Transport, TransportEvent};
use crate::error::TransportError;
use nodes::{Nodes, Phase};

/// How long a rank may take to answer.
const CONNECT_TIME_MAX: Duration = Duration::from_secs(5);

struct Shared {
    nodes: Mutex<Nodes>,
    /// Something is to be done by the thread that calls MPI.
    called: Condvar,
    /// It has done something.
    answered: Condvar,
}

impl Shared {
    /// Does something with the nodes, and wakes the thread that calls MPI if it is to act.
    fn with<T>(&self, act: impl FnOnce(&mut Nodes) -> T) -> T {
        let mut nodes = self.nodes.lock();
        let result = act(&mut nodes);
        if nodes.is_called {
            self.called.notify_one();
        }
        result
    }
}

/// This process's part of an MPI job: one rank.
///
/// Dropping it ends MPI here, which waits until all ranks do; dropping it in a panic ends the whole job.
pub struct MpiJob {
    shared: Arc<Shared>,
    rank: usize,
    size: usize,
    service: Option<JoinHandle<()>>,
}

impl MpiJob {
    /// Whether a launcher of MPI jobs seems to have started this process, by the variables that Open MPI, MPICH and Slurm set.
    /// That the processes then find each other is not certain: a library that does not speak the launcher's protocol makes each a job by
    /// itself (MPICH), or ends it (Open MPI).
    pub fn is_launched() -> bool {
        ["OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK"].iter().any(|name| std::env::var_os(name).is_some())
    }

    /// Starts MPI. Once in a process. Without a launcher the job is this process alone.
    ///
    /// # Errors
    /// [`TransportError::Mpi`] if MPI was started before, or cannot work beside threads.
    pub fn start() -> Result<MpiJob, TransportError> {
        let error = |reason: String| TransportError::Mpi { reason };
        let (nodes, called, answered) = (Mutex::new(Nodes::default()), Condvar::new(), Condvar::new());
        let shared = Arc::new(Shared { nodes, called, answered });
        let (started_in, started) = mpsc::channel();
        let serving = Arc::clone(&shared);
        let service = thread::Builder::new()
            .name("mpi".to_owned())
            .spawn(move || service::serve(&serving, &started_in))
            .map_err(|reason| error(reason.to_string()))?;
        let start = started.recv().map_err(|_| error("it ended while it was starting".to_owned()))?;
        let (rank, size) = start.map_err(error)?;
        // Neither is negative.
        let (rank, size) = (rank.max(0) as usize, size.max(0) as usize);
        Ok(MpiJob { shared, rank, size, service: Some(service) })
    }

    /// This process's number, from 0.
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// How many processes the job has.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Where a node that rank `rank` opened as `name` is reached.
    pub fn address_of(rank: usize, name: &str) -> String {
        format!("mpi:{rank}/{name}")
    }

    /// Opens a node that others reach as [`MpiJob::address_of`] this rank and `name`. An earlier node of that name is not reached any
    /// more.
    pub fn open(&self, name: &str) -> MpiTransport {
        let (node, mailbox) = self.shared.with(|nodes| nodes.open_node(name));
        MpiTransport {
            shared: Arc::clone(&self.shared),
            node,
            mailbox,
            rank: self.rank,
            size: self.size,
            name: name.to_owned(),
        }
    }

    /// Waits until all ranks have called this as often. Sleeps, and burns no core.
    pub fn barrier(&self) {
        let mut nodes = self.shared.nodes.lock();
        nodes.barriers[0] += 1;
        let number = nodes.barriers[0];
        nodes.is_called = true;
        self.shared.called.notify_one();
        while nodes.barriers[1] < number {
            self.shared.answered.wait(&mut nodes);
        }
    }

    /// Ends the job on all ranks at once with this exit code, by `MPI_Abort`. To be called with the reason told to the user.
    pub fn abort(&self, code: i32) -> ! {
        self.request_abort(code);
        // MPI has a few seconds to tell the launcher.
        thread::sleep(2 * CONNECT_TIME_MAX);
        std::process::abort()
    }

    /// A function that does what [`MpiJob::abort`] does, for a hook of panics or of signals.
    pub fn aborter(&self) -> impl Fn(i32) + Send + Sync + 'static {
        let shared = Arc::clone(&self.shared);
        move |code| {
            shared.with(|nodes| {
                nodes.abort.get_or_insert(code);
                nodes.is_called = true;
            })
        }
    }

    fn request_abort(&self, code: i32) {
        self.aborter()(code);
    }
}

impl Drop for MpiJob {
    fn drop(&mut self) {
        if thread::panicking() {
            self.request_abort(1);
        } else {
            self.shared.with(|nodes| (nodes.is_ending, nodes.is_called) = (true, true));
        }
        if let Some(service) = self.service.take() {
            // It ends the job if it panics.
            let _ = service.join();
        }
    }
}

/// A node of an [`MpiJob`]. Dropping it closes it.
pub struct MpiTransport {
    shared: Arc<Shared>,
    node: u64,
    mailbox: Arc<Mailbox>,
    rank: usize,
    size: usize,
    name: String,
}

impl MpiTransport {
    /// Rank and name of an address.
    fn parse(&self, address: &str) -> Result<(i32, String), String> {
        let parts = address.strip_prefix("mpi:").and_then(|rest| rest.split_once('/'));
        let (rank, name) = parts.ok_or("an address of MPI looks like `mpi:RANK/NAME`")?;
        let rank: i32 = rank.parse().map_err(|_| "the rank must be a number".to_owned())?;
        if usize::try_from(rank).is_ok_and(|rank| rank < self.size) {
            Ok((rank, name.to_owned()))
        } else {
            Err(format!("the job has {} ranks, from 0", self.size))
        }
    }
}

impl Transport for MpiTransport {
    fn address(&self) -> Option<String> {
        Some(MpiJob::address_of(self.rank, &self.name))
    }

    fn connect(&self, address: &str) -> Result<PeerId, TransportError> {
        let failed = |reason: String| TransportError::Connect { address: address.to_owned(), reason };
        if self.mailbox.is_closed() {
            return Err(TransportError::Closed);
        }
        let (rank, there) = self.parse(address).map_err(failed)?;
        let number = self.shared.with(|nodes| nodes.connect(self.node, rank, &there, &self.name));
        let deadline = Instant::now() + CONNECT_TIME_MAX;
        let mut nodes = self.shared.nodes.lock();
        loop {
            let error = match nodes.ways.get(&number).map(|way| &way.phase) {
                Some(Phase::Refused(reason)) => failed(reason.clone()),
                Some(Phase::Connecting) if self.mailbox.is_closed() => TransportError::Closed,
                Some(Phase::Connecting) if Instant::now() >= deadline => {
                    failed(format!("rank {rank} does not answer"))
                }
                Some(Phase::Connecting) => {
                    self.shared.answered.wait_until(&mut nodes, deadline);
                    continue;
                }
                // Open, or ended again by the peer, which the mailbox tells.
                Some(Phase::Open | Phase::Ending) | None => return Ok(PeerId(number)),
            };
            nodes.ways.remove(&number);
            return Err(error);
        }
    }

    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        if self.mailbox.is_closed() {
            return Err(TransportError::Closed);
        }
        if frame.len() > FRAME_BYTES_MAX {
            return Err(TransportError::FrameTooLong { bytes: frame.len(), limit: FRAME_BYTES_MAX });
        }
        self.shared.with(|nodes| {
            let is_open = nodes.way_of(self.node, to.0).is_some_and(|way| way.phase == Phase::Open);
            if !is_open {
                return Err(TransportError::NotConnected { peer: to.0 });
            }
            nodes.send(to.0, frame).map_err(|_| TransportError::QueueFull { peer: to.0 })
        })
    }

    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        let event = self.mailbox.take(wait)?;
        if let Some(TransportEvent::Frame { peer, bytes }) = &event {
            self.shared.with(|nodes| nodes.took(peer.0, bytes.len()));
        }
        Ok(event)
    }

    fn disconnect(&self, peer: PeerId) {
        self.shared.with(|nodes| {
            if nodes.way_of(self.node, peer.0).is_some() && self.mailbox.forget(peer) {
                nodes.end(peer.0);
            }
        });
    }

    fn frame_bytes_max(&self) -> usize {
        FRAME_BYTES_MAX
    }

    fn close(&self) {
        self.shared.with(|nodes| nodes.close_node(&self.name, self.node));
        self.shared.answered.notify_all();
    }
}

impl Drop for MpiTransport {
    fn drop(&mut self) {
        self.close();
    }
}

impl std::fmt::Debug for MpiJob {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MpiJob").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for MpiTransport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("MpiTransport").finish_non_exhaustive()
    }
}
