//! Renders whose rays wait for blocks that are not resident, while other samples go on.
//!
//! Many samples are on their way at once, out of several tiles of a picture or out of one region. Each has at most one ray of its
//! tree in a [`RayPool`](crate::trace::RayPool), and the shadow rays of the hit before. When all of these are answered the sample
//! is ready: the light that came is added in the order in which it was asked for, the next hit is shaded, by the code that shades
//! all hits, and so its sum is the same as without any waiting (I2). There are no rounds: what is answered goes on at once, in the
//! blocks that are just there, and new samples begin as long as too few rays wait.
//!
//! All lists are fixed in advance (I1). Trees of rays share one store of rays that wait for their siblings; when it is nearly full,
//! one sample alone goes on with what is kept for it, so that it ends and gives back what it holds.

mod claims;
mod places;
mod plan;
mod query;
mod samples;
mod tiles;
mod worker;

pub(super) use plan::{Extent, WaitingPlan};
pub(super) use query::PoolQuery;
pub(super) use tiles::OpenedTile;
pub(super) use worker::WaitingWorker;
