//! What the system has left: read when asked for, never watched by a thread of our own (I8).

mod control_group;
mod system;

pub use system::SystemMemory;

use crate::units::Bytes;

/// A place to read from how much memory is free.
pub trait FreeMemory: Send + Sync {
    /// The state now, or `None` if it cannot be known here.
    fn read(&self) -> Option<FreeMemoryReading>;
}

/// The state of the system's memory at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeMemoryReading {
    /// What this process could take more without anything being swapped out or killed. The page cache counts as free where
    /// the system can take it back.
    pub available: Bytes,
    /// Part of the last ten seconds in which some process waited for memory, in percent; 0 where it is not told.
    pub pressure_percent: f32,
}

/// That a cache follows the free memory, and how much it leaves to others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FollowFreeMemory {
    /// The cache gives memory back when less than this is free, and takes more only when an eighth more than this would
    /// still be free after it.
    pub keep_free: Bytes,
}
