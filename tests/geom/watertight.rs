//! No ray passes through a closed surface (I3): every triangle against every ray, no tree in between.

use std::collections::HashMap;

use outcrop::geom::{Ray, RayFrame, hit_position, offset_origin, position_error, triangle_normal};

use crate::samples::{Random, along, minus, unit};

/// A closed sphere of triangles about `center`; every vertex is rounded once and shared.
fn icosphere(center: [f64; 3], radius: f64, levels: usize) -> (Vec<[f64; 3]>, Vec<[usize; 3]>) {
    let golden = 0.5 * (1.0 + 5f64.sqrt());
    let mut vertices: Vec<[f64; 3]> = Vec::new();
    for (p, q) in [(-1.0, -golden), (-1.0, golden), (1.0, -golden), (1.0, golden)] {
        vertices.extend([[p, q, 0.0], [0.0, p, q], [q, 0.0, p]].map(unit));
    }
    let near = |a: [f64; 3], b: [f64; 3]| {
        let d = minus(a, b);
        d.iter().map(|x| x * x).sum::<f64>() < 1.2
    };
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                let [p, q, r] = [vertices[a], vertices[b], vertices[c]];
                if near(p, q) && near(q, r) && near(r, p) {
                    let n = triangle_normal(&[p, q, r]);
                    let outward = (0..3).map(|axis| n[axis] * p[axis]).sum::<f64>() > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    assert_eq!(triangles.len(), 20);
    for _ in 0..levels {
        let mut middles = HashMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in triangles {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    vertices.push(unit(along(vertices[p], 1.0, vertices[q])));
                    vertices.len() - 1
                })
            });
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    (vertices.into_iter().map(|p| along(center, radius, p)).collect(), triangles)
}

const TRANSLATIONS: [f64; 4] = [0.0, 1e4, 1e6, 1e7];

#[test]
fn closed_spheres_do_not_leak() {
    let mut random = Random(3);
    for translation in TRANSLATIONS {
        let center = [translation; 3];
        let (vertices, triangles) = icosphere(center, 1000.0, 3);
        let mesh: Vec<_> = triangles.iter().map(|t| t.map(|i| vertices[i])).collect();
        let mut targets = vertices.clone();
        for &[a, b, c] in &triangles {
            // Each inner edge comes up twice, once from each side.
            for (p, q) in [(a, b), (b, c), (c, a)] {
                let part = if random.below(2) == 0 { 0.5 } else { 0.5 * random.signed() + 0.5 };
                targets.push(along(vertices[p], part, minus(vertices[q], vertices[p])));
            }
        }
        let (mut leaks, mut rays, mut exact) = (0, 0, 0);
        for target in targets {
            let outward = unit(minus(target, center));
            let side = unit(random.vector(1.0));
            let outside = along(along(target, 2000.0, outward), 900.0, side);
            for origin in [center, along(center, 500.0, side), outside] {
                let mut frame = RayFrame::new(&Ray::new(origin, minus(target, origin)));
                if rays % 7 == 0 {
                    frame = RayFrame::new(&Ray::new(origin, unit(minus(target, origin))));
                }
                rays += 1;
                let hits =
                    mesh.iter().filter(|triangle| frame.intersect(triangle, &mut exact).is_some()).count();
                // From outside the line enters and leaves.
                let least = if origin == outside { 2 } else { 1 };
                leaks += usize::from(hits < least);
            }
        }
        println!("translation {translation:e}: {rays} rays, {leaks} leaks, {exact} exact decisions");
        assert_eq!(leaks, 0, "at translation {translation:e}");
    }
}

#[test]
fn rays_that_leave_a_convex_body_meet_nothing() {
    let mut random = Random(4);
    for translation in TRANSLATIONS {
        let (vertices, triangles) = icosphere([translation; 3], 1000.0, 2);
        let mesh: Vec<_> = triangles.iter().map(|t| t.map(|i| vertices[i])).collect();
        for triangle in &mesh {
            let normal = triangle_normal(triangle);
            for round in 0..20 {
                let (u, v) = match round {
                    0 => (0.0, 0.0),
                    1 => (0.5, 0.5),
                    2 => (0.0, 0.25),
                    _ => {
                        let u = 0.5 * random.signed() + 0.5;
                        (u, (1.0 - u) * (0.5 * random.signed() + 0.5))
                    }
                };
                let mut direction = along(unit(random.vector(1.0)), 1.0001, unit(normal));
                if round % 4 == 0 {
                    let edge = unit(minus(triangle[1], triangle[0]));
                    direction = along(edge, 1e-5, unit(normal));
                }
                let position = hit_position(triangle, u, v);
                let origin = offset_origin(position, position_error(triangle, u, v), normal, direction);
                let frame = RayFrame::new(&Ray::new(origin, direction));
                let again = mesh.iter().find_map(|other| frame.intersect(other, &mut 0));
                assert_eq!(again, None, "{triangle:?} {origin:?} {direction:?}");
            }
        }
    }
}
