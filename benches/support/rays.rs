//! Rays of the benchmarks: from the camera of the gears' standard view, and where light goes at a hit.
#![allow(dead_code)]

#[path = "../../tests/support/numbers.rs"]
pub mod numbers;

use outcrop::geom::Ray;
use outcrop::procedural::Gears;
use outcrop::trace::Hit;

use numbers::{Random, cross, dot, unit};

/// The ray through the middle of a pixel of a square picture of `size` pixels a side.
pub fn camera_ray([x, y]: [u32; 2], size: u32) -> Ray {
    let forward = unit(Gears::EYE.map(|x| -x));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let half = 22.5f64.to_radians().tan();
    let place = |i: u32| half * (2.0 * (f64::from(i) + 0.5) / f64::from(size) - 1.0);
    Ray::new(Gears::EYE, [0, 1, 2].map(|k| forward[k] + place(x) * right[k] - place(y) * up[k]))
}

/// Any direction, evenly distributed. Added to a unit normal it is distributed as the cosine: a point on the unit sphere that
/// touches the surface.
pub fn any_direction(random: &mut Random) -> [f64; 3] {
    loop {
        let any = random.vector(1.0);
        if (1e-3..1.0).contains(&dot(any, any).sqrt()) {
            return unit(any);
        }
    }
}

/// Refracted by glass of index 1.5, or reflected as often as Fresnel's equations for unpolarised light say. `normal` is on the
/// ray's side.
pub fn through_glass(hit: &Hit, direction: [f64; 3], normal: [f64; 3], random: &mut Random) -> [f64; 3] {
    let direction = unit(direction);
    let enters = dot(hit.normal(), normal) > 0.0;
    let eta = if enters { 1.0 / 1.5 } else { 1.5 };
    let cos_in = -dot(direction, normal);
    let sin_out_squared = eta * eta * (1.0 - cos_in * cos_in);
    let reflected = [0, 1, 2].map(|k| direction[k] + 2.0 * cos_in * normal[k]);
    if sin_out_squared >= 1.0 {
        return reflected;
    }
    let cos_out = (1.0 - sin_out_squared).sqrt();
    let (parallel, across) = (
        (cos_in - eta * cos_out) / (cos_in + eta * cos_out),
        (eta * cos_in - cos_out) / (eta * cos_in + cos_out),
    );
    if random.unit() < 0.5 * (parallel * parallel + across * across) {
        return reflected;
    }
    [0, 1, 2].map(|k| eta * direction[k] + (eta * cos_in - cos_out) * normal[k])
}
