//! Numbers only: no allocation, no I/O. Rays, boxes, triangles (scalar reference tests), the float helpers
//! that hold the only epsilons, exact predicates, and the global lattice.

mod aabb;
mod lattice;
mod ray;
mod triangle;

pub use aabb::Aabb;
pub use lattice::{Lattice, Precision};
pub use ray::Ray;
pub use triangle::{TriangleHit, intersect_certified};
