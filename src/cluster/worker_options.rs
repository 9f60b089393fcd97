//! What can be chosen about a worker.

use std::sync::Arc;
use std::time::Duration;

use super::RoleOptions;
use super::block_client::RemoteOptions;
use super::file_copy::CopyOptions;
use crate::budget::MemoryBudget;
use crate::octree::OctreeOptions;
use crate::render::WaitingRays;
use crate::source::BlockSource;

/// What can be chosen about a worker.
#[derive(Clone)]
pub struct WorkerOptions {
    /// What it calls itself to others.
    pub name: String,
    /// Threads that render.
    pub lanes: u16,
    /// The compiled model, if this node has it. Readers are asked first where there are any.
    pub file: Option<Arc<dyn BlockSource>>,
    /// If it does not have the model: where it makes itself a copy of the file, from the readers, while it renders. Its blocks come
    /// from there once the copy is complete. Without room for one it does without.
    pub copy: Option<CopyOptions>,
    /// All memory of the worker.
    pub budget: MemoryBudget,
    /// How the octree is opened; as many tracers as lanes.
    pub octree: OctreeOptions,
    /// How readers are asked.
    pub remote: RemoteOptions,
    /// Whether rays wait for blocks that are not resident, all lanes together; see [`RenderSettings::waiting`](crate::render::RenderSettings::waiting). Does not show.
    pub waiting: WaitingRays,
    /// Threads beside the lanes that load blocks while rays wait for them: readers are asked for as many blocks at one time. See
    /// [`RenderSettings::loader_threads`](crate::render::RenderSettings::loader_threads).
    pub loader_threads: u32,
    /// Heartbeats.
    pub roles: RoleOptions,
    /// How long it tries to reach a coordinator, or waits for a reader, before it gives up.
    pub patience: Duration,
}

impl WorkerOptions {
    /// A worker called `name` with one lane and the usual rest: blocks come from readers, rays do not wait for blocks, and it gives up after a
    /// minute without a coordinator.
    pub fn new(name: impl Into<String>, budget: MemoryBudget) -> WorkerOptions {
        WorkerOptions {
            name: name.into(),
            lanes: 1,
            file: None,
            copy: None,
            budget,
            octree: OctreeOptions::default(),
            remote: RemoteOptions::default(),
            waiting: WaitingRays::Never,
            loader_threads: 0,
            roles: RoleOptions::default(),
            patience: Duration::from_secs(60),
        }
    }
}

impl std::fmt::Debug for WorkerOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WorkerOptions")
            .field("name", &self.name)
            .field("lanes", &self.lanes)
            .field("octree", &self.octree)
            .finish_non_exhaustive()
    }
}
