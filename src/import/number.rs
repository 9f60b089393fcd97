//! Decimal text to the nearest f64, ties to even; rounding that to f32 gives the f32 nearest to the text.
//!
//! Most numbers in model files have at most 15 digits and no exponent. Their digits are an integer below 2^53 and
//! their scale is a power of ten up to 10^22, both exact in f64, so that one division rounds once and correctly
//! (Clinger, "How to read floating point numbers accurately", 1990). Everything else goes to `fast-float2`.
//!
//! Where the nearest f64 is halfway between two f32 numbers and the text is not quite, rounding twice could go wrong. There the f64
//! next to it on the side of the text is given, one in 2^29 numbers.

use crate::simd::other_than_digits;

/// Powers of ten that are exact in f64.
const EXACT_POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];

/// Half a unit of the last digit, by the places after the point; the nearest f64.
const HALF_UNITS: [f64; EXACT_POWERS.len()] = {
    let mut halves = [0.5; EXACT_POWERS.len()];
    let mut places = 0;
    while places < halves.len() {
        halves[places] /= EXACT_POWERS[places];
        places += 1;
    }
    halves
};

/// Powers of ten by which up to eight new digits move the earlier ones.
pub(super) const SHIFTS: [u64; 9] = [1, 10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000, 100_000_000];

/// Longest token that is looked at as a number; longer digit strings do not occur in models.
const TOKEN_BYTES_MAX: usize = 4096;

/// Reads a whole token as a number. Takes every form that model files have: `1.`, `.5`, `+1`, `1e-5`, `nan`, `inf`,
/// the `nan(ind)` of Windows programs and the `1.#INF`, `1.#IND` of old ones; `None` for anything else.
pub(super) fn parse(token: &[u8]) -> Option<f64> {
    if token.len() > TOKEN_BYTES_MAX {
        return None;
    }
    let unsigned = match token {
        [b'+', rest @ ..] if !matches!(rest.first(), Some(b'+' | b'-')) => rest,
        _ => token,
    };
    if let Ok(value) = fast_float2::parse::<f64, _>(unsigned) {
        return Some(beside_halfway(value, unsigned));
    }
    let (sign, rest) = match unsigned {
        [b'-', rest @ ..] => (-1.0, rest),
        rest => (1.0, rest),
    };
    if rest.starts_with(b"nan(") && rest.ends_with(b")") {
        return Some(f64::NAN);
    }
    let name = rest.strip_prefix(b"1.#")?;
    if name.starts_with(b"INF") {
        return Some(sign * f64::INFINITY);
    }
    [b"IND".as_slice(), b"QNAN", b"SNAN"].iter().any(|nan| name.starts_with(nan)).then_some(f64::NAN)
}

/// Whether an f64 is halfway between two neighbours among the f32 numbers from 2^-126 on.
#[inline(always)]
fn is_halfway(value: f64) -> bool {
    // f64 has 29 bits more.
    value.to_bits() & 0x1FFF_FFFF == 0x1000_0000
}

/// `value`, the f64 nearest to `token`, moved off the middle between two f32 numbers if the text is not there.
fn beside_halfway(value: f64, token: &[u8]) -> f64 {
    let is_subnormal = value.abs() < f64::from(f32::MIN_POSITIVE) && value != 0.0;
    if !is_halfway(value) && !is_subnormal {
        return value;
    }
    match fast_float2::parse::<f32, _>(token) {
        Ok(nearest) if f64::from(nearest) > f64::from(value as f32) => value.next_up(),
        Ok(nearest) if f64::from(nearest) < f64::from(value as f32) => value.next_down(),
        _ => value,
    }
}

/// Up to eight decimal digits at `at`: their value and their count. Eight bytes must follow `at`.
#[inline(always)]
pub(super) fn digits(data: &[u8], at: usize) -> Option<(u32, usize)> {
    let bytes = data.get(at..)?.first_chunk::<8>()?;
    // Digits become 0 to 9; all other bytes become 10 or more.
    let values = u64::from_le_bytes(*bytes) ^ 0x3030_3030_3030_3030;
    // A carry out of a byte that is no digit spoils only later ones.
    let others = (values.wrapping_add(0x7676_7676_7676_7676) | values) & 0x8080_8080_8080_8080;
    let count = (others.trailing_zeros() / 8) as usize;
    // Bring the last digit to the top, with zeros before the first. Two shifts, since one by 64 would do nothing.
    let half = 4 * (8 - count as u32);
    Some((join((values << half) << half), count))
}

/// The number of eight digits, the first in the lowest byte.
#[inline(always)]
fn join(digits: u64) -> u32 {
    // Pairs, then fours, then eight.
    let pairs = digits.wrapping_mul(10).wrapping_add(digits >> 8);
    let low = (pairs & 0x0000_00FF_0000_00FF).wrapping_mul(0x000F_4240_0000_0064);
    let high = ((pairs >> 16) & 0x0000_00FF_0000_00FF).wrapping_mul(0x0000_2710_0000_0001);
    (low.wrapping_add(high) >> 32) as u32
}

/// The number of the first `count` of these bytes, 1 to 8, which are digits.
#[inline(always)]
pub(super) fn value(bytes: &[u8; 8], count: u32) -> u32 {
    let values = u64::from_le_bytes(*bytes) ^ 0x3030_3030_3030_3030;
    join(values << ((8 * (8 - count)) & 63))
}

/// Reads the number at `at` and gives the place after it, which is a blank, a tab or a line end, and before that whether it is
/// certain that f32 keeps all its digits; [`super::decimal`] has the last word. At least eight bytes that end any number must
/// follow the valid ones.
#[inline(always)]
pub(super) fn scan(data: &[u8], at: usize) -> Option<(f64, bool, usize)> {
    let negative = *data.get(at)? == b'-';
    let first = at + usize::from(negative);
    let Some(bytes) = data.get(first..).and_then(|rest| rest.first_chunk::<16>()) else {
        return scan_long(data, at);
    };
    // All of a number of at most seven digits before the point and eight behind it, and what ends it, is in these.
    let others = other_than_digits(bytes) | 1 << 16;
    let whole_count = others.trailing_zeros();
    if whole_count > 7 {
        return scan_long(data, at);
    }
    let (mut mantissa, mut fraction_count, mut length) = (0, 0, whole_count);
    if whole_count == 1 {
        // As in most models.
        mantissa = u64::from(bytes[0] - b'0');
    } else if whole_count > 0 {
        mantissa = u64::from(value(bytes.first_chunk()?, whole_count));
    }
    if bytes[whole_count as usize] == b'.' {
        fraction_count = (others >> (whole_count + 1)).trailing_zeros();
        if fraction_count > 8 {
            return scan_long(data, at);
        }
        length += 1 + fraction_count;
        if fraction_count > 0 {
            let fraction = bytes[whole_count as usize + 1..].first_chunk()?;
            mantissa =
                mantissa * SHIFTS[fraction_count as usize] + u64::from(value(fraction, fraction_count));
        }
    }
    if length > 15 {
        return scan_long(data, at);
    }
    let end = first + length as usize;
    let ends = matches!(bytes[length as usize], b' ' | b'\n' | b'\r' | b'\t');
    if !ends || whole_count + fraction_count == 0 {
        return scan_any(data, at);
    }
    finish(data, at, negative, mantissa, fraction_count as usize, end)
}

/// The number `mantissa / 10^fraction_count`, which stands from `start` to `end` and whose mantissa is at most 2^53.
#[inline(always)]
fn finish(
    data: &[u8],
    start: usize,
    negative: bool,
    mantissa: u64,
    fraction_count: usize,
    end: usize,
) -> Option<(f64, bool, usize)> {
    let value = mantissa as i64 as f64 / EXACT_POWERS[fraction_count];
    if is_halfway(value) {
        return scan_any(data, start);
    }
    // The value is off by at most 2^-53 of it, and it is at least a unit unless it is zero: 2^-52 of it covers that and the
    // roundings here. It is below 2^-126 only if it is zero.
    let move_max = (value - f64::from(value as f32)).abs() + value * f64::EPSILON;
    let is_kept = move_max <= HALF_UNITS[fraction_count];
    Some((if negative { -value } else { value }, is_kept, end))
}

/// [`scan`] for numbers of more digits, and at the end of the data.
fn scan_long(data: &[u8], at: usize) -> Option<(f64, bool, usize)> {
    let start = at;
    let negative = *data.get(at)? == b'-';
    let mut at = at + usize::from(negative);
    let first = at;
    let (value, count) = digits(data, at)?;
    let mut mantissa = u64::from(value);
    at += count;
    if count == 8 {
        let (value, count) = digits(data, at)?;
        mantissa = mantissa * SHIFTS[count] + u64::from(value);
        at += count;
    }
    let mut digit_count = at - first;
    let mut fraction_count = 0;
    if *data.get(at)? == b'.' {
        at += 1;
        let (value, count) = digits(data, at)?;
        mantissa = mantissa.wrapping_mul(SHIFTS[count]).wrapping_add(u64::from(value));
        fraction_count = count;
        at += count;
        if count == 8 {
            let (value, count) = digits(data, at)?;
            mantissa = mantissa.wrapping_mul(SHIFTS[count]).wrapping_add(u64::from(value));
            fraction_count += count;
            at += count;
        }
        digit_count += fraction_count;
    }
    // With more than 19 digits the mantissa may have wrapped; an exponent, or a 17th digit on either side, stops the
    // scan at a byte that is no blank.
    let ends = matches!(data.get(at)?, b' ' | b'\n' | b'\r' | b'\t');
    if ends && digit_count > 0 && digit_count <= 19 && mantissa <= 1 << 53 {
        return finish(data, start, negative, mantissa, fraction_count, at);
    }
    scan_any(data, start)
}

/// The numbers that [`scan`] does not take itself.
#[cold]
fn scan_any(data: &[u8], start: usize) -> Option<(f64, bool, usize)> {
    let length = data[start..].iter().position(|byte| matches!(byte, b' ' | b'\n' | b'\r' | b'\t'))?;
    Some((parse(&data[start..start + length])?, false, start + length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::random::Random;

    #[test]
    fn short_numbers_are_read_as_long_ones_are() {
        let mut random = Random::new(8);
        for _ in 0..20_000 {
            let mut text = Vec::new();
            let mut digits = |text: &mut Vec<u8>, below: u64| {
                let count = random.next_u64() % below;
                text.extend((0..count).map(|_| b'0' + (random.next_u64() % 10) as u8));
                random.next_u64()
            };
            let chance = digits(&mut text, 10);
            if chance.is_multiple_of(3) {
                text.insert(0, b'-');
            }
            if !chance.is_multiple_of(8) {
                text.push(b'.');
                let chance = digits(&mut text, 11);
                if chance.is_multiple_of(10) {
                    text.push(b"e,x"[chance as usize / 10 % 3]);
                }
            }
            text.push(b" \n\r\t"[chance as usize / 8 % 4]);
            text.extend([b'\n'; 32]);
            let bits = |number: Option<(f64, bool, usize)>| {
                number.map(|(x, is_kept, at)| (x.to_bits(), is_kept, at))
            };
            assert_eq!(
                bits(scan(&text, 0)),
                bits(scan_long(&text, 0)),
                "{:?}",
                String::from_utf8_lossy(&text)
            );
        }
    }
}
