//! Every tier, as far as its guarantee goes.

use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LeafLayout, OctreeOptions, Tier};

use crate::cases::{self, Case, Random};
use crate::everywhere::{LEVELS, closest, open, source};
use crate::truth::{Truth, Verdict};

/// Well-shaped triangles of f32 vertices, and rays well inside of them or well beside.
fn easy() -> Case {
    let mut random = Random(50);
    let triangles = cases::sphere([0.0; 3], 100.0, 3, 2f64.powi(-10));
    let rays = (0..1000)
        .map(|index| {
            let [a, b, c] = random.pick(&triangles);
            let inside = [0, 1, 2].map(|axis| 0.3 * a[axis] + 0.3 * b[axis] + 0.4 * c[axis]);
            let origin = cases::to_f32(random.vector(40.0));
            let away = if index % 4 == 0 { [300.0, 0.0, 0.0] } else { [0.0; 3] };
            let ray = Ray::new(cases::along(origin, 1.0, away), cases::to_f32(cases::minus(inside, origin)));
            if index % 4 == 0 { Ray { direction: [1.0, 0.25, 0.125], ..ray } } else { ray }
        })
        .collect();
    Case { name: "easy", precision: Precision::Float32, triangles, rays }
}

#[test]
fn easy_hits_are_right_in_every_tier() {
    let case = easy();
    let source = source(&case, 4 << 10);
    let truths: Vec<Truth> = case.rays.iter().map(|ray| Truth::of(ray, &case.triangles)).collect();
    assert!(truths.iter().filter(|truth| truth.hits.is_empty()).count() > 200);
    for tier in Tier::ALL {
        for leaf_layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
            for level in LEVELS {
                let options = OctreeOptions { tier, leaf_layout, simd: Some(level), ..Default::default() };
                let octree = open(&source, options);
                let hits = closest(&octree, &case.rays);
                let blocked = crate::everywhere::occluded(&octree, &case.rays);
                for (((ray, truth), hit), blocked) in case.rays.iter().zip(&truths).zip(hits).zip(blocked) {
                    let found = hit.map(|hit| (hit.t, hit.triangle.0 as usize));
                    let verdict = truth.judge(found, &case.triangles, 1e-5);
                    assert_eq!(verdict, Verdict::Right, "{options:?}: {ray:?}: {found:?}");
                    assert_eq!(blocked, hit.is_some(), "{options:?}: {ray:?}");
                }
            }
        }
    }
}

#[test]
fn watertight_does_not_leak_where_f32_is_exact() {
    // One frame, vertices and origins exact in f32: no ray passes out, though it may be wrong about which triangle it met.
    for translation in cases::TRANSLATIONS {
        for at_edges in [false, true] {
            let case = cases::closed_sphere("watertight", translation, at_edges);
            let source = source(&case, 64 << 10);
            for leaf_layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
                for level in LEVELS {
                    let tier = Tier::Watertight;
                    let options =
                        OctreeOptions { tier, leaf_layout, simd: Some(level), ..Default::default() };
                    let leaks = closest(&open(&source, options), &case.rays)
                        .iter()
                        .filter(|hit| hit.is_none())
                        .count();
                    assert_eq!(leaks, 0, "of {} at {translation:e}, {options:?}", case.rays.len());
                }
            }
        }
    }
}

#[test]
fn exact_and_certified_give_the_same_bits() {
    for case in cases::all() {
        let source = source(&case, 4 << 10);
        let both = [Tier::Certified, Tier::Exact].map(|tier| {
            let octree = open(&source, OctreeOptions { tier, ..Default::default() });
            closest(&octree, &case.rays[..case.rays.len().min(800)])
        });
        assert_eq!(both[0], both[1], "{}", case.name);
    }
}

#[test]
fn failures_are_told_apart() {
    // The judge of the table: each verdict on a ray with two surfaces, the first of them doubled.
    let near = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
    let far = near.map(|p| [p[0], p[1], 2.0]);
    let triangles = [near, near, far];
    let truth = Truth::of(&Ray::new([1.0, 1.0, 0.0], [0.0, 0.0, 1.0]), &triangles);
    let judge = |found| truth.judge(found, &triangles, 1e-5);
    assert_eq!(truth.hits.len(), 3);
    assert_eq!(judge(Some((1.0, 0))), Verdict::Right);
    assert_eq!(judge(Some((1.000_001, 0))), Verdict::Right);
    assert_eq!(judge(Some((1.0, 1))), Verdict::NotTheLowest);
    assert_eq!(judge(Some((1.001, 0))), Verdict::Misplaced);
    assert_eq!(judge(Some((2.0, 2))), Verdict::Misplaced);
    assert_eq!(judge(Some((f64::NAN, 0))), Verdict::Misplaced);
    assert_eq!(judge(None), Verdict::Lost);
    let nothing = Truth::of(&Ray::new([1.0, 1.0, 3.0], [0.0, 0.0, 1.0]), &triangles);
    assert_eq!(nothing.judge(Some((1.0, 0)), &triangles, 1e-5), Verdict::Invented);
    assert_eq!(nothing.judge(None, &triangles, 1e-5), Verdict::Right);
}
