//! Unit vectors in 32 bits: the octahedron's surface unfolded to a square, 16 bits each way.

/// The 32 bits of the direction of `normal`; `None` if it has none (zero, not finite). The direction that they give back is less than
/// 0.005 degrees away.
pub fn normal_bits(normal: [f32; 3]) -> Option<u32> {
    let [x, y, z] = normal.map(f64::from);
    let sum = x.abs() + y.abs() + z.abs();
    if !(sum > 0.0 && sum.is_finite()) {
        return None;
    }
    let (mut u, mut v) = (x / sum, y / sum);
    if z < 0.0 {
        (u, v) = ((1.0 - v.abs()) * 1f64.copysign(u), (1.0 - u.abs()) * 1f64.copysign(v));
    }
    // -1 ..= 1 to 0 ..= 65,534, so that 0 is exact: axes stay axes.
    let place = |w: f64| (w.clamp(-1.0, 1.0) * 32_767.0).round() as i32 + 32_767;
    Some(place(u) as u32 | (place(v) as u32) << 16)
}

/// The unit vector of 32 bits of [`normal_bits`]; any bits give one.
pub fn normal_of_bits(bits: u32) -> [f64; 3] {
    let place = |word: u32| (f64::from(word & 0xffff) - 32_767.0).min(32_767.0) / 32_767.0;
    let (u, v) = (place(bits), place(bits >> 16));
    let z = 1.0 - u.abs() - v.abs();
    let fold = (-z).max(0.0);
    let (x, y) = (u - fold.copysign(u), v - fold.copysign(v));
    // Never zero: |x| + |y| + |z| is 1 up to rounding.
    let length = (x * x + y * y + z * z).sqrt();
    [x / length, y / length, z / length]
}
