//! Procedural models that examples, tests and benches share.
//!
//! Every model is a [`Shape`]: it knows its exact counts and writes itself into a
//! [`MeshSink`](crate::import::MeshSink) as a stream, the same stream every time and on every machine
//! (trigonometry comes from `libm`, random numbers from a generator of this room). [`export`] writes any of them
//! to a model file, [`MeshBuffer`] keeps a small one in memory.

pub mod export;
mod gears;
mod mesh_buffer;
mod shape;
mod tessellation;

pub use gears::Gears;
pub use mesh_buffer::MeshBuffer;
pub use shape::Shape;
pub use tessellation::Tessellation;
