//! `outcrop` ray traces triangle models larger than memory.
//!
//! A model file is compiled once, in bounded memory, to a file of compressed blocks. A query then
//! reads only the blocks that its rays reach, builds a small octree for each in a preallocated
//! slot, and forgets it when the slot is needed for another block. Memory stays inside the
//! [`budget::MemoryBudget`] that the caller sets, and hits are certified: no ray passes through a
//! closed surface.
//!
//! The rooms below import only from rooms above them in this list; `docs/architecture.md` explains
//! why and numbers the invariants (I1 to I8) that the code refers to.
#![deny(missing_docs)]
#![deny(unsafe_op_in_unsafe_fn)]

pub mod block;
pub mod budget;
pub mod cache;
pub mod compile;
pub mod error;
pub mod geom;
pub mod import;
pub mod model;
pub mod octree;
pub mod procedural;
pub mod render;
pub mod scene;
pub mod simd;
pub mod source;
pub mod stats;
pub mod trace;
pub mod units;

pub use budget::MemoryBudget;
pub use cache::GeometryCache;
pub use octree::LazyOctree;
pub use source::BlockSource;
