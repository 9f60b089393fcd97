//! Polygon cutting: areas add up, nothing overlaps, no edge is lost.

use proptest::prelude::*;

use crate::import::polygon::{Cut, Cutter};

/// Twice the signed area in the xy plane.
fn area(points: &[[f64; 2]], corners: &[u32]) -> f64 {
    let point = |index: usize| points[corners[index % corners.len()] as usize];
    (0..corners.len()).map(|i| point(i)[0] * point(i + 1)[1] - point(i + 1)[0] * point(i)[1]).sum()
}

/// Cuts a polygon of small whole numbers and checks that the triangles tile it: all counterclockwise, areas add up,
/// every boundary edge is an edge of exactly one triangle and every other edge of two, in opposite directions.
#[track_caller]
fn tiles(points: &[[f64; 2]]) {
    // Through all planes: the projection must keep the turn.
    for axis in 0..3 {
        let positions: Vec<[f64; 3]> = points
            .iter()
            .map(|[x, y]| {
                let mut position = [0.0; 3];
                (position[(axis + 1) % 3], position[(axis + 2) % 3]) = (*x, *y);
                position[axis] = 0.25 * x - 0.5 * y;
                position
            })
            .collect();
        let mut cutter = Cutter::default();
        let (cut, triangles) = cutter.cut(&positions);
        assert_eq!(cut, Cut::Clean, "{points:?}");
        assert_eq!(triangles.len(), points.len() - 2);
        let all: Vec<u32> = (0..points.len() as u32).collect();
        let sum: f64 = triangles.iter().map(|triangle| area(points, triangle)).sum();
        assert_eq!(sum, area(points, &all), "{points:?} {triangles:?}");
        assert!(triangles.iter().all(|triangle| area(points, triangle) >= 0.0), "{points:?} {triangles:?}");
        let mut edges: Vec<[u32; 2]> =
            triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
        for (from, to) in all.iter().zip(all.iter().cycle().skip(1)) {
            let boundary = edges.iter().position(|edge| edge == &[*from, *to]);
            edges.swap_remove(boundary.unwrap_or_else(|| panic!("edge {from} {to} is lost: {triangles:?}")));
        }
        while let Some([from, to]) = edges.pop() {
            let back = edges.iter().position(|edge| *edge == [to, from]);
            edges.swap_remove(back.unwrap_or_else(|| panic!("edge {from} {to} has no other side")));
        }
    }
}

#[test]
fn quads() {
    tiles(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    // An arrowhead, with the notch at each corner in turn.
    let mut arrow = vec![[0.0, 0.0], [4.0, -4.0], [0.0, 8.0], [-4.0, -4.0]];
    for _ in 0..4 {
        tiles(&arrow);
        arrow.rotate_left(1);
    }
    // A corner straight between its neighbours must stay a corner.
    let mut straight = vec![[0.0, 0.0], [2.0, 0.0], [4.0, 0.0], [1.0, 3.0]];
    for _ in 0..4 {
        tiles(&straight);
        straight.rotate_left(1);
    }
}

#[test]
fn orientation_is_decided_exactly() {
    // Corner 2 lies beyond the line from 1 to 3 by less than plain f64 arithmetic can tell.
    let e = f64::EPSILON / 2.0;
    let cutter = &mut Cutter::default();
    let notch = |depth: f64| {
        [[0.0, 0.0, 0.0], [0.5 + e, 0.5 + e + depth, 0.0], [24.0, 24.0, 0.0], [12.0, 12.0 + 12.0, 0.0]]
    };
    for depth in [-e, 0.0, e] {
        let (_, triangles) = cutter.cut(&notch(depth));
        assert_eq!(triangles.len(), 2);
    }
}

#[test]
fn concave_shapes() {
    // L, U, a comb, a spiral.
    tiles(&[[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [2.0, 2.0], [2.0, 4.0], [0.0, 4.0]]);
    tiles(&[[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [4.0, 4.0], [4.0, 2.0], [2.0, 2.0], [2.0, 4.0], [0.0, 4.0]]);
    let teeth = (0..50).rev().flat_map(|i| [[f64::from(2 * i + 1), 9.0], [f64::from(2 * i), 1.0]]);
    let mut comb = vec![[0.0, 0.0], [100.0, 0.0]];
    comb.extend(teeth);
    tiles(&comb);
    tiles(&[
        [0.0, 0.0],
        [10.0, 0.0],
        [10.0, 10.0],
        [2.0, 10.0],
        [2.0, 4.0],
        [6.0, 4.0],
        [6.0, 6.0],
        [4.0, 6.0],
        [4.0, 8.0],
        [8.0, 8.0],
        [8.0, 2.0],
        [0.0, 2.0],
    ]);
}

#[test]
fn corners_on_straight_edges_stay() {
    let mut square = Vec::new();
    for i in 0..8 {
        square.push([f64::from(i), 0.0]);
    }
    for i in 0..8 {
        square.push([8.0, f64::from(i)]);
    }
    for i in 0..8 {
        square.push([f64::from(8 - i), 8.0]);
    }
    for i in 0..8 {
        square.push([0.0, f64::from(8 - i)]);
    }
    tiles(&square);
}

#[test]
fn a_hole_through_a_slit() {
    // Corners 2 and 7 coincide, and so do 3 and 8: there and back along the slit, round the hole clockwise.
    let points = [
        [0.0, 0.0],
        [9.0, 0.0],
        [9.0, 9.0],
        [6.0, 6.0],
        [6.0, 3.0],
        [3.0, 3.0],
        [3.0, 6.0],
        [6.0, 6.0],
        [9.0, 9.0],
        [0.0, 9.0],
    ];
    let positions: Vec<[f64; 3]> = points.iter().map(|[x, y]| [*x, *y, 0.0]).collect();
    let mut cutter = Cutter::default();
    let (cut, triangles) = cutter.cut(&positions);
    assert_eq!(cut, Cut::Clean);
    let sum: f64 = triangles.iter().map(|triangle| area(&points, triangle)).sum();
    assert_eq!(sum, 2.0 * (81.0 - 9.0));
    for triangle in triangles {
        assert!(area(&points, triangle) >= 0.0);
        // None covers the middle of the hole.
        let turns: Vec<f64> = (0..3)
            .map(|i| {
                let [a, b] = [triangle[i], triangle[(i + 1) % 3]].map(|corner| points[corner as usize]);
                (b[0] - a[0]) * (4.5 - a[1]) - (b[1] - a[1]) * (4.5 - a[0])
            })
            .collect();
        assert!(turns.iter().any(|turn| *turn <= 0.0), "{triangle:?} covers the hole");
    }
}

#[test]
fn what_cannot_be_cut_becomes_a_fan() {
    let mut cutter = Cutter::default();
    let pentagram: Vec<[f64; 3]> = (0..5)
        .map(|i| f64::from(i) * 2.0 * std::f64::consts::TAU / 5.0)
        .map(|a| [a.cos(), a.sin(), 0.0])
        .collect();
    assert_eq!(cutter.cut(&pentagram).1.len(), 3);
    for flat in [
        vec![[0.0; 3]; 4],
        vec![[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0]],
        vec![[f64::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        vec![[f64::INFINITY, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
    ] {
        let (cut, triangles) = cutter.cut(&flat);
        assert_eq!((cut, triangles), (Cut::Fan, [[0, 1, 2], [0, 2, 3]].as_slice()));
    }
}

#[test]
fn large_polygons_take_near_linear_work() {
    // A star of 65,536 corners, half of them reflex; the work limit would make it a fan.
    let count = 1 << 16;
    let star: Vec<[f64; 3]> = (0..count)
        .map(|i| {
            let angle = f64::from(i) / f64::from(count) * std::f64::consts::TAU;
            let radius = if i % 2 == 0 { 1.0 } else { 0.9 };
            [radius * angle.cos(), radius * angle.sin(), 0.0]
        })
        .collect();
    let mut cutter = Cutter::default();
    assert_eq!(cutter.cut(&star).0, Cut::Clean);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500))]

    /// Points around a centre in order of angle make a polygon that does not cross itself.
    #[test]
    fn star_shaped_polygons_tile(radii in prop::collection::vec(1_u32..60, 4..40)) {
        let count = radii.len() as f64;
        let points: Vec<[f64; 2]> = radii
            .iter()
            .enumerate()
            .map(|(i, radius)| {
                let angle = i as f64 / count * std::f64::consts::TAU;
                let radius = f64::from(*radius) * 4.0 + 20.0;
                [(radius * angle.cos()).round(), (radius * angle.sin()).round()]
            })
            .collect();
        let mut distinct = points.clone();
        distinct.sort_by(|a, b| a.partial_cmp(b).unwrap());
        distinct.dedup();
        // Rounding can move corners onto each other; such polygons are not in question here.
        prop_assume!(distinct.len() == points.len());
        let turns_around = points.iter().zip(points.iter().cycle().skip(1));
        prop_assume!(turns_around.clone().all(|(a, b)| a[0] * b[1] - a[1] * b[0] > 0.0));
        tiles(&points);
    }

    /// Nothing panics, and the count is right, whatever the polygon.
    #[test]
    fn any_corners(corners in prop::collection::vec(prop::array::uniform3(-3_i32..3), 3..30)) {
        let positions: Vec<[f64; 3]> = corners.iter().map(|corner| corner.map(f64::from)).collect();
        let mut cutter = Cutter::default();
        prop_assert_eq!(cutter.cut(&positions).1.len(), positions.len() - 2);
    }
}
