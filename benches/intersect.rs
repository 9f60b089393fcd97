//! The scalar certified test: nanoseconds per call where f64 decides (hit and miss), where a secondary ray leaves its surface, and
//! where exact arithmetic decides; the same pairs in plain f64 and in exact arithmetic alone, and the error bounds of a hit. Each
//! case first checks that its calls take the path that it names.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use outcrop::geom::{
    Ray, RayFrame, hit_position, intersect_certified, intersect_plain, offset_origin, position_error,
    triangle_normal,
};

type Triangle = [[f64; 3]; 3];

const CALLS: usize = 1024;

/// A fixed stream of numbers in `-1 .. 1` (a linear congruential generator; the high bits are good enough here).
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn point(&mut self, size: f64) -> [f64; 3] {
        [(); 3].map(|()| self.next() * size)
    }

    /// A triangle with f32 corners and some area.
    fn triangle(&mut self) -> Triangle {
        let center = self.point(10.0);
        loop {
            let corners = [(); 3].map(|()| self.point(0.1));
            let triangle = corners.map(|p| [0, 1, 2].map(|axis| f64::from((center[axis] + p[axis]) as f32)));
            let normal = triangle_normal(&triangle);
            if normal.iter().any(|x| x.abs() > 3e-3) {
                return triangle;
            }
        }
    }
}

fn between(triangle: &Triangle, u: f64, v: f64) -> [f64; 3] {
    hit_position(triangle, u, v)
}

fn aimed(origin: [f64; 3], target: [f64; 3]) -> Ray {
    Ray::new(origin, [0, 1, 2].map(|axis| target[axis] - origin[axis]))
}

/// Pairs that f64 decides; with a hit if `inside`.
fn decided(numbers: &mut Numbers, inside: bool) -> Vec<(Ray, Triangle)> {
    let (u, v) = if inside { (0.3, 0.4) } else { (-0.2, 0.5) };
    let mut pairs = Vec::new();
    while pairs.len() < CALLS {
        let triangle = numbers.triangle();
        let ray = aimed(numbers.point(50.0), between(&triangle, u, v));
        let mut exact = 0;
        let hit = intersect_certified(&ray, &triangle, &mut exact);
        assert_eq!(hit.is_some(), inside);
        if exact == 0 {
            pairs.push((ray, triangle));
        }
    }
    pairs
}

/// Rays that leave the triangle they start on.
fn leaving(numbers: &mut Numbers) -> Vec<(Ray, Triangle)> {
    let mut pairs = Vec::new();
    while pairs.len() < CALLS {
        let triangle = numbers.triangle();
        let direction = numbers.point(1.0);
        let (position, error) = (between(&triangle, 0.3, 0.4), position_error(&triangle, 0.3, 0.4));
        let origin = offset_origin(position, error, triangle_normal(&triangle), direction);
        let ray = Ray::new(origin, direction);
        let mut exact = 0;
        assert_eq!(intersect_certified(&ray, &triangle, &mut exact), None);
        if exact == 0 {
            pairs.push((ray, triangle));
        }
    }
    pairs
}

/// Rays through the middle of an edge, exactly: `f32` corners and origin, or full f64 ones.
fn through_edges(numbers: &mut Numbers, f32_origin: bool) -> Vec<(Ray, Triangle)> {
    let mut pairs = Vec::new();
    while pairs.len() < CALLS {
        let triangle = numbers.triangle();
        let origin = numbers.point(50.0).map(|x| if f32_origin { f64::from(x as f32) } else { x });
        let ray = aimed(origin, between(&triangle, 0.5, 0.0));
        let mut exact = 0;
        intersect_certified(&ray, &triangle, &mut exact);
        if exact == 1 {
            pairs.push((ray, triangle));
        }
    }
    pairs
}

/// Flat hits whose sign f64 knows but whose `t` it does not.
fn grazing(numbers: &mut Numbers) -> Vec<(Ray, Triangle)> {
    let mut pairs = Vec::new();
    while pairs.len() < CALLS {
        let triangle = numbers.triangle();
        let target = between(&triangle, 0.3, 0.4);
        let normal = triangle_normal(&triangle);
        let [a, b, _] = triangle;
        let origin = [0, 1, 2].map(|axis| target[axis] + 200.0 * (b[axis] - a[axis]) + 1e-1 * normal[axis]);
        let ray = aimed(origin, target);
        let mut exact = 0;
        if intersect_certified(&ray, &triangle, &mut exact).is_some() && exact == 1 {
            pairs.push((ray, triangle));
        }
    }
    pairs
}

fn intersect(criterion: &mut Criterion) {
    let mut numbers = Numbers(1);
    let cases = [
        ("hit", decided(&mut numbers, true)),
        ("miss", decided(&mut numbers, false)),
        ("leaving", leaving(&mut numbers)),
        ("exact, grazing", grazing(&mut numbers)),
        ("exact, edge, f32 origin", through_edges(&mut numbers, true)),
        ("exact, edge, f64 origin", through_edges(&mut numbers, false)),
    ];
    let mut group = criterion.benchmark_group("certified");
    group.throughput(Throughput::Elements(CALLS as u64));
    for (name, pairs) in &cases {
        let prepared: Vec<_> = pairs.iter().map(|(ray, triangle)| (RayFrame::new(ray), *triangle)).collect();
        group.bench_function(*name, |bencher| {
            bencher.iter(|| {
                let (mut exact, mut hits) = (0, 0);
                for (frame, triangle) in black_box(&prepared) {
                    hits += usize::from(frame.intersect(triangle, &mut exact).is_some());
                }
                black_box((hits, exact))
            });
        });
    }
    for (name, pairs) in &cases[..2] {
        group.bench_function(format!("plain f64, {name}"), |bencher| {
            bencher.iter(|| {
                let hits = black_box(pairs)
                    .iter()
                    .filter(|(ray, triangle)| intersect_plain(ray, triangle).is_some());
                black_box(hits.count())
            });
        });
        let prepared: Vec<_> = pairs.iter().map(|(ray, triangle)| (RayFrame::new(ray), *triangle)).collect();
        for (frame, triangle) in &prepared {
            assert_eq!(frame.intersect_exactly(triangle), frame.intersect(triangle, &mut 0));
        }
        group.bench_function(format!("exact alone, {name}"), |bencher| {
            bencher.iter(|| {
                let hits = black_box(&prepared)
                    .iter()
                    .filter(|(frame, triangle)| frame.intersect_exactly(triangle).is_some());
                black_box(hits.count())
            });
        });
    }
    let met: Vec<_> = cases[0]
        .1
        .iter()
        .map(|(ray, triangle)| {
            let frame = RayFrame::new(ray);
            (frame, *triangle, frame.intersect(triangle, &mut 0).expect("these are hits"))
        })
        .collect();
    group.bench_function("error bounds of a hit", |bencher| {
        bencher.iter(|| {
            for (frame, triangle, hit) in black_box(&met) {
                black_box(frame.error_bounds(triangle, hit));
            }
        });
    });
    let rays: Vec<_> = cases[0].1.iter().map(|(ray, _)| *ray).collect();
    group.bench_function("RayFrame::new", |bencher| {
        bencher.iter(|| {
            for ray in black_box(&rays) {
                black_box(RayFrame::new(ray));
            }
        });
    });
    group.finish();
}

criterion_group!(benches, intersect);
criterion_main!(benches);
