//! Bytes to linear numbers and back.

use super::Encoding;

/// The number that each byte stands for, and the way back.
pub(super) struct Table {
    linear: [f32; 256],
    /// `steps[k]` is the least number that is stored as `k + 1`.
    steps: [f32; 255],
}

impl Table {
    pub(super) fn new(encoding: Encoding) -> Table {
        let linear = |byte: f64| match encoding {
            Encoding::Linear => byte / 255.0,
            Encoding::Srgb if byte / 255.0 <= 0.04045 => byte / 255.0 / 12.92,
            Encoding::Srgb => libm::pow((byte / 255.0 + 0.055) / 1.055, 2.4),
        };
        Table {
            linear: std::array::from_fn(|byte| linear(byte as f64) as f32),
            steps: std::array::from_fn(|byte| linear(byte as f64 + 0.5) as f32),
        }
    }

    pub(super) fn decode(&self, byte: u8) -> f32 {
        self.linear[usize::from(byte)]
    }

    pub(super) fn encode(&self, number: f32) -> u8 {
        self.steps.partition_point(|step| *step <= number) as u8
    }
}
