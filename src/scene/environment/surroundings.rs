//! What surrounds a scene, and how it is sampled as a light.

use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::image::EnvironmentImage;
use crate::error::RenderError;
use crate::scene::sphere::{cosine_direction, to_frame, unit};

/// What surrounds a scene at an infinite distance, and lights it. Rays that hit nothing see it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Environment {
    /// The same linear RGB radiance from everywhere.
    Constant([f32; 3]),
    /// A picture. It does not travel: a scene with one cannot be sent to the workers of a cluster.
    #[serde(skip)]
    Image {
        /// The picture; shared, not copied, where a scene is cloned.
        image: Arc<EnvironmentImage>,
        /// The picture's radiances are multiplied by this; finite and not negative.
        scale: f32,
        /// Where the picture's upper border is; any length but zero.
        up: [f64; 3],
        /// Where the middle of the picture is, up to its height: must not be along `up`.
        front: [f64; 3],
    },
}

impl Environment {
    /// A picture with +Y up and its middle in the direction -Z.
    pub fn image(image: Arc<EnvironmentImage>) -> Environment {
        Environment::Image { image, scale: 1.0, up: [0.0, 1.0, 0.0], front: [0.0, 0.0, -1.0] }
    }

    /// Largest radiance per channel that any ray can see.
    pub fn radiance_max(&self) -> [f64; 3] {
        match self {
            Environment::Constant(radiance) => radiance.map(f64::from),
            Environment::Image { image, scale, .. } => {
                image.radiance_max().map(|channel| f64::from(channel) * f64::from(*scale))
            }
        }
    }

    /// Whether it gives no light at all.
    pub fn is_dark(&self) -> bool {
        self.radiance_max() == [0.0; 3]
    }

    /// Says what is wrong with it, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is negative or not finite, or `front` lies along `up`.
    pub fn validate(&self) -> Result<(), RenderError> {
        match self {
            Environment::Constant(radiance) => {
                if radiance.iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
                    return Err(refused("each channel must be finite and not negative"));
                }
                Ok(())
            }
            Environment::Image { scale, up, front, .. } => Self::validate_picture(*scale, *up, *front),
        }
    }

    /// [`Environment::validate`] for what stands beside a picture.
    pub(crate) fn validate_picture(scale: f32, up: [f64; 3], front: [f64; 3]) -> Result<(), RenderError> {
        if !(scale >= 0.0 && scale.is_finite()) {
            return Err(refused("the scale must be finite and not negative"));
        }
        if frame(up, front).is_none() {
            return Err(refused("up and front must be finite, not zero and not along one line"));
        }
        Ok(())
    }
}

fn refused(reason: &str) -> RenderError {
    RenderError::Setting { what: "environment", reason: reason.to_string() }
}

/// Right, up and front of a picture, orthonormal.
fn frame(up: [f64; 3], front: [f64; 3]) -> Option<[DVec3; 3]> {
    let up = unit(DVec3::from_array(up))?;
    let right = unit(DVec3::from_array(front))?.cross(up);
    // Below this its direction is mostly rounding error.
    let right = (right.length_squared() > 1e-24).then(|| right.normalize())?;
    Some([right, up, up.cross(right)])
}

/// An environment in the form that shading uses.
#[derive(Clone, Debug)]
pub(crate) enum EnvironmentEmitter {
    Constant(DVec3),
    Image { image: Arc<EnvironmentImage>, scale: f64, frame: [DVec3; 3] },
}

impl EnvironmentEmitter {
    /// The environment must be valid.
    pub fn new(environment: &Environment) -> EnvironmentEmitter {
        match environment {
            Environment::Constant(radiance) => {
                EnvironmentEmitter::Constant(DVec3::from_array(radiance.map(f64::from)))
            }
            Environment::Image { image, scale, up, front } => EnvironmentEmitter::Image {
                image: Arc::clone(image),
                scale: f64::from(*scale),
                frame: frame(*up, *front).unwrap_or([DVec3::X, DVec3::Y, DVec3::NEG_Z]),
            },
        }
    }

    /// What a ray along the unit vector `direction` sees.
    pub fn radiance(&self, direction: DVec3) -> DVec3 {
        match self {
            EnvironmentEmitter::Constant(radiance) => *radiance,
            EnvironmentEmitter::Image { image, scale, frame } => {
                image.radiance(frame.map(|axis| axis.dot(direction))) * *scale
            }
        }
    }

    /// A direction that lights a surface with this unit `normal`, and its density over solid angle, above 0. A constant
    /// environment is sampled by the cosine at the normal, a picture by its own radiance.
    pub fn sample(&self, normal: DVec3, point: [f64; 2]) -> Option<(DVec3, f64)> {
        match self {
            EnvironmentEmitter::Constant(_) => {
                let toward = to_frame(normal, cosine_direction(point));
                Some((toward, self.density(normal, toward))).filter(|(_, density)| *density > 0.0)
            }
            EnvironmentEmitter::Image { image, frame, .. } => {
                let ([x, y, z], density) = image.sample(point)?;
                Some((frame[0] * x + frame[1] * y + frame[2] * z, density))
            }
        }
    }

    /// Density with which [`EnvironmentEmitter::sample`] chooses a direction.
    pub fn density(&self, normal: DVec3, direction: DVec3) -> f64 {
        match self {
            EnvironmentEmitter::Constant(_) => normal.dot(direction).max(0.0) / std::f64::consts::PI,
            EnvironmentEmitter::Image { image, frame, .. } => {
                image.density(frame.map(|axis| axis.dot(direction)))
            }
        }
    }
}
