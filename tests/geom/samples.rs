//! Rays and triangles: easy, hard and meant to break.

use outcrop::geom::Ray;

pub use crate::numbers::{Random, along, cross, minus, unit};

pub type Triangle = [[f64; 3]; 3];

/// A point of the triangle: inside, on an edge, at a vertex, or a little outside.
pub fn point_of(random: &mut Random, [a, b, c]: &Triangle) -> [f64; 3] {
    let (mut u, mut v) = match random.below(4) {
        0 => (0.0, 0.0),
        1 => (0.5 * random.signed() + 0.5, 0.0),
        _ => (0.5 * random.signed() + 0.5, 0.5 * random.signed() + 0.5),
    };
    if u + v > 1.0 && random.below(4) > 0 {
        (u, v) = (1.0 - u, 1.0 - v);
    }
    [0, 1, 2].map(|axis| a[axis] + u * (b[axis] - a[axis]) + v * (c[axis] - a[axis]))
}

fn aimed(origin: [f64; 3], target: [f64; 3]) -> Ray {
    Ray::new(origin, minus(target, origin))
}

fn translated(triangle: Triangle, by: [f64; 3]) -> Triangle {
    triangle.map(|p| along(p, 1.0, by))
}

fn to_f32(triangle: Triangle) -> Triangle {
    triangle.map(|p| p.map(|x| f64::from(x as f32)))
}

/// The axes in some order.
fn turned(random: &mut Random) -> [usize; 3] {
    let first = random.below(3) as usize;
    let others = [(first + 1) % 3, (first + 2) % 3];
    if random.below(2) == 0 { [first, others[0], others[1]] } else { [first, others[1], others[0]] }
}

/// A vertex, or the middle or a quarter of an edge: exact for vertices of up to 51 bits.
fn on_border(random: &mut Random, triangle: &Triangle) -> [f64; 3] {
    let first = random.below(3) as usize;
    let (a, b) = (triangle[first], triangle[(first + 1) % 3]);
    let part = [0.0, 0.5, 0.25][random.below(3) as usize];
    [0, 1, 2].map(|axis| a[axis] + part * (b[axis] - a[axis]))
}

/// As it is, or one component off by the least step of f32 or of f64.
fn nudged(random: &mut Random, mut point: [f64; 3]) -> [f64; 3] {
    let axis = random.below(3) as usize;
    match random.below(4) {
        0 => point[axis] = point[axis].next_up(),
        1 => point[axis] = f64::from((point[axis] as f32).next_down()),
        _ => {}
    }
    // Nothing below the proven domain.
    point.map(|x| if x.abs() < 2f64.powi(-200) { 0.0 } else { x })
}

/// The families of [`sample`], by name.
pub const FAMILIES: [&str; 20] = [
    "random",
    "f32 vertices",
    "exact hits of vertices and edges",
    "collinear and double vertices",
    "needles at grazing incidence",
    "1e-3 detail at 1e7",
    "small integers",
    "directions of extreme length",
    "extreme f32 coordinates",
    "whole proven domain",
    "origin on the surface",
    "parallel to the plane",
    "far and tiny",
    "extreme lattices",
    "needles of every width at every slope",
    "needles in their own plane",
    "a hair off a slanted plane",
    "along an axis at boxes, and nearly",
    "short directions at short vertices, and nearly",
    "f32 directions at f32 vertices, and nearly",
];

/// A ray and a triangle of a family. All inside the proven domain.
pub fn sample(family: usize, random: &mut Random) -> (Ray, Triangle) {
    match family {
        0 => {
            let triangle = [(); 3].map(|()| random.vector(1.0));
            (aimed(random.vector(3.0), point_of(random, &triangle)), triangle)
        }
        1 => {
            let triangle = to_f32([(); 3].map(|()| random.vector(100.0)));
            (aimed(random.vector(300.0), point_of(random, &triangle)), triangle)
        }
        2 => {
            // Even vertices and integer steps: midpoints and directions are exact.
            let triangle = [(); 3].map(|()| random.integers(1000).map(|x| 4.0 * x));
            let [a, b, c] = triangle;
            let target = match random.below(3) {
                0 => a,
                1 => [0, 1, 2].map(|axis| 0.5 * (a[axis] + b[axis])),
                _ => [0, 1, 2].map(|axis| 0.25 * (b[axis] + 3.0 * c[axis])),
            };
            let direction = random.integers(1000);
            let direction = if direction == [0.0; 3] { [1.0, 2.0, 3.0] } else { direction };
            let steps = random.below(1000) as f64;
            (Ray::new(along(target, -steps, direction), direction), triangle)
        }
        3 => {
            let (a, d) = (random.integers(50), random.integers(50));
            let mut triangle = [a, along(a, random.below(5) as f64, d), along(a, random.below(5) as f64, d)];
            if random.below(2) == 0 {
                // One unit in the last place away from collinear.
                triangle[2][0] =
                    if triangle[2][0] == 0.0 { 2f64.powi(-200) } else { triangle[2][0].next_up() };
            }
            (aimed(random.integers(90), point_of(random, &triangle)), triangle)
        }
        4 => {
            let size = 10.0;
            let a = random.vector(size);
            let (length, width) = (unit(random.vector(1.0)), unit(random.vector(1.0)));
            let b = along(a, size, length);
            let c = along(along(a, size * 0.5 * (random.signed() + 1.0), length), size * 1e-5, width);
            let triangle = to_f32([a, b, c]);
            let normal = unit(cross(length, width));
            let slope = along(unit(random.vector(1.0)), 0.0, normal);
            let flat = cross(normal, slope);
            let direction = along(flat, 1e-4 * random.signed(), normal);
            let target = point_of(random, &triangle);
            (Ray::new(along(target, -100.0, direction), direction), triangle)
        }
        5 => {
            let base = random.vector(1e7);
            let triangle = translated([(); 3].map(|()| random.vector(1e-3)), base);
            let distance = if random.below(2) == 0 { 1.0 } else { 1e4 };
            let origin = along(base, 1.0, random.vector(distance));
            (aimed(origin, point_of(random, &triangle)), triangle)
        }
        6 => {
            let triangle = [(); 3].map(|()| random.integers(3));
            let direction = random.integers(2);
            let direction = if direction == [0.0; 3] { [0.0, 0.0, -1.0] } else { direction };
            (Ray::new(random.integers(4), direction), triangle)
        }
        7 => {
            let (mut ray, triangle) = sample(random.below(2) as usize, random);
            // Powers of two keep the aim; the finest are left with a few bits of direction.
            let exponent = [-1060, -1022, -700, 700, 1010][random.below(5) as usize];
            let (half, rest) = (2f64.powi(exponent / 2), 2f64.powi(exponent - exponent / 2));
            ray.direction = ray.direction.map(|x| x * half * rest);
            if ray.direction == [0.0; 3] {
                ray.direction[2] = f64::from_bits(1);
            }
            (ray, triangle)
        }
        8 => {
            let low = random.below(2) == 0;
            let pick = |random: &mut Random| {
                if low {
                    f64::from(f32::from_bits(random.below(100) as u32 | (random.bits() as u32 & 1 << 31)))
                } else {
                    f64::from((random.signed() * 3.4e38) as f32)
                }
            };
            let triangle = [(); 3].map(|()| [(); 3].map(|()| pick(random)));
            let origin = [(); 3].map(|()| pick(random));
            let ray = aimed(origin, point_of(random, &triangle));
            (if ray.direction == [0.0; 3] { Ray::new(origin, [1.0, 0.0, 0.0]) } else { ray }, triangle)
        }
        9 => {
            let (low, high) = match random.below(3) {
                0 => (-200, 252),
                1 => (-200, -190),
                _ => (248, 252),
            };
            let triangle = [(); 3].map(|()| random.wilds(low, high));
            let origin = random.wilds(low, high);
            let (aim, ratio) = (random.below(2), random.below(2));
            let direction = match (aim, ratio) {
                (0, _) => minus(point_of(random, &triangle), origin),
                (_, 0) => random.wilds(0, 3),
                _ => random.wilds(-250, 250),
            };
            // point_of rounds below the grid; the direction must stay inside the domain.
            let longest = direction.iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let direction = direction.map(|x| if x.abs() < longest * 2f64.powi(-518) { 0.0 } else { x });
            (Ray::new(origin, if longest == 0.0 { [0.0, 1.0, 0.0] } else { direction }), triangle)
        }
        10 => {
            let far = [1.0, 1e3, 1e7][random.below(3) as usize];
            let base = random.vector(far);
            let triangle = translated([(); 3].map(|()| random.vector(1.0)), base);
            let mut origin = point_of(random, &triangle);
            if random.below(2) == 0 {
                origin[0] = origin[0].next_up();
            }
            (Ray::new(origin, random.vector(1.0)), triangle)
        }
        11 => {
            let triangle = [(); 3].map(|()| random.integers(20));
            let [a, b, c] = triangle;
            let (ab, ac) = (minus(b, a), minus(c, a));
            let direction = along(ab, random.integers(3)[0], ac);
            let mut ray = Ray::new(along(a, -3.0, direction), direction);
            if random.below(2) == 0 {
                // Meets the plane somewhere near 3 steps ahead.
                ray.direction[random.below(3) as usize] += 2f64.powi(-40);
                ray.origin[random.below(3) as usize] += 2f64.powi(-39);
            }
            if ray.direction == [0.0; 3] {
                ray.direction[0] = 1.0;
            }
            (ray, triangle)
        }
        12 => {
            let triangle = to_f32([(); 3].map(|()| random.vector(1e-6)));
            (aimed(random.vector(1e9), point_of(random, &triangle)), triangle)
        }
        14 | 15 => {
            // Full mantissas, so that every operation of every stage rounds.
            let (a, ab) = (random.vector(1.0), random.vector(1.0));
            let width = 2f64.powi(-(random.below(45) as i32));
            let ac = along(random.vector(width), random.signed(), ab);
            let triangle = [a, along(a, 1.0, ab), along(a, 1.0, ac)];
            let target = point_of(random, &triangle);
            let mut direction = along(random.vector(1.0), random.signed() / width, ac);
            if family == 14 {
                direction = along(direction, 2f64.powi(-(random.below(52) as i32)), random.vector(1.0));
            } else {
                let slope = 2f64.powi(-(random.below(52) as i32));
                let level = random.signed();
                direction = along(along(random.vector(slope), level, ab), random.signed(), ac);
            }
            let distance = 2f64.powi(random.below(12) as i32 - 2);
            (Ray::new(along(target, -distance, direction), direction), triangle)
        }
        16 => {
            // The plane y = 3 x, exactly, with z of full mantissa; the origin 2^-80 of the triangle's size off it.
            let corner = |random: &mut Random, x: f64, z: f64| {
                let x = (2f64.powi(40) * (x + 0.1 * random.signed())).round();
                [x, 3.0 * x, 2f64.powi(40) * (z + 0.1 * random.signed())]
            };
            let corners = [(1.0, 0.0), (-0.5, 0.8), (-0.5, -0.8)];
            let triangle = corners.map(|(x, z)| corner(random, x, z));
            let x = random.integers(1 << 20)[0] * 2f64.powi(-20);
            let off = 2f64.powi(-(random.below(50) as i32));
            let origin = [x, 3.0 * x + off, random.signed()];
            (Ray::new(origin, [random.signed(), -4.0, random.signed()]), triangle)
        }
        17 => {
            let corners = if random.below(2) == 0 {
                [(); 2].map(|()| random.vector(100.0).map(|x| f64::from(x as f32)))
            } else {
                // A lattice far out.
                [(); 2].map(|()| random.integers(1 << 34).map(|x| x * 2f64.powi(-10)))
            };
            let [x, y, z] = turned(random);
            // Two opposite vertices of one side of the box, and one of the others.
            let (lower, upper) = (corners[0], corners[1]);
            let mut side = [lower; 3];
            (side[1][x], side[1][y], side[2][x]) = (upper[x], upper[y], upper[x]);
            let target = on_border(random, &side);
            let mut direction = [0.0; 3];
            direction[z] = if random.below(2) == 0 { 1.0 } else { -1.0 };
            let back = along(target, -f64::from(1 << random.below(10)), direction);
            (Ray::new(nudged(random, back), direction), side)
        }
        18 => {
            let bits = random.below(24);
            let step = 2f64.powi(random.below(60) as i32 - 30);
            let triangle = [(); 3].map(|()| random.integers(4 << bits).map(|x| x * step));
            let longest = 1 << random.below(12);
            let direction = random.integers(longest);
            let direction = if direction == [0.0; 3] { [0.0, 1.0, 0.0] } else { direction };
            let target = on_border(random, &triangle);
            let origin = along(target, -(random.below(1 << 10) as f64) * step, direction);
            (Ray::new(nudged(random, origin), direction), triangle)
        }
        19 => {
            let triangle = to_f32([(); 3].map(|()| random.vector(10.0)));
            let origin = random.vector(100.0).map(|x| f64::from(x as f32));
            // From f32 to the middle of f32: an exact difference of few bits.
            let target = on_border(random, &triangle);
            (Ray::new(nudged(random, origin), minus(target, origin)), triangle)
        }
        _ => {
            let exponent = [-200, -100, 0, 100, 200][random.below(5) as usize];
            let step = 2f64.powi(exponent);
            let size = [4i64, 1 << 24, 1 << 52][random.below(3) as usize];
            let triangle = [(); 3].map(|()| random.integers(size).map(|x| x * step));
            let origin = random.integers(size).map(|x| x * step);
            let ray = aimed(origin, point_of(random, &triangle));
            (if ray.direction == [0.0; 3] { Ray::new(origin, [0.0, 1.0, 0.0]) } else { ray }, triangle)
        }
    }
}
