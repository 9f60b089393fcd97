//! Lights: those without extent, and what all have in common.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::Camera;
use super::area_light::{AreaEmitter, LightShape};
use super::sphere::unit;
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

/// A light. The colour of one without extent is linear RGB irradiance at perpendicular incidence, in the convention of MTL
/// files: a surface with diffuse reflectance `Kd` that faces the light shows `Kd` times that, without a factor pi. The
/// colour of one with extent is its radiance. The two fit together: a surface that receives radiance 1 from its whole
/// hemisphere shows `Kd` as well.
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
    /// Shines from a point into a cone, evenly inside `inner_degrees` and less and less up to `outer_degrees`.
    Spot {
        /// Where it is.
        position: [f64; 3],
        /// Middle of the cone, the way the light travels; any length but zero.
        direction: [f64; 3],
        /// As for [`Light::Point`], inside the inner cone.
        intensity: [f32; 3],
        /// How it weakens with distance.
        falloff: Falloff,
        /// Angle between the middle and the border of the evenly lit cone: 0 to `outer_degrees`.
        inner_degrees: f64,
        /// Angle between the middle and the border of all light: above 0, at most 90.
        outer_degrees: f64,
    },
    /// Shines from a shape with extent: its shadows are soft. It is seen, directly and in mirrors; it is no surface,
    /// so it hides nothing and casts no shadow: a ray through its lit side gathers its radiance and goes on.
    Area {
        /// What shines.
        shape: LightShape,
        /// Radiance of every point of it, in every direction of its lit side.
        radiance: [f32; 3],
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

/// Largest coordinate of a light: squares of distances from there are numbers.
pub(super) const POSITION_MAX: f64 = 1e150;

impl Light {
    /// A point light without falloff.
    pub fn point(position: [f64; 3], intensity: [f32; 3]) -> Light {
        Light::Point { position, intensity, falloff: Falloff::None }
    }

    /// A directional light; `direction` is the way the light travels.
    pub fn directional(direction: [f64; 3], intensity: [f32; 3]) -> Light {
        Light::Directional { direction, intensity }
    }

    /// A light with extent.
    pub fn area(shape: LightShape, radiance: [f32; 3]) -> Light {
        Light::Area { shape, radiance }
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
            Light::Point { intensity, .. }
            | Light::Directional { intensity, .. }
            | Light::Spot { intensity, .. } => intensity,
            Light::Area { radiance, .. } => radiance,
        }
    }

    /// Whether the light gives any light at all.
    pub fn is_dark(&self) -> bool {
        self.intensity() == [0.0; 3]
    }

    /// Whether it has extent.
    pub fn is_area(&self) -> bool {
        matches!(self, Light::Area { .. })
    }

    /// The most that any point can receive from it, in the unit of [`Light::Directional`]: for a light with extent, which at
    /// most fills the hemisphere, its radiance.
    pub fn irradiance_max(&self) -> [f64; 3] {
        let scale = match *self {
            Light::Point { falloff: Falloff::InverseSquare { radius }, .. }
            | Light::Spot { falloff: Falloff::InverseSquare { radius }, .. } => 1.0 / (radius * radius),
            _ => 1.0,
        };
        self.intensity().map(|channel| f64::from(channel) * scale)
    }

    /// Says what is wrong with the light, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is not finite, a coordinate is beyond 1e150, an intensity is negative, a direction is zero
    /// or a radius is not positive.
    pub fn validate(&self) -> Result<(), RenderError> {
        let error = |reason: &str| Err(RenderError::Setting { what: "light", reason: reason.to_string() });
        if self.intensity().iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
            return error("its intensity must be finite and not negative");
        }
        match *self {
            Light::Point { position, .. } | Light::Spot { position, .. }
                if !position.iter().all(|x| x.abs() <= POSITION_MAX) =>
            {
                error("its position must be finite, and no coordinate beyond 1e150")
            }
            Light::Point { falloff: Falloff::InverseSquare { radius }, .. }
            | Light::Spot { falloff: Falloff::InverseSquare { radius }, .. }
                if !(radius > 0.0 && self.irradiance_max().iter().all(|channel| channel.is_finite())) =>
            {
                error(
                    "the radius of a light with falloff must be positive, and not so small that its light is beyond all numbers",
                )
            }
            Light::Spot { inner_degrees, outer_degrees, .. }
                if !(inner_degrees >= 0.0
                    && inner_degrees <= outer_degrees
                    && outer_degrees > 0.0
                    && outer_degrees <= 90.0) =>
            {
                error("the angles of a spot light must satisfy 0 <= inner <= outer, 0 < outer <= 90")
            }
            Light::Area { shape, .. } => shape.validate(),
            Light::Directional { direction, .. } | Light::Spot { direction, .. }
                if unit(DVec3::from_array(direction)).is_none() =>
            {
                error("its direction must be finite and not zero")
            }
            _ => Ok(()),
        }
    }

    /// The light in the form that shading uses, if it has no extent. The light must be valid.
    pub(crate) fn emitter(&self) -> Option<Emitter> {
        let radius_squared = |falloff| match falloff {
            Falloff::None => None,
            Falloff::InverseSquare { radius } => Some(radius * radius),
        };
        Some(match *self {
            Light::Directional { direction, intensity } => Emitter::Directional(Incidence {
                toward: -unit(DVec3::from_array(direction)).unwrap_or(DVec3::NEG_Y),
                irradiance: DVec3::from_array(intensity.map(f64::from)),
            }),
            Light::Point { position, intensity, falloff } => Emitter::Point {
                position: DVec3::from_array(position),
                intensity: DVec3::from_array(intensity.map(f64::from)),
                radius_squared: radius_squared(falloff),
                cone: None,
            },
            Light::Spot { position, direction, intensity, falloff, inner_degrees, outer_degrees } => {
                let cos = |degrees: f64| libm::cos(degrees.to_radians());
                let cone = Cone {
                    axis: unit(DVec3::from_array(direction)).unwrap_or(DVec3::NEG_Y),
                    cos_inner: cos(inner_degrees),
                    cos_outer: cos(outer_degrees),
                };
                Emitter::Point {
                    position: DVec3::from_array(position),
                    intensity: DVec3::from_array(intensity.map(f64::from)),
                    radius_squared: radius_squared(falloff),
                    cone: Some(cone),
                }
            }
            Light::Area { .. } => return None,
        })
    }
}

impl Light {
    /// The light in the form that shading uses, if it has extent. The light must be valid.
    pub(crate) fn area_emitter(&self) -> Option<AreaEmitter> {
        match self {
            Light::Area { shape, radiance } => Some(AreaEmitter::new(shape, *radiance)),
            _ => None,
        }
    }
}

/// The cone of a spot light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cone {
    axis: DVec3,
    cos_inner: f64,
    cos_outer: f64,
}

impl Cone {
    /// The share of the light that goes along the unit vector `away`: 1 inside, 0 outside, between them a smooth step of
    /// the cosine.
    fn share(&self, away: DVec3) -> f64 {
        let cos = away.dot(self.axis);
        if cos >= self.cos_inner {
            1.0
        } else if cos <= self.cos_outer {
            0.0
        } else {
            let x = (cos - self.cos_outer) / (self.cos_inner - self.cos_outer);
            x * x * (3.0 - 2.0 * x)
        }
    }
}

/// A light without extent, with everything computed that does not depend on the receiver.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Emitter {
    /// The same everywhere.
    Directional(Incidence),
    /// From a point; `radius_squared` if it weakens, `cone` if it is a spot light.
    Point { position: DVec3, intensity: DVec3, radius_squared: Option<f64>, cone: Option<Cone> },
}

impl Emitter {
    /// What arrives at `point`. A point exactly at the light receives nothing.
    #[inline(always)]
    pub(crate) fn incidence(&self, point: DVec3) -> Incidence {
        match *self {
            Emitter::Directional(incidence) => incidence,
            Emitter::Point { position, intensity, radius_squared, ref cone } => {
                let offset = position - point;
                let squared = offset.length_squared();
                if squared == 0.0 {
                    return Incidence { toward: DVec3::ZERO, irradiance: DVec3::ZERO };
                }
                let toward = offset / squared.sqrt();
                let irradiance = weakened(intensity, radius_squared, cone.as_ref(), squared, toward);
                Incidence { toward, irradiance }
            }
        }
    }

    /// [`Emitter::incidence`] on a surface with this unit normal, and the cosine between it and the light, if that is greater than 0. What
    /// faces away is not asked further.
    #[inline(always)]
    pub(crate) fn incidence_facing(&self, point: DVec3, normal: DVec3) -> Option<(f64, Incidence)> {
        match *self {
            Emitter::Directional(incidence) => {
                let cosine = incidence.toward.dot(normal);
                (cosine > 0.0).then_some((cosine, incidence))
            }
            Emitter::Point { position, intensity, radius_squared, ref cone } => {
                let offset = position - point;
                let squared = offset.length_squared();
                let toward = offset / squared.sqrt();
                let cosine = toward.dot(normal);
                // At the light itself, or so near that squares vanish, neither is a number to be used.
                (cosine > 0.0 && squared > 0.0).then(|| {
                    let irradiance = weakened(intensity, radius_squared, cone.as_ref(), squared, toward);
                    (cosine, Incidence { toward, irradiance })
                })
            }
        }
    }

    /// The ray from `origin` to the light: to infinity, or with `t` 1 at the point. A surface at the light itself
    /// counts as in its way. From an origin at the light the ray is empty, along `normal`.
    #[inline]
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

/// What is left of a point's intensity at this squared distance in the direction opposite to `toward`.
#[inline(always)]
fn weakened(
    intensity: DVec3,
    radius_squared: Option<f64>,
    cone: Option<&Cone>,
    squared: f64,
    toward: DVec3,
) -> DVec3 {
    let mut irradiance = intensity;
    if let Some(floor) = radius_squared {
        irradiance *= 1.0 / squared.max(floor);
    }
    if let Some(cone) = cone {
        irradiance *= cone.share(-toward);
    }
    irradiance
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falloff_and_direction() {
        let near = Light::point([0.0, 2.0, 0.0], [1.0, 0.5, 0.0]);
        let at = near.emitter().unwrap().incidence(DVec3::ZERO);
        assert_eq!(at.toward, DVec3::Y);
        assert_eq!(at.irradiance, DVec3::new(1.0, 0.5, 0.0));
        let weakening = Light::Point {
            position: [0.0, 2.0, 0.0],
            intensity: [8.0; 3],
            falloff: Falloff::InverseSquare { radius: 1.0 },
        };
        assert_eq!(weakening.emitter().unwrap().incidence(DVec3::ZERO).irradiance, DVec3::splat(2.0));
        assert_eq!(
            weakening.emitter().unwrap().incidence(DVec3::new(0.0, 1.9, 0.0)).irradiance,
            DVec3::splat(8.0)
        );
        assert_eq!(weakening.irradiance_max(), [8.0; 3]);
        let sun = Light::directional([0.0, -3.0, 0.0], [1.0; 3]);
        assert_eq!(sun.emitter().unwrap().incidence(DVec3::splat(1e9)).toward, DVec3::Y);
        assert!(!weakening.emitter().unwrap().incidence(DVec3::new(0.0, 2.0, 0.0)).irradiance.is_nan());
    }

    #[test]
    fn lights_stand_where_distances_are_numbers() {
        for (x, is_valid) in [(-1e150, true), (1e151, false), (f64::INFINITY, false), (f64::NAN, false)] {
            let light = Light::point([0.0, x, 0.0], [1.0; 3]);
            assert_eq!(light.validate().is_ok(), is_valid, "{x}");
        }
    }

    #[test]
    fn a_spot_light_is_a_point_light_in_its_cone() {
        let spot = |inner_degrees, outer_degrees| Light::Spot {
            position: [0.0, 2.0, 0.0],
            direction: [0.0, -3.0, 0.0],
            intensity: [4.0; 3],
            falloff: Falloff::InverseSquare { radius: 0.5 },
            inner_degrees,
            outer_degrees,
        };
        let received =
            |light: Light, x: f64| light.emitter().unwrap().incidence(DVec3::new(x, 0.0, 0.0)).irradiance.x;
        let soft = spot(20.0, 45.0);
        assert!(soft.validate().is_ok());
        assert_eq!(received(soft, 0.0), 1.0);
        // Just inside and just outside of the inner cone, half way of the step in cosine, and outside.
        let tan = |degrees: f64| 2.0 * libm::tan(degrees.to_radians());
        let at = |degrees: f64| {
            received(soft, tan(degrees)) * (1.0 + libm::pow(libm::tan(degrees.to_radians()), 2.0))
        };
        assert!((at(19.99) - 1.0).abs() < 1e-12 && (at(20.01) - 1.0).abs() < 1e-5 && at(20.01) < 1.0);
        let middle = 0.5 * (libm::cos(20f64.to_radians()) + libm::cos(45f64.to_radians()));
        assert!((at(libm::acos(middle).to_degrees()) - 0.5).abs() < 1e-12);
        assert_eq!(at(45.01), 0.0);
        // A hard border, and senseless angles.
        assert_eq!(
            (received(spot(30.0, 30.0), tan(29.9)) > 0.0, received(spot(30.0, 30.0), tan(30.1))),
            (true, 0.0)
        );
        for (inner, outer) in [(-1.0, 10.0), (20.0, 10.0), (0.0, 0.0), (0.0, 91.0), (f64::NAN, 10.0)] {
            assert!(spot(inner, outer).validate().is_err(), "{inner} {outer}");
        }
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
            // What can be received from it must be a number, or bounds on light are none.
            Light::Point {
                position: [0.0; 3],
                intensity: [1e30; 3],
                falloff: Falloff::InverseSquare { radius: 1e-145 },
            },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
        assert!(falloff(0.1).validate().is_ok());
    }

    #[test]
    fn directions_may_have_any_length() {
        let along = DVec3::new(0.6, -0.8, 0.0);
        for length in [1e-320, 1e-200, 1e-162, 1e-9, 1.0, 3.0, 1e160, 1e300] {
            let direction = (along * length).to_array();
            let spot = Light::Spot {
                position: [0.0; 3],
                direction,
                intensity: [1.0; 3],
                falloff: Falloff::None,
                inner_degrees: 1.0,
                outer_degrees: 2.0,
            };
            let sun = Light::directional(direction, [1.0; 3]);
            assert!(sun.validate().is_ok() && spot.validate().is_ok(), "{length}");
            let incidence = sun.emitter().unwrap().incidence(DVec3::ZERO);
            // Of the shortest little more than three digits are left.
            let error = if length < 1e-300 { 1e-3 } else { 1e-15 };
            assert!((incidence.toward + along).length() < error, "{length}: {}", incidence.toward);
            assert!((incidence.toward.length() - 1.0).abs() < 1e-15, "{length}");
            assert_eq!(spot.emitter().unwrap().incidence(along).irradiance, DVec3::ONE, "{length}");
        }
    }

    #[test]
    fn what_faces_a_light_gets_what_arrives_there() {
        let lights = [
            Light::directional([0.3, -3.0, 0.1], [1.0, 0.5, 0.25]),
            Light::point([0.0, 2.0, 0.0], [1.0, 0.5, 0.0]),
            Light::Point {
                position: [0.5, 2.0, 0.0],
                intensity: [8.0; 3],
                falloff: Falloff::InverseSquare { radius: 1.0 },
            },
            Light::Spot {
                position: [0.0, 2.0, 0.0],
                direction: [0.1, -1.0, 0.0],
                intensity: [1.0; 3],
                inner_degrees: 10.0,
                outer_degrees: 40.0,
                falloff: Falloff::None,
            },
        ];
        let normals =
            [DVec3::Y, DVec3::NEG_Y, DVec3::X, DVec3::new(0.6, -0.8, 0.0), DVec3::new(0.0, 0.6, 0.8)];
        let mut counts = [0; 2];
        for emitter in lights.map(|light| light.emitter().unwrap()) {
            for x in -4_i32..5 {
                // One of the points is at the lights, and one so near that squares vanish.
                let near = if x == 4 { DVec3::new(-2.0, 0.0, 1e-200) } else { DVec3::ZERO };
                let point =
                    near + DVec3::new(f64::from(x) * 0.5, 2.0, 0.0) - DVec3::Y * f64::from(x.abs() % 2) * 1.5;
                for normal in normals {
                    let plain = emitter.incidence(point);
                    let cosine = plain.toward.dot(normal);
                    let facing = emitter.incidence_facing(point, normal);
                    counts[usize::from(facing.is_some())] += 1;
                    assert_eq!(facing.is_some(), cosine > 0.0);
                    if let Some((found, incidence)) = facing {
                        assert_eq!(found.to_bits(), cosine.to_bits());
                        assert_eq!(incidence.toward, plain.toward);
                        assert_eq!(incidence.irradiance, plain.irradiance);
                    }
                }
            }
        }
        assert!(counts.into_iter().min() > Some(20), "{counts:?}");
    }
}
