//! A cluster in simulated time: the real scheduler over measured costs and a model of machines, network, disk and
//! caches.
//!
//! [`measure`] takes the costs of an image's cells and the blocks that they enter from counters of a real run. [`simulate`] then
//! renders that image on any number of simulated workers, [`simulate_two_levels`] on workers under sub-coordinators. Nothing in it
//! depends on the machine that simulates: a simulation gives the same report every time.

mod cluster;
mod cost_image;
mod desk;
mod machine;
mod measure;
mod report;
mod two_levels;
mod worker;

pub use cluster::simulate;
pub use cost_image::{BlockSize, CostImage, CostModel};
pub use machine::{ClusterModel, Relays, SequentialRun, sequential};
pub use measure::{AccessDetail, TracePixel, measure};
pub use report::SimulationReport;
pub use two_levels::{SecondLevel, simulate_two_levels};

#[cfg(test)]
mod tests;
