//! The lines that make up nearly all of a file, in their plainest form. Whatever is not plain gives `None` and is
//! read by `statement`, which also words the errors.
//!
//! The slices are padded with newlines, so that every scan ends.

use crate::import::attributes::Reference;
use crate::import::number;
use crate::import::sink::NO_INDEX;
use crate::simd::other_than_digits;

/// Place of the first byte from `at` that is not a blank or a tab.
#[inline(always)]
fn skip_blanks(data: &[u8], mut at: usize) -> usize {
    while matches!(data.get(at), Some(b' ' | b'\t')) {
        at += 1;
    }
    at
}

/// Place after the line end that stands at `at`, perhaps after blanks.
#[inline(always)]
fn line_end(data: &[u8], at: usize) -> Option<usize> {
    if *data.get(at)? == b'\n' {
        return Some(at + 1);
    }
    let at = skip_blanks(data, at);
    match data.get(at..at + 2)? {
        [b'\n', _] => Some(at + 1),
        [b'\r', b'\n'] => Some(at + 2),
        _ => None,
    }
}

/// The rest of a `v` line: three numbers and up to four more (weight, colour), which are checked and dropped.
/// Gives the position, whether it is certain that f32 keeps its digits, and the start of the next line.
#[inline(always)]
pub(super) fn vertex(data: &[u8], at: usize) -> Option<([f64; 3], bool, usize)> {
    let (x, x_kept, at) = number::scan(data, skip_blanks(data, at))?;
    let (y, y_kept, at) = number::scan(data, skip_blanks(data, at))?;
    let (z, z_kept, mut at) = number::scan(data, skip_blanks(data, at))?;
    for _ in 0..5 {
        if let Some(next) = line_end(data, at) {
            return Some(([x, y, z], x_kept & y_kept & z_kept, next));
        }
        (_, _, at) = number::scan(data, skip_blanks(data, at))?;
    }
    None
}

/// Three positive indices of at most eight digits with a blank between them and a line feed behind: the commonest face, from the start
/// of its line. Gives them counted from 0, each below `known`, and the start of the next line. [`face`] takes the same lines.
#[inline(always)]
pub(super) fn triangle(data: &[u8], at: usize, known: u64) -> Option<([u32; 3], usize)> {
    let line = data.get(at..)?.first_chunk::<32>()?;
    // From behind `f` and its blank: lengths of runs of digits.
    let others = other_than_digits(line) >> 2;
    let first = others.trailing_zeros();
    let others = others >> (first & 31) >> 1;
    let second = others.trailing_zeros();
    let others = others >> (second & 31) >> 1;
    let third = others.trailing_zeros();
    // A length of 0 is as large as any here.
    let longest = first.wrapping_sub(1) | second.wrapping_sub(1) | third.wrapping_sub(1);
    if longest >= 8 {
        return None;
    }
    let places = [2, 3 + first as usize, 4 + (first + second) as usize];
    let end = places[2] + third as usize;
    if line[places[1] - 1] != b' ' || line[places[2] - 1] != b' ' || line[end] != b'\n' {
        return None;
    }
    let lengths = [first, second, third];
    // Index 0, which counts from 0 as the greatest number, is never known.
    let known = known.min(u32::MAX.into());
    let mut indices = [0; 3];
    let mut are_known = true;
    for corner in 0..3 {
        let index =
            number::value(line[places[corner]..].first_chunk::<8>()?, lengths[corner]).wrapping_sub(1);
        are_known &= u64::from(index) < known;
        indices[corner] = index;
    }
    are_known.then_some((indices, at + end + 1))
}

/// What the indices of a face count from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Numbering {
    /// Vertices above the face: -1 is the last of them.
    pub(super) above: u64,
    /// Vertices that may be named: positive indices are at most this.
    pub(super) known: u64,
}

impl Numbering {
    /// The vertex of a 1-based or negative index; `None` if there is none.
    #[inline(always)]
    pub(super) fn vertex(self, magnitude: u64, negative: bool) -> Option<u32> {
        let vertex = if negative && magnitude > 0 {
            self.above.checked_sub(magnitude)?
        } else {
            magnitude.checked_sub(1)?
        };
        // The feed keeps `known` within 2^32.
        if vertex < self.known { u32::try_from(vertex).ok() } else { None }
    }
}

/// The rest of an `f` line. Gives the start of the next line; the corners are in `three` where there are three of
/// them, which is told by an empty `corners`, else in `corners`. If attributes are `WANTED`, `references` gets those of each corner, or
/// nothing if no corner names any.
#[inline(always)]
pub(super) fn face<const WANTED: bool>(
    data: &[u8],
    at: usize,
    numbering: Numbering,
    corners: &mut Vec<u32>,
    references: &mut Vec<Reference>,
    corners_max: usize,
) -> Option<([u32; 3], usize)> {
    corners.clear();
    let (a, first, at) = corner::<WANTED>(data, skip_blanks(data, at), numbering)?;
    let (b, second, at) = corner::<WANTED>(data, skip_blanks(data, at), numbering)?;
    let (c, third, mut at) = corner::<WANTED>(data, skip_blanks(data, at), numbering)?;
    let three = [a, b, c];
    if WANTED {
        references.clear();
        for (place, reference) in [first, second, third].into_iter().enumerate() {
            note(references, place, reference);
        }
    }
    let mut end = line_end(data, at);
    if end.is_none() {
        corners.extend_from_slice(&three);
    }
    let next = loop {
        if let Some(next) = end {
            break next;
        }
        let (corner, reference, after) = corner::<WANTED>(data, skip_blanks(data, at), numbering)?;
        if corners.len() == corners_max {
            return None;
        }
        corners.push(corner);
        if WANTED {
            note(references, corners.len() - 1, reference);
        }
        at = after;
        end = line_end(data, at);
    };
    Some((three, next))
}

/// Takes the attributes of corner number `place`; nothing is written before the first corner that names any.
#[inline(always)]
fn note(references: &mut Vec<Reference>, place: usize, reference: Reference) {
    if reference != [NO_INDEX; 2] || !references.is_empty() {
        references.resize(place, [NO_INDEX; 2]);
        references.push(reference);
    }
}

/// One corner, `a`, `a/b`, `a//c` or `a/b/c`, its attributes if they are `WANTED`, and the place after it.
#[inline(always)]
fn corner<const WANTED: bool>(
    data: &[u8],
    at: usize,
    numbering: Numbering,
) -> Option<(u32, Reference, usize)> {
    let negative = *data.get(at)? == b'-';
    let (magnitude, mut at) = integer(data, at + usize::from(negative))?;
    let vertex = numbering.vertex(magnitude, negative)?;
    let mut reference = [NO_INDEX; 2];
    if data[at] == b'/' {
        (reference[0], at) = attribute::<WANTED>(data, at + 1)?;
        if data[at] == b'/' {
            (reference[1], at) = attribute::<WANTED>(data, at + 1)?;
        }
    }
    matches!(data[at], b' ' | b'\n' | b'\r' | b'\t').then_some((vertex, reference, at))
}

/// A run of one to sixteen digits, and the place after it, which is inside `data`.
#[inline(always)]
fn integer(data: &[u8], at: usize) -> Option<(u64, usize)> {
    let (value, count) = number::digits(data, at)?;
    match count {
        0 => None,
        8 => {
            let (more, count) = number::digits(data, at + 8)?;
            Some((u64::from(value) * number::SHIFTS[count] + u64::from(more), at + 8 + count))
        }
        _ => Some((value.into(), at + count)),
    }
    .filter(|(_, at)| *at < data.len())
}

/// The index, from 0, of a texture coordinate or a normal, which may be missing. If it is `WANTED`, one that counts backwards is not
/// plain.
#[inline(always)]
fn attribute<const WANTED: bool>(data: &[u8], at: usize) -> Option<(u32, usize)> {
    let negative = *data.get(at)? == b'-';
    let at = at + usize::from(negative);
    match integer(data, at) {
        Some((_, at)) if !WANTED => Some((NO_INDEX, at)),
        Some((index @ 1..=0xffff_ffff, at)) if !negative => Some((index as u32 - 1, at)),
        Some(_) => None,
        None => (at < data.len() && !negative).then_some((NO_INDEX, at)),
    }
}

/// The rest of a `vt` or `vn` line: at least `LEAST` numbers, of which three at most are kept, and up to two more. Gives the start of the
/// next line.
#[inline(always)]
pub(super) fn numbers<const LEAST: usize>(data: &[u8], mut at: usize) -> Option<([f32; 3], usize)> {
    let mut found = [0.0; 3];
    for count in 0..5 {
        if count >= LEAST
            && let Some(next) = line_end(data, at)
        {
            return Some((found, next));
        }
        let (number, _, after) = number::scan(data, skip_blanks(data, at))?;
        if let Some(place) = found.get_mut(count) {
            *place = number as f32;
        }
        at = after;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    #[test]
    fn the_commonest_face_is_a_face() {
        let mut random = Random::new(21);
        let mut taken = 0;
        for _ in 0..4000 {
            // Mostly plain lines; bytes that end, join or spoil numbers, lengths of 0 to 10 digits, leading zeros.
            let mut line = b"f ".to_vec();
            for place in 0..2 + random.next_u64() % 3 {
                if place > 0 {
                    line.push(if random.next_u64().is_multiple_of(20) {
                        b"\t/-\r,"[random.next_u64() as usize % 5]
                    } else {
                        b' '
                    });
                }
                let length = if random.next_u64().is_multiple_of(8) {
                    random.next_u64() % 11
                } else {
                    1 + random.next_u64() % 8
                };
                line.extend((0..length).map(|_| b'0' + (random.next_u64() % 10) as u8));
            }
            line.push(b'\n');
            line.extend([b'\n'; 32]);
            let known = [1 << 32, 5000, 0][random.next_u64() as usize % 3];
            let (mut corners, mut references) = (Vec::new(), Vec::new());
            let numbering = Numbering { above: 0, known };
            let face = face::<false>(&line, 2, numbering, &mut corners, &mut references, 100);
            if let Some(found) = triangle(&line, 0, known) {
                assert_eq!((face, corners.is_empty()), (Some(found), true), "{line:?}");
                taken += 1;
            }
        }
        assert!(taken > 300, "{taken}");
    }
}
