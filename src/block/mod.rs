//! One block: bytes to triangles and back. No I/O. Input bytes are untrusted (I5).
//!
//! A stored block is a fixed header and a payload. The payload is filtered (vertices as byte planes of differences from what is
//! expected of them, triangles as shapes that say where each corner comes from, ids and materials as runs) and then compressed
//! with the block's [`Codec`]. `docs/format.md` gives every byte. Encoding is lossless, also for -0.0 and denormals.
//!
//! Attributes of triangle corners stand beside the blocks, in pages of their own: [`attributes`].
//!
//! Decoding goes into preallocated memory, checks the checksum before it decompresses, every count before it is used,
//! and every index and id as it is made.

pub mod attributes;
mod check;
mod codec;
mod data;
mod decode;
mod encode;
mod header;
mod ids;
mod lzo;
mod materials;
mod planes;
mod shapes;
#[cfg(test)]
mod tests;
mod vertices;
mod zstd_codec;

pub use check::{BlockCheck, checksum};
pub use codec::Codec;
pub use data::{BlockData, BlockInput, BlockLimits, VertexInput};
pub use decode::{DecodeScratch, decode};
pub use encode::{EncodeScratch, encode};
pub use header::BLOCK_HEADER_BYTES;
pub use vertices::is_wide;

pub(crate) use check::Fault;
pub(crate) use header::stored_bytes_max;
