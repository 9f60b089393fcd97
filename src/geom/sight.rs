//! Lines of sight between points that may lie on surfaces.

use super::Ray;
use super::offset::offset_origin;

/// One end of a line of sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SightEnd {
    /// A point that belongs to no surface.
    Free([f64; 3]),
    /// A point of a surface, which is not to block the view of its own points.
    Surface {
        /// Where it is.
        position: [f64; 3],
        /// How far from the surface it may be, per axis: [`position_error`](super::position_error).
        error: f64,
        /// The geometric normal, of any length: [`triangle_normal`](super::triangle_normal).
        normal: [f64; 3],
    },
}

impl SightEnd {
    /// Where a line towards `other` begins.
    fn start(&self, other: &SightEnd) -> [f64; 3] {
        let position = self.position();
        match *self {
            SightEnd::Free(_) => position,
            SightEnd::Surface { error, normal, .. } => {
                offset_origin(position, error, normal, direction(position, other.position()))
            }
        }
    }

    fn position(&self) -> [f64; 3] {
        match *self {
            SightEnd::Free(position) | SightEnd::Surface { position, .. } => position,
        }
    }
}

fn direction(from: [f64; 3], to: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|axis| to[axis] - from[axis])
}

/// Where a line of sight ends, in its lengths: `t` of a hit is off by a factor of up to `1 + 2^-40`.
const END: f64 = 1.0 - 1.0 / (1u64 << 39) as f64;

/// The ray from `from` to `to`, whose `t` runs from 0 to just under 1; `None` if the points are the same. Whether anything
/// lies on it is whether one sees the other.
///
/// An end on a surface is moved off it by [`offset_origin`], to the side of the other end, so with the guarantee given there the
/// triangle that it lies on does not block the view, at any translation. What lies on `to` itself, within `2^-39` of the
/// distance, does not block it either. A surface end seen from the back of its triangle is seen, unless
/// something else lies between: for an opaque body that is its other side.
pub fn line_of_sight(from: &SightEnd, to: &SightEnd) -> Option<Ray> {
    let (start, end) = (from.start(to), to.start(from));
    let direction = direction(start, end);
    (direction != [0.0; 3]).then_some(Ray { t_max: END, ..Ray::new(start, direction) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{RayFrame, position_error, triangle_normal};

    /// Pairs of points on two triangles that face each other.
    #[test]
    fn the_surfaces_at_the_ends_do_not_block() {
        let mut state = 3u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1u64 << 53) as f64
        };
        for translation in [0.0, 1e4, 1e6, 1e7] {
            for distance in [1e-3, 1.0, 1e5] {
                for _ in 0..2000 {
                    let mut triangle = |x: f64| {
                        [0, 1, 2].map(|_| {
                            [x + 0.2 * distance * random(), distance * random(), distance * random()]
                                .map(|x| x + translation)
                        })
                    };
                    let triangles = [triangle(0.0), triangle(distance)];
                    let ends = triangles.map(|vertices| {
                        let (u, v) = (0.5 * random(), 0.5 * random());
                        SightEnd::Surface {
                            position: crate::geom::hit_position(&vertices, u, v),
                            error: position_error(&vertices, u, v),
                            normal: triangle_normal(&vertices),
                        }
                    });
                    let frame = RayFrame::new(&line_of_sight(&ends[0], &ends[1]).unwrap());
                    for (triangle, end) in triangles.iter().zip(&ends) {
                        assert_eq!(frame.intersect(triangle, &mut 0), None, "{end:?} at {translation}");
                    }
                }
            }
        }
    }

    #[test]
    fn free_ends_stay_where_they_are_and_equal_ones_make_no_ray() {
        let (a, b) = (SightEnd::Free([1.0, 2.0, 3.0]), SightEnd::Free([1.0, 2.0, 5.0]));
        let ray = line_of_sight(&a, &b).unwrap();
        assert_eq!((ray.origin, ray.direction, ray.t_min), ([1.0, 2.0, 3.0], [0.0, 0.0, 2.0], 0.0));
        assert!(ray.t_max < 1.0 && ray.t_max > 1.0 - 1e-11);
        assert_eq!(line_of_sight(&a, &a), None);
    }
}
