//! What a progress callback is told.

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
