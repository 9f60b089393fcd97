//! Numbers only: no allocation, no I/O. Rays, boxes, triangles (scalar reference tests), the float helpers
//! that hold the only epsilons, exact predicates, and the global lattice.

mod aabb;
mod affine;
mod bounds;
mod crossing;
mod degenerate;
mod double;
mod expansion;
mod float;
mod frame;
mod grid;
mod lattice;
mod motion;
mod offset;
mod plain;
mod ray;
mod sight;
mod triangle;
mod triangle_exact;

pub use aabb::Aabb;
pub use affine::Affine;
pub use bounds::HitErrorBounds;
pub use crossing::Sense;
pub use degenerate::{count_degenerate, is_degenerate};
pub use float::{
    U32, U64, gamma, gamma_f32, relative_bounds_f32, relative_down_f32, relative_up_f32, round_down_f32,
    round_up_f32,
};
pub use frame::RayFrame;
pub use lattice::{Lattice, Precision};
pub(crate) use motion::Motion;
pub use offset::{hit_position, offset_origin, position_error, triangle_normal};
pub use plain::intersect_plain;
pub use ray::Ray;
pub use sight::{SightEnd, line_of_sight};
pub use triangle::{TriangleHit, intersect_certified};
