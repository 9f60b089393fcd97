//! Whether a triangle has any area at all.

use super::float::gamma;
use super::triangle_exact;

/// Whether the triangle's area is exactly zero: two vertices coincide or all three lie on one line. Decided exactly; false for
/// vertices that are not finite.
#[inline]
pub fn is_degenerate(vertices: &[[f64; 3]; 3]) -> bool {
    let [a, b, c] = vertices;
    let ab = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
    let ac = [c[0] - a[0], c[1] - a[1], c[2] - a[2]];
    for (j, k) in AXES {
        if is_certain([ab[j], ab[k]], [ac[j], ac[k]]) {
            return false;
        }
    }
    triangle_exact::is_degenerate(vertices)
}

/// The axes that make up each component of a cross product.
const AXES: [(usize, usize); 3] = [(1, 2), (2, 0), (0, 1)];

/// Whether a component of the cross product of two edges is certainly not zero.
#[inline(always)]
fn is_certain(ab: [f64; 2], ac: [f64; 2]) -> bool {
    let (p, q) = (ab[0] * ac[1], ab[1] * ac[0]);
    // Each product is two differences and a multiplication away from exact, the difference one more; the bound
    // itself rounds. A component that is certainly not zero settles it.
    (p - q).abs() > gamma(6) * (p.abs() + q.abs()) + f64::MIN_POSITIVE
}

/// How many triangles in front are settled by the component of their cross products that the axes `J` and `K` make up.
#[inline(always)]
fn settled<const J: usize, const K: usize, C: Copy, R: Copy>(
    triangles: &[[C; 3]],
    position: &impl Fn(C) -> [R; 3],
    wide: &impl Fn(R) -> f64,
) -> usize {
    for (index, &[a, b, c]) in triangles.iter().enumerate() {
        let (a, b, c) = (position(a), position(b), position(c));
        let (aj, ak) = (wide(a[J]), wide(a[K]));
        let (ab, ac) = ([wide(b[J]) - aj, wide(b[K]) - ak], [wide(c[J]) - aj, wide(c[K]) - ak]);
        if !is_certain(ab, ac) {
            return index;
        }
    }
    triangles.len()
}

/// How many of `triangles` are degenerate as [`is_degenerate`] has it; `position` gives the place of a corner, and `wide` makes a
/// coordinate f64. Neighbours are mostly settled by the same component, so that the one that settled the last triangle is tried first.
#[inline]
pub fn count_degenerate<C: Copy, R: Copy>(
    triangles: &[[C; 3]],
    position: impl Fn(C) -> [R; 3],
    wide: impl Fn(R) -> f64,
) -> u64 {
    let (mut rest, mut count, mut axis, mut failed) = (triangles, 0, 0, 0);
    while let Some(first) = rest.first() {
        let front = match axis {
            0 => settled::<1, 2, _, _>(rest, &position, &wide),
            1 => settled::<2, 0, _, _>(rest, &position, &wide),
            _ => settled::<0, 1, _, _>(rest, &position, &wide),
        };
        rest = &rest[front..];
        failed = if front > 0 { 1 } else { failed + 1 };
        axis = (axis + 1) % 3;
        if failed == 3 {
            let [a, b, c] = [position(first[0]), position(first[1]), position(first[2])];
            let wide3 = |[x, y, z]: [R; 3]| [wide(x), wide(y), wide(z)];
            count += u64::from(triangle_exact::is_degenerate(&[wide3(a), wide3(b), wide3(c)]));
            rest = &rest[1..];
            failed = 0;
        }
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_exact_lines_and_points_are_degenerate() {
        let p = [0.1, 0.2, 0.3];
        let third = |t: f64| [1.0 + t * 4.0, 2.0 + t * 8.0, -3.0 + t * 16.0];
        assert!(is_degenerate(&[p, p, p]));
        assert!(is_degenerate(&[p, [1.0, 2.0, 3.0], p]));
        assert!(is_degenerate(&[third(0.0), third(1.0), third(5.0)]));
        assert!(!is_degenerate(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1e-300, 0.0]]));
        let mut bent = [third(0.0), third(1.0), third(5.0)];
        bent[2][1] = bent[2][1].next_up();
        assert!(!is_degenerate(&bent));
        assert!(!is_degenerate(&[[f64::NAN; 3], p, p]));
    }

    #[test]
    fn many_are_counted_as_one_by_one() {
        use crate::procedural::random::Random;
        // Few places on a small grid: about a tenth of the triangles are lines or points.
        let mut random = Random::new(3);
        let mut number = |below: u64| random.next_u64() % below;
        let points: Vec<[f32; 3]> = (0..60).map(|_| [0; 3].map(|_| number(4) as f32)).collect();
        for _ in 0..200 {
            let triangles: Vec<[u16; 3]> =
                (0..number(40)).map(|_| [0; 3].map(|_| number(60) as u16)).collect();
            let position = |corner: u16| points[usize::from(corner)];
            let naive = triangles
                .iter()
                .filter(|corners| is_degenerate(&corners.map(|corner| position(corner).map(f64::from))));
            assert_eq!(count_degenerate(&triangles, position, f64::from), naive.count() as u64);
        }
    }
}
