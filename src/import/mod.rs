//! Streamed readers for model formats: OBJ and MTL, PLY, STL, each also gzipped, and glTF (feature `gltf`). Never the whole mesh in memory.
//!
//! A reader holds a window of 1 MiB on the file and batches of 32,768 vertices and triangles: about 4 MiB, whatever the size of the
//! model (I1). Polygons of many corners take up to 90 bytes for each ([`CORNERS_MAX`] of them at most: 6 MiB), the names of
//! material libraries up to 8 MiB, and OBJ text parsed by other threads up to about 8 MiB. Files are untrusted (I5): no count in a
//! file chooses an allocation, and what cannot be read is a typed error that names the line or the byte.
//!
//! [`import_file`] chooses the reader by the extension; [`read_obj`], [`read_ply`] and [`read_stl`] take any stream;
//! [`TriangleSink`] takes triangles that never were a file. All send what they read to a [`MeshSink`]:
//! the compiler, or a [`MeshBuffer`] in memory.

mod attributes;
mod buffer;
mod decimal;
mod feed;
mod file;
#[cfg(feature = "gltf")]
pub(crate) mod gltf;
#[cfg(feature = "gzip")]
mod gzip;
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
pub use file::{import_file, source_record, source_record_of};
#[cfg(feature = "gltf")]
pub use gltf::{GltfMesh, GltfPart, JSON_BYTES_MAX, gltf_meshes};
pub use obj::read_obj;
pub use ply::read_ply;
pub use polygon::CORNERS_MAX;
pub use report::{IgnoredCounts, ImportOptions, ImportReport, WARNINGS_MAX, Warning};
pub use sink::{CornerIndices, MeshSink, NO_INDEX, VertexBatch};
pub use stl::read_stl;
pub use triangles::{Corners, TriangleSink, import_triangles};
