//! Bytes to attributes. Everything here treats the bytes as untrusted (I5).

use super::PageCheck;
use super::page::{
    CORNERS, COUNTS_BYTES, NONE, PAGE_HEADER_BYTES, PAGE_MAGIC, PageHeader, page_bytes, parts, payload_bytes,
    stored_page_bytes_max,
};
use crate::block::check::{Fault, checksum};
use crate::block::codec::{self, Codec};
use crate::block::zstd_codec::ZstdDecoder;
use crate::error::AttributeError;

/// Memory of the decoder, reused from page to page. One per thread.
pub struct PageDecodeScratch {
    payload: Vec<u8>,
    zstd: ZstdDecoder,
}

impl Default for PageDecodeScratch {
    fn default() -> PageDecodeScratch {
        PageDecodeScratch { payload: vec![0; stored_page_bytes_max()], zstd: ZstdDecoder::default() }
    }
}

impl PageDecodeScratch {
    /// What it allocates, for the memory budget (I1).
    pub const BYTES: u64 = (stored_page_bytes_max() + ZstdDecoder::BYTES) as u64;
}

impl PageHeader {
    fn parse(bytes: &[u8], check: &PageCheck) -> Result<PageHeader, Fault> {
        let Some(bytes) = bytes.first_chunk::<PAGE_HEADER_BYTES>() else {
            return Err(Fault(bytes.len(), "it ends inside its header"));
        };
        let require = |holds: bool, at: usize, reason| if holds { Ok(()) } else { Err(Fault(at, reason)) };
        require(bytes[0] == PAGE_MAGIC, 0, "it does not start with the page signature")?;
        let codec = Codec::from_id(bytes[1]).ok_or(Fault(1, "its codec is unknown"))?;
        require(bytes[2..4] == [0; 2] && bytes[12..16] == [0; 4], 2, "a reserved byte is not zero")?;
        let half = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
        let (uv_count, normal_count) = (half(4), half(6));
        let same = (uv_count, normal_count) == (check.uv_count, check.normal_count);
        require(same, 4, "its counts are not those of the directory")?;
        let (uv_count, normal_count) = (usize::from(uv_count), usize::from(normal_count));
        require(uv_count.max(normal_count) <= CORNERS, 4, "it has more attributes than corners")?;
        require(uv_count + normal_count > 0, 4, "it is empty")?;
        let bytes = u32::from_le_bytes([bytes[8], bytes[9], bytes[10], bytes[11]]) as usize;
        let expected = payload_bytes(uv_count, normal_count);
        require(bytes == expected, 8, "its payload length does not follow from its counts")?;
        Ok(PageHeader { codec, uv_count, normal_count, payload_bytes: bytes })
    }
}

/// Decodes the stored bytes of a page into the front of `into`, for [`corner_attributes`](super::corner_attributes). Does not allocate.
///
/// # Errors
/// [`AttributeError`] if the bytes are not exactly what `check` promises, or `into` is too short; what is in `into` means nothing then.
/// Never panics, whatever the bytes are.
pub fn decode_page(
    bytes: &[u8],
    check: &PageCheck,
    scratch: &mut PageDecodeScratch,
    into: &mut [u8],
) -> Result<(), AttributeError> {
    decode_parts(bytes, check, scratch, into).map_err(|Fault(offset, reason)| AttributeError {
        page: check.page,
        offset: offset as u64,
        reason,
    })
}

fn decode_parts(
    bytes: &[u8],
    check: &PageCheck,
    scratch: &mut PageDecodeScratch,
    into: &mut [u8],
) -> Result<(), Fault> {
    if checksum(bytes) != check.checksum {
        return Err(Fault(0, "its checksum is wrong"));
    }
    let header = PageHeader::parse(bytes, check)?;
    let PageHeader { uv_count, normal_count, .. } = header;
    // Both counts are at most 6,144, so the payload fits the scratch.
    let room = &mut scratch.payload[..header.payload_bytes];
    let stored = &bytes[PAGE_HEADER_BYTES..];
    codec::decompress(header.codec, stored, room, &mut scratch.zstd, PAGE_HEADER_BYTES)?;
    let page = into
        .get_mut(..page_bytes(check.uv_count, check.normal_count))
        .ok_or(Fault(0, "it is larger than the memory that was set aside"))?;
    page[..COUNTS_BYTES]
        .copy_from_slice(&[check.uv_count, check.normal_count].map(u16::to_le_bytes).concat());
    let [uvs, normals, uv_indices, normal_indices] = parts(uv_count, normal_count);
    let mut rest: &[u8] = room;
    let mut take = |count: usize| {
        let (part, after) = rest.split_at(count);
        rest = after;
        part
    };
    // Offsets of damage are known only if the payload is stored as it is.
    let fault = |reason| Fault(PAGE_HEADER_BYTES, reason);
    if uv_count > 0 {
        let codes = take(2 * CORNERS);
        decode_indices(codes, uv_count, &mut page[uv_indices..][..2 * CORNERS]).map_err(fault)?;
    }
    for axis in 0..2 {
        let planes = take(4 * uv_count);
        let place = &mut page[uvs..normals];
        for (index, value) in column::<4>(planes, uv_count).enumerate() {
            if !f32::from_bits(value).is_finite() {
                return Err(fault("a texture coordinate is not finite"));
            }
            place[8 * index + 4 * axis..][..4].copy_from_slice(&value.to_le_bytes());
        }
    }
    if normal_count > 0 {
        let codes = take(2 * CORNERS);
        decode_indices(codes, normal_count, &mut page[normal_indices..][..2 * CORNERS]).map_err(fault)?;
    }
    for axis in 0..2 {
        let planes = take(2 * normal_count);
        let place = &mut page[normals..uv_indices];
        for (index, value) in column::<2>(planes, normal_count).enumerate() {
            place[4 * index + 2 * axis..][..2].copy_from_slice(&(value as u16).to_le_bytes());
        }
    }
    Ok(())
}

/// Codes to indices: all values are used, in the order of their first use.
fn decode_indices(codes: &[u8], count: usize, into: &mut [u8]) -> Result<(), &'static str> {
    let (low, high) = codes.split_at(CORNERS);
    let mut met = 0;
    for ((low, high), place) in low.iter().zip(high).zip(into.as_chunks_mut::<2>().0) {
        let index = match u16::from_le_bytes([*low, *high]) {
            NONE => NONE,
            0 => {
                met += 1;
                met - 1
            }
            distance => {
                met.checked_sub(distance).ok_or("an index names an attribute that has not come yet")?
            }
        };
        *place = index.to_le_bytes();
    }
    if usize::from(met) == count { Ok(()) } else { Err("not all of its attributes are used") }
}

/// The numbers of a column of differences in `WIDTH` byte planes.
fn column<const WIDTH: usize>(planes: &[u8], count: usize) -> impl Iterator<Item = u32> {
    let mut value = 0u32;
    let mask = u32::MAX >> (32 - 8 * WIDTH as u32);
    (0..count).map(move |index| {
        let folded = (0..WIDTH)
            .fold(0, |folded, plane| folded | u32::from(planes[plane * count + index]) << (8 * plane));
        let difference = folded >> 1 ^ 0u32.wrapping_sub(folded & 1);
        value = value.wrapping_add(difference) & mask;
        value
    })
}

impl std::fmt::Debug for PageDecodeScratch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PageDecodeScratch").finish_non_exhaustive()
    }
}
