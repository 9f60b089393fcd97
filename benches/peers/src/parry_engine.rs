//! The `parry3d` crate: its triangle mesh with the bounding volume hierarchy that it makes for itself, in f32.

use std::ops::Range;

use parry3d::math::{Point, Vector};
use parry3d::query::{Ray, RayCast};
use parry3d::shape::{FeatureId, TriMesh};

use crate::engine::{Engine, Found, Surface};
use crate::mesh::Mesh;
use crate::rays::{Ray32, Rays};

pub struct Parry {
    mesh: TriMesh,
    triangle_count: u32,
}

impl Parry {
    pub fn new(mesh: &Mesh) -> Parry {
        let vertices = mesh.vertices.iter().map(|[x, y, z]| Point::new(*x, *y, *z)).collect();
        let triangle_count = mesh.triangles.len() as u32;
        Parry { mesh: TriMesh::new(vertices, mesh.triangles.clone()), triangle_count }
    }

    fn cast(&self, from: &Ray32) -> Option<(f32, u32, Vector<f32>)> {
        let ([x, y, z], [dx, dy, dz]) = (from.origin, from.direction);
        let ray = Ray::new(Point::new(x, y, z), Vector::new(dx, dy, dz));
        let hit = self.mesh.cast_local_ray_and_get_normal(&ray, from.t_max, false)?;
        // Faces met from behind are numbered after the others.
        match hit.feature {
            FeatureId::Face(face) => Some((hit.time_of_impact, face % self.triangle_count, hit.normal)),
            _ => None,
        }
    }
}

impl Engine for Parry {
    fn name(&self) -> &str {
        "parry3d"
    }

    fn closest(&mut self, rays: &Rays, range: Range<usize>, found: &mut [Found]) {
        for (from, to) in rays.single[range].iter().zip(found) {
            *to = self.cast(from).map_or(Found::NONE, |(t, triangle, _)| Found { t: f64::from(t), triangle });
        }
    }

    fn occluded(&mut self, rays: &Rays, range: Range<usize>, blocked: &mut [bool]) {
        for (from, to) in rays.single[range].iter().zip(blocked) {
            *to = self.cast(from).is_some();
        }
    }

    fn surfaces(&mut self, rays: &Rays, range: Range<usize>, surfaces: &mut [Option<Surface>]) {
        for (from, to) in rays.single[range].iter().zip(surfaces) {
            *to = self.cast(from).map(|(t, _, normal)| Surface {
                t: f64::from(t),
                normal: [normal.x, normal.y, normal.z].map(f64::from),
            });
        }
    }
}
