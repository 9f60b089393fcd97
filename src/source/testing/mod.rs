//! Sources that misbehave and models made on the spot, for tests of this crate and of programs that use it. Everything
//! is seeded and repeatable. Not for production use.

mod faulty;
mod naive;
mod slow;

pub use faulty::{FaultRates, FaultySource};
pub use naive::memory_model;
pub use slow::SlowSource;
