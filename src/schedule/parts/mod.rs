//! Two levels: a top coordinator gives parts of the image to sub-coordinators, who hand them out to workers of their own.
//!
//! One coordinator spends some 50 microseconds on each hand-out of each worker; thousands of workers keep it busier than it can be.
//! With two levels it hears of sub-coordinators only (about the square root of the number of workers), and of each some times per
//! second.
//!
//! - At the start each sub-coordinator gets half of a piece of the curve through all cells, all pieces of equal numbers of cells; when it asks, the next
//!   portions come from the rest of that piece as long as there are any.
//! - What its workers return it gathers, and reports a tile's cells together; with each report goes what it has left ([`PartRest`]).
//! - With results goes what they cost, so that the top can say of each part what is known about its costs: without that, who comes from the plain
//!   would hand out cells of a hill by the tile.
//! - Shortly before it has nothing left it asks for more. The top gives it cells that nobody has; if there are none, the sub-coordinator that
//!   would be through last is told to give up so much that both would be through at one time.
//!
//! Both ends are pure state machines, as every [scheduler](super) is. Messages between the two arrive in the order in which they
//! were sent, as long as the connection lasts. What they keep, whatever is lost:
//!
//! - Every cell is done once: [`PartScheduler::report`] says which cells of a report are new, and no cell is new twice.
//! - No cell is lost: one that is not done belongs to nobody and will be given, or to one sub-coordinator that takes part.
//! - A sub-coordinator that is lost costs what it had not reported ([`PartOptions::gather`]) and what its workers have in hand. Who finds out that it is lost, by
//!   silence or a broken connection, is whoever drives this, as for workers.

mod book;
mod messages;
mod sub;
mod top;

pub use messages::{PartCells, PartNotice, PartOptions, PartProgress, PartReport, PartRest};
pub use sub::SubScheduler;
pub use top::PartScheduler;
