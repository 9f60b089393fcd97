//! Attributes to bytes.

use std::collections::HashMap;
use std::hash::Hash;

use super::page::{CORNERS, NONE, PAGE_HEADER_BYTES, PAGE_MAGIC, payload_bytes};
use super::{PAGE_TRIANGLES, PageCheck};
use crate::block::checksum;
use crate::block::codec::{self, Codec, CodecScratch};
use crate::error::EncodeError;

/// The attributes of the triangles of a page, in the order of their ids; triangles that are missing at the end have none.
#[derive(Clone, Copy, Debug)]
pub struct PageInput<'a> {
    /// Texture coordinates of the three corners, by their bits. Triangles of which not all are finite have none.
    pub uvs: &'a [Option<[[f32; 2]; 3]>],
    /// Normals of the three corners as of [`normal_bits`](super::normal_bits).
    pub normals: &'a [Option<[u32; 3]>],
}

/// Memory of the encoder, reused from page to page.
pub struct PageEncodeScratch {
    uvs: Column<[u32; 2]>,
    normals: Column<u32>,
    payload: Vec<u8>,
    codec: CodecScratch,
}

impl Default for PageEncodeScratch {
    fn default() -> PageEncodeScratch {
        PageEncodeScratch {
            uvs: Column::default(),
            normals: Column::default(),
            payload: Vec::new(),
            codec: CodecScratch::new(),
        }
    }
}

impl PageEncodeScratch {
    /// At most what it comes to hold, for the memory budget (I1).
    pub const BYTES: u64 = (2 * CORNERS * (8 + 4 + 2 + 2 + 3 * 24) + 2 * (16 * CORNERS) + (64 << 10)) as u64;
}

/// Distinct values in the order of their first use, and a code for each corner.
struct Column<T> {
    found: HashMap<T, u16>,
    values: Vec<T>,
    codes: Vec<u16>,
}

impl<T> Default for Column<T> {
    fn default() -> Column<T> {
        Column { found: HashMap::new(), values: Vec::new(), codes: Vec::new() }
    }
}

impl<T: Copy + Eq + Hash> Column<T> {
    fn collect(&mut self, triangles: impl Iterator<Item = Option<[T; 3]>>) {
        self.found.clear();
        self.values.clear();
        self.codes.clear();
        for corners in triangles {
            let Some(corners) = corners else {
                self.codes.extend([NONE; 3]);
                continue;
            };
            for value in corners {
                let next = self.values.len() as u16;
                let index = *self.found.entry(value).or_insert(next);
                if index == next {
                    self.values.push(value);
                }
                // 0 is the next new value, else how far below the number of values so far.
                self.codes.push(next - index);
            }
        }
        self.codes.resize(CORNERS, NONE);
    }

    fn put_codes(&self, out: &mut Vec<u8>) {
        if !self.values.is_empty() {
            out.extend(self.codes.iter().map(|code| *code as u8));
            out.extend(self.codes.iter().map(|code| (*code >> 8) as u8));
        }
    }
}

/// Appends `width` byte planes of the differences of a column of numbers, the sign folded into the lowest bit.
fn put_planes(values: impl Iterator<Item = u32> + Clone, width: u32, out: &mut Vec<u8>) {
    let unused = 32 - 8 * width;
    for plane in 0..width {
        let mut before = 0u32;
        out.extend(values.clone().map(|value| {
            // In `width` bytes: what is above them is shifted out and back.
            let difference = (value.wrapping_sub(before) << unused) as i32 >> unused;
            before = value;
            ((difference << 1 ^ difference >> 31) as u32 >> (8 * plane)) as u8
        }));
    }
}

/// Encodes one page into `out` (cleared first) and gives what the directory has to say about it; `None`, and nothing in `out`, if no
/// triangle has an attribute. Lossless for what [`PageInput`] holds, and a function of its arguments alone.
///
/// # Errors
/// [`EncodeError`] if there are more triangles than in a page, or the codec is not in this build.
pub fn encode_page(
    input: &PageInput<'_>,
    codec: Codec,
    scratch: &mut PageEncodeScratch,
    out: &mut Vec<u8>,
) -> Result<Option<PageCheck>, EncodeError> {
    out.clear();
    if input.uvs.len().max(input.normals.len()) > PAGE_TRIANGLES {
        return Err(EncodeError::Invalid("it has more triangles than a page of attributes"));
    }
    let PageEncodeScratch { uvs, normals, payload, codec: codec_scratch } = scratch;
    uvs.collect(input.uvs.iter().map(|corners| {
        corners
            .filter(|corners| corners.as_flattened().iter().all(|x| x.is_finite()))
            .map(|corners| corners.map(|pair| pair.map(f32::to_bits)))
    }));
    normals.collect(input.normals.iter().copied());
    let (uv_count, normal_count) = (uvs.values.len(), normals.values.len());
    if uv_count + normal_count == 0 {
        return Ok(None);
    }
    payload.clear();
    uvs.put_codes(payload);
    for axis in 0..2 {
        put_planes(uvs.values.iter().map(|pair| pair[axis]), 4, payload);
    }
    normals.put_codes(payload);
    for axis in 0..2 {
        put_planes(normals.values.iter().map(|bits| bits >> (16 * axis) & 0xffff), 2, payload);
    }
    debug_assert_eq!(payload.len(), payload_bytes(uv_count, normal_count));
    out.extend_from_slice(&[0; PAGE_HEADER_BYTES]);
    let mut used = codec;
    if !codec::compress(codec, payload, codec_scratch, out)? {
        used = Codec::Raw;
        out.extend_from_slice(payload);
    }
    // A page has 6,144 corners.
    let counts = [uv_count as u16, normal_count as u16];
    out[0] = PAGE_MAGIC;
    out[1] = used.id();
    out[4..6].copy_from_slice(&counts[0].to_le_bytes());
    out[6..8].copy_from_slice(&counts[1].to_le_bytes());
    out[8..12].copy_from_slice(&(payload.len() as u32).to_le_bytes());
    Ok(Some(PageCheck { page: 0, checksum: checksum(out), uv_count: counts[0], normal_count: counts[1] }))
}

impl std::fmt::Debug for PageEncodeScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PageEncodeScratch").finish_non_exhaustive()
    }
}
