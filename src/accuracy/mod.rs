//! What accuracy costs: pictures to an error goal or a time goal, and a certificate of what was reached.
//!
//! [`render_to_goal`] takes a [`Goal`], looks at a few thousand pixels, sets the [`Knobs`] that trade error for time, makes the picture,
//! and says in a [`Certificate`] what is *proven* (geometry, what was cut off) and, apart from it, what is *estimated* from the samples
//! (antialiasing). The knobs say everything that was chosen, by the clock too: [`render_with_knobs`] makes the same picture from
//! them, bit for bit (I2). `docs/accuracy.md` derives what is claimed.
//!
//! [`Metric`] is how errors are measured, and [`sweep`] measures what each knob costs.

mod certificate;
mod check;
mod choose;
mod estimate;
mod flip;
mod goal;
mod greatest;
mod job;
mod knobs;
mod metric;
mod predict;
mod run;
mod steps;
pub mod sweep;
mod time;
mod unseen;

pub use certificate::{Certificate, CutOffBounds, GeometryBounds, GoalCounters, GoalSeconds, Verdict};
pub use check::SamplingCheck;
pub use estimate::Estimate;
pub use goal::{Goal, GoalOptions, GoalProgress};
pub use knobs::{Knobs, Sampling, TileThreshold, render_with_knobs};
pub use metric::{Metric, flip_map};
pub use run::{GoalImage, bytes_needed, render_to_goal};
pub use unseen::MissedFeatures;
