//! Whole parts of numbers that a grid has few of: a cast that need not saturate, since the number was moved into range before.

/// The whole part of `x`, but at least 0 and at most `most`; 0 for NaN. What `(x as u32).min(most)` is, at half the instructions.
#[inline(always)]
pub fn whole_f64(x: f64, most: u8) -> u32 {
    let most = f64::from(most);
    // In this form, NaN becomes 0, and each line is one instruction.
    let x = if x > 0.0 { x } else { 0.0 };
    let x = if x < most { x } else { most };
    // SAFETY: not NaN, and from 0 to 255 by the two lines above.
    let whole: i32 = unsafe { x.to_int_unchecked() };
    whole as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_cast_that_saturates() {
        let limits = [0_u8, 1, 63, 127, 255];
        let near = |x: f64| [x, x.next_up(), x.next_down(), -x, x + 0.5];
        let mut numbers =
            vec![f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, 5e-324, -5e-324, -0.0];
        numbers.extend((0..300).flat_map(|whole| near(f64::from(whole))));
        for (x, most) in numbers.iter().flat_map(|x| limits.map(|most| (*x, most))) {
            assert_eq!(whole_f64(x, most), (x as u32).min(most.into()), "{x} {most}");
        }
    }
}
