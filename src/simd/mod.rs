//! Eight lanes: the only place for intrinsics. Chosen once at start, dispatched per call of a query or per block built,
//! never per node.
//!
//! A [`Simd`] value is a proof that the CPU has the instructions (as in `memchr`): it can only be had from
//! [`dispatch`], which enters a function compiled for them. Every kernel has a scalar twin in its tests.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod boxes;
mod bundle;
mod digits;
mod lanes;
mod level;
mod prefetch;
mod quad;
mod ray_rows;
#[cfg(test)]
mod tests;
mod triangles;
mod watertight;
mod whole;

pub use boxes::{BoxRay, Boxes, PackedBoxes, Parallel, ParallelAxes};
pub use bundle::RayBundle;
pub use digits::other_than_digits;
pub use lanes::{LANES, Portable, Simd};
pub use level::{AnyOperation, Operation, SimdLevel, dispatch};
pub use prefetch::prefetch;
pub use quad::{Quad, Quad32, Quad64};
pub use ray_rows::{RayRows, TestRay};
pub use triangles::{ErrorBounds, Interval, Packet, PacketRows, TriangleRay};
pub use watertight::Shear;
pub use whole::whole_f64;
