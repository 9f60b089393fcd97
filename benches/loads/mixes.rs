//! Rays as renders make them: what a path does at each hit. Shared with the bench of the paper's tables.
#![allow(dead_code)]

use outcrop::geom::{Ray, offset_origin};
use outcrop::trace::{AnyRequest, Hit};

use crate::rays::numbers::{Random, dot, unit};
use crate::rays::{any_direction, through_glass};

/// Which rays a picture takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mix {
    /// A camera ray per pixel and a shadow ray to each lamp.
    Shadows,
    /// Three more rays, cosine-distributed, with shadow rays at each of their hits.
    Bounces,
    /// Everything is glass: at each hit the ray is refracted or reflected, by chance after Fresnel, to depth 12, with shadow
    /// rays at each hit.
    Glass,
    /// Every second piece of so many triangles is glass, as in `Glass`; to so many rays that follow a path's first.
    Pieces { triangles: u64, depth: u32 },
}

impl Mix {
    pub const ALL: [Mix; 3] = [Mix::Shadows, Mix::Bounces, Mix::Glass];

    pub fn name(self) -> &'static str {
        match self {
            Mix::Shadows => "primary and shadows",
            Mix::Bounces => "three bounces",
            Mix::Glass => "glass to depth 12",
            Mix::Pieces { .. } => "every second piece glass",
        }
    }

    /// Most rays that follow a path's first.
    pub fn depth(self) -> u32 {
        match self {
            Mix::Shadows => 0,
            Mix::Bounces => 3,
            Mix::Glass => 12,
            Mix::Pieces { depth, .. } => depth,
        }
    }

    /// The ray that leaves `hit`, which ended a ray along `direction` after `depth` others.
    pub fn onward(self, hit: &Hit, direction: [f64; 3], pixel: u32, depth: u32) -> Option<Ray> {
        if depth == self.depth() {
            return None;
        }
        let key = u64::from(pixel) << 8 | u64::from(depth);
        let mut random = Random(key.wrapping_mul(0xd134_2543_de82_ef95));
        let behind = dot(hit.normal(), direction) > 0.0;
        let normal = unit(hit.normal()).map(|x| if behind { -x } else { x });
        let outward = match self {
            Mix::Shadows => return None,
            Mix::Bounces => {
                // As the cosine, but never zero.
                let any = any_direction(&mut random);
                unit([0, 1, 2].map(|axis| 1.0001 * normal[axis] + any[axis]))
            }
            Mix::Pieces { triangles, .. } if (hit.triangle.0 / triangles).is_multiple_of(2) => return None,
            Mix::Glass | Mix::Pieces { .. } => through_glass(hit, direction, normal, &mut random),
        };
        let origin = offset_origin(hit.position(), hit.position_error(), hit.normal(), outward);
        Some(Ray::new(origin, outward))
    }
}

/// The shadow ray from `hit` to a lamp.
pub fn shadow_ray(hit: &Hit, lamp: [f64; 3], tag: u64) -> AnyRequest {
    let toward = [0, 1, 2].map(|axis| lamp[axis] - hit.position()[axis]);
    let origin = offset_origin(hit.position(), hit.position_error(), hit.normal(), toward);
    let direction = [0, 1, 2].map(|axis| lamp[axis] - origin[axis]);
    AnyRequest { ray: Ray { t_max: 1.0, ..Ray::new(origin, direction) }, tag }
}
