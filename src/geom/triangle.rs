//! The scalar certified test: the meaning of "hit" for the whole library (I2, I3).

use super::{Ray, RayFrame};

/// A certified hit of a ray on one triangle: canonical `t` and barycentrics from one fixed f64 operation order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TriangleHit {
    /// Ray parameter, off by a factor within `1 +- 2^-40`.
    pub t: f64,
    /// Weight of the second vertex, in `0 ..= 1`, off by at most `2^-24`.
    pub u: f64,
    /// Weight of the third vertex, in `0 ..= 1` with `u + v <= 1`, off by at most `2^-24`.
    pub v: f64,
}

/// Decides exactly whether `ray` meets the closed triangle, and where: [`RayFrame::intersect`] for a single call.
///
/// For several triangles prepare the [`RayFrame`] once.
pub fn intersect_certified(
    ray: &Ray,
    vertices: &[[f64; 3]; 3],
    exact_fallbacks: &mut u64,
) -> Option<TriangleHit> {
    RayFrame::new(ray).intersect(vertices, exact_fallbacks)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRIANGLE: [[f64; 3]; 3] = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];

    fn hit(origin: [f64; 3], direction: [f64; 3]) -> Option<TriangleHit> {
        intersect_certified(&Ray::new(origin, direction), &TRIANGLE, &mut 0)
    }

    #[test]
    fn hits_inside_edges_vertices_and_both_sides() {
        let inside = Some(TriangleHit { t: 0.5, u: 0.25, v: 0.5 });
        assert_eq!(hit([0.25, 0.5, 0.0], [0.0, 0.0, 2.0]), inside);
        assert_eq!(hit([0.25, 0.5, 2.0], [0.0, 0.0, -2.0]), inside);
        assert_eq!(hit([0.5, 0.5, 0.0], [0.0, 0.0, 1.0]), Some(TriangleHit { t: 1.0, u: 0.5, v: 0.5 }));
        assert_eq!(hit([0.0, 0.0, 0.0], [0.0, 0.0, 1.0]), Some(TriangleHit { t: 1.0, u: 0.0, v: 0.0 }));
        assert_eq!(hit([0.0, 1.0, 1.0], [1.0, 0.0, 1.0]), Some(TriangleHit { t: 0.0, u: 0.0, v: 1.0 }));
        assert_eq!(hit([0.5, 0.5f64.next_up(), 0.0], [0.0, 0.0, 1.0]), None);
        assert_eq!(hit([0.0, -f64::from_bits(1), 0.0], [0.0, 0.0, 1.0]).map(|h| h.t), Some(1.0));
        assert_eq!(hit([0.25, 0.25, 2.0], [0.0, 0.0, 1.0]), None);
    }

    #[test]
    fn parallel_rays_and_flat_triangles_are_never_hit() {
        assert_eq!(hit([-1.0, 0.25, 1.0], [1.0, 0.0, 0.0]), None);
        for flat in [[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [2.0, 0.0, 1.0]], [[0.5, 0.0, 1.0]; 3]] {
            let ray = Ray::new([0.5, 0.0, 0.0], [0.0, 0.0, 1.0]);
            assert_eq!(intersect_certified(&ray, &flat, &mut 0), None);
        }
    }

    #[test]
    fn the_interval_is_closed() {
        let ray = Ray { t_min: 1.0, t_max: 1.0, ..Ray::new([0.25, 0.25, 0.0], [0.0, 0.0, 1.0]) };
        assert!(intersect_certified(&ray, &TRIANGLE, &mut 0).is_some());
        let before = Ray { t_min: 0.0, t_max: 1f64.next_down(), ..ray };
        assert_eq!(intersect_certified(&before, &TRIANGLE, &mut 0), None);
        let after = Ray { t_min: 1f64.next_up(), t_max: f64::INFINITY, ..ray };
        assert_eq!(intersect_certified(&after, &TRIANGLE, &mut 0), None);
    }

    #[test]
    fn nothing_outside_the_domain_panics_or_gives_nan() {
        let odd = [0.0, -0.0, 1.0, -3.5, 1e-320, 1e-70, -1e100, 1e300, f64::MAX, f64::INFINITY, f64::NAN];
        let mut seed = 1u64;
        let mut pick = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            odd[(seed >> 33) as usize % odd.len()]
        };
        let mut hits = 0;
        for _ in 0..200_000 {
            let mut vector = || [pick(), pick(), pick()];
            let ray = Ray::new(vector(), vector());
            let vertices = [vector(), vector(), vector()];
            if let Some(hit) = intersect_certified(&ray, &vertices, &mut 0) {
                hits += 1;
                assert!(
                    hit.t >= 0.0 && hit.t.is_finite() && hit.u >= 0.0 && hit.v >= 0.0 && hit.u + hit.v <= 1.0
                );
                assert!(vertices.iter().flatten().all(|x| x.is_finite()));
            }
        }
        assert!(hits > 0);
    }

    #[test]
    fn directions_of_any_length_scale_t_exactly() {
        let reference = hit([0.25, 0.5, 0.0], [0.0, 0.125, 1.0]).unwrap();
        for exponent in [-1000, -500, -1, 1, 500, 1000] {
            let factor = 2f64.powi(exponent);
            let scaled = hit([0.25, 0.5, 0.0], [0.0, 0.125 * factor, factor]).unwrap();
            assert_eq!(scaled, TriangleHit { t: reference.t / factor, ..reference });
        }
        let tiny = hit([0.25, 0.5, 0.0], [0.0, 0.0, f64::from_bits(1)]).unwrap();
        assert_eq!(tiny, TriangleHit { t: f64::MAX, u: 0.25, v: 0.5 });
        assert_eq!(hit([0.25, 0.5, 0.0], [0.0, 0.0, f64::MAX]).unwrap().u, 0.25);
    }
}
