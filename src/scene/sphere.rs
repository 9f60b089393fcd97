//! From the unit square to discs, hemispheres, cones and the sphere, without distorting areas; orthonormal frames.
//!
//! Sines and cosines are `libm`'s, so the same on every machine (I2).

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, TAU};

use glam::DVec3;

/// The unit vector along a vector of any length; `None` if it is zero or not finite.
pub(super) fn unit(v: DVec3) -> Option<DVec3> {
    let largest = v.abs().max_element();
    if !v.is_finite() || largest == 0.0 {
        return None;
    }
    // Of other lengths squares lose digits, vanish or overflow. Powers of two leave the vector what it is.
    match (1e-100..=1e100).contains(&largest) {
        true => v.try_normalize(),
        false => unit(v * libm::exp2(if largest < 1.0 { 500.0 } else { -600.0 })),
    }
}

/// A point of the unit disc, evenly spread: the concentric map (P. Shirley and K. Chiu, "A Low Distortion Map Between Disk
/// and Square", 1997). The middle of the square is the middle of the disc, to the bit.
pub(crate) fn disc_point([u, v]: [f64; 2]) -> [f64; 2] {
    let (a, b) = (2.0 * u - 1.0, 2.0 * v - 1.0);
    if a == 0.0 && b == 0.0 {
        return [0.0; 2];
    }
    let (radius, angle) =
        if a.abs() > b.abs() { (a, FRAC_PI_4 * (b / a)) } else { (b, FRAC_PI_2 - FRAC_PI_4 * (a / b)) };
    let (sin, cos) = libm::sincos(angle);
    [radius * cos, radius * sin]
}

/// A unit vector with z at least 0 whose density over solid angle is z / pi (Malley's method).
pub(crate) fn cosine_direction(point: [f64; 2]) -> DVec3 {
    let [x, y] = disc_point(point);
    DVec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// A unit vector at most `1 - one_minus_cos` in cosine from +z, evenly spread over the cone's solid angle,
/// `2 pi one_minus_cos`.
pub(crate) fn cone_direction([u, v]: [f64; 2], one_minus_cos: f64) -> DVec3 {
    let drop = u * one_minus_cos;
    // 1 - cos^2 as a product keeps its digits in thin cones.
    let sin = (drop * (2.0 - drop)).max(0.0).sqrt();
    let (y, x) = libm::sincos(TAU * v);
    DVec3::new(sin * x, sin * y, 1.0 - drop)
}

/// Two unit vectors at right angles to the unit vector `z` and to each other, `x` first: `x`, `y`, `z` are right-handed
/// (T. Duff et al., "Building an Orthonormal Basis, Revisited", JCGT 2017).
pub(crate) fn frame_around(z: DVec3) -> [DVec3; 2] {
    let sign = 1f64.copysign(z.z);
    let a = -1.0 / (sign + z.z);
    let b = z.x * z.y * a;
    [DVec3::new(1.0 + sign * z.x * z.x * a, sign * b, -sign * z.x), DVec3::new(b, sign + z.y * z.y * a, -z.y)]
}

/// The vector `local` of a frame around `z`.
pub(crate) fn to_frame(z: DVec3, local: DVec3) -> DVec3 {
    let [x, y] = frame_around(z);
    (x * local.x + y * local.y + z * local.z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_orthonormal() {
        for z in [DVec3::Z, DVec3::NEG_Z, DVec3::X, DVec3::new(0.6, -0.48, -0.64), DVec3::new(0.1, 0.2, 0.97)]
        {
            let z = z.normalize();
            let [x, y] = frame_around(z);
            for (a, b, dot) in [(x, y, 0.0), (x, z, 0.0), (y, z, 0.0), (x, x, 1.0), (y, y, 1.0)] {
                assert!((a.dot(b) - dot).abs() < 1e-14, "{z}");
            }
            assert!(x.cross(y).dot(z) > 0.99);
        }
    }

    #[test]
    fn means_are_those_of_the_densities() {
        const SIDE: u32 = 256;
        let mut sums = [0.0; 4];
        for index in 0..SIDE * SIDE {
            let point = [index % SIDE, index / SIDE].map(|i| (f64::from(i) + 0.5) / f64::from(SIDE));
            let [x, y] = disc_point(point);
            let (cosine, cone) = (cosine_direction(point), cone_direction(point, 0.25));
            assert!((cosine.length() - 1.0).abs() < 1e-12 && (cone.length() - 1.0).abs() < 1e-12);
            assert!(cone.z >= 0.75 - 1e-12);
            sums[0] += x * x + y * y;
            sums[1] += cosine.z;
            sums[2] += cone.z;
            sums[3] += cone.x;
        }
        let count = f64::from(SIDE * SIDE);
        // Mean of r^2 over a disc 1/2; of z under z/pi 2/3; of z over the cone the middle of its range.
        for (sum, mean) in sums.into_iter().zip([0.5, 2.0 / 3.0, 0.875, 0.0]) {
            assert!((sum / count - mean).abs() < 2e-4, "{} {mean}", sum / count);
        }
    }
}
