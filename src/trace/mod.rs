//! Queries: closest hit and any hit, for streams of rays.
