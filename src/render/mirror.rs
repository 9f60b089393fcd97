//! Reflection by smooth mirrors.

use glam::DVec3;

/// The mirror direction: `direction` (unit) off a surface with unit `normal` on either side.
pub(crate) fn reflect(direction: DVec3, normal: DVec3) -> DVec3 {
    (direction - normal * (2.0 * direction.dot(normal))).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reflection_keeps_the_angle() {
        let (sin, cos) = libm::sincos(35_f64.to_radians());
        let incoming = DVec3::new(sin, 0.0, -cos);
        let out = reflect(incoming, DVec3::Z);
        assert!((out - incoming * DVec3::new(1.0, 1.0, -1.0)).length() < 1e-15);
        assert_eq!(out, reflect(incoming, DVec3::NEG_Z));
    }
}
