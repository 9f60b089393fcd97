//! Area lights: rectangle, disc, sphere. Points on them by importance, and the densities of those points.

use serde::{Deserialize, Serialize};
use std::f64::consts::{PI, TAU};

use glam::DVec3;

use super::light::POSITION_MAX;
use super::sphere::{cone_direction, disc_point, frame_around, to_frame, unit};
use crate::error::RenderError;

/// The shape of a light with extent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum LightShape {
    /// A parallelogram, usually a rectangle; shines to the side of `edges[0]` x `edges[1]`.
    Rectangle {
        /// One corner.
        corner: [f64; 3],
        /// From the corner to its two neighbours.
        edges: [[f64; 3]; 2],
    },
    /// A round plate; shines to the side of `normal`.
    Disc {
        /// Its middle.
        center: [f64; 3],
        /// Any length but zero.
        normal: [f64; 3],
        /// Above 0.
        radius: f64,
    },
    /// A ball; shines outward. Points inside it receive nothing from it.
    Sphere {
        /// Its middle.
        center: [f64; 3],
        /// Above 0.
        radius: f64,
    },
}

impl LightShape {
    /// Says what is wrong with the shape, if anything is.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if a number is not finite, a coordinate is beyond 1e150, or the shape has no extent.
    pub fn validate(&self) -> Result<(), RenderError> {
        let error = |reason: &str| Err(RenderError::Setting { what: "light", reason: reason.to_string() });
        let is_near = |point: [f64; 3]| point.iter().all(|x| x.abs() <= POSITION_MAX);
        // Squares of such radii neither vanish nor overflow.
        let sensible = |radius: f64| (1e-100..=1e100).contains(&radius);
        match *self {
            LightShape::Rectangle { corner, edges } => {
                let [a, b] = edges.map(DVec3::from_array);
                // Neither vanishes nor overflows: what points are found by is divided by it.
                if !is_near(corner) || !a.cross(b).length_squared().is_normal() {
                    return error(
                        "the corner and edges of a rectangle must be finite, its corner within 1e150, its edges not parallel and of sensible lengths",
                    );
                }
            }
            LightShape::Disc { center, normal, radius } => {
                let normal = unit(DVec3::from_array(normal));
                if !is_near(center) || normal.is_none() || !sensible(radius) {
                    return error(
                        "a disc needs a middle within 1e150, a normal that is not zero and a positive radius",
                    );
                }
            }
            LightShape::Sphere { center, radius } => {
                if !is_near(center) || !sensible(radius) {
                    return error("a sphere needs a middle within 1e150 and a positive radius");
                }
            }
        }
        Ok(())
    }
}

/// A point of a light, as seen from a point that it lights.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightPoint {
    pub position: DVec3,
    /// Unit vector to it.
    pub toward: DVec3,
    /// Its density over solid angle, above 0.
    pub density: f64,
}

/// Where a ray gathers the radiance of a light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightCrossing {
    pub t: f64,
    /// Density over solid angle with which [`AreaEmitter::sample`] chooses this direction from the ray's origin.
    pub density: f64,
}

/// An area light with everything computed that does not depend on the receiver.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AreaEmitter {
    shape: Shape,
    pub radiance: DVec3,
}

#[derive(Clone, Copy, Debug)]
enum Shape {
    /// `inverse` takes an offset from the corner to its coordinates along the edges.
    Rectangle {
        corner: DVec3,
        edges: [DVec3; 2],
        inverse: [DVec3; 2],
        normal: DVec3,
        area: f64,
    },
    Disc {
        center: DVec3,
        axes: [DVec3; 2],
        normal: DVec3,
        radius: f64,
    },
    Sphere {
        center: DVec3,
        radius: f64,
    },
}

impl AreaEmitter {
    /// The light in the form that shading uses. The shape must be valid.
    pub fn new(shape: &LightShape, radiance: [f32; 3]) -> AreaEmitter {
        let shape = match *shape {
            LightShape::Rectangle { corner, edges } => {
                let [a, b] = edges.map(DVec3::from_array);
                let cross = a.cross(b);
                let squared = cross.length_squared();
                Shape::Rectangle {
                    corner: DVec3::from_array(corner),
                    edges: [a, b],
                    inverse: [b.cross(cross) / squared, cross.cross(a) / squared],
                    normal: cross.normalize(),
                    area: cross.length(),
                }
            }
            LightShape::Disc { center, normal, radius } => {
                let normal = unit(DVec3::from_array(normal)).unwrap_or(DVec3::Z);
                let axes = frame_around(normal);
                Shape::Disc { center: DVec3::from_array(center), axes, normal, radius }
            }
            LightShape::Sphere { center, radius } => {
                Shape::Sphere { center: DVec3::from_array(center), radius }
            }
        };
        AreaEmitter { shape, radiance: DVec3::from_array(radiance.map(f64::from)) }
    }

    /// A black light: sampled where a test or a measurement forces the effect on.
    pub fn black(center: DVec3) -> AreaEmitter {
        AreaEmitter { shape: Shape::Sphere { center, radius: 1.0 }, radiance: DVec3::ZERO }
    }

    /// The point of the light that belongs to `point` in the unit square, seen from `from`; `None` if it shines elsewhere.
    /// Plane shapes are sampled by area, the sphere by the solid angle that it covers.
    pub fn sample(&self, from: DVec3, point: [f64; 2]) -> Option<LightPoint> {
        match self.shape {
            Shape::Rectangle { corner, edges, normal, area, .. } => {
                let position = corner + edges[0] * point[0] + edges[1] * point[1];
                plane_point(from, position, normal, area)
            }
            Shape::Disc { center, axes, normal, radius } => {
                let [x, y] = disc_point(point);
                let position = center + (axes[0] * x + axes[1] * y) * radius;
                plane_point(from, position, normal, PI * radius * radius)
            }
            Shape::Sphere { center, radius } => {
                let offset = center - from;
                let squared = offset.length_squared();
                let one_minus_cos = cone_of(squared, radius)?;
                let local = cone_direction(point, one_minus_cos);
                let toward = to_frame(offset / squared.sqrt(), local);
                // The nearer of the two points on the line; at the rim rounding may pass it by.
                let along = offset.dot(toward);
                let miss = (offset - toward * along).length_squared();
                let t = along - (radius * radius - miss).max(0.0).sqrt();
                let density = 1.0 / (TAU * one_minus_cos);
                Some(LightPoint { position: from + toward * t, toward, density })
            }
        }
    }

    /// Where the ray from `origin` along the unit vector `direction` meets the lit side, at up to `t_max`.
    pub fn crossing(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<LightCrossing> {
        match self.shape {
            Shape::Rectangle { corner, inverse, normal, area, .. } => {
                let (t, cos) = plane_crossing(origin, direction, corner, normal, t_max)?;
                let offset = origin + direction * t - corner;
                let inside = inverse.iter().all(|axis| (0.0..=1.0).contains(&offset.dot(*axis)));
                inside.then(|| LightCrossing { t, density: t * t / (area * cos) })
            }
            Shape::Disc { center, normal, radius, .. } => {
                let (t, cos) = plane_crossing(origin, direction, center, normal, t_max)?;
                let inside = (origin + direction * t - center).length_squared() <= radius * radius;
                inside.then(|| LightCrossing { t, density: t * t / (PI * radius * radius * cos) })
            }
            Shape::Sphere { center, radius } => {
                let offset = center - origin;
                let one_minus_cos = cone_of(offset.length_squared(), radius)?;
                let along = offset.dot(direction);
                let inside = radius * radius - (offset - direction * along).length_squared();
                if along <= 0.0 || inside < 0.0 {
                    return None;
                }
                let t = along - inside.sqrt();
                (t > 0.0 && t <= t_max).then(|| LightCrossing { t, density: 1.0 / (TAU * one_minus_cos) })
            }
        }
    }
}

/// 1 minus the cosine of the half angle of the cone that a sphere fills, seen from a point at this squared distance from its
/// middle; `None` from inside.
fn cone_of(squared: f64, radius: f64) -> Option<f64> {
    let sin_squared = radius * radius / squared;
    if sin_squared.is_nan() || sin_squared >= 1.0 {
        return None;
    }
    // 1 - cos = sin^2 / (1 + cos) keeps its digits for a far sphere.
    Some(sin_squared / (1.0 + (1.0 - sin_squared).sqrt())).filter(|drop| *drop > 0.0)
}

fn plane_point(from: DVec3, position: DVec3, normal: DVec3, area: f64) -> Option<LightPoint> {
    let offset = position - from;
    let squared = offset.length_squared();
    let toward = offset / squared.sqrt();
    let cos = -toward.dot(normal);
    let density = squared / (area * cos);
    // Not for a point in the plane of the light or at its back.
    (cos > 0.0 && density > 0.0 && density.is_finite()).then_some(LightPoint { position, toward, density })
}

/// Parameter of a ray in a plane, and the cosine there; only from the side of the normal.
fn plane_crossing(
    origin: DVec3,
    direction: DVec3,
    point: DVec3,
    normal: DVec3,
    t_max: f64,
) -> Option<(f64, f64)> {
    let cos = -direction.dot(normal);
    let t = (origin - point).dot(normal) / cos;
    (cos > 0.0 && t > 0.0 && t <= t_max).then_some((t, cos))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shapes() -> [LightShape; 3] {
        [
            LightShape::Rectangle { corner: [-0.5, 2.0, -0.7], edges: [[1.2, 0.0, 0.1], [0.2, 0.1, 1.0]] },
            LightShape::Disc { center: [0.3, 2.0, 0.1], normal: [0.1, -2.0, 0.3], radius: 0.8 },
            LightShape::Sphere { center: [0.2, 1.5, 0.0], radius: 0.7 },
        ]
    }

    /// The rectangle shines along edges[0] x edges[1]; turn it to look down.
    fn emitters() -> [AreaEmitter; 3] {
        shapes().map(|shape| {
            let shape = match shape {
                LightShape::Rectangle { corner, edges: [a, b] } => {
                    let down = DVec3::from_array(a).cross(DVec3::from_array(b)).y < 0.0;
                    LightShape::Rectangle { corner, edges: if down { [a, b] } else { [b, a] } }
                }
                other => other,
            };
            AreaEmitter::new(&shape, [1.0; 3])
        })
    }

    #[test]
    fn a_ray_to_a_sampled_point_crosses_the_light_there_with_the_same_density() {
        let from = DVec3::new(0.4, -0.3, 0.2);
        for emitter in emitters() {
            for step in 0..400 {
                let point = [f64::from(step % 20) + 0.5, f64::from(step / 20) + 0.5].map(|x| x / 20.0);
                let sample = emitter.sample(from, point).unwrap();
                assert!((sample.toward.length() - 1.0).abs() < 1e-12);
                // Not exactly: a point on the border may fall to either side.
                if let Some(crossing) = emitter.crossing(from, sample.toward, f64::INFINITY) {
                    assert!((crossing.density / sample.density - 1.0).abs() < 1e-9, "{emitter:?}");
                    assert!((from + sample.toward * crossing.t - sample.position).length() < 1e-6);
                    let before = 0.999 * crossing.t;
                    assert!(emitter.crossing(from, sample.toward, before).is_none());
                } else {
                    let at_the_rim = matches!(emitter.shape, Shape::Sphere { .. });
                    assert!(at_the_rim && point[0] > 0.9, "{emitter:?} {point:?}");
                }
            }
        }
    }

    /// The mean of 1 / density over samples is the solid angle: compare with counting directions that cross.
    #[test]
    fn densities_integrate_to_the_solid_angle() {
        let from = DVec3::new(0.4, -0.3, 0.2);
        const SIDE: u32 = 400;
        for emitter in emitters() {
            let (mut sampled, mut counted) = (0.0, 0u32);
            for index in 0..SIDE * SIDE {
                let point = [index % SIDE, index / SIDE].map(|i| (f64::from(i) + 0.5) / f64::from(SIDE));
                sampled += 1.0 / emitter.sample(from, point).unwrap().density;
                let direction = cone_direction(point, 2.0);
                counted += u32::from(emitter.crossing(from, direction, f64::INFINITY).is_some());
            }
            let count = f64::from(SIDE * SIDE);
            let (sampled, counted) = (sampled / count, 2.0 * TAU * f64::from(counted) / count);
            assert!((sampled / counted - 1.0).abs() < 3e-3, "{emitter:?}: {sampled} {counted}");
        }
    }

    #[test]
    fn backs_and_insides_are_dark() {
        let [rectangle, disc, sphere] = emitters();
        let above = DVec3::new(0.3, 5.0, 0.1);
        for plane in [rectangle, disc] {
            assert!(plane.sample(above, [0.5; 2]).is_none());
            assert!(plane.crossing(above, DVec3::NEG_Y, f64::INFINITY).is_none());
        }
        let inside = DVec3::new(0.2, 1.4, 0.0);
        assert!(sphere.sample(inside, [0.3, 0.4]).is_none());
        assert!(sphere.crossing(inside, DVec3::X, f64::INFINITY).is_none());
        // From very far away too the density is a number.
        let far = sphere.sample(DVec3::new(1e8, 0.0, 0.0), [0.3, 0.4]).unwrap();
        assert!(far.density.is_finite() && far.density > 1e14);
    }

    #[test]
    fn senseless_shapes_are_refused() {
        let (center, normal) = ([0.0; 3], [0.0, 0.0, 1.0]);
        for bad in [
            LightShape::Rectangle { corner: [f64::NAN; 3], edges: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] },
            LightShape::Rectangle { corner: center, edges: [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]] },
            LightShape::Rectangle { corner: center, edges: [[1e-80, 0.0, 0.0], [0.0, 1e-80, 0.0]] },
            LightShape::Rectangle { corner: center, edges: [[1e80, 0.0, 0.0], [0.0, 1e80, 0.0]] },
            LightShape::Disc { center, normal: [0.0; 3], radius: 1.0 },
            LightShape::Disc { center, normal, radius: 0.0 },
            LightShape::Sphere { center, radius: -1.0 },
            LightShape::Sphere { center, radius: f64::INFINITY },
            LightShape::Sphere { center: [f64::INFINITY; 3], radius: 1.0 },
            LightShape::Disc { center: [0.0, 1e151, 0.0], normal, radius: 1.0 },
        ] {
            assert!(bad.validate().is_err(), "{bad:?}");
        }
        for shape in shapes() {
            assert!(shape.validate().is_ok());
        }
        for length in [1e-300, 1e-162, 1e300] {
            let disc = LightShape::Disc { center, normal: [0.0, 0.6 * length, 0.8 * length], radius: 1.0 };
            assert!(disc.validate().is_ok(), "{length}");
            let normal = DVec3::new(0.0, 0.6, 0.8);
            let seen = AreaEmitter::new(&disc, [1.0; 3]).crossing(normal, -normal, 2.0).unwrap();
            assert!((seen.t - 1.0).abs() < 1e-15 && (seen.density * PI - 1.0).abs() < 1e-14, "{length}");
        }
    }
}
