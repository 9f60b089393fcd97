//! Rays as renders make them: what a path does at each hit.

use outcrop::geom::{Ray, offset_origin};
use outcrop::trace::{AnyRequest, Hit};

const EYE: [f64; 3] = [-1.1, -2.1, 2.6];
/// Lamps of the standard view.
pub const LAMPS: [[f64; 3]; 5] =
    [[2.0, 4.0, 4.0], [-2.0, 4.0, 3.0], [2.0, -2.5, 2.5], [-1.0, -4.0, 2.0], [-1.111, -2.121, 2.626]];

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
}

impl Mix {
    pub const ALL: [Mix; 3] = [Mix::Shadows, Mix::Bounces, Mix::Glass];

    pub fn name(self) -> &'static str {
        match self {
            Mix::Shadows => "primary and shadows",
            Mix::Bounces => "three bounces",
            Mix::Glass => "glass to depth 12",
        }
    }

    fn depth(self) -> u32 {
        match self {
            Mix::Shadows => 0,
            Mix::Bounces => 3,
            Mix::Glass => 12,
        }
    }

    /// The ray that leaves `hit`, which ended a ray along `direction` after `depth` others.
    pub fn onward(self, hit: &Hit, direction: [f64; 3], pixel: u32, depth: u32) -> Option<Ray> {
        if depth == self.depth() {
            return None;
        }
        let mut random = Random::new(pixel, depth);
        let behind = dot(hit.normal(), direction) > 0.0;
        let normal = unit(hit.normal()).map(|x| if behind { -x } else { x });
        let outward = match self {
            Mix::Shadows => return None,
            Mix::Bounces => {
                // The unit sphere on the tip of the normal: cosine-distributed.
                let any = loop {
                    let any = [0, 1, 2].map(|_| 2.0 * random.next() - 1.0);
                    if dot(any, any) < 1.0 && dot(any, any) > 1e-6 {
                        break unit(any);
                    }
                };
                let sum = [0, 1, 2].map(|axis| 1.0001 * normal[axis] + any[axis]);
                unit(sum)
            }
            Mix::Glass => {
                refract(unit(direction), normal, if behind { 1.5 } else { 1.0 / 1.5 }, random.next())
            }
        };
        let origin = offset_origin(hit.position(), hit.position_error(), hit.normal(), outward);
        Some(Ray::new(origin, outward))
    }
}

/// The ray through a pixel of a square picture.
pub fn camera_ray(x: u32, y: u32, side: u32) -> Ray {
    let forward = unit(EYE.map(|x| -x));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let half = 22.5f64.to_radians().tan();
    let place = |i: u32| half * (2.0 * (f64::from(i) + 0.5) / f64::from(side) - 1.0);
    Ray::new(EYE, [0, 1, 2].map(|axis| forward[axis] + place(x) * right[axis] - place(y) * up[axis]))
}

/// The shadow ray from `hit` to a lamp.
pub fn shadow_ray(hit: &Hit, lamp: [f64; 3], tag: u64) -> AnyRequest {
    let toward = [0, 1, 2].map(|axis| lamp[axis] - hit.position()[axis]);
    let origin = offset_origin(hit.position(), hit.position_error(), hit.normal(), toward);
    let direction = [0, 1, 2].map(|axis| lamp[axis] - origin[axis]);
    AnyRequest { ray: Ray { t_max: 1.0, ..Ray::new(origin, direction) }, tag }
}

/// Snell and Fresnel; reflects if `chance` is below the reflectance.
fn refract(direction: [f64; 3], normal: [f64; 3], eta: f64, chance: f64) -> [f64; 3] {
    let cos_in = -dot(direction, normal);
    let sin_squared = eta * eta * (1.0 - cos_in * cos_in);
    let reflected = [0, 1, 2].map(|axis| direction[axis] + 2.0 * cos_in * normal[axis]);
    if sin_squared >= 1.0 {
        return reflected;
    }
    let cos_out = (1.0 - sin_squared).sqrt();
    let perpendicular = (eta * cos_in - cos_out) / (eta * cos_in + cos_out);
    let parallel = (cos_in - eta * cos_out) / (cos_in + eta * cos_out);
    if chance < 0.5 * (perpendicular * perpendicular + parallel * parallel) {
        return reflected;
    }
    [0, 1, 2].map(|axis| eta * direction[axis] + (eta * cos_in - cos_out) * normal[axis])
}

/// Numbers in 0 .. 1, keyed by pixel and depth.
struct Random(u64);

impl Random {
    fn new(pixel: u32, depth: u32) -> Random {
        Random((u64::from(pixel) << 8 | u64::from(depth)).wrapping_mul(0xd134_2543_de82_ef95))
    }

    /// SplitMix64.
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix(self.0) >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// SplitMix64's finaliser.
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ z >> 31
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
