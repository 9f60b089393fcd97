//! Crossings against a line that is moved indeed, by a tiny amount, in exact integers.

use outcrop::geom::{Ray, RayFrame, Sense};

use crate::oracle::{Exact, moved_edges, sign};
use crate::samples::Random;

fn expected(ray: &Ray, triangle: &[[f64; 3]; 3]) -> Option<Sense> {
    match moved_edges(ray, triangle).map(|edge| sign(&edge)) {
        [1, 1, 1] => Some(Sense::Exit),
        [-1, -1, -1] => Some(Sense::Entry),
        _ => None,
    }
}

#[test]
fn crossings_are_those_of_a_line_that_is_moved() {
    let mut random = Random(77);
    let mut counts = [0; 4];
    // Few coordinates, so that lines run through edges and vertices, along edges and in planes.
    for (grid, scale, shift) in
        [(3, 1.0, -1.0), (3, 1e30, -1.0), (4, 1.0, 1e7), (4, 0.1, 1e4), (40, 1e-3, 0.0)]
    {
        for _ in 0..4000 {
            let mut point = || [0, 1, 2].map(|_| (random.below(grid) as f64 + shift) * scale);
            let [a, b, c, origin, target] = [point(), point(), point(), point(), point()];
            let direction = [0, 1, 2].map(|axis| target[axis] - origin[axis]);
            if direction == [0.0; 3] {
                continue;
            }
            let ray = Ray::new(origin, direction);
            let frame = RayFrame::new(&ray);
            let meets = Exact::new(&ray, &[a, b, c]).meets();
            for triangle in [[a, b, c], [b, c, a], [c, b, a]] {
                let found = frame.crossing(&triangle);
                assert_eq!(found, expected(&ray, &triangle), "{ray:?} {triangle:?}");
                counts[found.map_or(0, |sense| 1 + usize::from(sense == Sense::Exit))] += 1;
                counts[3] += usize::from(meets && found.is_none());
                assert!(meets || found.is_none(), "what is crossed is met: {ray:?} {triangle:?}");
            }
        }
    }
    assert!(counts.iter().all(|count| *count > 200), "{counts:?}");
}
