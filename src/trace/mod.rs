//! Queries: closest hit and any hit, for streams of rays.
//!
//! A [`Tracer`] belongs to one thread and holds all the memory that queries need; nothing is allocated while rays are
//! traced. Rays of one call are traced in the order given, and no result depends on that order.

mod any;
mod closest;
mod exact;
mod hit;
mod load;
mod policy;
mod stack;
mod tracer;

pub use hit::{Hit, MaterialSet, Occlusion};
pub use tracer::Tracer;
