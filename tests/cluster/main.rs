//! The cluster as a whole: simulated with faults, in threads, as processes, and with hostile peers.

mod attributes;
mod block_client;
#[path = "../support/compiled.rs"]
mod compiled;
mod copy;
mod hostile;
mod hot;
mod members;
mod messages;
#[path = "../support/numbers.rs"]
mod numbers;
mod processes;
mod simulated;
mod squares;
mod support;
mod threads;
