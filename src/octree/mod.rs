//! The lazy octree: a coarse level over the blocks, always resident, and a fine level per block, built in the block's
//! slot when the first ray reaches it.

mod build;
mod coarse;
mod fill;
mod fine;
mod frame;
mod grown;
mod lazy;
mod node;
mod options;
mod ray;
mod ray_group;
mod sah;
mod touched;

pub use lazy::LazyOctree;
pub use options::{LeafLayout, OctreeOptions, Tier, TreeQuality};

pub(crate) use build::BuildScratch;
pub(crate) use coarse::CoarseTree;
pub(crate) use fill::build;
pub(crate) use fine::{Fine, TriangleLocation};
pub(crate) use grown::Reached;
pub(crate) use lazy::{TracerPermit, tracer_bytes, tracer_bytes_about};
pub(crate) use node::{Child, LEVELS_MAX, STACK_MAX};
pub(crate) use ray::{LocalRay, MovedRay, QueryRay, power_of_two, prepare_moved, splat_interval};
pub(crate) use ray_group::RayGroup;
