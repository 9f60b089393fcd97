//! Leaving surfaces, and surfaces close to each other.

use outcrop::geom::{Precision, Ray, offset_origin};
use outcrop::octree::OctreeOptions;
use outcrop::trace::Occlusion;

use crate::cases::{self, Case, Random, along, minus, unit};
use crate::everywhere::{check, closest, open, source};

#[test]
fn no_self_hit_from_a_convex_surface_outward() {
    for translation in [0.0, 1e4, 1e6, 1e7] {
        let case = cases::closed_sphere("no_self_hit", translation, false);
        let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
        let first = closest(&octree, &case.rays);
        let mut random = Random(21);
        let mut outward = Vec::new();
        for (ray, hit) in case.rays.iter().zip(&first) {
            let hit = hit.unwrap();
            let normal = hit.normal();
            for slope in [1.0, 1e-2, 1e-5] {
                let sideways = unit(random.vector(1.0));
                // Off the normal's side by at least `slope`, whatever the sideways part is.
                let across: f64 = (0..3).map(|axis| sideways[axis] * unit(normal)[axis]).sum();
                let direction = along(along(sideways, -across, unit(normal)), slope, unit(normal));
                let toward: f64 = (0..3).map(|axis| ray.direction[axis] * normal[axis]).sum();
                assert!(toward > 0.0, "rays come from inside, normals point outward");
                let origin = offset_origin(hit.position(), hit.position_error(), normal, direction);
                outward.push(Ray::new(origin, direction));
            }
        }
        let again = closest(&octree, &outward).iter().flatten().count();
        assert_eq!(again, 0, "of {} rays at translation {translation:e}", outward.len());
        let mut occlusions = vec![Occlusion::Clear; outward.len()];
        octree.tracer().unwrap().occluded(&outward, None, &mut occlusions).unwrap();
        assert!(occlusions.iter().all(|occlusion| *occlusion == Occlusion::Clear));
    }
}

#[test]
fn plates_1e_3_apart_at_1e7() {
    let case = cases::plates_far_out();
    check(&case);
    let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
    // A ray from outside meets the first plate; one that leaves it there meets the second, 1e-3 on.
    let rays: Vec<Ray> = case.rays.iter().step_by(2).copied().collect();
    let first = closest(&octree, &rays);
    let onward: Vec<Ray> = rays
        .iter()
        .zip(&first)
        .map(|(ray, hit)| {
            let hit = hit.expect("the plate is wide");
            Ray::new(
                offset_origin(hit.position(), hit.position_error(), hit.normal(), ray.direction),
                ray.direction,
            )
        })
        .collect();
    for (ray, (hit, next)) in rays.iter().zip(first.iter().zip(closest(&octree, &onward))) {
        let (hit, next) = (hit.unwrap(), next.expect("the second plate is as wide"));
        let gap = next.position()[2] - hit.position()[2];
        assert!((gap - 1e-3).abs() < 1e-8 + hit.position_error() + next.position_error(), "{gap} {ray:?}");
    }
}

#[test]
fn leaving_a_doubled_surface() {
    // Two copies of each face: an offset origin leaves both.
    let mut case = cases::closed_sphere("leaving_a_doubled_surface", 1e6, true);
    case.triangles = case.triangles.iter().flat_map(|triangle| [*triangle; 2]).collect();
    case.rays.truncate(1000);
    let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
    let outward: Vec<Ray> = case
        .rays
        .iter()
        .zip(closest(&octree, &case.rays))
        .map(|(ray, hit)| {
            let hit = hit.unwrap();
            assert_eq!(hit.triangle.0 % 2, 0, "the first copy is met");
            let direction = unit(hit.normal());
            assert!((0..3).map(|axis| direction[axis] * ray.direction[axis]).sum::<f64>() > 0.0);
            Ray::new(offset_origin(hit.position(), hit.position_error(), hit.normal(), direction), direction)
        })
        .collect();
    assert_eq!(closest(&octree, &outward).iter().flatten().count(), 0);
}

#[test]
fn t_min_and_t_max_exactly_at_a_hit() {
    check(&cases::ends_at_a_hit());
    // And for canonical t of any mantissa: closed at both ends, open one step further.
    let mut case = cases::closed_hulls();
    case.rays.truncate(400);
    for ray in &mut case.rays {
        ray.direction = ray.direction.map(|x| x * 0.3);
    }
    let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
    let hits = closest(&octree, &case.rays);
    let bounded = |bound: &dyn Fn(&Ray, f64) -> Ray| -> Vec<Ray> {
        case.rays.iter().zip(&hits).map(|(ray, hit)| bound(ray, hit.unwrap().t)).collect()
    };
    let exactly = bounded(&|ray, t| Ray { t_min: t, t_max: t, ..*ray });
    assert_eq!(closest(&octree, &exactly), hits);
    let before = bounded(&|ray, t| Ray { t_max: t.next_down(), ..*ray });
    assert!(closest(&octree, &before).iter().all(Option::is_none));
    let after = bounded(&|ray, t| Ray { t_min: t.next_up(), ..*ray });
    for (hit, next) in hits.iter().zip(closest(&octree, &after)) {
        assert!(next.is_none_or(|next| next.t > hit.unwrap().t));
    }
    let mut occlusions = vec![Occlusion::Clear; hits.len()];
    for (rays, expected) in [(&exactly, Occlusion::Blocked), (&before, Occlusion::Clear)] {
        octree.tracer().unwrap().occluded(rays, None, &mut occlusions).unwrap();
        assert!(occlusions.iter().all(|occlusion| *occlusion == expected));
    }
}

#[test]
fn origins_on_the_surface() {
    // From vertices and edges themselves: t = 0 is a hit, exactly.
    let closed = cases::closed_hulls();
    let mut random = Random(22);
    let starts = cases::vertices(&closed.triangles).into_iter().chain(cases::middles(&closed.triangles));
    let rays: Vec<Ray> = starts
        .take(600)
        .map(|start| Ray::new(start, minus([0, 1, 2].map(|_| 0.0), random.vector(1.0))))
        .collect();
    let case = Case { name: "origins_on_the_surface", precision: Precision::Float32, rays, ..closed };
    check(&case);
    let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
    let at_start = closest(&octree, &case.rays).iter().flatten().filter(|hit| hit.t == 0.0).count();
    assert_eq!(at_start, case.rays.len());
}
