//! Rays along the axes, zeros of both signs, and geometry exactly where trees split space.

use outcrop::geom::{Precision, Ray};

use crate::cases::{self, Case};
use crate::everywhere::check;

#[test]
fn axes_split_planes_and_cell_corners() {
    check(&cases::on_split_planes());
}

#[test]
fn signs_of_zero_do_not_matter() {
    // Each ray with every choice of signs for its zeros, of origin and direction: the same hit.
    let case = cases::on_split_planes();
    let base: Vec<Ray> = case.rays.iter().step_by(9).copied().collect();
    let mut rays = Vec::new();
    for ray in &base {
        for signs in 0..64 {
            let sign = |x: f64, bit: usize| if x == 0.0 && signs >> bit & 1 == 1 { -0.0 } else { x + 0.0 };
            let origin = [0, 1, 2].map(|axis| sign(ray.origin[axis], axis));
            let direction = [0, 1, 2].map(|axis| sign(ray.direction[axis], 3 + axis));
            rays.push(Ray::new(origin, direction));
        }
    }
    let octree = crate::everywhere::open(&crate::everywhere::source(&case, 4 << 10), Default::default());
    let hits = crate::everywhere::closest(&octree, &rays);
    for (ray, hits) in base.iter().zip(hits.chunks(64)) {
        assert!(hits.iter().all(|hit| *hit == hits[0]), "{ray:?}");
    }
}

#[test]
fn flat_models_have_boxes_without_depth() {
    for axis in 0..3 {
        let turn = |p: [f64; 3]| [p[(3 - axis) % 3], p[(4 - axis) % 3], p[(5 - axis) % 3]];
        let flat = cases::grid_from_above();
        let triangles: Vec<_> = flat.triangles.iter().map(|t| t.map(|p| turn([p[0], p[1], 0.0]))).collect();
        let rays = flat
            .rays
            .iter()
            .map(|ray| {
                let down = [ray.origin[0], ray.origin[1], if ray.direction[2] < 0.0 { 8.0 } else { -8.0 }];
                Ray::new(turn(down), turn(ray.direction))
            })
            .collect();
        let name = "flat_models_have_boxes_without_depth";
        check(&Case { name, precision: Precision::Float32, triangles, rays });
    }
}
