//! Which triangle a line crosses where triangles meet.
//!
//! Triangles are closed, so a line through an edge or a vertex hits every triangle there. To cross a surface once it must
//! belong to one of them. The rule is symbolic perturbation (H. Edelsbrunner and E. Mücke, "Simulation of Simplicity", 1990):
//! the origin is moved by `(e, e^2, e^3)` for an infinitesimal `e > 0`, the direction is kept. The moved line meets no edge
//! and no vertex, unless it is parallel to the edge, and then it meets no triangle there.

use super::frame::edge_functions;
use super::{RayFrame, triangle_exact};

/// From which side a line goes through a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Sense {
    /// Against the geometric normal: into a body whose normals point outward.
    Entry,
    /// Along the geometric normal: out of such a body.
    Exit,
}

impl Sense {
    /// The other one.
    #[inline]
    pub fn opposite(self) -> Sense {
        match self {
            Sense::Entry => Sense::Exit,
            Sense::Exit => Sense::Entry,
        }
    }
}

impl RayFrame {
    /// In which sense the line of the ray, moved by an infinitesimal amount, crosses the triangle; `None` if it does not.
    /// Decided exactly, with the domain of [`RayFrame::intersect`]; the ray's interval does not count.
    ///
    /// # Guarantee
    /// The triangles that are crossed are among those that the line meets. Of the triangles around an edge or a vertex that
    /// the line passes through from one side of a surface to the other, the crossings in one sense are one more than those
    /// in the other, and usually one is crossed and no other. Over all triangles of a closed, consistently oriented surface,
    /// entries and exits are equal in number, whatever edges and vertices the line passes through: the moved line is in
    /// general position, and the same one for every triangle.
    ///
    /// At a silhouette, where the line touches an edge or a vertex and stays on one side, there is no crossing, or an entry
    /// and an exit at the same point. On the border of an open surface a hit is a crossing or not.
    #[inline]
    pub fn crossing(&self, vertices: &[[f64; 3]; 3]) -> Option<Sense> {
        let ([u, v, w], error) = edge_functions(self, vertices);
        let sign = if u > error && v > error && w > error {
            1
        } else if u < -error && v < -error && w < -error {
            -1
        } else {
            triangle_exact::moved_sign(self, vertices)
        };
        match sign {
            0 => None,
            sign if sign < 0 => Some(Sense::Entry),
            _ => Some(Sense::Exit),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Ray;

    /// Counter-clockwise seen from +z, about the origin.
    const FAN: [[f64; 3]; 6] = [
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-1.0, 1.0, 0.0],
        [-1.0, 0.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, -1.0, 0.0],
    ];

    #[test]
    fn a_vertex_and_its_edges_are_crossed_once() {
        for target in [[0.0, 0.0], [0.5, 0.0], [-0.5, 0.5], [0.0, -0.25], [0.25, 0.25]] {
            for (height, sense) in [(4.0, Sense::Entry), (-4.0, Sense::Exit)] {
                let ray = Ray::new([target[0], target[1], height], [0.0, 0.0, -height]);
                let frame = RayFrame::new(&ray);
                let crossings: Vec<Sense> =
                    (0..6).filter_map(|i| frame.crossing(&[[0.0; 3], FAN[i], FAN[(i + 1) % 6]])).collect();
                assert_eq!(crossings, [sense], "{target:?}");
            }
        }
    }

    #[test]
    fn a_ridge_that_is_touched_is_crossed_twice_or_not_at_all() {
        let roof = |z: f64| {
            let [a, b] = [[0.0, -1.0, 0.0], [0.0, 1.0, 0.0]];
            [[a, b, [-1.0, 0.0, z]], [b, a, [1.0, 0.0, z]]]
        };
        for direction in [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [1.0, 0.25, 0.0]] {
            for slope in [-1.0, 1.0] {
                let ray = Ray::new(direction.map(|x: f64| -2.0 * x), direction);
                let senses = roof(slope).map(|triangle| RayFrame::new(&ray).crossing(&triangle));
                match senses {
                    [None, None] => {}
                    [Some(a), Some(b)] => assert_eq!(a, b.opposite()),
                    one => panic!("{one:?}"),
                }
            }
        }
    }

    #[test]
    fn what_is_parallel_flat_or_not_finite_is_never_crossed() {
        let frame = RayFrame::new(&Ray::new([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]));
        let parallel = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 1.0, 0.0]];
        let flat = [[1.0, 0.0, -1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 1.0]];
        let broken = [[1.0, f64::NAN, -1.0], [1.0, -1.0, -1.0], [1.0, 0.0, f64::INFINITY]];
        for triangle in [parallel, flat, broken, [[1.0, 0.0, 0.0]; 3]] {
            assert_eq!(frame.crossing(&triangle), None);
        }
    }
}
