//! Transmission through clear media that bend light: Snell's law and Fresnel's equations. Square roots only, so the same on every
//! machine (I2).

use glam::DVec3;

use super::stage::Shader;
use super::ways::{Course, Ways};

/// What a smooth border between two clear media does to a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Split {
    /// Share of the light that is reflected; 1 for total internal reflection. The rest is refracted.
    pub reflectance: f64,
    /// Unit direction of the refracted ray; none for total internal reflection.
    pub refracted: Option<DVec3>,
}

/// Snell's law and Fresnel's equations for unpolarised light. `normal` is unit and faces the ray; `eta` is the
/// refractive index on the ray's side over that on the other.
///
/// The radiance of refracted light is not scaled by `1 / eta^2`: cameras and lamps are outside of all glass, where the
/// factors of entering and leaving cancel.
pub(crate) fn split(direction: DVec3, normal: DVec3, eta: f64) -> Split {
    let cos_in = (-direction.dot(normal)).clamp(0.0, 1.0);
    // 1 - cos^2 as a product keeps its digits near the normal.
    let sin_out_squared = eta * eta * (1.0 - cos_in) * (1.0 + cos_in);
    if sin_out_squared >= 1.0 {
        return Split { reflectance: 1.0, refracted: None };
    }
    let cos_out = (1.0 - sin_out_squared).sqrt();
    let perpendicular = (eta * cos_in - cos_out) / (eta * cos_in + cos_out);
    let parallel = (cos_in - eta * cos_out) / (cos_in + eta * cos_out);
    let reflectance = 0.5 * (perpendicular * perpendicular + parallel * parallel);
    let refracted = (direction * eta + normal * (eta * cos_in - cos_out)).normalize();
    Split { reflectance, refracted: Some(refracted) }
}

impl Ways {
    /// A ray along `direction` meets a border with this `facet` for its normal, and this `eta`: what goes through is bent, and a
    /// part of it mirrored.
    pub fn refract(&mut self, shader: &Shader, direction: DVec3, facet: DVec3, eta: f64) {
        let fresnel = split(direction, facet, eta);
        self.reflection.weight += DVec3::splat(shader.transmission * fresnel.reflectance);
        let through = &mut self.transmission;
        through.weight = DVec3::splat(shader.transmission * (1.0 - fresnel.reflectance));
        through.direction = fresnel.refracted;
        through.course = Course::Lawful;
        if fresnel.refracted.is_none() {
            through.weight = DVec3::ZERO;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ray in the XZ plane that meets the plane z = 0 from above at this angle.
    fn incoming(degrees: f64) -> DVec3 {
        let angle = degrees.to_radians();
        DVec3::new(libm::sin(angle), 0.0, -libm::cos(angle))
    }

    #[test]
    fn fresnel_values_of_glass() {
        // Normal incidence: ((n - 1) / (n + 1))^2, from both sides.
        for eta in [1.0 / 1.5, 1.5] {
            let split = split(incoming(0.0), DVec3::Z, eta);
            assert!((split.reflectance - 0.04).abs() < 1e-15);
            assert!((split.refracted.unwrap() - DVec3::NEG_Z).length() < 1e-15);
        }
        // 60 degrees into n = 1.5: textbook 0.0892; grazing: everything is reflected.
        assert!((split(incoming(60.0), DVec3::Z, 1.0 / 1.5).reflectance - 0.0892).abs() < 5e-5);
        assert!((split(incoming(90.0), DVec3::Z, 1.0 / 1.5).reflectance - 1.0).abs() < 1e-12);
        // Brewster's angle: no parallel part, so half of the perpendicular one.
        let brewster = libm::atan(1.5).to_degrees();
        let at = split(incoming(brewster), DVec3::Z, 1.0 / 1.5);
        let perpendicular = libm::pow(libm::cos(2.0 * brewster.to_radians()), 2.0);
        assert!((at.reflectance - 0.5 * perpendicular).abs() < 1e-14);
    }

    #[test]
    fn snell_and_the_critical_angle() {
        let at = split(incoming(30.0), DVec3::Z, 1.0 / 1.5).refracted.unwrap();
        assert!((at.x - 0.5 / 1.5).abs() < 1e-15 && at.z < 0.0 && (at.length() - 1.0).abs() < 1e-15);
        let critical = libm::asin(1.0 / 1.5).to_degrees();
        assert!(split(incoming(critical - 1e-7), DVec3::Z, 1.5).refracted.is_some());
        assert_eq!(
            split(incoming(critical + 1e-7), DVec3::Z, 1.5),
            Split { reflectance: 1.0, refracted: None }
        );
    }

    #[test]
    fn reflectance_stays_within_bounds_and_is_reciprocal() {
        for n in [1.0 + 1e-9, 1.1, 1.5, 2.4, 4.0] {
            // At 90 degrees itself nothing comes in that could be reversed.
            for step in 0..900 {
                let direction = incoming(f64::from(step) / 10.0);
                let inward = split(direction, DVec3::Z, 1.0 / n);
                assert!((0.0..=1.0).contains(&inward.reflectance));
                let refracted = inward.refracted.unwrap();
                // Back along the refracted ray from inside: the same share is reflected.
                let back = split(DVec3::new(-refracted.x, 0.0, refracted.z), DVec3::Z, n);
                assert!((back.reflectance - inward.reflectance).abs() < 1e-6, "n {n} step {step}");
            }
        }
    }
}
