//! Every query against brute force with the scalar certified test, for any partition, layout, kernel and cache.

mod support;

use std::sync::Arc;

use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LazyOctree, LeafLayout, OctreeOptions, TreeQuality};
use outcrop::simd::SimdLevel;
use outcrop::trace::{MaterialSet, Occlusion, Tracer};
use outcrop::units::{Bytes, MaterialId, TriangleId};
use outcrop::{BlockSource, MemoryBudget};
use support::numbers::Random;
use support::{MATERIALS, Triangles, all_hits, compile, occlusion_of};

/// Rounds to f32, so that `Float32` files hold the positions exactly.
fn round(triangles: Triangles) -> Triangles {
    triangles.into_iter().map(|t| t.map(|v| v.map(|x| f64::from(x as f32)))).collect()
}

fn soup(random: &mut Random, count: usize, size: f64, scale: f64, shift: [f64; 3]) -> Triangles {
    let triangles = (0..count).map(|_| {
        let center = random.vector(1.0);
        let mut corner = || {
            let offset = random.vector(1.0);
            [0, 1, 2].map(|axis| scale * (center[axis] + size * offset[axis]) + shift[axis])
        };
        [corner(), corner(), corner()]
    });
    round(triangles.collect())
}

/// Rays that mix free ones with those aimed exactly at vertices, edges and along axes.
fn rays(random: &mut Random, triangles: &Triangles, count: usize) -> Vec<Ray> {
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for vertex in triangles.iter().flatten() {
        for axis in 0..3 {
            low[axis] = low[axis].min(vertex[axis]);
            high[axis] = high[axis].max(vertex[axis]);
        }
    }
    let size = (0..3).fold(0.0f64, |size, axis| size.max(high[axis] - low[axis]));
    let size = if size == 0.0 { 1.0 } else { size };
    (0..count)
        .map(|i| {
            let v = random.vector(1.0);
            let origin = [0, 1, 2].map(|axis| 0.5 * (low[axis] + high[axis]) + size * v[axis]);
            let triangle = triangles[random.index(triangles.len())];
            let corner = triangle[random.index(3)];
            let mut direction = match i % 5 {
                0 => random.vector(1.0),
                1 => [0, 1, 2].map(|axis| corner[axis] - origin[axis]),
                2 => {
                    let t = 0.5 * (random.signed() + 1.0);
                    [0, 1, 2].map(|axis| {
                        triangle[0][axis] + t * (triangle[1][axis] - triangle[0][axis]) - origin[axis]
                    })
                }
                3 => {
                    let mut axis_aligned = [0.0; 3];
                    axis_aligned[random.index(3)] = if random.bits() & 1 == 0 { 1.0 } else { -1.0 };
                    axis_aligned
                }
                _ => random.vector(1.0),
            };
            if direction == [0.0; 3] {
                direction = [1.0, 0.0, 0.0];
            }
            let mut ray = Ray::new(origin, direction);
            if i % 5 == 3 {
                // Straight through a vertex along an axis, from outside.
                for axis in 0..3 {
                    ray.origin[axis] = corner[axis] - 3.0 * size * direction[axis];
                }
            }
            if i % 7 == 0 {
                (ray.t_min, ray.t_max) = (0.2, 0.9 + random.signed().abs());
            }
            ray
        })
        .collect()
}

/// Eight rays around each of `rays`, which go much the same way, as a camera's do or a lamp's: from one point or side by side, of
/// different lengths.
fn bundles(random: &mut Random, rays: &[Ray]) -> Vec<Ray> {
    let mut bundles = Vec::new();
    for (i, ray) in rays.iter().enumerate() {
        let size = ray.direction.iter().fold(0.0f64, |size, x| size.max(x.abs()));
        for lane in 0..8 {
            let mut near = *ray;
            // The first of some is the ray itself, which may be along an axis.
            if lane > 0 || i % 3 > 0 {
                let (v, w) = (random.vector(1.0), random.vector(1.0));
                near.direction = [0, 1, 2].map(|axis| ray.direction[axis] + 0.04 * size * v[axis]);
                if i % 2 == 0 {
                    near.origin = [0, 1, 2].map(|axis| ray.origin[axis] + 0.004 * size * w[axis]);
                }
            }
            if (i + lane) % 4 == 0 {
                (near.t_min, near.t_max) = (0.1 + 0.1 * random.signed(), 1.0 + 0.3 * random.signed());
            }
            bundles.push(near);
        }
    }
    bundles
}

/// Compares every query with brute force.
fn check(tracer: &mut Tracer<'_>, triangles: &Triangles, rays: &[Ray]) {
    let mut hits = vec![None; rays.len()];
    tracer.closest_hits(rays, &mut hits).unwrap();
    let mut occlusions = vec![Occlusion::Clear; rays.len()];
    tracer.occluded(rays, None, &mut occlusions).unwrap();
    let ignore: MaterialSet = [MaterialId(0), MaterialId(2)].into_iter().collect();
    let mut filtered = vec![Occlusion::Clear; rays.len()];
    tracer.occluded(rays, Some(&ignore), &mut filtered).unwrap();
    for (i, ray) in rays.iter().enumerate() {
        let expected = all_hits(triangles, ray);
        let found = hits[i].map(|hit| (hit.t, hit.triangle));
        assert_eq!(found, expected.first().copied(), "ray {i}: {ray:?}");
        if let Some(hit) = hits[i] {
            assert_eq!(hit.vertices, triangles[hit.triangle.0 as usize]);
            assert_eq!(u64::from(hit.material.0), hit.triangle.0 % u64::from(MATERIALS));
        }
        let blocked = if expected.is_empty() { Occlusion::Clear } else { Occlusion::Blocked };
        assert_eq!(occlusions[i], blocked, "ray {i}: {ray:?}");
        let opaque = expected.iter().any(|(_, id)| id.0 % u64::from(MATERIALS) == 1);
        assert_eq!(filtered[i], occlusion_of(!expected.is_empty(), opaque), "ray {i}: {ray:?}");
        // Walking on from hit to hit visits every hit once, coincident ones too.
        let mut at = (-1.0, TriangleId(0));
        for (step, expected) in expected.iter().take(6).enumerate() {
            let mut next = [None];
            tracer.closest_hits_after(&[*ray], &[at], &mut next).unwrap();
            let found = next[0].map(|hit| (hit.t, hit.triangle));
            assert_eq!(found, Some(*expected), "ray {i} step {step}: {ray:?}");
            at = *expected;
        }
        if expected.len() <= 6 {
            let mut next = [None];
            tracer.closest_hits_after(&[*ray], &[at], &mut next).unwrap();
            if !expected.is_empty() {
                assert_eq!(next[0], None, "ray {i} past the end: {ray:?}");
            }
        }
    }
}

/// All combinations that may not change a hit.
fn check_everywhere(triangles: &Triangles, precision: Precision, rays: &[Ray]) {
    let bundles = bundles(&mut Random(rays.len() as u64), &rays[..rays.len() / 8]);
    for (partition, block_triangles) in [1300, 40, 7, 1].into_iter().enumerate() {
        if block_triangles == 1 && triangles.len() > 200 {
            continue;
        }
        let source = compile(triangles, precision, block_triangles, |i| match partition {
            0 => 0,
            1 => (triangles[i][0][0]).to_bits() >> 40,
            _ => (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32,
        });
        for (layout, simd, slots_max, quality) in [
            (LeafLayout::Expanded, SimdLevel::Avx2, None, TreeQuality::Best),
            (LeafLayout::Expanded, SimdLevel::Avx2, None, TreeQuality::Quick),
            (LeafLayout::Indexed, SimdLevel::Portable, Some(1), TreeQuality::Quick),
            (LeafLayout::Indexed, SimdLevel::Avx2, Some(3), TreeQuality::Best),
            (LeafLayout::Expanded, SimdLevel::Portable, None, TreeQuality::Finest),
        ] {
            let leaf_layout = layout;
            let options =
                OctreeOptions { leaf_layout, simd: Some(simd), slots_max, quality, ..Default::default() };
            let budget = MemoryBudget::new(Bytes::mib(256));
            let source: Arc<dyn BlockSource> = source.clone();
            let octree = LazyOctree::open(source, &budget, options).unwrap();
            let mut tracer = octree.tracer().unwrap();
            // The slow combinations see fewer rays.
            let share = if slots_max.is_some() || simd == SimdLevel::Portable { 4 } else { 1 };
            check(&mut tracer, triangles, &rays[..rays.len() / share]);
            check(&mut tracer, triangles, &bundles[..bundles.len() / 8 / share * 8]);
        }
    }
}

#[test]
fn random_soups() {
    let mut random = Random(1);
    for (count, size) in [(1, 1.0), (9, 1.0), (300, 0.3), (1500, 0.02)] {
        let triangles = soup(&mut random, count, size, 1.0, [0.0; 3]);
        let rays = rays(&mut random, &triangles, 200);
        check_everywhere(&triangles, Precision::Float32, &rays);
    }
}

#[test]
fn scales_and_translations() {
    let mut random = Random(2);
    for scale in [1e-35, 1e-18, 1e-6, 1e11, 1e30] {
        let triangles = soup(&mut random, 150, 0.3, scale, [0.0; 3]);
        let rays = rays(&mut random, &triangles, 100);
        check_everywhere(&triangles, Precision::Float32, &rays);
    }
    for shift in [1e4, -1e6, 1e7] {
        let triangles = soup(&mut random, 150, 0.3, 10.0, [shift, -shift, shift]);
        let rays = rays(&mut random, &triangles, 100);
        check_everywhere(&triangles, Precision::Float32, &rays);
    }
}

#[test]
fn coincident_triangles_resolve_by_id() {
    let mut random = Random(3);
    let one = soup(&mut random, 12, 0.8, 1.0, [0.0; 3]);
    // All centroids of each are equal, and every hit ties many times.
    let triangles: Triangles = (0..240).map(|i| one[i % 12]).collect();
    let rays = rays(&mut random, &triangles, 60);
    check_everywhere(&triangles, Precision::Float32, &rays);
    let same: Triangles = vec![one[0]; 100];
    check_everywhere(&same, Precision::Float32, &rays);
}

#[test]
fn needles_and_flat_triangles() {
    let mut random = Random(4);
    let mut triangles = soup(&mut random, 200, 1.0, 1.0, [0.0; 3]);
    for (i, triangle) in triangles.iter_mut().enumerate() {
        match i % 4 {
            0 => triangle[2] = [0, 1, 2].map(|axis| triangle[0][axis] + 1e-6 * triangle[2][axis]),
            1 => triangle[2] = triangle[1],
            2 => *triangle = triangle.map(|v| v.map(|x| 1e-7 * x)),
            _ => {}
        }
    }
    let triangles = round(triangles);
    let rays = rays(&mut random, &triangles, 200);
    check_everywhere(&triangles, Precision::Float32, &rays);
}

#[test]
fn planar_grids_hit_at_vertices() {
    // Flat boxes, and axis-aligned rays that run exactly through box borders.
    let mut triangles = Triangles::new();
    for x in 0..12 {
        for y in 0..12 {
            let p = |i: i32, j: i32| [f64::from(x + i), f64::from(y + j), 2.0];
            triangles.push([p(0, 0), p(1, 0), p(1, 1)]);
            triangles.push([p(0, 0), p(1, 1), p(0, 1)]);
        }
    }
    let mut rays = Vec::new();
    for x in 0..13 {
        for y in 0..13 {
            let at = [f64::from(x), f64::from(y)];
            for (dx, dy) in [(0.0, 0.0), (-0.0, -0.0), (1e-300, -1e-300), (1e-40, 0.0)] {
                rays.push(Ray::new([at[0], at[1], 5.0], [dx, dy, -1.0]));
                rays.push(Ray::new([at[0], at[1], -5.0], [dx, dy, 1e-9]));
            }
        }
    }
    check_everywhere(&triangles, Precision::Float32, &rays);
    for direction in [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]] {
        // In the plane: never a hit, whatever the boxes say.
        rays.clear();
        rays.push(Ray::new([-1.0, 3.0, 2.0], direction));
        check_everywhere(&triangles, Precision::Float32, &rays);
    }
}

#[test]
fn huge_and_tiny_together() {
    let mut random = Random(5);
    let mut triangles = soup(&mut random, 100, 1.0, 1e6, [0.0; 3]);
    triangles.extend(soup(&mut random, 100, 1.0, 1e-3, [1.0, 2.0, 3.0]));
    triangles.extend(soup(&mut random, 100, 1.0, 1e-9, [0.0; 3]));
    let rays = rays(&mut random, &triangles, 200);
    check_everywhere(&triangles, Precision::Float32, &rays);
}

#[test]
fn lattice_models_far_out_and_wide() {
    let mut random = Random(6);
    for (exponent, extent, shift) in
        [(-20, 10.0, 1e7), (-30, 1000.0, 0.0), (-30, 1e5, 1e6), (150, 1e50, 0.0), (-180, 1e-45, 0.0)]
    {
        let lattice = outcrop::geom::Lattice { exponent };
        let mut triangles = Triangles::new();
        for _ in 0..150 {
            let center = random.vector(1.0);
            let mut corner = || {
                let offset = random.vector(1.0);
                [0, 1, 2].map(|axis| {
                    let x = shift + extent * (center[axis] + 0.3 * offset[axis]);
                    lattice.position(lattice.quantize(x).unwrap())
                })
            };
            triangles.push([corner(), corner(), corner()]);
        }
        let rays = rays(&mut random, &triangles, 100);
        check_everywhere(&triangles, Precision::Lattice(lattice), &rays);
    }
}

#[test]
fn rays_from_beyond_the_domain_hit_nothing() {
    let mut random = Random(8);
    for shift in [0.0, 1e7, 1e12] {
        let lattice = outcrop::geom::Lattice { exponent: -10 };
        let mut corner =
            || random.vector(1.0).map(|x| lattice.position(lattice.quantize(shift + x).unwrap()));
        let triangles: Triangles = (0..30).map(|_| [corner(), corner(), corner()]).collect();
        let mut far = Vec::new();
        for distance in [1e77, 1e150, 1e300] {
            for triangle in &triangles {
                let toward = random.vector(1.0);
                let origin = [0, 1, 2].map(|axis| triangle[0][axis] - distance * toward[axis]);
                far.push(Ray::new(origin, toward));
                far.push(Ray::new(origin, toward.map(|x| x * distance)));
            }
        }
        assert!(far.iter().all(|ray| all_hits(&triangles, ray).is_empty()));
        check_everywhere(&triangles, Precision::Lattice(lattice), &far);
    }
}

#[test]
fn rays_from_far_away_and_of_any_length() {
    let mut random = Random(7);
    let triangles = soup(&mut random, 300, 0.2, 1.0, [0.0; 3]);
    let mut far = Vec::new();
    for distance in [1e2, 1e6, 1e12, 1e30, 1e60] {
        for _ in 0..20 {
            let (toward, target) = (random.vector(1.0), triangles[random.index(300)][random.index(3)]);
            let origin = [0, 1, 2].map(|axis| target[axis] - distance * toward[axis]);
            far.push(Ray::new(origin, toward));
            let mut short = Ray::new(origin, toward);
            (short.t_min, short.t_max) = (0.5 * distance, distance);
            far.push(short);
            far.push(Ray::new(target, toward.map(|x| x * distance)));
            far.push(Ray::new(target, toward.map(|x| x / distance)));
            far.push(Ray::new(target, toward.map(|x| x * 1e-310)));
            far.push(Ray::new(origin, toward.map(|x| -x)));
        }
    }
    check_everywhere(&triangles, Precision::Float32, &far);
}
