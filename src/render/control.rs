//! How a caller lends threads to a render, watches it, and stops it.

use rayon::ThreadPool;

/// The threads that a render may use. The picture does not depend on them (I2).
#[derive(Clone, Copy, Debug, Default)]
pub enum Threads<'p> {
    /// The calling thread only.
    #[default]
    Current,
    /// This many threads, made for the render and ended with it; 0 and 1 mean [`Threads::Current`].
    Own(u32),
    /// All threads of the caller's pool.
    Pool(&'p ThreadPool),
}

impl Threads<'_> {
    /// How many there are.
    pub fn count(&self) -> u32 {
        match self {
            Threads::Current => 1,
            Threads::Own(count) => (*count).max(1),
            Threads::Pool(pool) => u32::try_from(pool.current_num_threads()).unwrap_or(u32::MAX),
        }
    }
}

/// How far a render is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Samples done.
    pub samples: u64,
    /// Samples of the whole picture.
    pub samples_total: u64,
    /// Tiles done.
    pub tiles: u32,
    /// Tiles of the whole picture.
    pub tiles_total: u32,
}

/// What a progress callback answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Control {
    /// Go on.
    Continue,
    /// Stop soon, and keep what is finished.
    Cancel,
}
