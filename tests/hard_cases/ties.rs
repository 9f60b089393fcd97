//! Equal hits resolve by the lowest source id, whatever the order of things.

use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LeafLayout, OctreeOptions};

use crate::cases::{self, Case};
use crate::everywhere::{check, closest, open};
use crate::support;

#[test]
fn a_mesh_laid_on_itself() {
    check(&cases::laid_twice());
}

#[test]
fn ties_resolve_by_the_lowest_id() {
    // Copies of one triangle, dealt to blocks in every rotation: the lowest wins although its block comes last.
    let triangle = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
    let triangles = vec![triangle; 24];
    let rays: Vec<Ray> = (0..16)
        .map(|i| Ray::new([f64::from(i % 4) * 0.5, f64::from(i / 4) * 0.5, 4.0], [0.0, 0.0, -1.0]))
        .collect();
    for rotation in 0..24 {
        let source = support::compile(&triangles, Precision::Float32, 5, |i| (i as u64 * 7 + rotation) % 24);
        let source: std::sync::Arc<dyn outcrop::BlockSource> = source;
        for slots_max in [Some(1), None] {
            let octree = open(&source, OctreeOptions { slots_max, ..Default::default() });
            for hit in closest(&octree, &rays) {
                assert_eq!(hit.map(|hit| (hit.t, hit.triangle.0)), Some((3.0, 0)), "rotation {rotation}");
            }
        }
    }
}

#[test]
fn a_box_entered_at_the_best_hit_still_counts() {
    // Flat blocks on one plane: the ray enters each one's box exactly where the best hit is. The lowest id lies in the
    // block that is visited last, whichever that is.
    let mut triangles = Vec::new();
    for i in 0..60 {
        let reach = f64::from(60 - i);
        triangles.push([[-reach, -reach, 2.0], [reach, -reach, 2.0], [0.0, 2.0 * reach, 2.0]]);
    }
    let rays =
        [[0.0, 0.0, -1.0], [0.0, -0.0, 1.0], [1e-3, 1e-30, -1.0], [-0.25, 0.125, 1.0]].map(|direction| {
            Ray::new([0, 1, 2].map(|axis| [0.0, 0.0, 2.0][axis] - 7.0 * direction[axis]), direction)
        });
    check(&Case {
        name: "a_box_entered_at_the_best_hit_still_counts",
        precision: Precision::Float32,
        triangles: triangles.clone(),
        rays: rays.to_vec(),
    });
    triangles.reverse();
    let name = "a_box_entered_at_the_best_hit_still_counts";
    check(&Case { name, precision: Precision::Float32, triangles, rays: rays.to_vec() });
}

#[test]
fn walking_on_visits_every_copy_once() {
    // Leaving a doubled surface: (t, id) tells the copies apart where no epsilon can.
    let case = cases::laid_twice();
    let source = crate::everywhere::source(&case, 4 << 10);
    for leaf_layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
        let octree = open(&source, OctreeOptions { leaf_layout, ..Default::default() });
        let mut tracer = octree.tracer().unwrap();
        for ray in &case.rays {
            let mut at = (f64::NAN, outcrop::units::TriangleId(0));
            for expected in support::all_hits(&case.triangles, ray) {
                let mut next = [None];
                tracer.closest_hits_after(&[*ray], &[at], &mut next).unwrap();
                assert_eq!(next[0].map(|hit| (hit.t, hit.triangle)), Some(expected), "{ray:?}");
                at = expected;
            }
        }
    }
}
