//! No ray passes through a closed surface (I3): rays aimed at the vertices and edges of a compiled sphere, near the
//! origin and far from it.

#[path = "support/compiling.rs"]
mod compiling;
#[path = "support/mod.rs"]
mod support;

use std::sync::Arc;

use compiling::{Mesh, compile, read_back};
use outcrop::compile::CompileOptions;
use outcrop::geom::Ray;
use outcrop::octree::{LazyOctree, LeafLayout, OctreeOptions};
use outcrop::procedural::Icosphere;
use outcrop::source::MemorySource;
use outcrop::trace::Occlusion;
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};
use support::Triangles;
use support::numbers::Random;

const RADIUS: f64 = 1000.0;
/// How far from its target a hit may be, in distances from origin to target. A leak ends at the far side.
const NEAR: f64 = 1e-6;

/// A compiled sphere of 20,480 triangles.
struct Sphere {
    center: [f64; 3],
    source: Arc<dyn BlockSource>,
    triangles: Triangles,
}

impl Sphere {
    fn new(translation: f64, block_bytes: u32) -> Sphere {
        let center = [translation, -translation, 0.5 * translation];
        let mesh = Mesh::of(&Icosphere::new(RADIUS, center, 5).unwrap());
        let options = CompileOptions { block_bytes, ..Default::default() };
        let (report, bytes) = compile(&mesh, &options, Bytes::mib(64));
        assert!(report.blocks > 1, "there are seams between blocks");
        let (_, stored) = read_back(&bytes);
        let triangles = stored.into_iter().map(|triangle| triangle.unwrap().corners).collect();
        Sphere { center, source: Arc::new(MemorySource::new(bytes).unwrap()), triangles }
    }

    /// A point as stored: every vertex in turn, then points of edges.
    fn target(&self, index: usize, random: &mut Random) -> [f64; 3] {
        let triangle = self.triangles[index % self.triangles.len()];
        let corner = index / self.triangles.len() % 3;
        let (a, b) = (triangle[corner], triangle[(corner + 1) % 3]);
        let along = 0.5 * (random.signed() + 1.0);
        match index % 3 {
            0 => a,
            1 => [0, 1, 2].map(|axis| 0.5 * (a[axis] + b[axis])),
            _ => [0, 1, 2].map(|axis| a[axis] + along * (b[axis] - a[axis])),
        }
    }

    /// From inside and outside in turn. From outside never at a grazing angle: past the silhouette a ray may miss.
    fn ray(&self, index: usize, target: [f64; 3], random: &mut Random) -> Ray {
        let outward = [0, 1, 2].map(|axis| (target[axis] - self.center[axis]) / RADIUS);
        let sideways = random.vector(1.0);
        let distance = RADIUS * (1.1 + random.signed());
        let origin = if index.is_multiple_of(2) {
            [0, 1, 2].map(|axis| self.center[axis] + 0.5 * RADIUS * sideways[axis])
        } else {
            [0, 1, 2].map(|axis| target[axis] + distance * (outward[axis] + 0.5 * sideways[axis]))
        };
        Ray::new(origin, [0, 1, 2].map(|axis| target[axis] - origin[axis]))
    }

    /// Aims a ray at every vertex, the others at more vertices and at edges, and asserts that each meets its target.
    fn check(&self, ray_count: usize, options: OctreeOptions) {
        let budget = MemoryBudget::new(Bytes::mib(256));
        let octree = LazyOctree::open(Arc::clone(&self.source), &budget, options).unwrap();
        let mut tracer = octree.tracer().unwrap();
        let mut random = Random(9);
        let mut vertices: Vec<[u64; 3]> =
            self.triangles.iter().flatten().map(|v| v.map(f64::to_bits)).collect();
        vertices.sort_unstable();
        vertices.dedup();
        assert!(vertices.len() < ray_count, "every vertex is aimed at");
        let rays: Vec<Ray> = (0..ray_count)
            .map(|index| {
                let target = match vertices.get(index) {
                    Some(vertex) => vertex.map(f64::from_bits),
                    None => self.target(index - vertices.len(), &mut random),
                };
                self.ray(index, target, &mut random)
            })
            .collect();
        let mut hits = vec![None; rays.len()];
        tracer.closest_hits(&rays, &mut hits).unwrap();
        // The far side does not count for a shadow either.
        let ended: Vec<Ray> = rays.iter().map(|ray| Ray { t_max: 1.0 + NEAR, ..*ray }).collect();
        let mut occlusions = vec![Occlusion::Clear; rays.len()];
        tracer.occluded(&ended, None, &mut occlusions).unwrap();
        let is_leak = |index: &usize| hits[*index].is_none_or(|hit| (hit.t - 1.0).abs() > NEAR);
        let leaks: Vec<&Ray> = (0..ray_count).filter(is_leak).map(|index| &rays[index]).collect();
        assert!(leaks.is_empty(), "{} of {ray_count}, first {:?}", leaks.len(), leaks[0]);
        let clear = occlusions.iter().filter(|occlusion| **occlusion != Occlusion::Blocked).count();
        assert_eq!(clear, 0, "shadow rays that nothing blocks, of {ray_count}");
    }
}

const TRANSLATIONS: [f64; 4] = [0.0, 1e4, 1e6, 1e7];

#[test]
fn no_ray_leaks_at_any_translation() {
    for translation in TRANSLATIONS {
        Sphere::new(translation, 64 << 10).check(20_000, OctreeOptions::default());
    }
}

#[test]
fn no_ray_leaks_between_blocks_of_any_size_in_any_layout() {
    for block_bytes in [4 << 10, 64 << 10] {
        let sphere = Sphere::new(1e6, block_bytes);
        for leaf_layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
            sphere.check(20_000, OctreeOptions { leaf_layout, ..Default::default() });
        }
    }
}

#[test]
#[ignore = "ten times the rays"]
fn no_ray_of_many_leaks() {
    for translation in TRANSLATIONS {
        for block_bytes in [4 << 10, 64 << 10] {
            Sphere::new(translation, block_bytes).check(200_000, OctreeOptions::default());
        }
    }
}
