//! Cuts polygons into triangles.

/// Most corners that a polygon may have.
pub const CORNERS_MAX: usize = 1 << 16;
