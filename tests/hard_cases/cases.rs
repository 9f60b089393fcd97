//! Models and rays that are hard to get right. Shared with `benches/peers`, which counts what each tier and each peer
//! makes of them. All numbers are exact as they stand; those of `Precision::Float32` cases are exact in f32, rays too.

use std::collections::BTreeSet;

use outcrop::geom::{Lattice, Precision, Ray, triangle_normal};
use outcrop::import::MeshBuffer;
use outcrop::procedural::{Icosphere, Shape};

pub use crate::numbers::{Random, along, minus, unit};
use crate::truth::Triangle;

/// A model, and rays that ask for its weak spots.
pub struct Case {
    /// As in `docs/numerics.md`.
    pub name: &'static str,
    pub precision: Precision,
    pub triangles: Vec<Triangle>,
    pub rays: Vec<Ray>,
}

/// To the nearest multiple of `step`, a power of two.
fn snap(p: [f64; 3], step: f64) -> [f64; 3] {
    p.map(|x| (x / step).round() * step)
}

pub fn to_f32(p: [f64; 3]) -> [f64; 3] {
    p.map(|x| f64::from(x as f32))
}

/// The nearest power of two above `x`.
fn power_above(x: f64) -> f64 {
    x.log2().ceil().exp2()
}

/// The triangles of a sphere about `center` with all coordinates multiples of `step`.
pub fn sphere(center: [f64; 3], radius: f64, subdivisions: u32, step: f64) -> Vec<Triangle> {
    let mut mesh = MeshBuffer::new();
    Icosphere::new(radius, [0.0; 3], subdivisions).and_then(|shape| shape.emit(&mut mesh)).unwrap();
    let place = |p: [f64; 3]| along(center, 1.0, snap(p, step));
    (0..mesh.triangles.len()).map(|triangle| mesh.corners(triangle).map(place)).collect()
}

/// The convex hull of random points with integer coordinates (brute force, exact in f64): flat, long and tiny
/// faces side by side, unlike a sphere's.
pub fn hull(count: usize, size: f64, random: &mut Random) -> Vec<Triangle> {
    let points: Vec<[f64; 3]> =
        (0..count).map(|_| unit(random.vector(1.0)).map(|x| (size * x * x.abs()).round())).collect();
    let mut faces = Vec::new();
    for a in 0..count {
        for b in a + 1..count {
            for c in b + 1..count {
                let face = [points[a], points[b], points[c]];
                let normal = triangle_normal(&face);
                let side = |p: &[f64; 3]| {
                    let away = minus(*p, face[0]);
                    (0..3).map(|axis| normal[axis] * away[axis]).sum::<f64>()
                };
                let (low, high) = points
                    .iter()
                    .map(side)
                    .fold((0.0f64, 0.0f64), |(low, high), side| (low.min(side), high.max(side)));
                if normal != [0.0; 3] && (low == 0.0) != (high == 0.0) {
                    faces.push(if high == 0.0 { face } else { [face[0], face[2], face[1]] });
                }
            }
        }
    }
    faces
}

/// Squares of a height field over integer x and y, each cut in two.
fn grid(side: i32, height: impl Fn(i32, i32) -> f64) -> Vec<Triangle> {
    let corner = |x: i32, y: i32| [f64::from(x), f64::from(y), height(x, y)];
    let mut triangles = Vec::new();
    for x in 0..side {
        for y in 0..side {
            triangles.push([corner(x, y), corner(x + 1, y), corner(x + 1, y + 1)]);
            triangles.push([corner(x, y), corner(x + 1, y + 1), corner(x, y + 1)]);
        }
    }
    triangles
}

/// Every distinct vertex.
pub fn vertices(triangles: &[Triangle]) -> Vec<[f64; 3]> {
    let distinct: BTreeSet<[u64; 3]> = triangles.iter().flatten().map(|p| p.map(f64::to_bits)).collect();
    distinct.into_iter().map(|p| p.map(f64::from_bits)).collect()
}

/// The middle of every edge, twice where two triangles share it.
pub fn middles(triangles: &[Triangle]) -> Vec<[f64; 3]> {
    let middle = |p: [f64; 3], q: [f64; 3]| [0, 1, 2].map(|axis| 0.5 * p[axis] + 0.5 * q[axis]);
    triangles.iter().flat_map(|[a, b, c]| [middle(*a, *b), middle(*b, *c), middle(*c, *a)]).collect()
}

fn aimed(origin: [f64; 3], target: [f64; 3]) -> Ray {
    Ray::new(origin, minus(target, origin))
}

/// Rays from points near the middle, multiples of `step`, exactly through the targets.
fn from_inside(
    center: [f64; 3],
    reach: f64,
    step: f64,
    targets: &[[f64; 3]],
    random: &mut Random,
) -> Vec<Ray> {
    let origin = |random: &mut Random| along(center, 1.0, snap(random.vector(reach), step));
    targets.iter().map(|target| aimed(origin(random), *target)).collect()
}

fn lattice(step: f64) -> Precision {
    Precision::Lattice(Lattice { exponent: step.log2() as i32 })
}

/// Translations of the closed models.
pub const TRANSLATIONS: [f64; 4] = [0.0, 1e4, 1e6, 1e7];

/// A closed sphere far from the origin; rays from within exactly at its vertices or at the middles of its edges.
pub fn closed_sphere(name: &'static str, translation: f64, at_edges: bool) -> Case {
    let mut random = Random(1);
    // Coordinates are f32 numbers, and so are their differences and the middles of edges.
    let step = (translation * 2f64.powi(-22)).max(2f64.powi(-10));
    let step = if translation == 0.0 { step } else { power_above(step) };
    let center = [translation, -translation, translation].map(|x| (x / step).round() * step);
    let triangles = sphere(center, 1000.0, 3, step);
    let targets = if at_edges { middles(&triangles) } else { vertices(&triangles) };
    let rays = from_inside(center, 300.0, step, &targets, &mut random);
    Case { name, precision: Precision::Float32, triangles, rays }
}

/// Closed hulls of random points, rays from within at vertices and edges.
pub fn closed_hulls() -> Case {
    let mut random = Random(2);
    let mut case = Case {
        name: "leaks_of_hulls",
        precision: Precision::Float32,
        triangles: Vec::new(),
        rays: Vec::new(),
    };
    for index in 0..4 {
        let shift = [3000.0 * f64::from(index), 0.0, 0.0];
        let triangles: Vec<Triangle> = hull(40, 1000.0, &mut random)
            .into_iter()
            .map(|face| face.map(|p| along(p, 1.0, shift)))
            .collect();
        let targets: Vec<_> = vertices(&triangles).into_iter().chain(middles(&triangles)).collect();
        for _ in 0..4 {
            case.rays.extend(from_inside(shift, 60.0, 1.0, &targets, &mut random));
        }
        case.triangles.extend(triangles);
    }
    case
}

/// A height field over integers, rays straight down and slanted at vertices, edges and diagonals.
pub fn grid_from_above() -> Case {
    let mut random = Random(3);
    let triangles = grid(20, |x, y| f64::from((x * 7 + y * 13) % 5));
    let mut rays = Vec::new();
    for target in vertices(&triangles).into_iter().chain(middles(&triangles)) {
        // Inside the border, where every line meets something.
        if (0..2).all(|axis| target[axis] > 0.5 && target[axis] < 19.5) {
            rays.push(Ray::new([target[0], target[1], 64.0], [0.0, 0.0, -1.0]));
            rays.push(Ray::new([target[0], target[1], -64.0], [-0.0, 0.0, 4.0]));
            let slant = [0.25 * random.signed().round(), 0.25 * random.signed().round(), -1.0];
            rays.push(Ray::new(along(target, -16.0, slant), slant));
        }
    }
    Case { name: "leaks_of_a_grid", precision: Precision::Float32, triangles, rays }
}

/// A sphere on a lattice of so many steps across, rays from within at vertices and edges.
pub fn sphere_on_lattice(bits: i32) -> Case {
    let mut random = Random(4);
    let (step, radius) = (2f64.powi(-bits), 0.5);
    let center = [1.0, 2.0, -3.0];
    let triangles = sphere(center, radius, 3, step);
    let targets: Vec<_> = vertices(&triangles).into_iter().chain(middles(&triangles)).collect();
    let rays = from_inside(center, 0.1, 0.5 * step, &targets, &mut random);
    Case { name: "seams_across_block_borders", precision: lattice(step), triangles, rays }
}

/// A height field, every triangle three times: all hits tie.
pub fn laid_twice() -> Case {
    let mut case = grid_from_above();
    let once: Vec<Triangle> = case.triangles.iter().copied().take(200).collect();
    let mut random = Random(5);
    case.triangles = (0..600).map(|i| once[(i * 7) % 200]).collect();
    case.rays.retain(|ray| ray.at(64.0)[0] < 5.0 || ray.origin[0] < 5.0);
    case.rays.truncate(300);
    for _ in 0..300 {
        let [a, b, c] = random.pick(&once);
        let inside = [0, 1, 2].map(|axis| 0.25 * a[axis] + 0.5 * b[axis] + 0.25 * c[axis]);
        case.rays.push(Ray::new(along(inside, 8.0, [0.5, 0.25, 1.0]), [-0.5, -0.25, -1.0]));
    }
    Case { name: "a_mesh_laid_on_itself", ..case }
}

/// Needles of aspect 1e5, rays through inner points at a slope of 1e-4.
pub fn needles() -> Case {
    let mut random = Random(6);
    let mut case = Case {
        name: "needles_at_grazing_incidence",
        precision: Precision::Float32,
        triangles: Vec::new(),
        rays: Vec::new(),
    };
    for _ in 0..400 {
        let middle = random.vector(100.0);
        let length = unit(random.vector(1.0));
        let width = unit(random.vector(1.0));
        let b = along(middle, 10.0, length);
        let c = along(along(middle, 10.0 * random.signed().abs(), length), 1e-4, width);
        let triangle = [middle, b, c].map(to_f32);
        let normal = unit(triangle_normal(&triangle));
        if !normal[0].is_finite() {
            continue;
        }
        let inside =
            [0, 1, 2].map(|axis| 0.3 * triangle[0][axis] + 0.4 * triangle[1][axis] + 0.3 * triangle[2][axis]);
        let direction = to_f32(along(unit(minus(triangle[1], triangle[0])), 1e-4, normal));
        case.rays.push(Ray::new(to_f32(along(inside, -50.0, direction)), direction));
        // And across, where the needle is a hair.
        let origin = to_f32(along(inside, 30.0, unit(along(normal, 0.3, length))));
        case.rays.push(Ray::new(origin, to_f32(minus(inside, origin))));
        case.triangles.push(triangle);
    }
    case
}

/// Triangles of no area, among which others stand; rays through both.
pub fn without_area() -> Case {
    let mut random = Random(7);
    let mut triangles = Vec::new();
    let integers = |random: &mut Random| random.vector(40.0).map(f64::round);
    for round in 0..600 {
        let (a, d) = (integers(&mut random), integers(&mut random));
        triangles.push(match round % 4 {
            0 => [a, along(a, 1.0, d), along(a, 3.0, d)],
            1 => [a, a, along(a, 1.0, d)],
            2 => [a; 3],
            _ => [a, along(a, 1.0, d), integers(&mut random)],
        });
    }
    let rays = (0..800)
        .map(|_| {
            let [a, b, _] = random.pick(&triangles);
            let target = [0, 1, 2].map(|axis| 0.5 * (a[axis] + b[axis]));
            let origin = integers(&mut random).map(|x| 2.0 * x + 1.0);
            aimed(origin, target)
        })
        .collect();
    Case { name: "zero_area_and_collinear_triangles", precision: Precision::Float32, triangles, rays }
}

/// Rays exactly in the planes of triangles, and others half a step off.
pub fn in_the_plane() -> Case {
    let mut random = Random(8);
    let mut case = Case {
        name: "rays_in_a_triangles_plane",
        precision: Precision::Float32,
        triangles: Vec::new(),
        rays: Vec::new(),
    };
    for _ in 0..300 {
        let shift = random.vector(200.0).map(f64::round);
        let triangle = [(); 3].map(|()| along(shift, 1.0, random.vector(20.0).map(f64::round)));
        let [a, b, c] = triangle;
        let direction = along(minus(b, a), random.pick(&[0.0, 1.0, -2.0]), minus(c, a));
        if direction == [0.0; 3] {
            continue;
        }
        let origin = along(along(a, -3.0, direction), random.pick(&[0.0, 1.0]), minus(c, a));
        case.rays.push(Ray::new(origin, direction));
        let mut off = origin;
        off[random.index(3)] += 2f64.powi(-12);
        case.rays.push(Ray::new(off, direction));
        case.triangles.push(triangle);
    }
    case
}

/// Boxes whose faces lie where trees split, rays along the axes with zeros of both signs, from split planes, through
/// corners of cells and along their faces.
pub fn on_split_planes() -> Case {
    let mut triangles = Vec::new();
    // Walls of a cubic lattice of cells: every face lies on a plane that halves the model, a half of it, and so on.
    for axis in 0..3 {
        for layer in [0, 2, 4, 6, 8] {
            for (i, j) in (0..16).map(|cell| (cell / 4, cell % 4)) {
                let corner = |di: i32, dj: i32| {
                    let mut p = [0.0; 3];
                    p[axis] = f64::from(layer) - 4.0;
                    p[(axis + 1) % 3] = f64::from(2 * (i + di)) - 4.0;
                    p[(axis + 2) % 3] = f64::from(2 * (j + dj)) - 4.0;
                    p
                };
                triangles.push([corner(0, 0), corner(1, 0), corner(1, 1)]);
                triangles.push([corner(0, 0), corner(1, 1), corner(0, 1)]);
            }
        }
    }
    let mut rays = Vec::new();
    for axis in 0..3 {
        for sign in [1.0, -1.0] {
            for zero in [0.0, -0.0] {
                for (i, j) in (0..81).map(|place| (place / 9, place % 9)) {
                    let mut origin = [0.0; 3];
                    origin[axis] = -sign * 8.0;
                    origin[(axis + 1) % 3] = f64::from(i) - 4.0;
                    origin[(axis + 2) % 3] = f64::from(j) - 4.0;
                    let mut direction = [zero; 3];
                    direction[axis] = sign;
                    rays.push(Ray::new(origin, direction));
                    // From a split plane itself.
                    origin[axis] = 2.0 * sign;
                    rays.push(Ray { t_min: 0.0, ..Ray::new(origin, direction) });
                }
            }
        }
    }
    // Through the corners of cells along diagonals of faces and of the cube.
    for x in [-1.0, 0.0, 1.0] {
        for y in [-1.0, 0.0, 1.0] {
            for z in [-1.0, -0.0, 1.0] {
                if [x, y, z] != [0.0; 3] {
                    for start in [[0.0; 3], [2.0, -2.0, 4.0], [-4.0, 4.0, 0.0], [1.0, 1.0, 1.0]] {
                        rays.push(Ray::new(along(start, -16.0, [x, y, z]), [x, y, z]));
                    }
                }
            }
        }
    }
    Case { name: "axes_split_planes_and_cell_corners", precision: Precision::Float32, triangles, rays }
}

/// A sphere scaled by a power of two, rays from within at its vertices.
pub fn sphere_of_size(name: &'static str, scale: f64) -> Case {
    let case = closed_sphere(name, 0.0, false);
    let times = |p: [f64; 3]| p.map(|x| x * scale);
    Case {
        triangles: case.triangles.iter().map(|triangle| triangle.map(times)).collect(),
        rays: case.rays.iter().map(|ray| Ray::new(times(ray.origin), times(ray.direction))).collect(),
        ..case
    }
}

/// Scales of [`sphere_of_size`]: radii of about 1e-3, 1e-9, 1e-18 and 6e11.
pub fn sizes() -> [(&'static str, f64); 4] {
    [
        ("radius_1e-3", 2f64.powi(-20)),
        ("radius_1e-9", 2f64.powi(-40)),
        ("radius_1e-18", 2f64.powi(-70)),
        ("extent_6e11", 2f64.powi(29)),
    ]
}

/// A sphere and rays of which some components are subnormal in f32, or the whole direction is tiny or huge (1e18 at most:
/// Embree ends the process beyond).
pub fn denormal_directions() -> Case {
    let mut case = closed_sphere("denormal_directions", 0.0, false);
    let mut random = Random(9);
    case.rays = case
        .rays
        .iter()
        .enumerate()
        .map(|(index, ray)| match index % 3 {
            0 => Ray::new(ray.origin, ray.direction.map(|x| x * 2f64.powi(-136))),
            1 => {
                let mut direction = [2f64.powi(-149), -2f64.powi(-140), 2f64.powi(-149)];
                direction[random.index(3)] = 1.0;
                Ray::new(ray.origin, direction)
            }
            _ => Ray::new(ray.origin, ray.direction.map(|x| x * 2f64.powi(50))),
        })
        .collect();
    case
}

/// 1e-3 detail at 1e7 on a lattice: a sphere of radius 1e-3, rays from one unit away and from within.
pub fn detail_far_out() -> Case {
    let mut random = Random(10);
    let step = 2f64.powi(-28);
    let center = [1e7, -1e7, 0.5e7];
    let triangles = sphere(center, 1e-3, 2, step);
    let targets: Vec<_> = vertices(&triangles).into_iter().chain(middles(&triangles)).collect();
    let mut rays = from_inside(center, 3e-4, step, &targets, &mut random);
    for target in &targets {
        let outward = unit(minus(*target, center));
        let origin = snap(along(*target, 1.0, along(outward, 0.2, random.vector(1.0))), step);
        rays.push(aimed(origin, *target));
    }
    Case { name: "detail_of_1e-3_at_1e7", precision: lattice(step), triangles, rays }
}

/// Pairs of plates 1e-3 apart at 1e7, rays across; the second plate is asked for from between the two.
pub fn plates_far_out() -> Case {
    let step = 2f64.powi(-28);
    let gap = (1e-3 / step).round() * step;
    let base = [1e7, 1e7, -1e7];
    let mut triangles = Vec::new();
    for z in [0.0, gap] {
        triangles.extend(
            grid(8, |_, _| 0.0).iter().map(|t| t.map(|p| along(along(base, 1.0, p), z, [0.0, 0.0, 1.0]))),
        );
    }
    let mut random = Random(11);
    let mut rays = Vec::new();
    for _ in 0..400 {
        let at = [4.0 + 3.0 * random.signed(), 4.0 + 3.0 * random.signed(), 0.0];
        let target = along(base, 1.0, snap(at, step));
        let slant = snap([0.3 * random.signed(), 0.3 * random.signed(), 1.0], step);
        rays.push(Ray::new(along(target, -2.0, slant), slant));
        let between = along(target, 0.5 * gap, [0.0, 0.0, 1.0]);
        rays.push(Ray::new(snap(between, 0.5 * step), slant));
    }
    Case { name: "plates_1e-3_apart_at_1e7", precision: lattice(step), triangles, rays }
}

/// Rays that end exactly at a hit, or one step of f32 before it.
pub fn ends_at_a_hit() -> Case {
    let mut case = closed_sphere("t_max_exactly_at_a_hit", 0.0, true);
    for (index, ray) in case.rays.iter_mut().enumerate() {
        // The target is at t = 1.
        ray.t_max = if index % 2 == 0 { 1.0 } else { f64::from(1f32.next_down()) };
    }
    case
}

/// Every case that a table can hold.
pub fn all() -> Vec<Case> {
    let mut cases = Vec::new();
    for (names, at_edges) in [
        (
            [
                "sphere_vertices_at_0",
                "sphere_vertices_at_1e4",
                "sphere_vertices_at_1e6",
                "sphere_vertices_at_1e7",
            ],
            false,
        ),
        (["sphere_edges_at_0", "sphere_edges_at_1e4", "sphere_edges_at_1e6", "sphere_edges_at_1e7"], true),
    ] {
        cases.extend(names.into_iter().zip(TRANSLATIONS).map(|(name, by)| closed_sphere(name, by, at_edges)));
    }
    cases.extend([closed_hulls(), grid_from_above(), sphere_on_lattice(16), laid_twice(), needles()]);
    cases.extend([without_area(), in_the_plane(), on_split_planes()]);
    cases.extend(sizes().into_iter().map(|(name, scale)| sphere_of_size(name, scale)));
    cases.extend([denormal_directions(), detail_far_out(), plates_far_out(), ends_at_a_hit()]);
    cases
}
