//! Moeller and Trumbore's test in f64 as it is commonly written, without a bound on any rounding: what `Tier::Double` is.

use super::{Ray, TriangleHit};

/// Whether `ray` meets the triangle, as far as f64 can tell: near edges, at grazing angles and far from the origin hits may
/// be lost, invented or misplaced.
///
/// T. Moeller, B. Trumbore, "Fast, Minimum Storage Ray-Triangle Intersection", Journal of Graphics Tools 2 (1997), the
/// two-sided form. See [`intersect_certified`](super::intersect_certified) for the one that is right.
#[inline]
pub fn intersect_plain(ray: &Ray, vertices: &[[f64; 3]; 3]) -> Option<TriangleHit> {
    let [a, b, c] = *vertices;
    let (ab, ac, from_a) = (minus(b, a), minus(c, a), minus(ray.origin, a));
    let p = cross(ray.direction, ac);
    let inverse = 1.0 / dot(ab, p);
    let u = dot(from_a, p) * inverse;
    let q = cross(from_a, ab);
    let v = dot(ray.direction, q) * inverse;
    let t = dot(ac, q) * inverse;
    // Written so that NaN, and infinity from a determinant of zero, fail.
    let is_inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
    (is_inside && t >= ray.t_min && t <= ray.t_max && t.is_finite()).then_some(TriangleHit { t, u, v })
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::intersect_certified;

    #[test]
    fn easy_hits_are_those_of_the_certified_test() {
        let mut seed = 3u64;
        let mut next = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (seed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
        };
        let mut hits = 0;
        for _ in 0..2000 {
            let mut point = || [next(), next(), next()];
            let triangle = [point(), point(), point()];
            let [a, b, c] = triangle;
            let (origin, aside) = (point().map(|x| 3.0 * x), point());
            let target = [0, 1, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0 + 0.5 * aside[axis]);
            let ray = Ray { t_min: 0.5, t_max: 3.0, ..Ray::new(origin, minus(target, origin)) };
            let (plain, certified) =
                (intersect_plain(&ray, &triangle), intersect_certified(&ray, &triangle, &mut 0));
            assert_eq!(plain.is_some(), certified.is_some());
            if let (Some(plain), Some(certified)) = (plain, certified) {
                hits += 1;
                assert!((plain.t - certified.t).abs() < 1e-9 * certified.t.max(1.0));
                assert!((plain.u - certified.u).abs() < 1e-9 && (plain.v - certified.v).abs() < 1e-9);
            }
        }
        assert!(hits > 300, "{hits}");
    }

    #[test]
    fn parallel_and_flat_never_hit() {
        let ray = Ray::new([0.0; 3], [1.0, 0.0, 0.0]);
        assert_eq!(intersect_plain(&ray, &[[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [1.0, 1.0, 0.0]]), None);
        assert_eq!(intersect_plain(&ray, &[[1.0, 0.0, 0.0]; 3]), None);
        assert_eq!(intersect_plain(&ray, &[[f64::NAN; 3]; 3]), None);
    }
}
