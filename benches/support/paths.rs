//! Paths of rays through a model, one for each pixel, straight on a tracer: what records of block accesses are made of.

use outcrop::error::TraceError;
use outcrop::geom::{Ray, offset_origin};
use outcrop::trace::{Hit, Occlusion, Tracer};
use outcrop::units::MaterialId;

/// The standard view and lights of the gears.
const EYE: [f64; 3] = [-1.1, -2.1, 2.6];
const LIGHTS: [[f64; 3]; 5] =
    [[2.0, 4.0, 4.0], [-2.0, 4.0, 3.0], [2.0, -2.5, 2.5], [-1.0, -4.0, 2.0], [-1.111, -2.121, 2.626]];

/// What happens at a hit, besides a shadow ray to each light.
#[derive(Clone, Copy)]
pub enum Paths {
    /// So many bounces, distributed as the cosine.
    Diffuse(u32),
    /// Glass of index 1.5 but for the floor: refraction or, as often as Fresnel's equations say, reflection, to so many rays
    /// in a row.
    Glass(u32),
}

impl Paths {
    /// Follows the path of a pixel of a square picture of `size` pixels a side to its end; its hits.
    pub fn trace(self, tracer: &mut Tracer<'_>, [x, y]: [u32; 2], size: u32) -> Result<u64, TraceError> {
        // A generator for each pixel: paths do not depend on their order.
        follow(tracer, camera_ray([x, y], size), self, &mut Random(u64::from(y * size + x)))
    }
}

/// One path; its hits.
fn follow(
    tracer: &mut Tracer<'_>,
    mut ray: Ray,
    paths: Paths,
    random: &mut Random,
) -> Result<u64, TraceError> {
    let rays = match paths {
        Paths::Diffuse(bounces) => bounces + 1,
        Paths::Glass(depth) => depth,
    };
    let mut occlusions = [Occlusion::Clear; LIGHTS.len()];
    for depth in 0..rays {
        let Some(hit) = tracer.closest_hit(&ray)? else { return Ok(depth.into()) };
        let normal = unit(hit.normal());
        // To the side from which the ray came.
        let normal = normal.map(|x| -x * dot(normal, ray.direction).signum());
        let from = |direction| offset_origin(hit.position(), hit.position_error(), normal, direction);
        let shadows = LIGHTS.map(|light| {
            let direction = sub(light, hit.position());
            Ray { t_max: 1.0, ..Ray::new(from(direction), direction) }
        });
        tracer.occluded(&shadows, None, &mut occlusions)?;
        let direction = match paths {
            Paths::Glass(_) if hit.material != MaterialId(0) => {
                through_glass(&hit, ray.direction, normal, random)
            }
            Paths::Glass(_) => return Ok(u64::from(depth) + 1),
            Paths::Diffuse(_) => cosine(normal, random),
        };
        ray = Ray::new(from(direction), direction);
    }
    Ok(rays.into())
}

/// Refracted, or reflected as often as Fresnel's equations for unpolarised light say. `normal` is on the ray's side.
fn through_glass(hit: &Hit, direction: [f64; 3], normal: [f64; 3], random: &mut Random) -> [f64; 3] {
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

/// A direction on the side of `normal`, distributed as the cosine: a point on the unit sphere that touches the surface.
fn cosine(normal: [f64; 3], random: &mut Random) -> [f64; 3] {
    loop {
        let any = [(); 3].map(|()| 2.0 * random.unit() - 1.0);
        let length = dot(any, any).sqrt();
        if (1e-3..1.0).contains(&length) {
            let direction = [0, 1, 2].map(|k| normal[k] + any[k] / length);
            if dot(direction, direction) > 1e-6 {
                return direction;
            }
        }
    }
}

fn camera_ray([x, y]: [u32; 2], size: u32) -> Ray {
    let forward = unit(EYE.map(|x| -x));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let half = 22.5f64.to_radians().tan();
    let place = |i: u32| half * (2.0 * (f64::from(i) + 0.5) / f64::from(size) - 1.0);
    Ray::new(EYE, [0, 1, 2].map(|k| forward[k] + place(x) * right[k] - place(y) * up[k]))
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|x| x / dot(a, a).sqrt())
}
