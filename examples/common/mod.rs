//! What the examples share: arguments and messages, nothing about ray tracing.

// Each example uses its part.
#![allow(dead_code)]

mod arguments;

pub use arguments::{Argument, Arguments, run};
