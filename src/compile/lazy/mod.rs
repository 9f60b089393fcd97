//! Lazy compile: a model that can be traced once its file has been read, long before it is compiled.
//!
//! One pass scatters the triangles to cells of an octree, as every compile does, and leaves them in a *working file*. A cell is cut
//! into blocks when a ray first reaches it; its blocks are appended to the same file. So a second run starts with all that an earlier
//! one has cut, also if that one was killed, and what no ray ever reaches is never sorted nor encoded. [`LazyModel::finish`]
//! cuts what is left and publishes the compiled file that a compile in one go makes, byte for byte.
//!
//! `docs/lazy-compile.md` gives the bytes of the working file and says why things are as they are.

mod cutter;
mod keep;
mod lazy_model;
mod log;
mod seal;
mod working_file;

pub use lazy_model::{LazyModel, LazyOptions, LazyReport};
