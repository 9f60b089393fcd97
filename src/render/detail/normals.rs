//! Smooth normals: what light falls on is the curved surface that a mesh stands for, what rays meet is the mesh.
//!
//! The interpolated normal decides how much light a point answers to. The triangle's own normal decides from which side it is seen and
//! where rays begin. Where the two disagree there are three rules. A normal is turned to the side that is seen. One that
//! faces away from the viewer, as happens at the rim of a coarse mesh, is bent until it does not. And rays on the side that is
//! seen begin where the curved surface would be (J. Hanika, "Hacking the Shadow Terminator", Ray Tracing Gems II, 2021): without
//! that each triangle would shade its neighbours at the border of light and dark.

use glam::DVec3;

use crate::trace::Hit;

/// The normal that shading uses at a hit, and how far above the triangle the curved surface is there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Smooth {
    /// Unit.
    pub normal: DVec3,
    /// From the triangle to the curved surface; never to the far side.
    pub lift: DVec3,
}

/// The least cosine between a normal and the way back to the viewer.
const COSINE_MIN: f64 = 1e-3;

/// `geometric` is the triangle's unit normal on the side of `view`, the unit vector back along the ray.
pub(crate) fn smooth(hit: &Hit, normals: &[[f64; 3]; 3], geometric: DVec3, view: DVec3) -> Smooth {
    let weights = [1.0 - hit.u - hit.v, hit.u, hit.v];
    let corners = hit.vertices.map(DVec3::from_array);
    let mut normals = normals.map(DVec3::from_array);
    // All together: which side they mean is a matter of the triangle, not of a corner.
    if (normals[0] + normals[1] + normals[2]).dot(geometric) < 0.0 {
        normals = normals.map(|normal| -normal);
    }
    let sum = normals[0] * weights[0] + normals[1] * weights[1] + normals[2] * weights[2];
    let normal = sum.try_normalize().filter(|normal| normal.dot(geometric) > 0.0).unwrap_or(geometric);
    let position = DVec3::from_array(hit.position());
    let mut lift = DVec3::ZERO;
    for ((corner, normal), weight) in corners.iter().zip(normals).zip(weights) {
        let depth = (position - *corner).dot(normal);
        // Below the tangent plane of the corner, up to which the curved surface may bulge.
        if depth < 0.0 && weight > 0.0 && normal.dot(geometric) > 0.0 {
            lift -= normal * (depth * weight);
        }
    }
    Smooth { normal: facing(normal, view), lift }
}

/// `normal`, bent toward `view` if it faces away from it.
pub(crate) fn facing(normal: DVec3, view: DVec3) -> DVec3 {
    let cosine = normal.dot(view);
    if cosine >= COSINE_MIN {
        return normal;
    }
    // Zero only if the normal is just opposite to the view.
    (normal + view * (COSINE_MIN - cosine)).try_normalize().unwrap_or(view)
}

/// A direction that shall leave on the side of `side`, bent there if the normal of shading sent it to the other.
pub(crate) fn on_side(direction: DVec3, side: DVec3) -> DVec3 {
    let cosine = direction.dot(side);
    if cosine > 0.0 {
        return direction;
    }
    (direction + side * (COSINE_MIN - cosine)).try_normalize().unwrap_or(side)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{MaterialId, TriangleId};

    fn hit(u: f64, v: f64) -> Hit {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
        Hit { t: 1.0, u, v, triangle: TriangleId(0), material: MaterialId(0), vertices }
    }

    fn unit(x: f64, y: f64, z: f64) -> [f64; 3] {
        DVec3::new(x, y, z).normalize().to_array()
    }

    #[test]
    fn normals_are_interpolated_and_turned_to_the_side_that_is_seen() {
        let normals = [unit(-0.3, -0.3, 1.0), unit(0.5, 0.0, 1.0), unit(0.0, 0.5, 1.0)];
        let above = smooth(&hit(0.25, 0.25), &normals, DVec3::Z, DVec3::Z);
        let sum = normals.map(DVec3::from_array);
        let expected = (sum[0] * 0.5 + sum[1] * 0.25 + sum[2] * 0.25).normalize();
        assert!((above.normal - expected).length() < 1e-15);
        let below = smooth(&hit(0.25, 0.25), &normals, -DVec3::Z, -DVec3::Z);
        assert!((below.normal + expected).length() < 1e-15);
        // Normals that are stored the wrong way round mean the same.
        let turned = normals.map(|normal| normal.map(|x| -x));
        assert_eq!(smooth(&hit(0.25, 0.25), &turned, DVec3::Z, DVec3::Z), above);
        // At a corner it is the corner's.
        assert!((smooth(&hit(1.0, 0.0), &normals, DVec3::Z, DVec3::Z).normal - sum[1]).length() < 1e-15);
    }

    #[test]
    fn the_lift_goes_up_to_a_bulge_and_never_into_a_hollow() {
        let bulge = [unit(-1.0, -1.0, 2.0), unit(1.0, 0.0, 2.0), unit(0.0, 1.0, 2.0)];
        let middle = hit(1.0 / 3.0, 1.0 / 3.0);
        let lift = smooth(&middle, &bulge, DVec3::Z, DVec3::Z).lift;
        assert!(lift.z > 0.05 && lift.z < 0.5, "{lift}");
        for corner in [hit(0.0, 0.0), hit(1.0, 0.0), hit(0.0, 1.0)] {
            assert!(smooth(&corner, &bulge, DVec3::Z, DVec3::Z).lift.length() < 1e-15);
        }
        // From within the bulge it is a hollow: the surface lies behind the triangle.
        assert_eq!(smooth(&middle, &bulge, -DVec3::Z, -DVec3::Z).lift, DVec3::ZERO);
        let flat = [[0.0, 0.0, 1.0]; 3];
        let flat = smooth(&middle, &flat, DVec3::Z, DVec3::Z);
        assert_eq!(flat, Smooth { normal: DVec3::Z, lift: DVec3::ZERO });
    }

    #[test]
    fn normals_that_face_away_are_bent_or_given_up() {
        let view = DVec3::new(1.0, 0.0, 0.05).normalize();
        let tilted = [unit(-1.0, 0.0, 0.5); 3];
        let normal = smooth(&hit(0.2, 0.2), &tilted, DVec3::Z, view).normal;
        assert!(normal.dot(view) > 0.0 && (normal.length() - 1.0).abs() < 1e-14, "{normal}");
        // They cancel, or lie in the triangle: its own is taken.
        let opposite = [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]];
        assert_eq!(smooth(&hit(0.5, 0.0), &opposite, DVec3::Z, DVec3::Z).normal, DVec3::Z);
        assert_eq!(facing(-DVec3::Z, DVec3::Z), DVec3::Z);
        assert!(on_side(DVec3::new(1.0, 0.0, -0.2), DVec3::Z).dot(DVec3::Z) > 0.0);
        assert_eq!(on_side(DVec3::X, -DVec3::X), -DVec3::X);
    }
}
