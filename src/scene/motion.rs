//! Motion blur of the camera: where it is while the shutter is open.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::RenderError;

/// Where a camera is when its shutter closes. Where it is when the shutter opens is the camera itself.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Pose {
    eye: DVec3,
    frame: [DVec3; 3],
}

impl Pose {
    /// A pose that the frame `from` can turn into.
    pub fn new(from: [DVec3; 3], eye: DVec3, frame: [DVec3; 3]) -> Result<Pose, RenderError> {
        // Below a right angle no interpolated vector can vanish, nor up fall onto forward.
        if from.iter().zip(&frame).any(|(a, b)| a.dot(*b) <= 0.0) {
            let reason = "an axis of the camera turns by a right angle or more while the shutter is open; \
                          cut the motion into shorter ones";
            return Err(RenderError::Setting { what: "motion", reason: reason.to_string() });
        }
        Ok(Pose { eye, frame })
    }

    /// Whether anything moves at all.
    pub fn differs_from(&self, eye: DVec3, frame: [DVec3; 3]) -> bool {
        self.eye != eye || self.frame != frame
    }

    /// Eye and frame at `time` in 0 ..= 1, for a motion that begins at `eye` and `frame`. Square roots only, so the same on
    /// every machine (I2).
    pub fn at(&self, eye: DVec3, frame: [DVec3; 3], time: f64) -> (DVec3, [DVec3; 3]) {
        let between = |a: DVec3, b: DVec3| a + (b - a) * time;
        let forward = between(frame[2], self.frame[2]).normalize();
        let right = forward.cross(between(frame[1], self.frame[1])).normalize();
        (between(eye, self.eye), [right, right.cross(forward), forward])
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::Camera;

    fn camera(eye: [f64; 3], look_at: [f64; 3]) -> Camera {
        Camera::pinhole(eye, look_at, [0.0, 1.0, 0.0], 50.0).unwrap()
    }

    #[test]
    fn the_shutter_opens_at_one_camera_and_closes_at_the_other() {
        let (start, end) = (camera([0.0, 0.0, 5.0], [0.0; 3]), camera([1.0, 0.5, 4.0], [0.3, 0.0, 0.0]));
        let view = start.moving_to(&end).unwrap().view(40, 30);
        assert!(view.is_moving());
        for (time, fixed) in [(0.0, start), (1.0, end)] {
            let (moving, fixed) =
                (view.sampled_ray(3.0, 7.0, [0.5; 2], time), fixed.view(40, 30).ray(3.0, 7.0));
            for axis in 0..3 {
                assert!((moving.origin[axis] - fixed.origin[axis]).abs() < 1e-15);
                assert!((moving.direction[axis] - fixed.direction[axis]).abs() < 1e-15);
            }
        }
        let half = view.sampled_ray(20.0, 15.0, [0.5; 2], 0.5);
        assert_eq!(half.origin, [0.5, 0.25, 4.5]);
    }

    #[test]
    fn a_camera_that_stays_is_not_moving_and_one_that_turns_round_is_refused() {
        let start = camera([0.0, 0.0, 5.0], [0.0; 3]);
        let view = start.moving_to(&start).unwrap().view(40, 30);
        assert!(!view.is_moving());
        assert_eq!(view.sampled_ray(3.0, 4.0, [0.1; 2], 0.7), view.ray(3.0, 4.0));
        assert!(start.moving_to(&camera([0.0, 0.0, -5.0], [0.0; 3])).is_err());
    }
}
