//! Bytes to linear numbers and back.

use super::Encoding;

/// The number that each byte stands for, and the way back.
pub(super) struct Table {
    linear: [f32; 256],
    /// `steps[k]` is the least number that is stored as `k + 1`.
    steps: [f32; 255],
}

/// The number that a byte stands for, or what is between two bytes.
pub(super) fn linear(encoding: Encoding, byte: f64) -> f32 {
    let number = match encoding {
        Encoding::Linear => byte / 255.0,
        Encoding::Srgb if byte / 255.0 <= 0.04045 => byte / 255.0 / 12.92,
        Encoding::Srgb => libm::pow((byte / 255.0 + 0.055) / 1.055, 2.4),
    };
    number as f32
}

impl Table {
    pub(super) fn new(encoding: Encoding) -> Table {
        Table {
            linear: std::array::from_fn(|byte| linear(encoding, byte as f64)),
            steps: std::array::from_fn(|byte| linear(encoding, byte as f64 + 0.5)),
        }
    }

    pub(super) fn decode(&self, byte: u8) -> f32 {
        self.linear[usize::from(byte)]
    }

    pub(super) fn encode(&self, number: f32) -> u8 {
        self.steps.partition_point(|step| *step <= number) as u8
    }
}
