//! Positions, their error bounds, and where secondary rays start.

use outcrop::geom::{Ray, hit_position, intersect_certified, offset_origin, position_error, triangle_normal};

use crate::oracle::{Exact, position_is};
use crate::samples::{Random, Triangle, along, minus, point_of, unit};

const TRANSLATIONS: [f64; 6] = [0.0, 1.0, 1e4, 1e7, 1e12, 1e30];

fn triangle_at(random: &mut Random, translation: f64) -> Triangle {
    let base = random.vector(translation);
    let size = (translation * 1e-12).max([1e-3, 1.0, 1e3][random.below(3) as usize]);
    let mut triangle = [(); 3].map(|()| along(base, 1.0, random.vector(size)));
    if random.below(3) == 0 {
        // A needle.
        let [a, b, _] = triangle;
        triangle[2] = along(along(a, 0.3, minus(b, a)), 1.0, random.vector(size * 1e-4));
    }
    triangle
}

#[test]
fn position_errors_are_bounds() {
    let mut random = Random(7);
    for round in 0..20_000 {
        let vertices = triangle_at(&mut random, TRANSLATIONS[round % TRANSLATIONS.len()]);
        let u = 0.5 * random.signed() + 0.5;
        let v = (0.5 * random.signed() + 0.5) * (1.0 - u);
        let (position, error) = (hit_position(&vertices, u, v), position_error(&vertices, u, v));
        assert!(position_is(&vertices, u, v, position, error), "{vertices:?} {u} {v}");
        // And not by far: within a few units in the last place of the largest number involved.
        let largest = vertices.iter().flatten().fold(0.0f64, |m, x| m.max(x.abs()));
        assert!(error <= 16.0 * f64::EPSILON * largest + 1e-300, "{error} {largest}");
    }
}

#[test]
fn secondary_rays_never_meet_their_triangle_again() {
    let mut random = Random(8);
    let (mut checked, mut fallbacks) = (0, 0);
    for round in 0..60_000 {
        let vertices = triangle_at(&mut random, TRANSLATIONS[round % TRANSLATIONS.len()]);
        let target = point_of(&mut random, &vertices);
        let origin = along(target, 10.0, random.vector(1.0));
        let Some(hit) = intersect_certified(&Ray::new(origin, minus(target, origin)), &vertices, &mut 0)
        else {
            continue;
        };
        let position = hit_position(&vertices, hit.u, hit.v);
        let error = position_error(&vertices, hit.u, hit.v);
        let normal = triangle_normal(&vertices);
        let direction = match random.below(3) {
            0 => unit(random.vector(1.0)),
            // Grazing.
            1 => along(unit(minus(vertices[1], vertices[0])), 1e-6 * random.signed(), unit(normal)),
            _ => unit(normal),
        };
        let secondary = Ray::new(offset_origin(position, error, normal, direction), direction);
        let exact = Exact::new(&secondary, &vertices);
        let side: f64 = (0..3).map(|axis| normal[axis] * direction[axis]).sum();
        if exact.determinant_sign() == 0 || f64::from(exact.determinant_sign()) * side <= 0.0 {
            continue; // Within rounding of the plane: not promised.
        }
        checked += 1;
        assert!(exact.t_sign() < 0, "the origin is not off the plane: {vertices:?} {secondary:?}");
        assert_eq!(intersect_certified(&secondary, &vertices, &mut fallbacks), None);
        // The offset is a few position errors, at any translation.
        let moved = minus(secondary.origin, position).iter().fold(0.0f64, |m, x| m.max(x.abs()));
        assert!(moved <= 20.0 * error, "{moved} {error}");
    }
    println!("{checked} secondary rays, {fallbacks} exact decisions");
    assert!(checked > 25_000);
}

#[test]
fn useless_normals_leave_the_position() {
    let position = [1.0, 2.0, 3.0];
    for normal in [[0.0; 3], [f64::NAN, 0.0, 1.0], [f64::INFINITY, 0.0, 0.0]] {
        assert_eq!(offset_origin(position, 1e-15, normal, [0.0, 0.0, 1.0]), position);
    }
}
