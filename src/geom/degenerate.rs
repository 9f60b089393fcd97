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
    for (j, k) in [(1, 2), (2, 0), (0, 1)] {
        let (p, q) = (ab[j] * ac[k], ab[k] * ac[j]);
        // Each product is two differences and a multiplication away from exact, the difference one more; the bound
        // itself rounds. A component that is certainly not zero settles it.
        if (p - q).abs() > gamma(6) * (p.abs() + q.abs()) + f64::MIN_POSITIVE {
            return false;
        }
    }
    triangle_exact::is_degenerate(vertices)
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
}
