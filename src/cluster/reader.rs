//! A reader: holds blocks in memory and serves them, and any other bytes of the compiled file.

use std::collections::{HashMap, HashSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

use super::message::{MESSAGE_VERSION, Message, Role, short};
use super::model_file::{ModelFile, model_key};
use super::{Action, RoleOptions};
use crate::block::checksum;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::BudgetError;
use crate::transport::{PeerId, TransportEvent};
use crate::units::{BlockId, Bytes};

/// What a reader did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReaderCounters {
    /// Blocks that were asked for.
    pub blocks_asked: u64,
    /// Of these, blocks that were read from disk.
    pub blocks_from_disk: u64,
    /// Blocks that could not be given.
    pub blocks_failed: u64,
    /// Of these answers, those that sent the worker to another reader for the next time, because the block is asked for so often.
    pub blocks_hot: u64,
    /// Bytes of blocks sent.
    pub bytes_sent: u64,
    /// Bytes of the file sent to nodes that do not have it.
    pub file_bytes_sent: u64,
    /// Frames that were not messages; their senders were disconnected.
    pub bad_frames: u64,
}

/// The state machine of a reader: events in, actions out.
///
/// Workers decide which blocks they ask which reader for (see [`readers_of`](super::readers_of)); a reader keeps what it was asked
/// for, as it should be and the latest first, within its memory. So each block that a picture needs is read from disk once in the whole
/// cluster, as long as the readers' memories together hold it. A block that is asked for much more often than others is *hot*: those who
/// get it are told to ask the readers in turn for it from then on, so that all come to hold it and share the work.
pub struct Reader {
    file: Arc<dyn ModelFile>,
    name: String,
    address: String,
    key: u64,
    coordinator: Option<PeerId>,
    options: RoleOptions,
    last_told: Duration,
    last_heard: Duration,
    held: HashMap<u32, Held>,
    /// In the order of their arrival.
    order: VecDeque<u32>,
    held_bytes: u64,
    /// Requests for all blocks that are held.
    asks_held: u64,
    memory: Reservation,
    counters: ReaderCounters,
    buffer: Vec<u8>,
    /// Nodes that are connected and may still want blocks.
    peers: HashSet<PeerId>,
    /// Since when the picture is done.
    finished: Option<Duration>,
    is_over: bool,
    /// Whether the coordinator has said anything in this connection.
    is_welcome: bool,
    refused: Option<String>,
}

/// A block in memory.
struct Held {
    bytes: Box<[u8]>,
    /// How often it was asked for since it is here.
    asks: u64,
}

/// A block is hot from so many requests on, if it is also asked for so many times as often as held blocks are on average. Each worker
/// keeps what it uses in its own cache, so most blocks are asked for a few times.
const HOT_ASKS_MIN: u64 = 16;
const HOT_FACTOR: u64 = 4;

/// When the picture is done, workers may be in the middle of a tile that they will throw away; so long a reader serves on.
const LINGER: Duration = Duration::from_secs(2);

impl Reader {
    /// A reader of `file` that others reach at `address`, and that keeps at most `memory` of blocks, which it takes from `budget`.
    ///
    /// # Errors
    /// [`BudgetError`].
    pub fn new(
        file: Arc<dyn ModelFile>,
        name: &str,
        address: &str,
        memory: Bytes,
        budget: &MemoryBudget,
        options: RoleOptions,
    ) -> Result<Reader, BudgetError> {
        let memory = budget.reserve(memory, "a reader's blocks")?;
        let key = model_key(file.model());
        Ok(Reader {
            name: short(name),
            address: address.to_owned(),
            key,
            coordinator: None,
            options,
            last_told: Duration::ZERO,
            last_heard: Duration::ZERO,
            held: HashMap::new(),
            order: VecDeque::new(),
            held_bytes: 0,
            asks_held: 0,
            memory,
            counters: ReaderCounters::default(),
            buffer: Vec::new(),
            file,
            peers: HashSet::new(),
            finished: None,
            is_over: false,
            is_welcome: false,
            refused: None,
        })
    }

    /// The connection to the coordinator was made.
    pub fn connected(&mut self, coordinator: PeerId, now: Duration, actions: &mut Vec<Action>) {
        self.coordinator = Some(coordinator);
        self.is_welcome = false;
        (self.last_told, self.last_heard) = (now, now);
        let hello = Message::Hello {
            version: MESSAGE_VERSION,
            role: Role::Reader,
            name: self.name.clone(),
            address: Some(self.address.clone()),
            model: Some(self.key),
        };
        actions.push(Action::Send { to: coordinator, frame: hello.frame() });
    }

    /// Whether the coordinator is connected; if not, the driver tries again.
    pub fn is_connected(&self) -> bool {
        self.coordinator.is_some()
    }

    /// Whether the coordinator is connected and has said something: the connection is of use.
    pub fn is_welcome(&self) -> bool {
        self.is_connected() && self.is_welcome
    }

    /// Why the coordinator does not want this reader, if it has said so; to try again is of no use.
    pub fn refusal(&self) -> Option<&str> {
        self.refused.as_deref()
    }

    /// Whether the picture is done, nobody wants blocks any more, and the reader may end.
    pub fn is_finished(&self) -> bool {
        self.is_over
    }

    pub(super) fn roles(&self) -> RoleOptions {
        self.options
    }

    /// What it did so far.
    pub fn counters(&self) -> ReaderCounters {
        self.counters
    }

    /// Bytes of the blocks in memory; at most what it was given.
    pub fn held_bytes(&self) -> Bytes {
        Bytes(self.held_bytes)
    }

    /// Something happened.
    pub fn handle(&mut self, now: Duration, event: TransportEvent, actions: &mut Vec<Action>) {
        if matches!(&event, TransportEvent::Frame { peer, .. } if Some(*peer) == self.coordinator) {
            self.last_heard = now;
        }
        match event {
            TransportEvent::Frame { peer, bytes } => match Message::parse(&bytes) {
                Ok((Message::Refused { reason }, _)) if Some(peer) == self.coordinator => {
                    self.refused = Some(reason);
                }
                Ok((Message::Finished, _)) if Some(peer) == self.coordinator => {
                    self.is_welcome = true;
                    self.finished = Some(now);
                }
                Ok((Message::Read { blocks }, _)) => {
                    for block in blocks {
                        let frame = self.block_frame(block);
                        actions.push(Action::Send { to: peer, frame });
                    }
                }
                Ok((Message::ReadFile { offset, length }, _)) => {
                    let frame = self.file_frame(offset, length);
                    actions.push(Action::Send { to: peer, frame });
                }
                // What the coordinator says to everybody.
                Ok((Message::Alive | Message::Finished | Message::Job(_) | Message::Readers { .. }, _)) => {
                    self.is_welcome |= Some(peer) == self.coordinator;
                }
                Ok(_) => self.refuse(peer, "a message that is not for readers".to_owned(), actions),
                Err(error) => self.refuse(peer, error.to_string(), actions),
            },
            TransportEvent::Disconnected { peer, reason } if Some(peer) == self.coordinator => {
                self.coordinator = None;
                actions.push(Action::Log(format!("the coordinator is gone: {reason}")));
            }
            TransportEvent::Refused { from, reason } => {
                actions.push(Action::Log(format!("refused {from}: {reason}")));
            }
            TransportEvent::Connected { peer, .. } => {
                self.peers.insert(peer);
            }
            TransportEvent::Disconnected { peer, .. } => {
                self.peers.remove(&peer);
            }
        }
        self.tick(now, actions);
    }

    /// To be called at least every [`RoleOptions::heartbeat`].
    pub fn tick(&mut self, now: Duration, actions: &mut Vec<Action>) {
        let is_done_for = |since| self.peers.is_empty() || now.saturating_sub(since) >= LINGER;
        self.is_over |= self.finished.is_some_and(is_done_for);
        let Some(coordinator) = self.coordinator else { return };
        if now.saturating_sub(self.last_heard) >= self.options.silence_max {
            let reason = "the coordinator is silent".to_owned();
            actions.push(Action::Disconnect { peer: coordinator, reason });
            self.coordinator = None;
        } else if now.saturating_sub(self.last_told) >= self.options.heartbeat {
            self.last_told = now;
            actions.push(Action::Send { to: coordinator, frame: Message::Alive.frame() });
        }
    }

    fn refuse(&mut self, peer: PeerId, reason: String, actions: &mut Vec<Action>) {
        self.counters.bad_frames += 1;
        self.peers.remove(&peer);
        if Some(peer) == self.coordinator {
            self.coordinator = None;
        }
        actions.push(Action::Disconnect { peer, reason });
    }

    fn block_frame(&mut self, block: u32) -> Vec<u8> {
        self.counters.blocks_asked += 1;
        let held_count = self.held.len() as u64;
        if let Some(Held { bytes, asks }) = self.held.get_mut(&block) {
            *asks += 1;
            self.asks_held += 1;
            // Against the average, without a division.
            let is_hot = *asks >= HOT_ASKS_MIN && *asks * held_count > HOT_FACTOR * self.asks_held;
            self.counters.bytes_sent += bytes.len() as u64;
            self.counters.blocks_hot += u64::from(is_hot);
            // Each time the next one.
            let turn = if is_hot { (*asks % 256) as u8 } else { 0 };
            return Message::Block { block, turn }.frame_with(bytes);
        }
        if let Err(error) = self.file.read_block(BlockId(block), &mut self.buffer) {
            self.counters.blocks_failed += 1;
            return Message::NoBlock { block, reason: short(error.to_string()) }.frame();
        }
        self.counters.blocks_from_disk += 1;
        self.counters.bytes_sent += self.buffer.len() as u64;
        let frame = Message::Block { block, turn: 0 }.frame_with(&self.buffer);
        // What the disk gave is the worker's to judge; but one that is damaged would stay so in memory, and be given to all.
        let entry = self.file.model().entry(BlockId(block));
        if entry.is_some_and(|entry| checksum(&self.buffer) == entry.checksum) {
            self.keep(block);
        }
        frame
    }

    /// Keeps the block in the buffer, and lets the oldest go to make room.
    fn keep(&mut self, block: u32) {
        let bytes = self.buffer.len() as u64;
        if bytes > self.memory.bytes().0 {
            return;
        }
        while self.held_bytes + bytes > self.memory.bytes().0 {
            let Some(oldest) = self.order.pop_front() else { break };
            if let Some(gone) = self.held.remove(&oldest) {
                self.held_bytes -= gone.bytes.len() as u64;
                self.asks_held -= gone.asks;
            }
        }
        self.held_bytes += bytes;
        self.order.push_back(block);
        self.asks_held += 1;
        self.held.insert(block, Held { bytes: self.buffer.as_slice().into(), asks: 1 });
    }

    fn file_frame(&mut self, offset: u64, length: u32) -> Vec<u8> {
        // The length is checked when the message is parsed.
        let file_bytes = self.file.file_bytes().unwrap_or(0);
        let length = u64::from(length).min(file_bytes.saturating_sub(offset));
        self.buffer.clear();
        self.buffer.resize(length as usize, 0);
        if self.file.read_range(offset, &mut self.buffer).is_err() {
            self.buffer.clear();
        }
        self.counters.file_bytes_sent += self.buffer.len() as u64;
        Message::FilePart { offset, file_bytes }.frame_with(&self.buffer)
    }
}

impl std::fmt::Debug for Reader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Reader").finish_non_exhaustive()
    }
}
