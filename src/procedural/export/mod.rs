//! Writes a [`Shape`](super::Shape) to a model file, as a stream, so that test files of any size can be made.

mod mtl;
mod obj;
mod out;
mod ply;

pub use obj::write_obj;
pub use ply::write_ply;
