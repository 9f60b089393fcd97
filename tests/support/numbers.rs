//! Seeded random numbers and a few operations on points, shared by tests and benchmarks.
#![allow(dead_code)]

/// SplitMix64: a test names its seed, so that a failure can be repeated.
pub struct Random(pub u64);

/// SplitMix64's finaliser.
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
}

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    pub fn below(&mut self, count: u64) -> u64 {
        self.bits() % count
    }

    pub fn index(&mut self, count: usize) -> usize {
        self.below(count as u64) as usize
    }

    pub fn pick<T: Copy>(&mut self, from: &[T]) -> T {
        from[self.index(from.len())]
    }

    /// Between 0 and 1.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Between -1 and 1.
    pub fn signed(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    pub fn vector(&mut self, size: f64) -> [f64; 3] {
        [(); 3].map(|()| size * self.signed())
    }

    /// Turns one bit over.
    pub fn flip(&mut self, bytes: &mut [u8]) {
        let bit = self.index(8 * bytes.len());
        bytes[bit / 8] ^= 1 << (bit % 8);
    }

    pub fn integers(&mut self, most: i64) -> [f64; 3] {
        [(); 3].map(|()| (self.below(2 * most as u64 + 1) as i64 - most) as f64)
    }

    /// Any mantissa, exponent in `low .. high`, now and then 0.
    pub fn wild(&mut self, low: i32, high: i32) -> f64 {
        let exponent = low + self.below((high - low) as u64) as i32;
        let bits = self.bits() & !(0x7ff << 52) | ((exponent + 1023) as u64) << 52;
        // Short mantissas make products that cancel exactly.
        let bits = if self.below(2) == 0 { bits & !0 << 48 } else { bits };
        if self.below(8) == 0 { 0.0 } else { f64::from_bits(bits) }
    }

    pub fn wilds(&mut self, low: i32, high: i32) -> [f64; 3] {
        [(); 3].map(|()| self.wild(low, high))
    }
}

pub fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub fn along(a: [f64; 3], t: f64, d: [f64; 3]) -> [f64; 3] {
    [a[0] + t * d[0], a[1] + t * d[1], a[2] + t * d[2]]
}

pub fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

pub fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = dot(a, a).sqrt();
    a.map(|x| x / length)
}
