//! `Hit::error_bounds` against exact rationals: never exceeded, and not slack.

use dashu::rational::RBig;
use outcrop::geom::{HitErrorBounds, Ray, RayFrame, TriangleHit, hit_position, intersect_certified};
use outcrop::octree::{OctreeOptions, Tier};

use crate::cases;
use crate::everywhere::{closest, open, source};
use crate::oracle::Exact;
use crate::samples::{FAMILIES, Random, sample};
use crate::truth::{Triangle, exact};

fn magnitude(x: RBig) -> RBig {
    if x < RBig::ZERO { -x } else { x }
}

/// The real errors of a hit: `t`, `u`, `v`, and the position per axis.
fn errors(ray: &Ray, vertices: &Triangle, hit: &TriangleHit) -> Option<[RBig; 6]> {
    let against = Exact::new(ray, vertices);
    if against.determinant_sign() == 0 {
        return None;
    }
    let [u, v] = against.weights();
    let position = hit_position(vertices, hit.u, hit.v);
    let [a, b, c] = vertices;
    let at = [0, 1, 2].map(|axis| {
        let (a, b, c) = (exact(a[axis]), exact(b[axis]), exact(c[axis]));
        let point = &a + &u * (b - &a) + &v * (c - &a);
        magnitude(exact(position[axis]) - point)
    });
    let [x, y, z] = at;
    Some([
        magnitude(exact(hit.t) - against.t()),
        magnitude(exact(hit.u) - u),
        magnitude(exact(hit.v) - v),
        x,
        y,
        z,
    ])
}

fn list(bounds: &HitErrorBounds) -> [f64; 6] {
    let [x, y, z] = bounds.position;
    [bounds.t, bounds.u, bounds.v, x, y, z]
}

const NAMES: [&str; 6] = ["t", "u", "v", "x", "y", "z"];

/// Bound over error of every hit, by quantity. Asserts that no bound is exceeded.
#[derive(Default)]
struct Slack([Vec<f64>; 6]);

impl Slack {
    fn add(&mut self, ray: &Ray, vertices: &Triangle, hit: &TriangleHit, bounds: &HitErrorBounds) {
        let Some(errors) = errors(ray, vertices, hit) else {
            assert_eq!(bounds.t, f64::INFINITY, "nothing is known of a parallel ray");
            return;
        };
        for (quantity, (error, bound)) in errors.into_iter().zip(list(bounds)).enumerate() {
            if !bound.is_finite() {
                self.0[quantity].push(f64::INFINITY);
                continue;
            }
            let name = NAMES[quantity];
            assert!(error <= exact(bound), "{name} of {hit:?}: {ray:?} {vertices:?}, bound {bound:e}");
            // An error of zero says nothing about slack.
            if error != RBig::ZERO {
                self.0[quantity].push((exact(bound) / error).to_f64().value());
            }
        }
    }

    fn medians(mut self) -> [f64; 6] {
        for ratios in &mut self.0 {
            ratios.sort_by(f64::total_cmp);
        }
        self.0.map(|ratios| ratios.get(ratios.len() / 2).copied().unwrap_or(1.0))
    }
}

#[test]
fn error_bounds_hold_and_are_not_slack() {
    let mut all = Slack::default();
    for (family, name) in FAMILIES.into_iter().enumerate() {
        let mut random = Random(40 + family as u64);
        let mut slack = Slack::default();
        for _ in 0..1500 {
            let (ray, vertices) = sample(family, &mut random);
            let Some(hit) = intersect_certified(&ray, &vertices, &mut 0) else { continue };
            // The interval of normal numbers: outside of it `t` saturates.
            if hit.t == f64::MAX || (hit.t != 0.0 && hit.t < f64::MIN_POSITIVE) {
                continue;
            }
            let bounds = RayFrame::new(&ray).error_bounds(&vertices, &hit);
            slack.add(&ray, &vertices, &hit, &bounds);
            all.add(&ray, &vertices, &hit, &bounds);
        }
        println!("{name}: median of bound / error {:.1?}", slack.medians());
    }
    assert!(all.0.iter().all(|ratios| ratios.len() > 5000), "most hits have an error to compare with");
    let medians = all.medians();
    println!("all: median of bound / error {medians:.1?}");
    assert!(medians.iter().all(|median| (1.0..=100.0).contains(median)), "{medians:?}");
}

#[test]
fn error_bounds_hold_for_hits_of_every_tier() {
    for case in [cases::needles(), cases::closed_sphere("bounds", 1e6, true), cases::detail_far_out()] {
        let source = source(&case, 4 << 10);
        for tier in Tier::ALL {
            let octree = open(&source, OctreeOptions { tier, ..Default::default() });
            let mut slack = Slack::default();
            for (ray, hit) in case.rays.iter().zip(closest(&octree, &case.rays)).take(400) {
                let Some(hit) = hit else { continue };
                let numbers = TriangleHit { t: hit.t, u: hit.u, v: hit.v };
                slack.add(ray, &hit.vertices, &numbers, &hit.error_bounds(ray));
            }
            println!("{} {}: {:.1?}", case.name, tier.name(), slack.medians());
        }
    }
}
