//! Measuring what each knob costs: pictures against a reference, with error beside time and counters.

mod front;
mod measure;

pub use front::{Halving, halving_costs, pareto_front};
pub use measure::{Measurement, Reference, Subject, processor_seconds};
