//! What encoder, decoder and reader of a page agree on.

use super::normal_of_bits;
use crate::block::codec::Codec;

/// Triangles of a page.
pub const PAGE_TRIANGLES: usize = 2048;

/// Bytes of the header of a stored page.
pub const PAGE_HEADER_BYTES: usize = 16;

/// Stands for a corner without the attribute, wherever indices to attributes stand.
pub const NO_ATTRIBUTE: u32 = u32::MAX;

/// First byte of every page: 0xA0 plus the version of the page format.
pub(super) const PAGE_MAGIC: u8 = 0xa1;

/// [`NO_ATTRIBUTE`] in 16 bits.
pub(super) const NONE: u16 = u16::MAX;

/// Corners of a page.
pub(super) const CORNERS: usize = 3 * PAGE_TRIANGLES;

/// What the directory promises about a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageCheck {
    /// Which page, for errors.
    pub page: u32,
    /// [`checksum`](crate::block::checksum) of its stored bytes.
    pub checksum: u64,
    /// Distinct texture coordinates in it.
    pub uv_count: u16,
    /// Distinct normals in it.
    pub normal_count: u16,
}

/// The attributes of one triangle; each only if all three corners have it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CornerAttributes {
    /// Texture coordinates.
    pub uvs: Option<[[f32; 2]; 3]>,
    /// Unit normals, as stored: they need not be on the side from which the corners are seen in counter-clockwise order.
    pub normals: Option<[[f64; 3]; 3]>,
}

/// The header in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PageHeader {
    pub codec: Codec,
    pub uv_count: usize,
    pub normal_count: usize,
    pub payload_bytes: usize,
}

/// Bytes of a payload with these counts: indices (two planes) and values (planes) of each kind that is there.
pub(super) fn payload_bytes(uv_count: usize, normal_count: usize) -> usize {
    let indices = |count: usize| if count > 0 { 2 * CORNERS } else { 0 };
    indices(uv_count) + 8 * uv_count + indices(normal_count) + 4 * normal_count
}

/// Longest stored form of a page. What does not shrink is stored raw.
pub(crate) const fn stored_page_bytes_max() -> usize {
    PAGE_HEADER_BYTES + CORNERS * (2 + 8 + 2 + 4)
}

/// Memory that a decoded page with these counts takes: counts, values, indices.
pub(crate) fn page_bytes(uv_count: u16, normal_count: u16) -> usize {
    // The same numbers as in the payload, not packed.
    COUNTS_BYTES + payload_bytes(usize::from(uv_count), usize::from(normal_count))
}

/// The two counts at the start of a decoded page.
pub(super) const COUNTS_BYTES: usize = 4;

/// Where the parts of a decoded page begin: pairs, normals, indices to pairs, indices to normals.
pub(super) fn parts(uv_count: usize, normal_count: usize) -> [usize; 4] {
    let uvs = COUNTS_BYTES;
    let normals = uvs + 8 * uv_count;
    let uv_indices = normals + 4 * normal_count;
    let normal_indices = uv_indices + if uv_count > 0 { 2 * CORNERS } else { 0 };
    [uvs, normals, uv_indices, normal_indices]
}

/// The attributes of triangle number `index` of a page that [`decode_page`](super::decode_page) laid out.
///
/// # Panics
/// `index` is not less than [`PAGE_TRIANGLES`], or `page` does not come from `decode_page`.
pub fn corner_attributes(page: &[u8], index: usize) -> CornerAttributes {
    assert!(index < PAGE_TRIANGLES, "a page has no triangle {index}");
    let half = |at: usize| u16::from_le_bytes([page[at], page[at + 1]]);
    let word = |at: usize| [page[at], page[at + 1], page[at + 2], page[at + 3]];
    let (uv_count, normal_count) = (usize::from(half(0)), usize::from(half(2)));
    let [uvs, normals, uv_indices, normal_indices] = parts(uv_count, normal_count);
    let corners = |count: usize, from: usize| -> Option<[usize; 3]> {
        if count == 0 {
            return None;
        }
        let indices = [0, 1, 2].map(|corner| half(from + 2 * (3 * index + corner)));
        (!indices.contains(&NONE)).then(|| indices.map(usize::from))
    };
    CornerAttributes {
        uvs: corners(uv_count, uv_indices).map(|corners| {
            corners.map(|corner| {
                let at = uvs + 8 * corner;
                [f32::from_le_bytes(word(at)), f32::from_le_bytes(word(at + 4))]
            })
        }),
        normals: corners(normal_count, normal_indices).map(|corners| {
            corners.map(|corner| normal_of_bits(u32::from_le_bytes(word(normals + 4 * corner))))
        }),
    }
}
