//! Depth of field: a thin lens.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::light::POSITION_MAX;
use super::sphere::disc_point;
use crate::error::RenderError;
use crate::geom::Ray;

/// A thin lens: all rays through a point of the image meet again in the plane of focus.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// Radius of the aperture in units of the model; at least 0, and 0 is a pinhole.
    pub radius: f64,
    /// Distance of the plane of focus from the eye, along the view; above 0.
    pub focus_distance: f64,
}

impl Lens {
    /// Says what is wrong with the lens, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is not finite, beyond 1e150, or out of its range.
    pub fn validate(&self) -> Result<(), RenderError> {
        let error = |reason: &str| Err(RenderError::Setting { what: "lens", reason: reason.to_string() });
        if !(self.radius >= 0.0 && self.radius <= POSITION_MAX) {
            return error("its radius must not be negative, nor beyond 1e150");
        }
        if !(self.focus_distance > 0.0 && self.focus_distance <= POSITION_MAX) {
            return error("its focus distance must be positive, and not beyond 1e150");
        }
        Ok(())
    }

    /// The ray that meets `ray`, one through the middle of the lens, in the plane of focus, and passes the lens at the point
    /// that belongs to `point` in the unit square.
    pub(super) fn bend(&self, ray: &Ray, [right, up, forward]: [DVec3; 3], point: [f64; 2]) -> Ray {
        let [x, y] = disc_point(point);
        let (eye, direction) = (DVec3::from_array(ray.origin), DVec3::from_array(ray.direction));
        let focus = eye + direction * (self.focus_distance / direction.dot(forward));
        let origin = eye + (right * x + up * y) * self.radius;
        Ray::new(origin.to_array(), (focus - origin).normalize().to_array())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Camera;

    #[test]
    fn rays_of_one_pixel_meet_in_the_plane_of_focus() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 60.0).unwrap();
        let lens = Lens { radius: 0.3, focus_distance: 4.0 };
        let view = camera.with_lens(lens).unwrap().view(64, 48);
        let straight = view.ray(10.5, 20.5);
        let focus = straight.at(4.0 / -straight.direction[2]);
        let mut widest: f64 = 0.0;
        for step in 0..64 {
            let point = [f64::from(step % 8) / 8.0, f64::from(step / 8) / 8.0];
            let ray = view.sampled_ray(10.5, 20.5, point, 0.0);
            let offset = [0, 1].map(|axis| ray.origin[axis]);
            assert_eq!(ray.origin[2], 5.0);
            widest = widest.max((offset[0] * offset[0] + offset[1] * offset[1]).sqrt());
            let met = ray.at(4.0 / -ray.direction[2]);
            assert!((0..3).all(|axis| (met[axis] - focus[axis]).abs() < 1e-12), "{met:?} {focus:?}");
        }
        assert!(widest > 0.25 && widest <= 0.3 + 1e-15, "{widest}");
        // The middle of the square is the middle of the lens.
        let middle = view.sampled_ray(10.5, 20.5, [0.5, 0.5], 0.0);
        assert_eq!(middle.origin, [0.0, 0.0, 5.0]);
    }

    #[test]
    fn senseless_lenses_are_refused_and_a_pinhole_is_one() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 60.0).unwrap();
        for (radius, focus_distance) in
            [(-1.0, 1.0), (f64::NAN, 1.0), (1e151, 1.0), (1.0, 0.0), (1.0, 1e151), (1.0, f64::INFINITY)]
        {
            assert!(camera.with_lens(Lens { radius, focus_distance }).is_err(), "{radius} {focus_distance}");
        }
        let flat = Camera::orthographic([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 2.0).unwrap();
        assert!(flat.with_lens(Lens { radius: 0.1, focus_distance: 1.0 }).is_err());
        let view = camera.with_lens(Lens { radius: 0.0, focus_distance: 1.0 }).unwrap().view(9, 9);
        assert!(!view.has_lens());
        assert_eq!(view.sampled_ray(1.0, 2.0, [0.9, 0.1], 0.5), view.ray(1.0, 2.0));
    }
}
