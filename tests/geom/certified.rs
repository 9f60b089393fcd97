//! Decision, `t` and weights of the certified test against exact integers, over every family of samples.

use outcrop::geom::{Ray, RayFrame, intersect_certified};
use proptest::prelude::*;

use crate::oracle::{Exact, sign};
use crate::samples::{FAMILIES, Random, Triangle, minus, sample};

/// What a check saw.
#[derive(Clone, Copy, Default)]
struct Seen {
    hits: u64,
    on_border: u64,
    /// Hits on a border whose bits are given by the rule for ties.
    compared: u64,
    fallbacks: u64,
}

fn check(ray: &Ray, vertices: &Triangle) -> Seen {
    let exact = Exact::new(ray, vertices);
    let expected = exact.meets() && exact.t_sign() >= 0;
    let mut seen = Seen::default();
    let hit = intersect_certified(ray, vertices, &mut seen.fallbacks);
    assert_eq!(hit.is_some(), expected, "decision for {ray:?} {vertices:?}");
    if let Some(hit) = hit {
        seen.hits = 1;
        seen.on_border = u64::from(exact.edges.iter().any(|e| sign(e) == 0));
        if hit.t < f64::MAX && (hit.t == 0.0 || hit.t > f64::MIN_POSITIVE) {
            assert!(exact.t_is(hit.t, 40), "t of {hit:?} for {ray:?} {vertices:?}");
        }
        if seen.on_border == 1
            && let Some(canonical) = exact.rounded_quotients()
        {
            assert_eq!(
                [hit.t, hit.u, hit.v].map(f64::to_bits),
                canonical.map(f64::to_bits),
                "{hit:?} {canonical:?} for {ray:?} {vertices:?}"
            );
            seen.compared = 1;
        }
        assert!(exact.weights_are(&hit, 24), "weights of {hit:?} for {ray:?} {vertices:?}");
        assert!(hit.u >= 0.0 && hit.v >= 0.0 && hit.u + hit.v <= 1.0 && 1.0 - hit.u - hit.v >= 0.0);
    }
    // Every order of the vertices gives the same decision: an edge has one sign, whoever asks.
    let [a, b, c] = *vertices;
    for order in [[b, c, a], [c, a, b], [a, c, b], [c, b, a], [b, a, c]] {
        assert_eq!(intersect_certified(ray, &order, &mut 0).is_some(), expected, "{ray:?} {order:?}");
    }
    seen
}

fn check_families(pairs: u64, seed: u64) {
    let per_family = pairs / FAMILIES.len() as u64;
    for (family, name) in FAMILIES.into_iter().enumerate() {
        let mut random = Random(seed + family as u64);
        let mut all = Seen::default();
        for _ in 0..per_family {
            let (ray, vertices) = sample(family, &mut random);
            ray.validate().unwrap();
            let seen = check(&ray, &vertices);
            all.hits += seen.hits;
            all.on_border += seen.on_border;
            all.compared += seen.compared;
            all.fallbacks += seen.fallbacks;
        }
        println!(
            "{name}: {per_family} pairs, {} hits, {} on a border ({} compared), {} exact",
            all.hits, all.on_border, all.compared, all.fallbacks
        );
        // A family that never hits tests nothing.
        assert!(all.hits > 0, "{name} never hits");
    }
}

#[test]
fn agrees_with_exact_integers() {
    check_families(100_000, 1);
}

#[test]
fn canonical_hits_are_the_same_bits_everywhere() {
    // I2: no compiler, target feature or optimisation level changes a bit. FNV-1a over all hits.
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    for family in 0..FAMILIES.len() {
        let mut random = Random(family as u64);
        for _ in 0..500 {
            let (ray, vertices) = sample(family, &mut random);
            let hit = intersect_certified(&ray, &vertices, &mut 0)
                .map_or([0; 3], |hit| [hit.t, hit.u, hit.v].map(f64::to_bits));
            for byte in hit.iter().flat_map(|bits| bits.to_le_bytes()) {
                hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
            }
        }
    }
    assert_eq!(hash, 0x927c_2683_a487_c98c, "{hash:#x}");
}

#[test]
#[ignore = "ten million pairs: minutes"]
fn agrees_with_exact_integers_at_length() {
    check_families(10_000_000, 1 << 32);
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        (-3i32..=3).prop_map(f64::from),
        any::<i16>().prop_map(|x| f64::from(x) / 16.0),
        proptest::num::f32::NORMAL.prop_map(f64::from),
        proptest::num::f32::SUBNORMAL.prop_map(f64::from),
        -1e7..1e7,
    ]
}

fn point() -> impl Strategy<Value = [f64; 3]> {
    [coordinate(), coordinate(), coordinate()]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn agrees_on_mixed_coordinates(origin in point(), direction in point(), a in point(), b in point(), c in point(), aim in 0..4) {
        let direction = match aim {
            0 => minus(a, origin),
            1 => minus([0, 1, 2].map(|axis| 0.5 * a[axis] + 0.5 * b[axis]), origin),
            2 => minus([0, 1, 2].map(|axis| a[axis] / 3.0 + b[axis] / 3.0 + c[axis] / 3.0), origin),
            _ => direction,
        };
        prop_assume!(direction != [0.0; 3]);
        check(&Ray::new(origin, direction), &[a, b, c]);
    }

    #[test]
    fn agrees_with_orient3d(o in small(), d in small(), a in small(), b in small(), c in small()) {
        prop_assume!(d != [0.0; 3]);
        let tip = [0, 1, 2].map(|axis| o[axis] + d[axis]);
        let orient = |p: [f64; 3], q: [f64; 3]| {
            let [p, q, tip, o] = [p, q, tip, o].map(|[x, y, z]| robust::Coord3D { x, y, z });
            robust::orient3d(p, q, tip, o)
        };
        let signs = [orient(b, c), orient(c, a), orient(a, b)];
        let line = (signs.iter().all(|s| *s >= 0.0) || signs.iter().all(|s| *s <= 0.0)) && signs != [0.0; 3];
        let ahead = intersect_certified(&Ray::new(o, d), &[a, b, c], &mut 0);
        let behind = intersect_certified(&Ray::new(o, d.map(|x| -x)), &[a, b, c], &mut 0);
        prop_assert_eq!(ahead.is_some() || behind.is_some(), line);
    }

    #[test]
    fn rays_beyond_the_domain_are_those_of_their_frame(seed in any::<u64>()) {
        // Directions of any ratio, origins of any fineness: rounded once, in the frame, then decided exactly.
        let mut random = Random(seed);
        let (low, high) = if random.below(2) == 0 { (-200, -150) } else { (-60, 60) };
        let triangle = [(); 3].map(|()| random.wilds(low, high));
        let mut ray = Ray::new(random.wilds(-1022, high), random.wilds(-1022, 3));
        if random.below(2) == 0 {
            let steps = random.wild(-300, 3);
            ray.origin = [0, 1, 2].map(|axis| triangle[0][axis] - steps * ray.direction[axis]);
        }
        prop_assume!(ray.validate().is_ok());
        let frame = RayFrame::new(&ray);
        let exact = Exact::new(&Ray::new(frame.origin(), frame.direction()), &triangle);
        let hit = frame.intersect(&triangle, &mut 0);
        // A negative t may round to zero if its scale is extreme.
        let expected = exact.meets() && exact.t_sign() >= 0;
        prop_assert!(hit.is_some() == expected || hit.is_some_and(|hit| hit.t == 0.0) && exact.meets(), "{ray:?} {triangle:?}");
    }

    #[test]
    fn the_interval_selects_by_canonical_t(family in 0..FAMILIES.len(), seed in any::<u64>()) {
        let (ray, vertices) = sample(family, &mut Random(seed));
        let Some(hit) = intersect_certified(&ray, &vertices, &mut 0) else { return Ok(()) };
        let mut frame = RayFrame::new(&ray);
        frame.t_min = hit.t;
        frame.t_max = hit.t;
        if hit.t < f64::MAX {
            prop_assert_eq!(frame.intersect(&vertices, &mut 0), Some(hit));
            frame.t_max = f64::INFINITY;
            frame.t_min = hit.t.next_up();
            prop_assert_eq!(frame.intersect(&vertices, &mut 0), None);
        }
        if hit.t > 0.0 {
            frame.t_min = 0.0;
            frame.t_max = hit.t.next_down();
            prop_assert_eq!(frame.intersect(&vertices, &mut 0), if hit.t < f64::MAX { None } else { frame.intersect(&vertices, &mut 0) });
        }
    }
}

#[test]
fn what_overflows_is_beyond_every_finite_end_in_both_ways_to_decide() {
    let vertices = [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]];
    let mut frame = RayFrame::new(&Ray::new([0.25, 0.5, 0.0], [0.0, 0.0, f64::from_bits(1)]));
    for (t_max, is_hit) in [(f64::INFINITY, true), (f64::MAX, false)] {
        frame.t_max = t_max;
        let hit = frame.intersect(&vertices, &mut 0);
        assert_eq!(hit.map(|hit| hit.t), is_hit.then_some(f64::MAX));
        assert_eq!(frame.intersect_exactly(&vertices), hit);
    }
}

/// Integers small enough for exact sums, at any scale that `robust` can take.
fn small() -> impl Strategy<Value = [f64; 3]> {
    let range = -(1i64 << 20)..(1i64 << 20);
    prop_oneof![
        [-2i64..3, -2i64..3, -2i64..3].prop_map(|v| v.map(|x| x as f64)),
        [range.clone(), range.clone(), range].prop_map(|v| v.map(|x| x as f64 / 1024.0)),
    ]
}
