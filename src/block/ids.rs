//! Ids as differences less one. Consecutive ids take no bytes at all; otherwise each difference takes `width` bytes in
//! planes, and the largest number of that width means that the difference follows in a list of its own.

use super::Fault;
use super::planes::{gather, width_of};

/// The width that should give the fewest bytes after compression, or `None` if the ids do not ascend strictly.
pub(super) fn choose_width(ids: &[u64]) -> Option<u8> {
    // How many differences need 0, 1, .. 8 bytes to stay below the escape of that width.
    let mut counts = [0usize; 9];
    let mut ascending = true;
    for pair in ids.windows(2) {
        ascending &= pair[0] < pair[1];
        let skipped = pair[1].wrapping_sub(pair[0]).wrapping_sub(1);
        let width = if skipped == 0 { 0 } else { width_of(skipped.saturating_add(1)) };
        counts[usize::from(width)] += 1;
    }
    if !ascending {
        return None;
    }
    let total = ids.len() - 1;
    if counts[0] == total {
        return Some(0);
    }
    // Zero bytes come in runs and compress well (a thirtieth, by experience); other bytes do not compress.
    let cost = |width: usize| -> usize {
        let zeros = total * width / 30;
        let bytes = |(size, count): (usize, &usize)| count * if size <= width { size } else { width + 8 };
        zeros + counts.iter().enumerate().map(bytes).sum::<usize>()
    };
    (1..=8).min_by_key(|width| cost(*width)).map(|width| width as u8)
}

fn escape(width: u8) -> u64 {
    u64::MAX >> (64 - 8 * u32::from(width))
}

/// Appends the planes of the differences to `out` and the escaped ones to `escapes`. `ids` ascend strictly.
pub(super) fn encode(ids: &[u64], width: u8, out: &mut Vec<u8>, escapes: &mut Vec<u64>) {
    if width == 0 {
        return;
    }
    let (start, count, escape) = (out.len(), ids.len() - 1, escape(width));
    out.resize(start + count * usize::from(width), 0);
    let planes = &mut out[start..];
    for (index, pair) in ids.windows(2).enumerate() {
        let skipped = pair[1] - pair[0] - 1;
        let code = if skipped < escape {
            skipped
        } else {
            escapes.push(skipped);
            escape
        };
        if code != 0 {
            for plane in 0..usize::from(width) {
                planes[plane * count + index] = (code >> (8 * plane)) as u8;
            }
        }
    }
}

/// Fills `ids` (not empty). `planes` has `width` planes of `ids.len() - 1` bytes, `escapes` eight bytes for each escape.
///
/// Errors carry offsets into `planes`.
pub(super) fn decode(
    base: u64,
    width: u8,
    planes: &[u8],
    escapes: &[u8],
    ids: &mut [u64],
) -> Result<(), Fault> {
    const OVERFLOW: Fault = Fault(0, "an id is out of range");
    let count = ids.len() - 1;
    if width == 0 {
        base.checked_add(count as u64).ok_or(OVERFLOW)?;
        for (id, offset) in ids.iter_mut().zip(0..) {
            *id = base + offset;
        }
        return if escapes.is_empty() { Ok(()) } else { Err(Fault(0, "a far id is left over")) };
    }
    let escape = escape(width);
    let mut escaped = escapes.as_chunks::<8>().0.iter().map(|bytes| u64::from_le_bytes(*bytes));
    let mut id = base;
    let mut overflow = false;
    ids[0] = base;
    for (index, place) in ids[1..].iter_mut().enumerate() {
        let mut skipped =
            if width == 1 { u64::from(planes[index]) } else { gather(planes, width, count, index) };
        if skipped == escape {
            skipped = escaped.next().ok_or(Fault(index, "a far id is missing"))?;
        }
        // Strictly ascending unless the sum wraps.
        let next = id.wrapping_add(skipped).wrapping_add(1);
        overflow |= next <= id;
        id = next;
        *place = id;
    }
    if overflow {
        return Err(OVERFLOW);
    }
    if escaped.next().is_some() {
        return Err(Fault(planes.len(), "a far id is left over"));
    }
    Ok(())
}
