//! What a ray meets in a whole model, by exact integers; and what to call an answer that differs.

use std::cmp::Ordering;

use dashu::rational::RBig;
use outcrop::geom::Ray;

use crate::oracle::Exact;

pub type Triangle = [[f64; 3]; 3];

/// A hit as real numbers have it.
pub struct ExactHit {
    pub triangle: usize,
    pub t: RBig,
}

/// Everything that a ray meets inside its interval, nearest first; equal ones by triangle.
pub struct Truth {
    pub hits: Vec<ExactHit>,
}

/// An answer held against the truth.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Right,
    /// Something is met, nothing was found.
    Lost,
    /// Nothing is met, something was found.
    Invented,
    /// What was found is not the nearest, is not met at all, or its `t` is off by more than allowed.
    Misplaced,
    /// The nearest of several equal triangles has a lower number.
    NotTheLowest,
}

/// `x` as a rational number. It is finite.
pub fn exact(x: f64) -> RBig {
    RBig::try_from(x).unwrap()
}

fn magnitude(x: RBig) -> RBig {
    if x < RBig::ZERO { -x } else { x }
}

/// Whether the ray's line certainly passes the triangle by, told by its ball with room for every rounding.
fn passes_by(ray: &Ray, triangle: &Triangle) -> bool {
    let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let longest = ray.direction.iter().fold(0.0f64, |longest, x| longest.max(x.abs()));
    if !(1e-60..1e60).contains(&longest) {
        return false;
    }
    let d = ray.direction.map(|x| x / longest);
    let center = [0, 1, 2].map(|axis| triangle.iter().map(|p| p[axis] / 3.0).sum::<f64>());
    let radius = triangle.iter().map(|p| dot(minus(*p, center), minus(*p, center))).fold(0.0, f64::max);
    let away = minus(center, ray.origin);
    let cross =
        [away[1] * d[2] - away[2] * d[1], away[2] * d[0] - away[0] * d[2], away[0] * d[1] - away[1] * d[0]];
    // Far more than the rounding of the lines above, of which the centre's is the largest.
    let largest = center.iter().chain(&ray.origin).fold(0.0f64, |largest, x| largest.max(x.abs()));
    let slack = 1e-12 * largest * largest * dot(d, d) + 1e-9 * dot(away, away) * dot(d, d);
    let distance = dot(cross, cross);
    distance.is_finite() && radius.is_finite() && distance > 1.1 * radius * dot(d, d) + slack
}

impl Truth {
    pub fn of(ray: &Ray, triangles: &[Triangle]) -> Truth {
        let (low, high) = (exact(ray.t_min), ray.t_max.is_finite().then(|| exact(ray.t_max)));
        let mut hits: Vec<ExactHit> = Vec::new();
        for (triangle, vertices) in triangles.iter().enumerate() {
            if passes_by(ray, vertices) {
                continue;
            }
            let against = Exact::new(ray, vertices);
            if !against.meets() || against.t_sign() < 0 {
                continue;
            }
            let t = against.t();
            if t >= low && high.as_ref().is_none_or(|high| t <= *high) {
                hits.push(ExactHit { triangle, t });
            }
        }
        hits.sort_by(|a, b| a.t.cmp(&b.t).then(a.triangle.cmp(&b.triangle)));
        Truth { hits }
    }

    /// Judges a closest hit: `t` may be off by `tolerance` of itself, and hits no farther apart than that count as
    /// equally near. Of triangles with the same vertices the first is right.
    pub fn judge(&self, found: Option<(f64, usize)>, triangles: &[Triangle], tolerance: f64) -> Verdict {
        let (Some((t, triangle)), Some(nearest)) = (found, self.hits.first()) else {
            return match (found, self.hits.first()) {
                (None, None) => Verdict::Right,
                (None, Some(_)) => Verdict::Lost,
                _ => Verdict::Invented,
            };
        };
        let allowed = exact(tolerance) * &nearest.t;
        let is_near = |t: &RBig| magnitude(t - &nearest.t) <= allowed;
        let met = self.hits.iter().find(|hit| hit.triangle == triangle);
        if !t.is_finite() || !is_near(&exact(t)) || met.is_none_or(|hit| !is_near(&hit.t)) {
            return Verdict::Misplaced;
        }
        let is_twin = |hit: &&ExactHit| triangles[hit.triangle] == triangles[triangle];
        match self.hits.iter().filter(is_twin).map(|hit| hit.triangle.cmp(&triangle)).min() {
            Some(Ordering::Less) => Verdict::NotTheLowest,
            _ => Verdict::Right,
        }
    }
}
