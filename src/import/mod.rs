//! Streamed readers for model formats: OBJ and MTL, PLY, STL, each also gzipped. Never the whole mesh in memory.

mod buffer;
mod feed;
mod file;
mod library;
mod meter;
mod mtl;
mod number;
mod obj;
mod ply;
mod polygon;
mod report;
mod sink;
mod stl;
#[cfg(test)]
mod tests;
mod text;
mod triangles;
mod window;

pub use buffer::MeshBuffer;
pub use file::{import_file, source_record};
pub use obj::read_obj;
pub use ply::read_ply;
pub use polygon::CORNERS_MAX;
pub use report::{IgnoredCounts, ImportOptions, ImportReport, WARNINGS_MAX, Warning};
pub use sink::{MeshSink, VertexBatch};
pub use stl::read_stl;
pub use triangles::{Corners, TriangleSink, import_triangles};
