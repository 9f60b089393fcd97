//! The certified triangle test against exact integer arithmetic (`dashu`), never against our own expansions.

#[path = "../support/numbers.rs"]
mod numbers;
mod oracle;
mod samples;

mod certified;
mod crossing;
mod offset;
mod watertight;
