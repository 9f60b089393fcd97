//! The `obvhs` crate: its compressed 8-wide BVH, medium build, triangles in leaf order as its examples advise.

use std::ops::Range;
use std::time::Duration;

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;

use crate::engine::{Engine, Found, Surface};
use crate::mesh::Mesh;
use crate::rays::{Ray32, Rays};

pub struct Obvhs {
    bvh: CwBvh,
    /// In the order of `bvh.primitive_indices`.
    triangles: Vec<Triangle>,
}

impl Obvhs {
    pub fn new(mesh: &Mesh) -> Obvhs {
        let corner = |vertex: u32| Vec3A::from(mesh.vertices[vertex as usize]);
        let in_source_order: Vec<Triangle> = mesh
            .triangles
            .iter()
            .map(|[a, b, c]| Triangle { v0: corner(*a), v1: corner(*b), v2: corner(*c) })
            .collect();
        let bvh =
            build_cwbvh_from_tris(&in_source_order, BvhBuildParams::medium_build(), &mut Duration::default());
        let triangles = bvh.primitive_indices.iter().map(|index| in_source_order[*index as usize]).collect();
        Obvhs { bvh, triangles }
    }
}

fn ray(from: &Ray32) -> Ray {
    Ray::new(from.origin.into(), from.direction.into(), 0.0, from.t_max)
}

impl Engine for Obvhs {
    fn name(&self) -> &str {
        "obvhs"
    }

    fn closest(&mut self, rays: &Rays, range: Range<usize>, found: &mut [Found]) {
        for (from, to) in rays.single[range].iter().zip(found) {
            let mut hit = RayHit::none();
            let is_hit =
                self.bvh.ray_traverse(ray(from), &mut hit, |ray, index| self.triangles[index].intersect(ray));
            *to = if is_hit {
                let triangle = self.bvh.primitive_indices[hit.primitive_id as usize];
                Found { t: f64::from(hit.t), triangle }
            } else {
                Found::NONE
            };
        }
    }

    fn occluded(&mut self, rays: &Rays, range: Range<usize>, blocked: &mut [bool]) {
        for (from, to) in rays.single[range].iter().zip(blocked) {
            *to = !self.bvh.ray_traverse_miss(ray(from), |ray, index| self.triangles[index].intersect(ray));
        }
    }

    fn surfaces(&mut self, rays: &Rays, range: Range<usize>, surfaces: &mut [Option<Surface>]) {
        for (from, to) in rays.single[range].iter().zip(surfaces) {
            let mut hit = RayHit::none();
            let is_hit =
                self.bvh.ray_traverse(ray(from), &mut hit, |ray, index| self.triangles[index].intersect(ray));
            *to = is_hit.then(|| {
                let normal = self.triangles[hit.primitive_id as usize].compute_normal();
                Surface { t: f64::from(hit.t), normal: normal.to_array().map(f64::from) }
            });
        }
    }
}
