//! The geometry cache: preallocated slots, an associative table from block to slot, pins, replacement policies, and
//! one fetch per missing block.
//!
//! The layers, from the bottom: `shim` names the synchronisation primitives, so that the same code runs under a model
//! checker; `word` packs what the table knows about a block into 64 bits; `arena` owns the slots' memory and moves a
//! block through its states, the only unsafe code here; `table` adds what needs a lock: free slots, the replacement
//! policy and waiting; `slot_cache` is the public face.

mod arena;
mod choice;
mod clock;
mod following;
mod geometry_cache;
mod ghosts;
mod lru;
mod pin;
mod policy;
mod rings;
mod s3_fifo;
mod shim;
mod slot_cache;
mod table;
mod word;

#[cfg(test)]
mod schedules;

pub use choice::Policy;
pub use clock::Clock;
pub use following::FollowingCache;
pub use geometry_cache::{CacheStats, GeometryCache};
pub use lru::Lru;
pub use pin::{Pin, PinOwner};
pub use policy::ReplacementPolicy;
pub use s3_fifo::S3Fifo;
pub use slot_cache::SlotCache;

pub(crate) use choice::WithPolicy;
