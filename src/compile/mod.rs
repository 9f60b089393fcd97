//! Triangles to a compiled file, in bounded memory: partition, cut, encode, write, seal.
//!
//! 1. Vertices are kept, in memory or in pages on disk, and counted in a grid that grows with them.
//! 2. The grid is cut into buckets, octree cells of about 64 k triangles. Each triangle goes to the bucket of its centroid, and
//!    buckets go to a spill as chunks that carry their own vertices.
//! 3. Bucket by bucket, triangles are cut into blocks at planes of least surface area, and encoded.
//! 4. Blocks are written one after the other under a temporary name; directory, materials and, last, the header
//!    seal the file, which then gets its name.
//!
//! Attributes of triangle corners go their own way, to pages by triangle id between the blocks and their directory; a model without any
//! compiles to the same file as if there were no such thing.
//!
//! The result is a function of the mesh and the options alone: not of threads, and for the image (I2) not of the
//! budget. Each triangle is in exactly one block (I4).

mod attributes;
mod blocks;
mod bucket;
mod chunk;
mod clock;
mod compiler;
mod crew;
mod cut;
mod faces;
mod file;
mod file_lock;
mod gather;
mod grid;
mod lazy;
mod lookup;
mod options;
mod output;
mod pages;
mod parallel;
mod placer;
mod point;
mod precision;
mod records;
mod refine;
mod scatter;
mod shape;
mod spill;
mod temporary;
mod vertices;

pub use compiler::Compiler;
pub use file::{compile_file, compile_file_with};
pub use lazy::{LazyModel, LazyOptions, LazyReport};
pub use options::{
    AUTO_TOLERANCE, CompileOptions, CompileReport, Control, Phase, PhaseSeconds, PrecisionChoice, Progress,
    Seconds, Threads,
};
pub use shape::compile_shape;

pub(crate) use file_lock::open_locked;
pub(crate) use temporary::{TemporaryFile, WriteError, write_at};
