//! The rays that all tracers get: numbers that are exact in f32, so that nobody rounds them differently.

use std::ops::Range;

use outcrop::geom::Ray;
use outcrop::procedural::Gears;

use crate::engine::{Engine, Found, Surface};
use crate::mesh::Mesh;
use crate::numbers::{Random, along, cross, dot, minus, unit};

/// Edge length of the tiles in which an image is traced. Rays of a tile are neighbours in memory.
const TILE: usize = 32;
/// How many rays a tracer gets at a time: what it says of them stays in the first cache, with the rays. Tracers that take rays one by one
/// have nothing from it and lose nothing by it.
pub const RAYS_PER_CALL: usize = 128;

/// Of the standard view of the gears.
pub const VERTICAL_FIELD_DEGREES: f64 = 45.0;

/// A ray in f32, the form that the peers take.
#[derive(Clone, Copy, Debug)]
pub struct Ray32 {
    pub origin: [f32; 3],
    pub direction: [f32; 3],
    pub t_max: f32,
}

/// The same rays in both forms, made before anything is timed.
#[derive(Default)]
pub struct Rays {
    pub single: Vec<Ray32>,
    pub double: Vec<Ray>,
}

impl Rays {
    /// Rounds to f32 first, so that both forms are the same numbers.
    pub fn push(&mut self, origin: [f64; 3], direction: [f64; 3], t_max: f64) {
        let single = Ray32 {
            origin: origin.map(|x| x as f32),
            direction: direction.map(|x| x as f32),
            t_max: t_max as f32,
        };
        self.single.push(single);
        self.double.push(Ray {
            origin: single.origin.map(f64::from),
            direction: single.direction.map(f64::from),
            t_min: 0.0,
            t_max: f64::from(single.t_max),
        });
    }

    /// Keeps the f64 form as it is; the f32 form is rounded.
    pub fn push_unrounded(&mut self, origin: [f64; 3], direction: [f64; 3]) {
        self.single.push(Ray32 {
            origin: origin.map(|x| x as f32),
            direction: direction.map(|x| x as f32),
            t_max: f32::INFINITY,
        });
        self.double.push(Ray::new(origin, direction));
    }

    pub fn len(&self) -> usize {
        self.single.len()
    }

    /// `0 .. len` in pieces of one call each.
    pub fn calls(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        pieces(self.len(), RAYS_PER_CALL)
    }

    /// `0 .. len` in pieces of one tile each, if these are the rays of pixels.
    fn tiles(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        pieces(self.len(), TILE * TILE)
    }
}

fn pieces(len: usize, size: usize) -> impl Iterator<Item = Range<usize>> {
    (0..len).step_by(size).map(move |start| start..len.min(start + size))
}

/// One ray through each pixel's centre of the standard view, `size` x `size`, tile by tile, with its pixel.
pub fn primary(size: usize) -> (Rays, Vec<[usize; 2]>) {
    let forward = unit(minus([0.0; 3], Gears::EYE));
    let right = unit(cross(forward, [0.0, 0.0, 1.0]));
    let up = cross(right, forward);
    let half = (0.5 * VERTICAL_FIELD_DEGREES.to_radians()).tan();
    let (mut rays, mut pixels) = (Rays::default(), Vec::new());
    for tile_y in (0..size).step_by(TILE) {
        for tile_x in (0..size).step_by(TILE) {
            for y in tile_y..size.min(tile_y + TILE) {
                for x in tile_x..size.min(tile_x + TILE) {
                    let across = |pixel: usize| half * (2.0 * (pixel as f64 + 0.5) / size as f64 - 1.0);
                    let direction = along(along(forward, across(x), right), -across(y), up);
                    rays.push(Gears::EYE, unit(direction), f64::INFINITY);
                    pixels.push([x, y]);
                }
            }
        }
    }
    (rays, pixels)
}

/// Where a ray hit, lifted off the surface towards where it came from, and the unit normal on that side.
pub struct Lifted {
    pub origin: [f64; 3],
    pub normal: [f64; 3],
}

/// `None` for a miss and for a triangle too thin to have a normal.
fn lift(mesh: &Mesh, ray: &Ray, found: Found) -> Option<Lifted> {
    if !found.is_hit() {
        return None;
    }
    let [a, b, c] = mesh.corners(found.triangle).map(|corner| corner.map(f64::from));
    lift_surface(ray, Surface { t: found.t, normal: cross(minus(b, a), minus(c, a)) })
}

/// `None` for a triangle too thin to have a normal.
pub fn lift_surface(ray: &Ray, surface: Surface) -> Option<Lifted> {
    let normal = unit(surface.normal);
    if !normal[0].is_finite() {
        return None;
    }
    let facing = if dot(normal, ray.direction) > 0.0 { normal.map(|x| -x) } else { normal };
    Some(Lifted { origin: along(ray.at(surface.t), 1e-4, facing), normal: facing })
}

/// From every hit to each light, unless the surface faces away; in the order in which renderers ask: tile by tile, light by light.
pub fn shadow(mesh: &Mesh, primary: &Rays, found: &[Found]) -> Rays {
    let mut rays = Rays::default();
    for range in primary.tiles() {
        let hits = primary.double[range.clone()].iter().zip(&found[range]);
        let lifted: Vec<Lifted> = hits.filter_map(|(ray, found)| lift(mesh, ray, *found)).collect();
        for light in Gears::LAMPS {
            for lifted in &lifted {
                let direction = minus(light, lifted.origin);
                if dot(direction, lifted.normal) > 0.0 {
                    rays.push(lifted.origin, direction, 1.0);
                }
            }
        }
    }
    rays
}

/// One cosine-distributed ray from every hit; the same ones in every run.
pub fn bounce(mesh: &Mesh, primary: &Rays, found: &[Found]) -> Rays {
    let mut rays = Rays::default();
    let mut random = Random(0x0a07_c209);
    for (ray, found) in primary.double.iter().zip(found) {
        // Drawn for misses too, so that one tracer's different hit does not change all rays that follow.
        let (angle, radius2) = (std::f64::consts::TAU * random.unit(), random.unit());
        let Some(lifted) = lift(mesh, ray, *found) else { continue };
        let normal = lifted.normal;
        let helper = if normal[0].abs() < 0.5 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let tangent = unit(cross(normal, helper));
        let bitangent = cross(normal, tangent);
        let radius = radius2.sqrt();
        let mut direction = normal.map(|x| x * (1.0 - radius2).sqrt());
        direction = along(direction, radius * angle.cos(), tangent);
        direction = along(direction, radius * angle.sin(), bitangent);
        rays.push(lifted.origin, direction, f64::INFINITY);
    }
    rays
}

/// All closest hits, call by call.
pub fn trace_closest(engine: &mut dyn Engine, rays: &Rays) -> Vec<Found> {
    let mut found = vec![Found::NONE; rays.len()];
    for range in rays.calls() {
        engine.closest(rays, range.clone(), &mut found[range]);
    }
    found
}

/// All occlusions, call by call.
pub fn trace_occluded(engine: &mut dyn Engine, rays: &Rays) -> Vec<bool> {
    let mut blocked = vec![false; rays.len()];
    for range in rays.calls() {
        engine.occluded(rays, range.clone(), &mut blocked[range]);
    }
    blocked
}
