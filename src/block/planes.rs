//! Byte planes: all low bytes of a column of numbers, then all second bytes, and so on. A plane of high bytes is
//! nearly constant and compresses to almost nothing.

/// Appends the `width` low planes of `column`.
pub(super) fn split(column: &[u32], width: u8, out: &mut Vec<u8>) {
    for plane in 0..width {
        let shift = 8 * u32::from(plane);
        out.extend(column.iter().map(|value| (value >> shift) as u8));
    }
}

/// Puts the column back together from `width` planes of `column.len()` bytes each. `planes` has that length.
pub(super) fn merge(planes: &[u8], width: u8, column: &mut [u32]) {
    let count = column.len();
    debug_assert_eq!(planes.len(), count * usize::from(width));
    // One pass for each width, so that every loop is straight-line code over slices of one length.
    let plane = |index: usize| &planes[index * count..][..count];
    match width {
        0 => column.fill(0),
        1 => {
            for (value, a) in column.iter_mut().zip(plane(0)) {
                *value = u32::from(*a);
            }
        }
        2 => {
            for ((value, a), b) in column.iter_mut().zip(plane(0)).zip(plane(1)) {
                *value = u32::from(*a) | u32::from(*b) << 8;
            }
        }
        3 => {
            for (((value, a), b), c) in column.iter_mut().zip(plane(0)).zip(plane(1)).zip(plane(2)) {
                *value = u32::from(*a) | u32::from(*b) << 8 | u32::from(*c) << 16;
            }
        }
        _ => {
            for ((((value, a), b), c), d) in
                column.iter_mut().zip(plane(0)).zip(plane(1)).zip(plane(2)).zip(plane(3))
            {
                *value = u32::from_le_bytes([*a, *b, *c, *d]);
            }
        }
    }
}

/// Number `index` of a column of wide numbers.
pub(super) fn gather(planes: &[u8], width: u8, count: usize, index: usize) -> u64 {
    (0..usize::from(width))
        .fold(0, |value, plane| value | u64::from(planes[plane * count + index]) << (8 * plane))
}

/// Bytes that the low end of a number needs to hold it.
pub(super) fn width_of(value: u64) -> u8 {
    (64 - value.leading_zeros()).div_ceil(8) as u8
}
