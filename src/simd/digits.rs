//! Where the digits of a text are, sixteen bytes at a time: with what every x86-64 has (SSE2), so there is nothing to dispatch.

/// Bit `i` is set if byte `i` is no decimal digit.
#[inline(always)]
pub fn other_than_digits<const N: usize>(bytes: &[u8; N]) -> u64 {
    const { assert!(N == 16 || N == 32) };
    let mut mask = 0;
    for (place, bytes) in bytes.as_chunks::<16>().0.iter().enumerate() {
        mask |= u64::from(others(bytes)) << (16 * place);
    }
    mask
}

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn others(bytes: &[u8; 16]) -> u16 {
    use std::arch::x86_64::*;
    // SAFETY: SSE2 is a part of x86-64; `bytes` is valid for reading sixteen bytes and the load may be unaligned.
    unsafe {
        let bytes = _mm_loadu_si128(bytes.as_ptr().cast());
        // Digits become the ten least signed numbers.
        let moved = _mm_add_epi8(bytes, _mm_set1_epi8(i8::MIN.wrapping_sub(b'0' as i8)));
        !(_mm_movemask_epi8(_mm_cmplt_epi8(moved, _mm_set1_epi8(i8::MIN + 10))) as u16)
    }
}

#[cfg(not(target_arch = "x86_64"))]
#[inline(always)]
fn others(bytes: &[u8; 16]) -> u16 {
    others_naively(bytes)
}

/// The meaning of [`others`].
#[cfg(any(test, not(target_arch = "x86_64")))]
fn others_naively(bytes: &[u8; 16]) -> u16 {
    bytes.iter().enumerate().fold(0, |mask, (place, byte)| mask | u16::from(!byte.is_ascii_digit()) << place)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    #[test]
    fn a_mask_is_what_each_byte_says() {
        for byte in 0..=255 {
            assert_eq!(others(&[byte; 16]), others_naively(&[byte; 16]));
        }
        let mut random = Random::new(5);
        for _ in 0..2000 {
            let bytes = [0; 32].map(|_| (random.next_u64() % 20 + 0x2a) as u8);
            let halves = bytes.as_chunks::<16>().0;
            let naive = u64::from(others_naively(&halves[0])) | u64::from(others_naively(&halves[1])) << 16;
            assert_eq!(other_than_digits(&bytes), naive);
            assert_eq!(other_than_digits(&halves[1]), naive >> 16);
        }
    }
}
