//! Paths of rays through a model, one for each pixel, straight on a tracer: what records of block accesses are made of.

#[path = "rays.rs"]
pub mod rays;

use outcrop::error::TraceError;
use outcrop::geom::{Ray, offset_origin};
use outcrop::procedural::Gears;
use outcrop::trace::{Occlusion, Tracer};
use outcrop::units::MaterialId;

use rays::numbers::{Random, dot, minus, unit};
use rays::{any_direction, camera_ray, through_glass};

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
    let mut occlusions = [Occlusion::Clear; Gears::LAMPS.len()];
    for depth in 0..rays {
        let Some(hit) = tracer.closest_hit(&ray)? else { return Ok(depth.into()) };
        let normal = unit(hit.normal());
        // To the side from which the ray came.
        let normal = normal.map(|x| -x * dot(normal, ray.direction).signum());
        let from = |direction| offset_origin(hit.position(), hit.position_error(), normal, direction);
        let shadows = Gears::LAMPS.map(|light| {
            let direction = minus(light, hit.position());
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

/// A direction on the side of `normal`, distributed as the cosine.
fn cosine(normal: [f64; 3], random: &mut Random) -> [f64; 3] {
    loop {
        let any = any_direction(random);
        let direction = [0, 1, 2].map(|k| normal[k] + any[k]);
        if dot(direction, direction) > 1e-6 {
            return direction;
        }
    }
}
