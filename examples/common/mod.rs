//! What the examples share: arguments, progress, ^C, and what the system says about memory.

// Each example uses its part.
#![allow(dead_code)]

pub mod arguments;
pub mod gears_view;
pub mod interrupt;
pub mod memory_log;
mod plot;
pub mod process;
pub mod progress;
pub mod svg;
