//! The sRGB transfer function (IEC 61966-2-1) from linear f32 to 8 bits.

/// Encodes by searching the linear values at which the 8-bit value changes: exact rounding, eight comparisons, and
/// no power function per pixel.
pub(super) struct Encoder {
    /// `steps[k]` is the least f32 that encodes as `k + 1`.
    steps: [f32; 255],
}

impl Encoder {
    pub(super) fn new() -> Encoder {
        let mut steps = [0.0; 255];
        for (k, step) in steps.iter_mut().enumerate() {
            *step = linear((k as f64 + 0.5) / 255.0) as f32;
        }
        Encoder { steps }
    }

    /// Below 0 and NaN give 0, above 1 gives 255.
    pub(super) fn encode(&self, linear: f32) -> u8 {
        self.steps.partition_point(|step| *step <= linear) as u8
    }
}

/// The linear value of an sRGB value in 0 ..= 1.
fn linear(encoded: f64) -> f64 {
    if encoded <= 0.04045 { encoded / 12.92 } else { libm::pow((encoded + 0.055) / 1.055, 2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn agrees_with_the_formula() {
        let encoder = Encoder::new();
        let formula =
            |x: f64| if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * libm::pow(x, 1.0 / 2.4) - 0.055 };
        for i in 0..=100_000 {
            let x = i as f32 / 100_000.0;
            let exact = 255.0 * formula(f64::from(x));
            // The standard's two branches and their inverses disagree in the eighth digit.
            assert!((f64::from(encoder.encode(x)) - exact).abs() < 0.5 + 1e-4, "{x}");
        }
        for (x, expected) in
            [(-1.0, 0), (f32::NAN, 0), (0.0, 0), (1.0, 255), (7.0, 255), (f32::INFINITY, 255), (0.5, 188)]
        {
            assert_eq!(encoder.encode(x), expected, "{x}");
        }
    }
}
