//! Pinhole and orthographic cameras; image position to ray as a pure function.
//!
//! A lens ([`super::lens`]) and a motion ([`super::motion`]) may be added; without them they cost a ray nothing.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::lens::Lens;
use super::motion::Pose;
use super::sphere::unit;
use crate::error::RenderError;
use crate::geom::{Aabb, Ray};

/// How the camera maps space to the image plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Projection {
    /// All rays leave the eye.
    Pinhole {
        /// Full vertical angle of view in degrees, above 0 and below 180.
        fov_degrees: f64,
    },
    /// All rays are parallel; they start on the plane through the eye.
    Orthographic {
        /// Height of the picture in units of the model.
        height: f64,
    },
}

/// A camera, valid by construction. Pixels are square.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    eye: DVec3,
    /// Orthonormal: right, up, forward.
    frame: [DVec3; 3],
    projection: Projection,
    lens: Option<Lens>,
    /// Where it is when the shutter closes, if it moves.
    end: Option<Pose>,
}

impl Camera {
    /// Angle of view of the automatic camera.
    const FRAMING_FOV_DEGREES: f64 = 40.0;
    /// How much farther the automatic camera stands than it must, so that the model does not touch the border.
    const FRAMING_MARGIN: f64 = 1.04;

    /// A camera at `eye` that looks at `look_at` with `up` upward in the picture.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is not finite, `look_at` is `eye`, `up` is zero or along the view, or
    /// the projection's number is out of its range.
    pub fn new(
        eye: [f64; 3],
        look_at: [f64; 3],
        up: [f64; 3],
        projection: Projection,
    ) -> Result<Camera, RenderError> {
        let error = |reason: &str| RenderError::Setting { what: "camera", reason: reason.to_string() };
        let [eye, look_at, up] = [eye, look_at, up].map(DVec3::from_array);
        if !(eye.is_finite() && look_at.is_finite() && up.is_finite()) {
            return Err(error("eye, look-at and up must be finite"));
        }
        let forward = unit(look_at - eye).ok_or_else(|| error("look-at is the eye itself"))?;
        let up = unit(up).ok_or_else(|| error("up is zero"))?;
        let side = forward.cross(up);
        // Below this the direction of `side` is mostly rounding error.
        if side.length_squared() < 1e-24 {
            return Err(error("up is along the line of view; choose another up"));
        }
        match projection {
            Projection::Pinhole { fov_degrees } if !(fov_degrees > 0.0 && fov_degrees < 180.0) => {
                return Err(error("the angle of view must lie between 0 and 180 degrees"));
            }
            Projection::Orthographic { height } if !(height > 0.0 && height < f64::INFINITY) => {
                return Err(error("the height of an orthographic picture must be positive"));
            }
            _ => {}
        }
        let right = side.normalize();
        let frame = [right, right.cross(forward), forward];
        Ok(Camera { eye, frame, projection, lens: None, end: None })
    }

    /// [`Camera::new`] with [`Projection::Pinhole`].
    ///
    /// # Errors
    /// As for [`Camera::new`].
    pub fn pinhole(
        eye: [f64; 3],
        look_at: [f64; 3],
        up: [f64; 3],
        fov_degrees: f64,
    ) -> Result<Camera, RenderError> {
        Camera::new(eye, look_at, up, Projection::Pinhole { fov_degrees })
    }

    /// [`Camera::new`] with [`Projection::Orthographic`].
    ///
    /// # Errors
    /// As for [`Camera::new`].
    pub fn orthographic(
        eye: [f64; 3],
        look_at: [f64; 3],
        up: [f64; 3],
        height: f64,
    ) -> Result<Camera, RenderError> {
        Camera::new(eye, look_at, up, Projection::Orthographic { height })
    }

    /// A three-quarter view that holds all of `bounds` in a picture of `aspect` = width / height.
    ///
    /// Up is +Y, as in most model files, unless the box is so flat in Z (terrain, plans) that +Z must be meant.
    /// An empty or single-point box is treated as one of unit size.
    pub fn framing(bounds: &Aabb, aspect: f64) -> Camera {
        let extent = bounds.extent();
        let z_up = extent[2] < 0.3 * extent[0].min(extent[1]);
        Camera::framing_with_up(bounds, if z_up { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }, aspect)
    }

    /// [`Camera::framing`] with a chosen `up` (zero or not finite counts as +Y).
    pub fn framing_with_up(bounds: &Aabb, up: [f64; 3], aspect: f64) -> Camera {
        let up = unit(DVec3::from_array(up)).unwrap_or(DVec3::Y);
        // The viewer stands at +Z of a model with +Y up and at -Y of one with +Z up, and a little to the right.
        let front = if up.y.abs() > 0.9 { DVec3::Z } else { DVec3::NEG_Y };
        let right = up.cross(front).try_normalize().unwrap_or(DVec3::X);
        let front = right.cross(up);
        let toward_eye = (0.5 * right + 0.45 * up + 0.75 * front).normalize();

        let (center, half) = if bounds.is_empty() {
            (DVec3::ZERO, DVec3::splat(0.5))
        } else {
            let half = 0.5 * DVec3::from_array(bounds.extent());
            let center = DVec3::from_array(bounds.center());
            if half == DVec3::ZERO { (center, DVec3::splat(0.5)) } else { (center, half) }
        };
        let forward = -toward_eye;
        let view_right = forward.cross(up).normalize();
        let view_up = view_right.cross(forward);
        let tan_y = libm::tan(0.5 * Self::FRAMING_FOV_DEGREES.to_radians());
        let tan_x = tan_y * if aspect > 0.0 && aspect.is_finite() { aspect } else { 1.0 };
        // The least distance at which each corner projects inside the picture.
        let distance = (0..8u32)
            .map(|corner| {
                let sign = |axis: u32| if corner >> axis & 1 == 0 { -1.0 } else { 1.0 };
                let offset = half * DVec3::new(sign(0), sign(1), sign(2));
                let across = offset.dot(view_right).abs() / tan_x;
                let along = offset.dot(view_up).abs() / tan_y;
                across.max(along) - offset.dot(forward)
            })
            .fold(0.0, f64::max);
        Camera {
            eye: center + toward_eye * (distance * Self::FRAMING_MARGIN),
            frame: [view_right, view_up, forward],
            projection: Projection::Pinhole { fov_degrees: Self::FRAMING_FOV_DEGREES },
            lens: None,
            end: None,
        }
    }

    /// The camera with a thin lens in place of the pinhole: what lies farther or nearer than the plane of focus is blurred.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if the projection is parallel, or a number of the lens is out of its range
    /// ([`Lens::validate`]).
    pub fn with_lens(self, lens: Lens) -> Result<Camera, RenderError> {
        lens.validate()?;
        if let Projection::Orthographic { .. } = self.projection {
            let reason = "an orthographic camera has no lens; use a pinhole".to_string();
            return Err(RenderError::Setting { what: "lens", reason });
        }
        Ok(Camera { lens: Some(lens), ..self })
    }

    /// The camera with a shutter that opens here and closes when the camera has become `end`. In between the eye moves on a
    /// straight line and the frame turns evenly enough for small turns: its vectors are interpolated and made orthonormal again.
    /// Projection and lens stay this camera's.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if one of the camera's axes turns by a right angle or more: cut the motion into shorter ones.
    pub fn moving_to(self, end: &Camera) -> Result<Camera, RenderError> {
        let pose = Pose::new(self.frame, end.eye, end.frame)?;
        Ok(Camera { end: Some(pose), ..self })
    }

    /// The lens, if there is one.
    pub fn lens(&self) -> Option<Lens> {
        self.lens
    }

    /// Whether the camera moves while the shutter is open.
    pub fn is_moving(&self) -> bool {
        self.end.is_some_and(|end| end.differs_from(self.eye, self.frame))
    }

    /// The same camera with an ideal pinhole.
    #[must_use]
    pub fn without_lens(self) -> Camera {
        Camera { lens: None, ..self }
    }

    /// The same camera at rest, where it is when the shutter opens.
    #[must_use]
    pub fn at_rest(self) -> Camera {
        Camera { end: None, ..self }
    }

    /// Where the camera stands.
    pub fn eye(&self) -> [f64; 3] {
        self.eye.to_array()
    }

    /// Unit vectors right, up and forward.
    pub fn frame(&self) -> [[f64; 3]; 3] {
        self.frame.map(|axis| axis.to_array())
    }

    /// How space is mapped.
    pub fn projection(&self) -> Projection {
        self.projection
    }

    /// The camera over an image of `width` by `height` pixels.
    pub fn view(&self, width: u32, height: u32) -> View {
        let half_height = match self.projection {
            Projection::Pinhole { fov_degrees } => libm::tan(0.5 * fov_degrees.to_radians()),
            Projection::Orthographic { height } => 0.5 * height,
        };
        let pixel = 2.0 * half_height / f64::from(height.max(1));
        View {
            eye: self.eye,
            frame: self.frame,
            pixel,
            steps: steps(self.frame, pixel),
            center: [0.5 * f64::from(width), 0.5 * f64::from(height)],
            parallel: matches!(self.projection, Projection::Orthographic { .. }),
            lens: self.lens.filter(|lens| lens.radius > 0.0),
            end: self.end.filter(|_| self.is_moving()),
        }
    }
}

/// A camera over an image of a certain size: gives the ray through any image position.
#[derive(Clone, Copy, Debug)]
pub struct View {
    eye: DVec3,
    frame: [DVec3; 3],
    /// Side of a pixel, at unit distance for a pinhole.
    pixel: f64,
    /// From a pixel to its neighbours to the right and below, when the shutter opens.
    steps: [DVec3; 2],
    center: [f64; 2],
    parallel: bool,
    lens: Option<Lens>,
    end: Option<Pose>,
}

impl View {
    /// The ray through `(x, y)` in pixels from the image's upper left corner: the middle of the first pixel is
    /// `(0.5, 0.5)`. The direction has unit length (rounded), so `t` is a distance. A pure function of the camera,
    /// the image size and the position (I2). Through the middle of a lens, when the shutter opens.
    #[inline]
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        self.ray_from(self.eye, self.frame[2], self.steps, x, y)
    }

    /// Width of a pixel at the beginning of its ray, and how much wider it becomes along a unit of the ray (in the middle of the picture).
    pub(crate) fn footprint(&self) -> [f64; 2] {
        if self.parallel { [self.pixel, 0.0] } else { [0.0, self.pixel] }
    }

    /// Whether [`View::sampled_ray`] looks at the point of the lens it is given.
    #[inline]
    pub(crate) fn has_lens(&self) -> bool {
        self.lens.is_some()
    }

    /// Whether [`View::sampled_ray`] looks at the time it is given.
    #[inline]
    pub(crate) fn is_moving(&self) -> bool {
        self.end.is_some()
    }

    /// [`View::ray`] through the point of the lens that belongs to `lens` in the unit square, at `time` between 0, when the
    /// shutter opens, and 1. Without lens and motion both are ignored, and the ray is that of [`View::ray`] to the bit.
    pub(crate) fn sampled_ray(&self, x: f64, y: f64, lens: [f64; 2], time: f64) -> Ray {
        let (eye, frame, steps) = match &self.end {
            Some(end) => {
                let (eye, frame) = end.at(self.eye, self.frame, time);
                (eye, frame, steps(frame, self.pixel))
            }
            None => (self.eye, self.frame, self.steps),
        };
        let ray = self.ray_from(eye, frame[2], steps, x, y);
        match &self.lens {
            Some(through) => through.bend(&ray, frame, lens),
            None => ray,
        }
    }

    #[inline]
    fn ray_from(&self, eye: DVec3, forward: DVec3, [right, down]: [DVec3; 2], x: f64, y: f64) -> Ray {
        let offset = right * (x - self.center[0]) + down * (y - self.center[1]);
        if self.parallel {
            Ray::new((eye + offset).to_array(), forward.to_array())
        } else {
            Ray::new(eye.to_array(), (forward + offset).normalize().to_array())
        }
    }
}

/// From a pixel of this side to its neighbours to the right and below.
fn steps([right, up, _]: [DVec3; 3], pixel: f64) -> [DVec3; 2] {
    [right * pixel, up * -pixel]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_go_where_the_picture_says() {
        let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 90.0).unwrap();
        let view = camera.view(200, 100);
        let middle = view.ray(100.0, 50.0);
        assert_eq!(middle.direction, [0.0, 0.0, -1.0]);
        assert_eq!(middle.origin, [0.0, 0.0, 5.0]);
        // The upper border is 45 degrees up, and twice as wide as high means tan = 2 to the side.
        let top = DVec3::from_array(view.ray(100.0, 0.0).direction);
        assert!((top - DVec3::new(0.0, 1.0, -1.0).normalize()).length() < 1e-15);
        let right = DVec3::from_array(view.ray(200.0, 50.0).direction);
        assert!((right - DVec3::new(2.0, 0.0, -1.0).normalize()).length() < 1e-15);

        let camera = Camera::orthographic([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 2.0).unwrap();
        let corner = camera.view(100, 100).ray(100.0, 100.0);
        assert_eq!(corner.direction, [0.0, 0.0, -1.0]);
        assert!((DVec3::from_array(corner.origin) - DVec3::new(1.0, -1.0, 5.0)).length() < 1e-15);
    }

    #[test]
    fn senseless_cameras_are_refused() {
        let (a, b, up) = ([0.0; 3], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]);
        assert!(Camera::pinhole(a, a, up, 40.0).is_err());
        assert!(Camera::pinhole(a, b, [0.0; 3], 40.0).is_err());
        assert!(Camera::pinhole(a, b, [0.0, 0.0, -2.0], 40.0).is_err());
        for fov in [0.0, 180.0, -1.0, f64::NAN] {
            assert!(Camera::pinhole(a, b, up, fov).is_err(), "{fov}");
        }
        for height in [0.0, f64::INFINITY, f64::NAN] {
            assert!(Camera::orthographic(a, b, up, height).is_err(), "{height}");
        }
        assert!(Camera::pinhole([f64::NAN, 0.0, 0.0], b, up, 40.0).is_err());
    }

    #[test]
    fn what_gives_a_camera_its_direction_may_have_any_length() {
        let same = Camera::pinhole([0.0; 3], [0.0, 0.6, 0.8], [0.0, 1.0, 0.0], 40.0).unwrap();
        let bounds = Aabb { min: [-1.0; 3], max: [1.0; 3] };
        let [x_up, framed] =
            [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]].map(|up| Camera::framing_with_up(&bounds, up, 1.0));
        for power in [-1000, -540, 500, 1000] {
            let length = libm::exp2(f64::from(power));
            let camera =
                Camera::pinhole([0.0; 3], [0.0, 0.6 * length, 0.8 * length], [0.0, length, 0.0], 40.0);
            assert_eq!(camera.unwrap(), same, "{power}");
            assert_eq!(Camera::framing_with_up(&bounds, [0.0, 0.0, length], 1.0), framed, "{power}");
            assert_eq!(Camera::framing_with_up(&bounds, [length, 0.0, 0.0], 1.0), x_up, "{power}");
        }
    }

    #[test]
    fn the_automatic_camera_holds_the_whole_model() {
        let boxes = [
            Aabb { min: [-1.0; 3], max: [1.0; 3] },
            Aabb { min: [1e7, 0.0, -3.0], max: [1e7 + 5.0, 0.1, 400.0] },
            Aabb { min: [0.0; 3], max: [100.0, 100.0, 1.0] },
            Aabb { min: [2.0; 3], max: [2.0; 3] },
        ];
        for bounds in boxes {
            for aspect in [0.3, 1.0, 2.5] {
                let camera = Camera::framing(&bounds, aspect);
                let [right, up, forward] = camera.frame;
                let tan = libm::tan(Camera::FRAMING_FOV_DEGREES.to_radians() / 2.0);
                let mut widest: f64 = 0.0;
                for corner in 0..8 {
                    let pick = |axis: usize| [bounds.min, bounds.max][corner >> axis & 1][axis];
                    let to = DVec3::new(pick(0), pick(1), pick(2)) - camera.eye;
                    let depth = to.dot(forward);
                    assert!(depth > 0.0);
                    let x = to.dot(right) / (depth * tan * aspect);
                    let y = to.dot(up) / (depth * tan);
                    widest = widest.max(x.abs()).max(y.abs());
                }
                assert!(widest <= 1.0, "{bounds:?} at {aspect}: {widest}");
                // Nor does the model vanish in the middle.
                assert!(widest > 0.5 || bounds.min == bounds.max, "{bounds:?} at {aspect}: {widest}");
            }
        }
    }
}
