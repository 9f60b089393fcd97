//! Which worker renders which part of the image.
//!
//! A [`TileScheduler`] is a pure state machine: no threads, no clock (time is an argument, counted from any start), no
//! sockets, no chance. A coordinator tells it who joined, who asks, what was finished and who is gone, and sends on what it
//! answers. [`AdaptiveScheduler`] is the one that this library has; [`SchedulerOptions`] select how it works, from tiles in rows over the
//! policies of "Rendering complex scenes on clusters with limited precomputation" (Cadet, Zambal, Lecussan 2004) to the default.
//! [`simulation`] runs it over measured costs and a model of machines, network, disks and caches.
//!
//! For more workers than one coordinator can serve there are two levels ([`parts`]): a [`PartScheduler`] gives large parts of the image to
//! sub-coordinators, and the [`SubScheduler`] of each hands out its part to workers of its own.
//!
//! The image is cut into tiles and tiles into cells ([`ImageGrid`]). What is handed out, returned and remembered is a set of cells of one
//! tile ([`TileCells`]), so a partial tile is nothing special, and a result says itself what it is good for.
//!
//! What it keeps, whatever the order of results, losses, joins and late answers:
//!
//! - Every cell of the image is done once: [`TileScheduler::complete`] says which cells of a result are new, and no cell is new twice.
//! - No cell is lost: one that is neither done nor free is on lease to a worker that joined, and a lease ends.
//! - A worker that is lost, slow or cut off holds up nobody for longer than a lease lasts.

mod adaptive;
mod affinity;
mod checkpoint;
mod cost;
mod crew;
mod estimates;
mod grid;
mod ledger;
mod options;
pub mod parts;
mod policy;
mod scheduler;
pub mod simulation;
mod speed;

pub use adaptive::AdaptiveScheduler;
pub use checkpoint::ScheduleCheckpoint;
pub use grid::{ImageGrid, Region, TileCells};
pub use options::{CentralPoints, PieceChoice, SchedulerOptions, TilePolicy};
pub use parts::{PartScheduler, SubScheduler};
pub use scheduler::{
    Answer, Assignment, Notice, Receipt, ScheduleProgress, Spent, TileResult, TileScheduler,
};

#[cfg(test)]
mod tests;
