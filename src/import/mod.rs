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
mod text;
mod window;

pub use buffer::MeshBuffer;
pub use file::{import_file, source_record};
pub use obj::read_obj;
pub use ply::read_ply;
pub use report::{IgnoredCounts, ImportOptions, ImportReport, WARNINGS_MAX, Warning};
pub use sink::{MeshSink, VertexBatch};
