//! Whether f32 keeps every digit of a decimal: whether the f32 nearest to it, written with as many digits, is that text again.
//!
//! That is so if it lies within half a unit of the last digit that is written (at exactly half a unit a writer may round to the
//! text or to its neighbour; that counts as kept). Digits that a writer of f32 numbers puts down pass, be they the shortest, a
//! fixed number of places or more than f32 has. The answer is exact: integers decide it, not rounded numbers.

/// Most digits that surely fit 64 bits.
const SHORT_DIGITS_MAX: usize = 19;
/// Most places after the point for which a 24-bit significand times a power of five fits 127 bits.
const SHORT_PLACES_MAX: i64 = 44;
/// Places after the point that hold any f32: it is a multiple of 2^-149.
const FLOAT32_PLACES: usize = 149;

/// Whether f32 keeps every digit of `token`, which [`number::parse`](super::number::parse) reads as `value`. Infinities and NaN in
/// words are kept.
pub(super) fn is_kept_by_float32(token: &[u8], value: f64) -> bool {
    // The f32 nearest to the value is also the nearest to the text: `number` sees to that.
    Decimal::of(token).is_none_or(|decimal| decimal.is_kept_by((value as f32).abs()))
}

/// A decimal without its sign.
struct Decimal<'a> {
    before_point: &'a [u8],
    behind_point: &'a [u8],
    /// The last digit counts powers of ten of this exponent.
    last_exponent: i64,
}

impl<'a> Decimal<'a> {
    /// The parts of a token that is a number; `None` if it is one in words.
    fn of(token: &'a [u8]) -> Option<Decimal<'a>> {
        let (digits, exponent) = match token.iter().position(|byte| matches!(byte, b'e' | b'E')) {
            Some(at) => (&token[..at], integer(&token[at + 1..])?),
            None => (token, 0),
        };
        let digits = match digits {
            [b'+' | b'-', digits @ ..] => digits,
            digits => digits,
        };
        let point = digits.iter().position(|byte| *byte == b'.');
        let before_point = &digits[..point.unwrap_or(digits.len())];
        let behind_point = point.map_or(&[][..], |point| &digits[point + 1..]);
        let last_exponent = exponent - behind_point.len() as i64;
        let decimal = Decimal { before_point, behind_point, last_exponent };
        let is_number = decimal.digits().all(|digit| digit <= 9);
        is_number.then_some(decimal)
    }

    /// The digits without zeros before the first other one.
    fn digits(&self) -> impl Iterator<Item = u8> + Clone {
        let digits = self.before_point.iter().chain(self.behind_point);
        digits.map(|byte| byte.wrapping_sub(b'0')).skip_while(|digit| *digit == 0)
    }

    /// Whether it is within half a unit of its last digit of `nearest`, the f32 nearest to it.
    fn is_kept_by(&self, nearest: f32) -> bool {
        let mut digits = self.digits();
        if self.before_point.len() + self.behind_point.len() > SHORT_DIGITS_MAX
            && digits.clone().nth(SHORT_DIGITS_MAX).is_some()
        {
            return nearest > 0.0 && nearest.is_finite() && self.is_kept_in_full(nearest);
        }
        let mantissa = digits.by_ref().fold(0_u64, |mantissa, digit| mantissa * 10 + u64::from(digit));
        if mantissa == 0 {
            return true;
        }
        if nearest == 0.0 || !nearest.is_finite() {
            return false;
        }
        match self.last_exponent {
            1.. => whole_is_kept(mantissa, self.last_exponent, nearest),
            places if places < -SHORT_PLACES_MAX => self.is_kept_in_full(nearest),
            places => short_is_kept(mantissa, places.unsigned_abs() as u32, nearest),
        }
    }

    /// [`Decimal::is_kept_by`] for any number of digits, if `nearest` is finite and above zero.
    fn is_kept_in_full(&self, nearest: f32) -> bool {
        // All in units of 10^-scale, in which half a unit of the last digit is a whole number. A token has at most 4096 characters and
        // is near `nearest`, so that `scale` is below 5000.
        let scale = (FLOAT32_PLACES as i64).max(1 - self.last_exponent);
        let zeros = (scale + self.last_exponent) as usize;
        let mut ours: Vec<u8> = self.digits().collect();
        ours.resize(ours.len() + zeros, 0);
        let places = scale as usize;
        let text = format!("{nearest:.places$}");
        let theirs: Vec<u8> = text.bytes().filter(|byte| *byte != b'.').map(|byte| byte - b'0').collect();
        // `zeros` is at least 1; half a unit is a 5 and the other zeros.
        let difference = difference(&ours, &theirs);
        match difference.len().cmp(&zeros) {
            std::cmp::Ordering::Less => true,
            std::cmp::Ordering::Equal => {
                difference[0] < 5 || difference[0] == 5 && difference[1..].iter().all(|digit| *digit == 0)
            }
            std::cmp::Ordering::Greater => false,
        }
    }
}

/// The distance of two decimal integers, without leading zeros.
fn difference(a: &[u8], b: &[u8]) -> Vec<u8> {
    let length = a.len().max(b.len());
    let padded = |digits: &[u8]| [&vec![0; length - digits.len()], digits].concat();
    let (a, b) = (padded(a), padded(b));
    let (mut more, less) = if a >= b { (a, b) } else { (b, a) };
    let mut borrow = 0;
    for (digit, other) in more.iter_mut().zip(&less).rev() {
        let taken = other + borrow;
        borrow = u8::from(*digit < taken);
        *digit = *digit + 10 * borrow - taken;
    }
    let zeros = more.iter().take_while(|digit| **digit == 0).count();
    more.split_off(zeros)
}

/// Whether `|mantissa - nearest * 10^places| <= 1/2`, for at most [`SHORT_PLACES_MAX`] places.
fn short_is_kept(mantissa: u64, places: u32, nearest: f32) -> bool {
    // nearest = significand * 2^exponent; times 10^places is scaled * 2^shift.
    let bits = nearest.to_bits();
    let (fraction, biased) = (bits & 0x007F_FFFF, bits >> 23);
    let (significand, exponent) =
        if biased == 0 { (fraction, -149) } else { (fraction | 0x0080_0000, biased as i32 - 150) };
    let scaled = u128::from(significand) * 5_u128.pow(places);
    let shift = exponent + places as i32;
    let mantissa = u128::from(mantissa);
    if shift >= 0 {
        // Both are whole. `nearest` is near the mantissa, so bits that are shifted out are an answer too.
        return scaled.leading_zeros() >= shift as u32 && scaled << shift == mantissa;
    }
    let shift = shift.unsigned_abs();
    // A mantissa that does not fit is more than twice `scaled`, which has at most 127 bits.
    mantissa.leading_zeros() >= shift && (mantissa << shift).abs_diff(scaled) <= 1 << (shift - 1)
}

/// Whether `|mantissa * 10^exponent - nearest| <= 10^exponent / 2`, for an exponent above 0.
fn whole_is_kept(mantissa: u64, exponent: i64, nearest: f32) -> bool {
    let unit = u32::try_from(exponent).ok().and_then(|exponent| 10_u128.checked_pow(exponent));
    let Some((unit, number)) = unit.and_then(|unit| Some((unit, unit.checked_mul(mantissa.into())?))) else {
        return false;
    };
    // The f32 nearest to a whole number is whole.
    let distance = number.abs_diff(nearest as u128);
    distance <= unit / 2
}

/// A decimal integer with a sign; those beyond any f32 are all the same.
fn integer(text: &[u8]) -> Option<i64> {
    let (negative, digits) = match text {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    let mut value = 0_i64;
    for byte in digits {
        let digit = byte.wrapping_sub(b'0');
        if digit > 9 {
            return None;
        }
        value = (value * 10 + i64::from(digit)).min(1_000_000);
    }
    Some(if negative { -value } else { value })
}
