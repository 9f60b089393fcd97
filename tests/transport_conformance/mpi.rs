//! The suite between the processes of an MPI job, and how such a job ends.
//!
//! This test program starts itself by `mpirun` (or what the variable `OUTCROP_MPIRUN` names). Rank 0 runs the suite; nodes are
//! opened on all ranks in turn, and those of other ranks do what rank 0 tells them.

use std::cell::Cell;
use std::collections::HashMap;
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use outcrop::error::TransportError;
use outcrop::transport::{FRAME_BYTES_MAX, MpiJob, MpiTransport, PeerId, Transport, TransportEvent};
use serde::{Deserialize, Serialize};

use super::{LONG, conforms, frame};

const WHAT: &str = "OUTCROP_MPI_TEST";

/// Runs `what` of [`rank`] with so many ranks.
fn launch(ranks: usize, what: &str) -> Output {
    let launcher = std::env::var("OUTCROP_MPIRUN").unwrap_or_else(|_| "mpirun".to_owned());
    let mut command = Command::new(&launcher);
    command.args(["-n", &ranks.to_string()]).arg(std::env::current_exe().unwrap());
    command.args(["--exact", "mpi::rank", "--nocapture", "--test-threads", "1"]).env(WHAT, what);
    // Open MPI: more ranks than cores, also for the superuser of a container.
    for version in ["OMPI", "PRTE"] {
        command.env(format!("{version}_ALLOW_RUN_AS_ROOT"), "1");
        command.env(format!("{version}_ALLOW_RUN_AS_ROOT_CONFIRM"), "1");
    }
    command.env("OMPI_MCA_rmaps_base_oversubscribe", "1");
    command.output().unwrap_or_else(|error| panic!("{launcher}: {error}; is MPI installed?"))
}

fn told(output: &Output) -> String {
    format!("{}\n{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[test]
fn between_ranks() {
    for ranks in 1..=3 {
        let output = launch(ranks, "suite");
        assert!(output.status.success(), "{}", told(&output));
        let passed = told(&output).matches("the suite passed").count();
        assert_eq!(passed, ranks, "{}", told(&output));
    }
}

#[test]
fn a_rank_that_ends_first_is_heard() {
    let output = launch(3, "early");
    assert!(output.status.success(), "{}", told(&output));
    assert!(told(&output).contains("heard 200 frames"), "{}", told(&output));
}

/// Others wait in a barrier, which nothing but the end of the whole job ends.
#[test]
fn an_error_or_a_panic_of_one_rank_ends_all() {
    for (what, code) in [("error", Some(7)), ("panic", None)] {
        let output = launch(3, what);
        assert!(!output.status.success(), "{what}: {}", told(&output));
        assert!(!told(&output).contains("through the barrier"), "{what}: {}", told(&output));
        if let Some(code) = code {
            assert_eq!(output.status.code(), Some(code), "{}", told(&output));
        } else {
            assert!(told(&output).contains("rank 1 fails on purpose"), "{}", told(&output));
        }
    }
}

/// Not a test: what the ranks run. Does nothing when it is run as one.
#[test]
fn rank() {
    let Ok(what) = std::env::var(WHAT) else { return };
    let job = MpiJob::start().unwrap();
    assert!(matches!(MpiJob::start(), Err(TransportError::Mpi { .. })));
    match what.as_str() {
        "suite" => suite(&job),
        "early" => early(&job),
        what => {
            if job.rank() == 1 {
                assert!(what != "panic", "rank 1 fails on purpose");
                job.abort(7);
            }
            job.barrier();
            println!("through the barrier");
        }
    }
}

fn early(job: &MpiJob) {
    if job.rank() == 0 {
        let hub = job.open("hub");
        // Both are gone by then, as far as they can be.
        std::thread::sleep(Duration::from_millis(300));
        let (mut frames, mut ends) = (0, 0);
        while ends < 2 {
            match hub.receive(LONG).unwrap().expect("an event should have come") {
                TransportEvent::Frame { bytes, .. } => {
                    assert_eq!(bytes.len(), 10_000);
                    frames += 1;
                }
                TransportEvent::Disconnected { .. } => ends += 1,
                _ => {}
            }
        }
        println!("heard {frames} frames");
    } else {
        let node = job.open("node");
        let to_hub = loop {
            match node.connect(&MpiJob::address_of(0, "hub")) {
                Ok(peer) => break peer,
                Err(error) => assert!(matches!(error, TransportError::Connect { .. })),
            }
        };
        (0..100).for_each(|_| node.send(to_hub, vec![1; 10_000]).unwrap());
    }
}

fn suite(job: &MpiJob) {
    if job.rank() > 0 {
        serve(job);
        println!("the suite passed");
        return;
    }
    let control = job.open("control");
    let mut lines = vec![None];
    for rank in 1..job.size() {
        let peer = loop {
            match control.connect(&MpiJob::address_of(rank, "remote")) {
                Ok(peer) => break peer,
                Err(error) => assert!(matches!(error, TransportError::Connect { .. })),
            }
        };
        lines.push(Some(peer));
    }
    assert!(control.connect(&MpiJob::address_of(job.size(), "remote")).is_err());
    assert!(control.connect("127.0.0.1:80").is_err());
    let control = Arc::new(control);
    // Each node of the suite gets to be on each rank.
    for shift in 0..job.size() {
        let opened = Cell::new(shift);
        conforms(&|name| {
            let rank = opened.replace(opened.get() + 1) % job.size();
            match lines[rank] {
                None => Box::new(job.open(name)),
                Some(peer) => Box::new(Remote::open(Arc::clone(&control), peer, name)),
            }
        });
    }
    for peer in lines.into_iter().flatten() {
        control.send(peer, postcard::to_allocvec(&Order::Stop).unwrap()).unwrap();
    }
    println!("the suite passed");
}

// --- Nodes of other ranks, told what to do from rank 0 ----------------------------------------------------------------

/// What a rank is told to do. What is sent goes in a frame of its own, as does what was received: it may be as long as a frame can be.
#[derive(Debug, Serialize, Deserialize)]
enum Order {
    Open(String),
    Connect(u64, String),
    /// A frame follows.
    Send(u64, u64),
    /// A frame of so many bytes, which is too long to be brought here.
    SendLong(u64, u64, usize),
    Receive(u64, Duration),
    Disconnect(u64, u64),
    Close(u64),
    Drop(u64),
    Stop,
}

#[derive(Debug, Serialize, Deserialize)]
enum Answer {
    Opened(u64, String),
    Peer(u64),
    Done,
    Nothing,
    Connected(u64, String),
    /// A frame follows.
    Frame(u64),
    Disconnected(u64, String),
    Failed(Failure),
}

/// What the suite tells apart in a [`TransportError`].
#[derive(Debug, Serialize, Deserialize)]
enum Failure {
    Connect(String, String),
    FrameTooLong(usize, usize),
    NotConnected(u64),
    QueueFull(u64),
    Closed,
}

impl From<TransportError> for Answer {
    fn from(error: TransportError) -> Answer {
        Answer::Failed(match error {
            TransportError::Connect { address, reason } => Failure::Connect(address, reason),
            TransportError::FrameTooLong { bytes, limit } => Failure::FrameTooLong(bytes, limit),
            TransportError::NotConnected { peer } => Failure::NotConnected(peer),
            TransportError::QueueFull { peer } => Failure::QueueFull(peer),
            TransportError::Closed => Failure::Closed,
            other => panic!("{other}"),
        })
    }
}

impl From<Failure> for TransportError {
    fn from(failure: Failure) -> TransportError {
        match failure {
            Failure::Connect(address, reason) => TransportError::Connect { address, reason },
            Failure::FrameTooLong(bytes, limit) => TransportError::FrameTooLong { bytes, limit },
            Failure::NotConnected(peer) => TransportError::NotConnected { peer },
            Failure::QueueFull(peer) => TransportError::QueueFull { peer },
            Failure::Closed => TransportError::Closed,
        }
    }
}

/// Does what rank 0 says until there is no more to do.
fn serve(job: &MpiJob) {
    let remote = job.open("remote");
    let mut nodes: HashMap<u64, MpiTransport> = HashMap::new();
    let mut peer = None;
    let mut opened = 0;
    loop {
        let order = match remote.receive(LONG).unwrap().expect("an order should have come") {
            TransportEvent::Connected { peer: found, .. } => {
                peer = Some(found);
                continue;
            }
            TransportEvent::Frame { bytes, .. } => postcard::from_bytes(&bytes).unwrap(),
            other => panic!("{other:?}"),
        };
        let peer = peer.unwrap();
        let mut body = None;
        let result = match order {
            Order::Open(name) => {
                opened += 1;
                let node = job.open(&name);
                let address = node.address().unwrap();
                nodes.insert(opened, node);
                Ok(Answer::Opened(opened, address))
            }
            Order::Connect(node, address) => nodes[&node].connect(&address).map(|peer| Answer::Peer(peer.0)),
            Order::Send(node, to) => {
                let (_, bytes) = frame(&remote);
                nodes[&node].send(PeerId(to), bytes).map(|()| Answer::Done)
            }
            Order::SendLong(node, to, length) => {
                nodes[&node].send(PeerId(to), vec![0; length]).map(|()| Answer::Done)
            }
            Order::Receive(node, wait) => nodes[&node].receive(wait).map(|event| match event {
                None => Answer::Nothing,
                Some(TransportEvent::Connected { peer, name }) => Answer::Connected(peer.0, name),
                Some(TransportEvent::Disconnected { peer, reason }) => Answer::Disconnected(peer.0, reason),
                Some(TransportEvent::Frame { peer, bytes }) => {
                    body = Some(bytes);
                    Answer::Frame(peer.0)
                }
                Some(other) => panic!("{other:?}"),
            }),
            Order::Disconnect(node, peer) => {
                nodes[&node].disconnect(PeerId(peer));
                Ok(Answer::Done)
            }
            Order::Close(node) => {
                nodes[&node].close();
                Ok(Answer::Done)
            }
            Order::Drop(node) => {
                nodes.remove(&node);
                Ok(Answer::Done)
            }
            Order::Stop => return,
        };
        let answer = result.unwrap_or_else(Answer::from);
        remote.send(peer, postcard::to_allocvec(&answer).unwrap()).unwrap();
        if let Some(body) = body {
            remote.send(peer, body).unwrap();
        }
    }
}

/// A node of another rank.
struct Remote {
    control: Arc<MpiTransport>,
    peer: PeerId,
    /// One order at a time.
    turn: Mutex<()>,
    node: u64,
    address: String,
}

impl Remote {
    fn open(control: Arc<MpiTransport>, peer: PeerId, name: &str) -> Remote {
        let mut remote = Remote { control, peer, turn: Mutex::new(()), node: 0, address: String::new() };
        match remote.ask(&Order::Open(name.to_owned()), None) {
            (Answer::Opened(node, address), None) => (remote.node, remote.address) = (node, address),
            other => panic!("{other:?}"),
        }
        remote
    }

    fn ask(&self, order: &Order, body: Option<Vec<u8>>) -> (Answer, Option<Vec<u8>>) {
        let _turn = self.turn.lock().unwrap();
        self.control.send(self.peer, postcard::to_allocvec(order).unwrap()).unwrap();
        if let Some(body) = body {
            self.control.send(self.peer, body).unwrap();
        }
        // Other ranks' lines are quiet meanwhile.
        let next = || match self.control.receive(2 * LONG).unwrap().expect("an answer should have come") {
            TransportEvent::Frame { peer, bytes } if peer == self.peer => bytes,
            other => panic!("{other:?}"),
        };
        let answer = postcard::from_bytes(&next()).unwrap();
        let body = matches!(answer, Answer::Frame(_)).then(next);
        (answer, body)
    }

    fn done(&self, order: &Order, body: Option<Vec<u8>>) -> Result<(), TransportError> {
        match self.ask(order, body).0 {
            Answer::Done => Ok(()),
            Answer::Failed(failure) => Err(failure.into()),
            other => panic!("{other:?}"),
        }
    }
}

impl Transport for Remote {
    fn address(&self) -> Option<String> {
        Some(self.address.clone())
    }

    fn connect(&self, address: &str) -> Result<PeerId, TransportError> {
        match self.ask(&Order::Connect(self.node, address.to_owned()), None).0 {
            Answer::Peer(peer) => Ok(PeerId(peer)),
            Answer::Failed(failure) => Err(failure.into()),
            other => panic!("{other:?}"),
        }
    }

    fn send(&self, to: PeerId, frame: Vec<u8>) -> Result<(), TransportError> {
        if frame.len() > FRAME_BYTES_MAX {
            return self.done(&Order::SendLong(self.node, to.0, frame.len()), None);
        }
        self.done(&Order::Send(self.node, to.0), Some(frame))
    }

    fn receive(&self, wait: Duration) -> Result<Option<TransportEvent>, TransportError> {
        Ok(Some(match self.ask(&Order::Receive(self.node, wait), None) {
            (Answer::Nothing, _) => return Ok(None),
            (Answer::Connected(peer, name), _) => TransportEvent::Connected { peer: PeerId(peer), name },
            (Answer::Disconnected(peer, reason), _) => {
                TransportEvent::Disconnected { peer: PeerId(peer), reason }
            }
            (Answer::Frame(peer), Some(bytes)) => TransportEvent::Frame { peer: PeerId(peer), bytes },
            (Answer::Failed(failure), _) => return Err(failure.into()),
            other => panic!("{other:?}"),
        }))
    }

    fn disconnect(&self, peer: PeerId) {
        self.done(&Order::Disconnect(self.node, peer.0), None).unwrap();
    }

    fn frame_bytes_max(&self) -> usize {
        FRAME_BYTES_MAX
    }

    fn close(&self) {
        self.done(&Order::Close(self.node), None).unwrap();
    }
}

impl Drop for Remote {
    fn drop(&mut self) {
        // What the suite had to say about a panic is said.
        if !std::thread::panicking() {
            self.done(&Order::Drop(self.node), None).unwrap();
        }
    }
}
