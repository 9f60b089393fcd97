//! `outcrop` ray traces triangle models larger than memory.
//!
//! A model file is compiled once, in bounded memory, to a file of compressed blocks. A query then
//! reads only the blocks that its rays reach, builds a small octree for each in a preallocated
//! slot, and forgets it when the slot is needed for another block. Memory stays inside the
//! [`budget::MemoryBudget`] that the caller sets, and hits are certified: no ray passes through a
//! closed surface.
//!
//! # Where to start
//! - Hits of rays: [`compile::compile_file`] once, then [`LazyOctree::open`] over a [`source::DiskSource`] and a [`trace::Tracer`] for each
//!   thread. The README has this as one program; [`trace`] has an example with crossings and lines of sight.
//! - Hits before anything is compiled: a [`compile::LazyModel`] in the place of the source.
//! - Geometry that never was a file: a [`compile::Compiler`] is an [`import::MeshSink`]; [`import::TriangleSink`] takes loose triangles.
//! - A picture: [`scene::Scene`] and [`render::Renderer`]; [`render`] has an example. To an error or a time: [`accuracy::render_to_goal`].
//! - The same model in many places: [`instance::Instances`].
//! - Little memory and rays in no order: [`trace::RayPool`].
//! - Many machines: [`cluster`].
//!
//! Of the features, `png` and `gzip` are on by default. `gltf`, `jpeg`, `exr`, `zstd`, `scene-file`, `tcp` and `mpi` each add what
//! the item that they are for says; nothing else changes.
//!
//! # Rooms
//! A room imports only from rooms above it in this list (`tests/tidy.rs` fails otherwise);
//! `docs/architecture.md` explains why and numbers the invariants (I1 to I8) that the code refers to.
//!
//! 1. [`units`]: newtypes that cross room borders
//! 1. [`error`]: every way in which the library can fail
//! 1. [`budget`]: the one budget that all memory draws on
//! 1. [`free_memory`]: what the system has left
//! 1. [`stats`]: exact counters
//! 1. [`geom`]: rays, boxes, triangles, exact predicates, the lattice; numbers only
//! 1. [`simd`]: eight lanes
//! 1. [`block`]: one block, bytes to triangles and back; no I/O
//! 1. [`model`]: the compiled file around the blocks; no I/O
//! 1. [`import`]: streamed readers for model formats
//! 1. [`procedural`]: models that are computed
//! 1. [`compile`]: triangles to a compiled file in bounded memory
//! 1. [`source`]: where a block's bytes come from
//! 1. [`cache`]: blocks in preallocated slots
//! 1. [`attributes`]: texture coordinates and normals in cache slots
//! 1. [`texture`]: pictures as tiles in cache slots
//! 1. [`access`]: recorded block accesses, and what they say about memory
//! 1. [`octree`]: the lazy octree
//! 1. [`trace`]: queries on streams of rays
//! 1. [`instance`]: models that stand in many places
//! 1. [`scene`]: camera, lights, the effects that a scene calls for
//! 1. [`render`]: shading, tiles, images
//! 1. [`scene_file`]: scenes described in TOML files
//! 1. [`schedule`]: which worker renders which tile; no threads, no clock, no sockets
//! 1. [`transport`]: frames between nodes
//! 1. [`cluster`]: coordinator, workers, readers
//! 1. [`accuracy`]: error goals, certificates, what accuracy costs
#![deny(missing_docs)]
#![warn(missing_debug_implementations)]
#![deny(unsafe_op_in_unsafe_fn)]

pub mod access;
pub mod accuracy;
pub mod attributes;
pub mod block;
pub mod budget;
pub mod cache;
pub mod cluster;
pub mod compile;
pub mod error;
pub mod free_memory;
pub mod geom;
pub mod import;
pub mod instance;
pub mod model;
pub mod octree;
pub mod procedural;
pub mod render;
pub mod scene;
pub mod scene_file;
pub mod schedule;
// Registers and views of them; what they hold is seen through their lanes.
#[allow(missing_debug_implementations)]
pub mod simd;
pub mod source;
pub mod stats;
pub mod texture;
pub mod trace;
pub mod transport;
pub mod units;
#[cfg(test)]
mod without_threads;

pub use budget::MemoryBudget;
pub use cache::GeometryCache;
pub use octree::LazyOctree;
pub use schedule::TileScheduler;
pub use source::BlockSource;
pub use transport::Transport;

/// The README's code compiles.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeDoctests;
