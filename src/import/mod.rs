//! Streamed readers for model formats: OBJ and MTL, PLY, STL, each also gzipped. Never the whole mesh in memory.

mod sink;

pub use sink::{MeshSink, VertexBatch};
