//! One picture by many machines: a coordinator hands out tiles, workers render them, readers hold blocks in memory and
//! serve them.
//!
//! Each role is a state machine: events and the time go in, [`Action`]s come out; no threads, no clock, no sockets. In real
//! use [`run_coordinator`], [`run_worker`] and [`run_reader`] drive them over a [`Transport`](crate::transport::Transport); tests drive
//! hundreds of them in simulated time, and kill them.
//!
//! Pictures are those of one machine, bit for bit (I2), whoever renders what and whoever dies. `docs/cluster.md` says how to run it,
//! what survives what, and what goes over the wire.

mod block_client;
mod checkpoint;
mod coordinator;
mod drive;
mod file_copy;
mod file_fetch;
mod hosts;
mod message;
mod model_file;
mod picture;
mod reader;
mod reconnect;
mod remote_source;
mod worker;
mod worker_options;

use std::time::Duration;

use crate::transport::PeerId;

pub use block_client::{BlockClient, Need, OwnFile, RemoteCounters, RemoteOptions};
pub use checkpoint::{Checkpoint, Record};
pub use coordinator::{
    Coordinator, CoordinatorCounters, CoordinatorError, CoordinatorOptions, LaneInfo, Span, map_colour,
};
pub use drive::{NodeError, WorkerReport, run_coordinator, run_reader, run_worker};
pub use file_copy::{CopyCounters, CopyError, CopyOptions, FileCopy};
pub use hosts::{HostRole, Hosts, HostsError};
pub use message::{
    BLOCKS_MAX, Job, LeasedCells, MESSAGE_VERSION, Message, MessageError, RANGE_BYTES_MAX, Role,
    UnsendableError,
};
pub use model_file::{ModelFile, model_key, readers_of};
pub use reader::{Reader, ReaderCounters};
pub use remote_source::RemoteSource;
pub use worker::{Worker, WorkerAction, WorkerCounters, WorkerEvent};
pub use worker_options::WorkerOptions;

/// What a role wants done.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Send a frame.
    Send {
        /// To whom.
        to: PeerId,
        /// What.
        frame: Vec<u8>,
    },
    /// End a connection.
    Disconnect {
        /// Which.
        peer: PeerId,
        /// Why, for the log.
        reason: String,
    },
    /// Something to tell the user.
    Log(String),
}

/// Times that all roles share.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoleOptions {
    /// How often a node says that it lives.
    pub heartbeat: Duration,
    /// A node that was silent for so long is given up. Much longer than `heartbeat`: a busy machine is not a dead one.
    pub silence_max: Duration,
}

impl Default for RoleOptions {
    fn default() -> RoleOptions {
        RoleOptions { heartbeat: Duration::from_secs(1), silence_max: Duration::from_secs(10) }
    }
}
