//! What nodes say to each other. One message is one frame: a head, encoded by `postcard`, and after it, for messages that carry
//! pixels, blocks or bytes of a file, these bytes as they are. `docs/cluster.md` has the bytes.
//!
//! Frames are untrusted (I5): a head that does not parse, bytes where none belong, or a count that does not fit is a
//! [`MessageError`], and nothing is allocated by a number in a frame.

use serde::{Deserialize, Serialize};

use crate::access::BlockSketch;
use crate::render::RenderSettings;
use crate::scene::Scene;

/// The version of these messages; the first thing that a node says.
pub const MESSAGE_VERSION: u16 = 6;

/// What a node does in a cluster beside coordinating.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Role {
    /// Renders. So many threads of it each work on an assignment of their own.
    Worker {
        /// How many.
        lanes: u16,
    },
    /// Holds blocks in memory and serves them.
    Reader,
}

/// Everything that decides a picture, and how it is cut up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Camera and lights.
    pub scene: Scene,
    /// Size and quality. `tile_size` is the greatest square that is rendered at once.
    pub settings: RenderSettings,
    /// Side of a tile, the most that is handed out at once.
    pub tile_side: u32,
    /// Side of a cell, the least.
    pub cell_side: u32,
    /// Which compiled model; see [`model_key`](super::model_key).
    pub model: u64,
}

impl Job {
    /// A job in tiles of 64 and cells of 8 pixels a side.
    pub fn new(scene: Scene, settings: RenderSettings, model: u64) -> Job {
        const TILE_SIDE: u32 = 64;
        // What a worker's lane renders at once; it does not show.
        let settings = RenderSettings { tile_size: TILE_SIDE, ..settings };
        Job { scene, settings, tile_side: TILE_SIDE, cell_side: 8, model }
    }
}

/// Some cells of a tile under a lease: what [`schedule`](crate::schedule) hands out and takes back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeasedCells {
    /// The lease.
    pub lease: u64,
    /// The tile.
    pub tile: u32,
    /// The set of cells.
    pub cells: u64,
}

/// A message's head.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Message {
    /// First message of everybody to the coordinator.
    Hello {
        /// [`MESSAGE_VERSION`].
        version: u16,
        /// What the node does.
        role: Role,
        /// What it calls itself.
        name: String,
        /// Where it listens, if it is a reader.
        address: Option<String>,
        /// The model that it has on disk, if any.
        model: Option<u64>,
    },
    /// From both sides, now and then: the node lives.
    Alive,
    /// Coordinator to worker: what is rendered.
    Job(Box<Job>),
    /// Coordinator to worker: where the readers are now.
    Readers {
        /// Their addresses. An empty one is a reader that is not there (yet, or any more); [`readers_of`](super::readers_of) says whom to
        /// ask for which block.
        addresses: Vec<String>,
    },
    /// Worker to coordinator: a lane has less to do than it could hold.
    Request {
        /// Which lane.
        lane: u16,
    },
    /// Coordinator to worker: render this.
    Assign {
        /// Which lane.
        lane: u16,
        /// What.
        what: LeasedCells,
        /// The critical time in microseconds.
        stop_after_us: u64,
    },
    /// Coordinator to worker: of this lease only these cells are wanted.
    Shorten {
        /// Which lane.
        lane: u16,
        /// What is left of it.
        what: LeasedCells,
    },
    /// Worker to coordinator, followed by pixels: for each cell of the set, from the lowest on, its pixels row by row, each three f32
    /// (little-endian).
    Result {
        /// Which lane.
        lane: u16,
        /// Which cells.
        what: LeasedCells,
        /// Whether the lane is through with the lease.
        is_last: bool,
        /// What the cells cost in microseconds by the worker's clock.
        micros: u64,
        /// The same in units of work; see [`schedule`](crate::schedule).
        work: f64,
        /// Which blocks they needed, roughly.
        blocks: BlockSketch,
    },
    /// Worker to coordinator: it cannot go on. Others can.
    Failed {
        /// Why.
        reason: String,
    },
    /// Coordinator to everybody: the picture is finished, or the coordinator ends. There will be no more work.
    Finished,
    /// Worker to reader: send these blocks, at most [`BLOCKS_MAX`].
    Read {
        /// Which.
        blocks: Vec<u32>,
    },
    /// Reader to worker, followed by the stored bytes of a block.
    Block {
        /// Which.
        block: u32,
        /// Whom to ask for it the next time, counted on from the first of [`readers_of`](super::readers_of) and round: above 0 for
        /// a block that very many ask for, so that the other readers come to hold it, too.
        turn: u8,
    },
    /// Reader to worker: it cannot give a block.
    NoBlock {
        /// Which.
        block: u32,
        /// Why.
        reason: String,
    },
    /// To a reader: send so many bytes of the compiled file, at most [`RANGE_BYTES_MAX`].
    ReadFile {
        /// From where.
        offset: u64,
        /// How many.
        length: u32,
    },
    /// From a reader, followed by bytes of the compiled file; fewer than asked for at its end.
    FilePart {
        /// From where.
        offset: u64,
        /// Length of the whole file.
        file_bytes: u64,
    },
    /// Coordinator to a node whose [`Message::Hello`] it does not accept: it need not try again. The connection ends then.
    Refused {
        /// Why.
        reason: String,
    },
}

/// Most blocks in one [`Message::Read`].
pub const BLOCKS_MAX: usize = 64;

/// Most bytes in one [`Message::FilePart`].
pub const RANGE_BYTES_MAX: u32 = 256 << 10;

/// Longest list of readers.
const READERS_MAX: usize = 1024;

/// Longest text.
const TEXT_BYTES_MAX: usize = 1024;

/// Why a frame is not a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a message is damaged: {0}")]
pub struct MessageError(pub &'static str);

/// A message holds what does not travel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("part of the message does not travel")]
pub struct UnsendableError;

impl Message {
    /// The frame of a message that carries nothing. For a [`Message::Job`], which may hold what does not travel, use
    /// [`Message::try_frame`]: here such a job gives a frame that no node accepts.
    pub fn frame(&self) -> Vec<u8> {
        self.frame_with(&[])
    }

    /// The frame of a message that carries nothing, whatever it holds.
    ///
    /// # Errors
    /// [`UnsendableError`] if part of it does not travel: [`Environment::Image`](crate::scene::Environment::Image).
    pub fn try_frame(&self) -> Result<Vec<u8>, UnsendableError> {
        postcard::to_allocvec(self).map_err(|_| UnsendableError)
    }

    /// The frame of a message that carries `tail`; the same note holds as for [`Message::frame`].
    pub fn frame_with(&self, tail: &[u8]) -> Vec<u8> {
        let mut frame = self.try_frame().unwrap_or_default();
        frame.extend_from_slice(tail);
        frame
    }

    /// Whether bytes may follow the head.
    fn carries(&self) -> bool {
        matches!(self, Message::Result { .. } | Message::Block { .. } | Message::FilePart { .. })
    }

    /// Takes a frame apart.
    ///
    /// # Errors
    /// [`MessageError`] if it is not a message.
    pub fn parse(frame: &[u8]) -> Result<(Message, &[u8]), MessageError> {
        let (message, tail) = postcard::take_from_bytes::<Message>(frame)
            .map_err(|_| MessageError("its head does not parse"))?;
        if !message.carries() && !tail.is_empty() {
            return Err(MessageError("there are bytes after it"));
        }
        message.check()?;
        Ok((message, tail))
    }

    fn check(&self) -> Result<(), MessageError> {
        let require = |holds, reason| if holds { Ok(()) } else { Err(MessageError(reason)) };
        let text = |text: &str| require(text.len() <= TEXT_BYTES_MAX, "a text is too long");
        match self {
            Message::Hello { name, address, .. } => {
                text(name)?;
                text(address.as_deref().unwrap_or_default())
            }
            Message::Readers { addresses } => {
                require(addresses.len() <= READERS_MAX, "there are too many readers")?;
                addresses.iter().try_for_each(|address| text(address))
            }
            Message::Failed { reason } | Message::NoBlock { reason, .. } | Message::Refused { reason } => {
                text(reason)
            }
            Message::Read { blocks } => {
                require((1..=BLOCKS_MAX).contains(&blocks.len()), "it asks for too many blocks, or none")
            }
            Message::ReadFile { length, .. } => {
                require((1..=RANGE_BYTES_MAX).contains(length), "it asks for too many bytes, or none")
            }
            Message::Result { work, .. } => {
                require(work.is_finite() && *work >= 0.0, "its work is not a number")
            }
            _ => Ok(()),
        }
    }
}

/// A text that fits into a message.
pub(super) fn short(text: impl Into<String>) -> String {
    let mut text = text.into();
    let mut end = text.len().min(TEXT_BYTES_MAX);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.truncate(end);
    text
}
