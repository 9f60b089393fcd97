//! Lights without extent.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Camera;
use crate::error::RenderError;
use crate::geom::Ray;

/// How a point light weakens with distance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Falloff {
    /// Not at all, as in the Standard Procedural Databases and the 2004 paper: every surface that faces the light
    /// receives `intensity`, however far it is.
    None,
    /// With the square of the distance: a facing surface at distance `r` receives `intensity / max(r, radius)^2`.
    InverseSquare {
        /// Size of the source; above 0. It bounds what can be received, which is what lets weak paths be cut with
        /// a proven error.
        radius: f64,
    },
}

/// A light without extent. Its colour is linear RGB irradiance at perpendicular incidence, in the convention of MTL
/// files: a surface with diffuse reflectance `Kd` that faces the light shows `Kd` times that, without a factor pi.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Light {
    /// Shines from a point in all directions.
    Point {
        /// Where it is.
        position: [f64; 3],
        /// Received at any distance ([`Falloff::None`]) or at unit distance.
        intensity: [f32; 3],
        /// How it weakens.
        falloff: Falloff,
    },
    /// Shines along one direction from infinitely far away.
    Directional {
        /// The way the light travels; any length but zero.
        direction: [f64; 3],
        /// Received by every facing surface.
        intensity: [f32; 3],
    },
}

/// What one point receives from a light, before the cosine and occlusion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Incidence {
    /// Unit vector toward the light.
    pub toward: DVec3,
    /// Irradiance at perpendicular incidence.
    pub irradiance: DVec3,
}

impl Light {
    /// A point light without falloff.
    pub fn point(position: [f64; 3], intensity: [f32; 3]) -> Light {
        Light::Point { position, intensity, falloff: Falloff::None }
    }

    /// A directional light; `direction` is the way the light travels.
    pub fn directional(direction: [f64; 3], intensity: [f32; 3]) -> Light {
        Light::Directional { direction, intensity }
    }

    /// Two lights that suit any model seen by `camera`: a key from above the viewer's left shoulder and a weaker
    /// fill from the right.
    pub fn automatic(camera: &Camera) -> Vec<Light> {
        let [right, up, forward] = camera.frame().map(DVec3::from_array);
        let key = forward + 0.55 * right - 0.75 * up;
        let fill = forward - 0.9 * right - 0.1 * up;
        vec![
            Light::directional(key.to_array(), [0.85, 0.84, 0.8]),
            Light::directional(fill.to_array(), [0.28, 0.3, 0.34]),
        ]
    }

    /// The colour given at construction.
    pub fn intensity(&self) -> [f32; 3] {
        match *self {
            Light::Point { intensity, .. } | Light::Directional { intensity, .. } => intensity,
        }
    }

    /// Whether the light gives any light at all.
    pub fn is_dark(&self) -> bool {
        self.intensity() == [0.0; 3]
    }

    /// The most that any point can receive from it.
    pub fn irradiance_max(&self) -> [f64; 3] {
        let scale = match *self {
            Light::Point { falloff: Falloff::InverseSquare { radius }, .. } => 1.0 / (radius * radius),
            _ => 1.0,
        };
        self.intensity().map(|channel| f64::from(channel) * scale)
    }

    /// Says what is wrong with the light, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is not finite, an intensity is negative, a direction is zero or a radius
    /// is not positive.
    pub fn validate(&self) -> Result<(), RenderError> {
        let error = |reason: &str| Err(RenderError::Setting { what: "light", reason: reason.to_string() });
        if self.intensity().iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
            return error("its intensity must be finite and not negative");
        }
        match *self {
            Light::Point { position, .. } if !DVec3::from_array(position).is_finite() => {
                error("its position must be finite")
            }
            Light::Point { falloff: Falloff::InverseSquare { radius }, .. }
                if !(radius > 0.0 && (1.0 / (radius * radius)).is_finite()) =>
            {
                error("the radius of a light with falloff must be positive")
            }
            Light::Directional { direction, .. }
                if DVec3::from_array(direction).try_normalize().is_none() =>
            {
                error("its direction must be finite and not zero")
            }
            _ => Ok(()),
        }
    }

    /// The light in the form that shading uses. The light must be valid.
    pub(crate) fn emitter(&self) -> Emitter {
        match *self {
            Light::Directional { direction, intensity } => Emitter::Directional(Incidence {
                toward: -DVec3::from_array(direction).normalize(),
                irradiance: DVec3::from_array(intensity.map(f64::from)),
            }),
            Light::Point { position, intensity, falloff } => Emitter::Point {
                position: DVec3::from_array(position),
                intensity: DVec3::from_array(intensity.map(f64::from)),
                radius_squared: match falloff {
                    Falloff::None => None,
                    Falloff::InverseSquare { radius } => Some(radius * radius),
                },
            },
        }
    }
}

/// A light with everything computed that does not depend on the receiver.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Emitter {
    /// The same everywhere.
    Directional(Incidence),
    /// From a point; `radius_squared` if it weakens.
    Point { position: DVec3, intensity: DVec3, radius_squared: Option<f64> },
}

impl Emitter {
    /// What arrives at `point`. A point exactly at the light receives nothing.
    pub(crate) fn incidence(&self, point: DVec3) -> Incidence {
        match *self {
            Emitter::Directional(incidence) => incidence,
            Emitter::Point { position, intensity, radius_squared } => {
                let offset = position - point;
                let squared = offset.length_squared();
                if squared == 0.0 {
                    return Incidence { toward: DVec3::ZERO, irradiance: DVec3::ZERO };
                }
                let scale = radius_squared.map_or(1.0, |floor| 1.0 / squared.max(floor));
                Incidence { toward: offset / squared.sqrt(), irradiance: intensity * scale }
            }
        }
    }

    /// The ray from `origin` to the light: to infinity, or with `t` 1 at the point. A surface at the light itself
    /// counts as in its way. From an origin at the light the ray is empty, along `normal`.
    pub(crate) fn shadow_ray(&self, origin: [f64; 3], normal: DVec3) -> Ray {
        match *self {
            Emitter::Directional(incidence) => Ray::new(origin, incidence.toward.to_array()),
            Emitter::Point { position, .. } => {
                let offset = position - DVec3::from_array(origin);
                if offset == DVec3::ZERO {
                    return Ray { t_max: 0.0, ..Ray::new(origin, normal.to_array()) };
                }
                Ray { t_max: 1.0, ..Ray::new(origin, offset.to_array()) }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falloff_and_direction() {
        let near = Light::point([0.0, 2.0, 0.0], [1.0, 0.5, 0.0]);
        let at = near.emitter().incidence(DVec3::ZERO);
        assert_eq!(at.toward, DVec3::Y);
        assert_eq!(at.irradiance, DVec3::new(1.0, 0.5, 0.0));
        let weakening = Light::Point {
            position: [0.0, 2.0, 0.0],
            intensity: [8.0; 3],
            falloff: Falloff::InverseSquare { radius: 1.0 },
        };
        assert_eq!(weakening.emitter().incidence(DVec3::ZERO).irradiance, DVec3::splat(2.0));
        assert_eq!(weakening.emitter().incidence(DVec3::new(0.0, 1.9, 0.0)).irradiance, DVec3::splat(8.0));
        assert_eq!(weakening.irradiance_max(), [8.0; 3]);
        let sun = Light::directional([0.0, -3.0, 0.0], [1.0; 3]);
        assert_eq!(sun.emitter().incidence(DVec3::splat(1e9)).toward, DVec3::Y);
        assert!(!weakening.emitter().incidence(DVec3::new(0.0, 2.0, 0.0)).irradiance.is_nan());
    }

    #[test]
    fn senseless_lights_are_refused() {
        let falloff = |radius| Light::Point {
            position: [0.0; 3],
            intensity: [1.0; 3],
            falloff: Falloff::InverseSquare { radius },
        };
        for bad in [
            Light::point([f64::NAN, 0.0, 0.0], [1.0; 3]),
            Light::point([0.0; 3], [-1.0, 0.0, 0.0]),
            Light::point([0.0; 3], [f32::INFINITY; 3]),
            Light::directional([0.0; 3], [1.0; 3]),
            falloff(0.0),
            falloff(1e-200),
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
        assert!(falloff(0.1).validate().is_ok());
    }
}
