//! Procedural models that examples, tests and benches share.
//!
//! Every model is a [`Shape`]: it knows its exact counts and writes itself into a
//! [`MeshSink`](crate::import::MeshSink) as a stream, the same stream every time and on every machine
//! (trigonometry comes from `libm`, random numbers from the library's generator). [`export`] writes any of them
//! to a model file.

mod assembly;
mod closed;
mod cuboid;
pub mod export;
mod gears;
mod glass_stack;
mod icosphere;
mod needles;
pub(crate) mod random;
mod shape;
mod soup;
mod terrain;
mod tessellation;
mod torus_field;

pub use assembly::Assembly;
pub use closed::open_edges;
pub use cuboid::{CUBOID_FACES, cuboid_corners};
pub use gears::Gears;
pub use glass_stack::GlassStack;
pub use icosphere::Icosphere;
pub use needles::Needles;
pub use shape::Shape;
pub use soup::Soup;
pub use terrain::Terrain;
pub use tessellation::Tessellation;
pub use torus_field::TorusField;
