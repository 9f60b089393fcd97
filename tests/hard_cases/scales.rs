//! The smallest and largest models, directions and details.

use outcrop::geom::{Precision, Ray};

use crate::cases::{self, Case, Random};
use crate::everywhere::check;

#[test]
fn radii_from_1e_3_to_1e_18_and_extent_6e11() {
    for (name, scale) in cases::sizes() {
        check(&cases::sphere_of_size(name, scale));
    }
}

#[test]
fn denormal_directions() {
    let mut case = cases::denormal_directions();
    check(&case);
    // And those that are subnormal in f64: the model is small, so that `t` is still a number.
    case = cases::sphere_of_size("denormal_directions", 2f64.powi(-20));
    case.rays.truncate(100);
    for ray in &mut case.rays {
        ray.direction = ray.direction.map(|x| x * 2f64.powi(-1013));
        assert!(ray.direction.iter().all(|x| x.abs() < f64::MIN_POSITIVE));
    }
    check(&case);
}

#[test]
fn detail_of_1e_3_at_1e7() {
    check(&cases::detail_far_out());
}

#[test]
fn tiny_and_huge_side_by_side() {
    // A sphere of radius 1e-6 on one of radius 1e6: boxes and errors of both scales in one tree.
    let mut triangles = cases::sphere([0.0; 3], 1e6, 2, 0.125);
    triangles.extend(cases::sphere([0.0, 0.0, 1.0], 2f64.powi(-20), 2, 2f64.powi(-40)));
    let mut random = Random(12);
    let mut rays = Vec::new();
    for target in cases::vertices(&triangles) {
        let origin = random.vector(0.01).map(|x| f64::from(x as f32));
        rays.push(Ray::new(origin, cases::minus(target, origin)));
    }
    // f32 holds 1 + 2^-23 and no finer.
    let triangles: Vec<_> = triangles.into_iter().map(|t| t.map(cases::to_f32)).collect();
    check(&Case { name: "tiny_and_huge_side_by_side", precision: Precision::Float32, triangles, rays });
}
