//! One block: bytes to triangles and back. No I/O. Input bytes are untrusted (I5).

mod data;

pub use data::{BlockData, BlockInput, BlockLimits, VertexInput};
