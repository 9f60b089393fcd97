//! Queries: closest hit and any hit, for streams of rays.
//!
//! A [`Tracer`] belongs to one thread and holds all the memory that queries need; nothing is allocated while rays are
//! traced. Rays of one call are traced in the order given, and no result depends on that order.
//!
//! A tracer waits for every block that is missing. A [`RayPool`] puts the ray aside instead and goes on with others, so
//! that one load serves all rays that need it; it answers in any order.

mod any;
mod closest;
mod exact;
mod hit;
mod load;
mod policy;
mod pool;
mod requests;
mod stack;
mod suspended;
mod tracer;

pub use hit::{Hit, MaterialSet, Occlusion};
pub use pool::{PoolOptions, RayPool};
pub use requests::{Answers, AnyRequest, ClosestRequest, OnMissing};
pub use tracer::Tracer;
