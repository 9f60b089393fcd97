//! Numbers that are none, and numbers beyond 32 bits.

use outcrop::compile::CompileOptions;
use outcrop::error::{CompileError, TraceError};
use outcrop::geom::{Precision, Ray};
use outcrop::octree::{LeafLayout, OctreeOptions};
use outcrop::trace::Occlusion;
use outcrop::units::Bytes;

use crate::cases;
use crate::compiling::{Mesh, Place, Vertices, compile, compile_with};
use crate::everywhere::{closest, open, source};
use crate::support;

const ODD: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

#[test]
fn nan_and_infinity_in_rays() {
    let case = cases::on_split_planes();
    let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
    let mut tracer = octree.tracer().unwrap();
    let good = Ray::new([0.5, 0.25, 9.0], [0.0, 0.0, -1.0]);
    let mut bad = vec![Ray { direction: [0.0, -0.0, 0.0], ..good }];
    for x in ODD {
        for axis in 0..3 {
            let with = |mut v: [f64; 3]| {
                v[axis] = x;
                v
            };
            bad.push(Ray { origin: with(good.origin), ..good });
            bad.push(Ray { direction: with(good.direction), ..good });
        }
    }
    bad.extend([f64::NAN, f64::INFINITY, -1.0].map(|t_min| Ray { t_min, ..good }));
    bad.extend([f64::NAN, -1.0].map(|t_max| Ray { t_max, ..good }));
    for ray in bad {
        // The bad ray is named; the good one beside it is not.
        let rays = [good, ray];
        let mut hits = [None; 2];
        let error = tracer.closest_hits(&rays, &mut hits).unwrap_err();
        assert!(matches!(error, TraceError::InvalidRay { index: 1, .. }), "{ray:?}: {error}");
        let error = tracer.occluded(&rays, None, &mut [Occlusion::Clear; 2]).unwrap_err();
        assert!(matches!(error, TraceError::InvalidRay { index: 1, .. }), "{ray:?}: {error}");
    }
    // The tracer goes on.
    assert!(tracer.closest_hit(&good).unwrap().is_some());
}

#[test]
fn nan_and_infinity_in_input() {
    let base = Mesh::new(
        Vertices::Float64(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        vec![[0, 1, 2], [0, 1, 3], [1, 2, 3]],
    );
    for x in ODD {
        for axis in 0..3 {
            let mut mesh = base.clone();
            if let Vertices::Float64(vertices) = &mut mesh.vertices {
                vertices[3][axis] = x;
            }
            let place = Place::new();
            let options = CompileOptions::default();
            let progress = &mut |_| outcrop::compile::Control::Continue;
            let error = compile_with(&mesh, &options, Bytes::mib(64), &place.output(), progress).unwrap_err();
            assert!(matches!(error, CompileError::NotFinite { .. }), "{error}");
            assert!(place.files().is_empty(), "no file is left");
            // Skipped on request: counted, and what is left is hit.
            let options = CompileOptions { skip_not_finite: true, ..options };
            let (report, _) = compile(&mesh, &options, Bytes::mib(64));
            assert_eq!(report.triangles, 1);
        }
    }
}

#[test]
fn more_ids_than_32_bits() {
    // A synthetic directory whose ids go past 2^32 in the middle of a block: all 64 bits come back, and decide ties.
    let triangle = [[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 4.0, 1.0]];
    let triangles = vec![triangle; 12];
    let first = (1u64 << 32) - 5;
    // The highest id first in every block.
    let number = |i: usize| if i == 11 { 3 } else { first + 10 - i as u64 };
    let source = support::compile_numbered(&triangles, Precision::Float32, 6, |i| i as u64, number);
    let source: std::sync::Arc<dyn outcrop::BlockSource> = source;
    let ray = Ray::new([0.5, 0.25, 9.0], [0.0, 0.0, -1.0]);
    for leaf_layout in [LeafLayout::Expanded, LeafLayout::Indexed] {
        let octree = open(&source, OctreeOptions { leaf_layout, ..Default::default() });
        assert_eq!(closest(&octree, &[ray])[0].unwrap().triangle.0, 3);
        let mut ids: Vec<u64> = (0..12).map(number).collect();
        ids.sort_unstable();
        assert_eq!(*ids.last().unwrap(), (1 << 32) + 5);
        let mut tracer = octree.tracer().unwrap();
        let mut at = (f64::NAN, outcrop::units::TriangleId(0));
        for id in ids {
            let mut next = [None];
            tracer.closest_hits_after(&[ray], &[at], &mut next).unwrap();
            let hit = next[0].unwrap();
            assert_eq!(hit.triangle.0, id);
            at = (hit.t, hit.triangle);
        }
    }
}
