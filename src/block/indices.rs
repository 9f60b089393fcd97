//! Indices in one byte each: how far an index lies below the number of vertices met so far. A new vertex is 0, so a
//! mesh in first-use order has mostly small numbers. 255 means that the index itself follows in a list of its own.

use super::Fault;

const ESCAPE: u32 = 255;

/// Appends one code per index to `codes` and the indices of escapes to `escapes`.
pub(super) fn encode(triangles: &[[u16; 3]], codes: &mut Vec<u8>, escapes: &mut Vec<u16>) {
    let start = codes.len();
    codes.resize(start + 3 * triangles.len(), 0);
    let mut met = 0u32;
    for (code, index) in codes[start..].iter_mut().zip(triangles.as_flattened()) {
        let distance = met.wrapping_sub(u32::from(*index));
        if distance < ESCAPE {
            *code = distance as u8;
            met += u32::from(distance == 0);
        } else {
            *code = ESCAPE as u8;
            escapes.push(*index);
            met = met.max(u32::from(*index) + 1);
        }
    }
}

/// Fills `triangles` from three codes each. `escapes` holds the low bytes of the escaped indices, then the high ones.
///
/// Errors carry offsets into `codes`; an index out of range is found at the end, so its offset is 0.
pub(super) fn decode(
    codes: &[u8],
    escapes: &[u8],
    vertex_count: usize,
    triangles: &mut [[u16; 3]],
) -> Result<(), Fault> {
    let (low, high) = escapes.split_at(escapes.len() / 2);
    let mut escaped = low.iter().zip(high).map(|(low, high)| u32::from(u16::from_le_bytes([*low, *high])));
    let mut met = 0u32;
    let mut highest = 0u32;
    for (number, (triangle, codes)) in triangles.iter_mut().zip(codes.chunks_exact(3)).enumerate() {
        let [a, b, c] = [u32::from(codes[0]), u32::from(codes[1]), u32::from(codes[2])];
        let indices;
        if a.max(b).max(c) < ESCAPE {
            // Written so that a triangle waits for `met` of the one before it and for nothing else. An index below
            // zero wraps to a large one and fails the range test.
            let (new_a, new_b, new_c) = (u32::from(a == 0), u32::from(b == 0), u32::from(c == 0));
            let after_a = met + new_a;
            let after_b = after_a + new_b;
            indices = [met.wrapping_sub(a), after_a.wrapping_sub(b), after_b.wrapping_sub(c)];
            met = after_b + new_c;
        } else {
            let mut found = [0; 3];
            for (index, code) in found.iter_mut().zip([a, b, c]) {
                if code < ESCAPE {
                    *index = met.wrapping_sub(code);
                    met += u32::from(code == 0);
                } else {
                    *index = escaped.next().ok_or(Fault(3 * number, "a far index is missing"))?;
                    met = met.max(*index + 1);
                }
            }
            indices = found;
        }
        highest = highest.max(indices[0]).max(indices[1]).max(indices[2]);
        *triangle = indices.map(|index| index as u16);
    }
    if highest as usize >= vertex_count {
        return Err(Fault(0, "an index is out of range"));
    }
    if escaped.next().is_some() {
        return Err(Fault(codes.len(), "a far index is left over"));
    }
    Ok(())
}
