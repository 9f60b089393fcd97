//! The kernels against their scalar twins: exact hits of `geom` for the reject test, slabs in f64 for the box test. A kernel
//! may keep too much, never too little.

#![allow(clippy::needless_range_loop)] // lanes and axes index rows of several arrays at once
use super::*;
use crate::geom::{Ray, intersect_certified};

struct Random(u64);

impl Random {
    /// In -1 to 1, on a coarse grid half of the time, so that vertices and edges are met exactly.
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let x = (self.0 >> 40) as f32 / (1 << 23) as f32 - 1.0;
        if self.0 >> 39 & 1 == 0 { (x * 4.0).round() / 4.0 } else { x }
    }

    fn vector(&mut self) -> [f32; 3] {
        [self.next(), self.next(), self.next()]
    }

    /// Largest magnitude in 1 to 2.
    fn direction(&mut self) -> [f32; 3] {
        let mut direction = self.vector();
        direction[(self.0 >> 20) as usize % 3] = 1.0 + self.next().abs() * 0.99;
        direction
    }
}

fn levels() -> [SimdLevel; 2] {
    [SimdLevel::Portable, SimdLevel::best()]
}

fn wide(x: [f32; 3]) -> [f64; 3] {
    x.map(f64::from)
}

/// Triangles of all shapes, at all distances: the kernel keeps what is hit, and what it calls certain is hit.
struct Triangles {
    scale: f32,
}

impl AnyOperation for Triangles {
    type Output = (u32, u32, u32);

    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let mut random = Random(u64::from(self.scale.to_bits()));
        let (mut hits, mut certainties, mut rejections) = (0, 0, 0);
        for round in 0..4000 {
            // From compact ones to needles, near and far.
            let size = self.scale * 0.5f32.powi(round % 12);
            let origin = random.vector().map(|x| x * self.scale * 4.0);
            let direction = random.direction();
            let mut triangles = [[[0.0f32; 3]; 3]; LANES];
            for triangle in &mut triangles {
                // Around a point of the ray, so that there is something to hit.
                let t = random.next().abs() * 4.0 * self.scale;
                for vertex in triangle.iter_mut() {
                    let offset = random.vector();
                    for axis in 0..3 {
                        vertex[axis] = origin[axis] + t * direction[axis] + offset[axis] * size;
                    }
                }
                if round % 5 == 0 {
                    let [a, b, _] = *triangle;
                    triangle[2] = [0, 1, 2].map(|axis| a[axis] + (b[axis] - a[axis]) * 1e-4 * random.next());
                }
            }
            let mut rows = [0.0f32; 10 * LANES];
            let (mut edge, mut reach) = (0.0f32, 0.0f32);
            for (lane, triangle) in triangles.iter().enumerate() {
                for (vertex, position) in triangle.iter().enumerate() {
                    for axis in 0..3 {
                        rows[(3 * vertex + axis) * LANES + lane] = position[axis];
                        edge = edge.max((position[axis] - triangle[0][axis]).abs());
                        reach = reach.max((position[axis] - origin[axis]).abs());
                    }
                }
            }
            let (edge, reach) = (edge * 1.000_001, reach * 1.000_001);
            let sum = direction.iter().map(|x| x.abs()).sum::<f32>() * 1.000_001;
            let ray = TriangleRay { origin, direction };
            let bounds = ErrorBounds::new(simd, sum, reach, 0.0, 0.0);
            let bounds = (&bounds, edge);
            let packet = PacketRows::new(&rows, LANES).packet(simd, 0);
            let t_max = if round % 2 == 0 { f32::INFINITY } else { 2.0 * self.scale };
            let outer = Interval { low: simd.splat(0.0), high: simd.splat(t_max * 1.001) };
            let inner = Interval {
                low: simd.splat(1e-30),
                high: simd.splat(if t_max == f32::INFINITY { f32::MAX } else { t_max * 0.999 }),
            };
            let (survivors, certain) = ray.survivors_and_certain(simd, &packet, bounds, &outer, &inner);
            assert_eq!(survivors, ray.survivors(simd, &packet, bounds, &outer));
            assert_eq!(certain & !survivors, 0);
            let exact = Ray { t_max: f64::from(t_max), ..Ray::new(wide(origin), wide(direction)) };
            for (lane, triangle) in triangles.iter().enumerate() {
                let hit = intersect_certified(&exact, &triangle.map(wide), &mut 0).is_some();
                let (kept, sure) = (survivors >> lane & 1 == 1, certain >> lane & 1 == 1);
                assert!(
                    kept || !hit,
                    "scale {}, round {round}: {triangle:?} is hit but rejected",
                    self.scale
                );
                assert!(
                    hit || !sure,
                    "scale {}, round {round}: {triangle:?} is missed but certain",
                    self.scale
                );
                hits += u32::from(hit);
                certainties += u32::from(sure);
                rejections += u32::from(!kept);
            }
        }
        (hits, certainties, rejections)
    }
}

#[test]
fn the_reject_test_keeps_every_hit_and_is_certain_of_hits_only() {
    for level in levels() {
        for scale in [1.0, 1e-12, 1e9] {
            let (hits, certainties, rejections) = dispatch(level, Triangles { scale });
            // It also does its work.
            assert!(
                hits > 1000 && certainties > 100 && rejections > 8000,
                "{hits} {certainties} {rejections}"
            );
        }
    }
}

/// Boxes beside, around and behind the ray's origin, flat ones among them.
struct BoxesOp;

impl AnyOperation for BoxesOp {
    type Output = (u32, u32);

    fn run<S: Simd>(self, simd: S) -> Self::Output {
        let mut random = Random(7);
        let parallel = Parallel::new(8);
        let (mut kept, mut dropped) = (0, 0);
        for round in 0..20_000 {
            let origin = random.vector().map(|x| 4.0 * x);
            let mut direction = random.direction();
            if round % 4 == 0 {
                // Along a plane or an axis, with either zero.
                direction = direction.map(|x| if x.abs() < 1.0 { 0.0f32.copysign(x) } else { x });
            }
            let mut boxes: Boxes = [[0.0; LANES]; 6];
            for lane in 0..LANES {
                // Near the ray, before and behind its origin.
                let (low, size, t) = (random.vector(), random.vector(), 4.0 * random.next());
                for axis in 0..3 {
                    let size = if size[axis] > 0.75 { 0.0 } else { size[axis].abs() };
                    let low = origin[axis] + t * direction[axis] + low[axis];
                    boxes[axis][lane] = low;
                    boxes[axis + 3][lane] = low + size;
                }
            }
            let lanes = |x: [f32; 3]| simd.load(&[x[0], x[1], x[2], 1.0, 1.0, 1.0, 1.0, 1.0]);
            let mut ray = BoxRay::UNSET;
            let axes = ParallelAxes::new(wide(direction), 0.0, &parallel);
            ray.set_direction(simd, lanes(direction), &axes);
            ray.set_origin(simd, origin, axes.widen());
            let (near, hits) = ray.test(simd, &boxes, simd.splat(0.0), simd.splat(100.0));
            let near = simd.to_array(near);
            for lane in 0..LANES {
                let (mut entry, mut exit) = (0.0f64, 100.0f64);
                for axis in 0..3 {
                    let (o, d) = (f64::from(origin[axis]), f64::from(direction[axis]));
                    let (low, high) = (f64::from(boxes[axis][lane]), f64::from(boxes[axis + 3][lane]));
                    if d == 0.0 {
                        if o < low || o > high {
                            exit = -1.0;
                        }
                        continue;
                    }
                    let (a, b) = ((low - o) / d, (high - o) / d);
                    (entry, exit) = (entry.max(a.min(b)), exit.min(a.max(b)));
                }
                let hit = hits >> lane & 1 == 1;
                if entry <= exit {
                    assert!(hit, "round {round}, lane {lane}: {origin:?} {direction:?}");
                    assert!(f64::from(near[lane]) <= entry * (1.0 + 1e-6), "round {round}, lane {lane}");
                }
                kept += u32::from(hit);
                dropped += u32::from(!hit);
            }
        }
        (kept, dropped)
    }
}

#[test]
fn the_box_test_keeps_every_box_that_the_ray_meets() {
    for level in levels() {
        let (kept, dropped) = dispatch(level, BoxesOp);
        assert!(kept > 1000 && dropped > 50_000, "{kept} {dropped}");
    }
}

/// Rays prepared eight at a time, and rows turned into columns, against one at a time.
struct GroupsOp;

impl AnyOperation for GroupsOp {
    type Output = ();

    fn run<S: Simd>(self, simd: S) {
        let mut random = Random(11);
        let parallel = Parallel::new(8);
        for _ in 0..2000 {
            let mut rows = [simd.splat(0.0); LANES];
            let mut rays = [([0.0f32; 3], [0.0f32; 3]); LANES];
            for (row, ray) in rows.iter_mut().zip(&mut rays) {
                let direction = random.direction().map(|x| if x == 0.0 { 0.25 } else { x });
                *ray = (random.vector().map(|x| 4.0 * x), direction);
                let ([ox, oy, oz], [dx, dy, dz]) = (wide(ray.0), wide(ray.1));
                *row = simd.narrow(&[ox, oy, oz, dx], &[dy, dz, 0.1, f64::MAX]);
            }
            let [ox, oy, oz, dx, dy, dz, tenth, most] = simd.transpose(&rows);
            assert_eq!(simd.to_array(tenth), [0.1f64 as f32; LANES]);
            assert_eq!(simd.to_array(most), [f32::INFINITY; LANES]);
            let group = RayRows::new(simd, &[dx, dy, dz], &[ox, oy, oz]);
            let mut boxes: Boxes = [[0.0; LANES]; 6];
            for axis in 0..3 {
                for lane in 0..LANES {
                    boxes[axis][lane] = 2.0 * random.next();
                    boxes[axis + 3][lane] = boxes[axis][lane] + random.next().abs();
                }
            }
            for (lane, (origin, direction)) in rays.iter().enumerate() {
                let [x, y, z] = *direction;
                let mut alone = BoxRay::UNSET;
                let lanes = simd.load(&[x, y, z, 1.0, 1.0, 1.0, 1.0, 1.0]);
                assert!(BoxRay::is_oblique(simd, lanes, &parallel));
                alone.set_direction(simd, lanes, &ParallelAxes::NONE);
                alone.set_origin(simd, *origin, BoxRay::WIDEN_LEAST);
                let TestRay { boxes: grouped, triangles } = *group.get(lane);
                assert_eq!((triangles.origin, triangles.direction), (*origin, *direction));
                let [one, other] = [alone, grouped].map(|ray| {
                    let (near, hits) = ray.test(simd, &boxes, simd.splat(0.0), simd.splat(9.0));
                    (simd.to_array(near).map(f32::to_bits), hits)
                });
                assert_eq!(one, other, "{origin:?} {direction:?}");
            }
        }
    }
}

#[test]
fn rays_prepared_together_are_those_prepared_alone() {
    for level in levels() {
        dispatch(level, GroupsOp);
    }
}

/// Bundles against their rays.
struct BundlesOp;

impl AnyOperation for BundlesOp {
    type Output = (u32, u32);

    fn run<S: Simd>(self, simd: S) -> (u32, u32) {
        let mut random = Random(13);
        let (mut kept, mut dropped) = (0, 0);
        for round in 0..4000 {
            let (base, way) = (random.vector().map(|x| 4.0 * x), random.direction());
            let (mut origins, mut directions) = ([[0.0f32; LANES]; 3], [[0.0f32; LANES]; 3]);
            for lane in 0..LANES {
                let (v, w) = (random.vector(), random.vector());
                for axis in 0..3 {
                    // Also from one point, and nearly along planes.
                    let spread = if round % 2 == 0 { 0.0 } else { 0.05 };
                    origins[axis][lane] = base[axis] + spread * v[axis];
                    let way = if way[axis] == 0.0 { 0.06 } else { way[axis] };
                    directions[axis][lane] = way + 0.06 * w[axis];
                    if directions[axis][lane] == 0.0 {
                        directions[axis][lane] = 1e-9;
                    }
                }
            }
            let load =
                |rows: &[[f32; LANES]; 3]| [simd.load(&rows[0]), simd.load(&rows[1]), simd.load(&rows[2])];
            let (direction, origin) = (load(&directions), load(&origins));
            let Some(bundle) = RayBundle::new(simd, &direction, &origin, 0.2) else { continue };
            for _ in 0..8 {
                let mut boxes: Boxes = [[0.0; LANES]; 6];
                for lane in 0..LANES {
                    let (low, size, t) = (random.vector(), random.vector(), 4.0 * random.next());
                    for axis in 0..3 {
                        let size = if size[axis] > 0.75 { 0.0 } else { size[axis].abs() };
                        let low = base[axis] + t * way[axis] + low[axis];
                        (boxes[axis][lane], boxes[axis + 3][lane]) = (low, low + size);
                    }
                }
                let (low, high) = (simd.splat(0.0), simd.splat(9.0));
                let (near, hits) = bundle.test(simd, &boxes, low, high);
                let near = simd.to_array(near);
                let mut any = 0u32;
                for ray in 0..LANES {
                    for lane in 0..LANES {
                        let (mut entry, mut exit) = (0.0f64, 9.0f64);
                        for axis in 0..3 {
                            let (o, d) = (f64::from(origins[axis][ray]), f64::from(directions[axis][ray]));
                            let (low, high) =
                                (f64::from(boxes[axis][lane]), f64::from(boxes[axis + 3][lane]));
                            let (a, b) = ((low - o) / d, (high - o) / d);
                            (entry, exit) = (entry.max(a.min(b)), exit.min(a.max(b)));
                        }
                        if entry <= exit {
                            any |= 1 << lane;
                            assert!(
                                hits >> lane & 1 == 1,
                                "round {round}, ray {ray}: a box that it meets is dropped"
                            );
                            assert!(
                                f64::from(near[lane]) <= entry * (1.0 + 1e-6),
                                "round {round}, ray {ray}"
                            );
                        }
                    }
                }
                kept += any.count_ones();
                dropped += (!hits & 0xff).count_ones();
            }
        }
        (kept, dropped)
    }
}

#[test]
fn a_bundle_keeps_every_box_that_one_of_its_rays_meets() {
    for level in levels() {
        let (kept, dropped) = dispatch(level, BundlesOp);
        assert!(kept > 1000 && dropped > 20_000, "{kept} {dropped}");
    }
}
