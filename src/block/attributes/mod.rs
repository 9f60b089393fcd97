//! Attributes of triangle corners (texture coordinates, normals), stored beside the blocks and only if a model has them.
//!
//! They stand in *pages* by triangle id, not in blocks: page `p` is about the triangles `2048 p .. 2048 (p + 1)`. So a hit finds its
//! attributes by its id alone, the cut into blocks does not show in them, and a block is as small as it is without them. A page
//! holds each distinct pair or normal once, and 16-bit indices to them. `docs/format.md` gives every byte.
//!
//! [`encode_page`] writes a page; [`decode_page`] checks its bytes, which are untrusted (I5), and lays them out in memory of a fixed
//! size, where [`corner_attributes`] finds the attributes of one triangle.

mod decode;
mod encode;
mod normal;
mod page;
#[cfg(test)]
mod tests;

pub use decode::{PageDecodeScratch, decode_page};
pub use encode::{PageEncodeScratch, PageInput, encode_page};
pub use normal::{normal_bits, normal_of_bits};
pub use page::{
    CornerAttributes, NO_ATTRIBUTE, PAGE_HEADER_BYTES, PAGE_TRIANGLES, PageCheck, corner_attributes,
};

pub(crate) use page::{page_bytes, stored_page_bytes_max};
