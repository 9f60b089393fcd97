//! Boxes contain what they say, and never prune what they contain.

use outcrop::geom::{Aabb, Ray};
use outcrop::octree::OctreeOptions;
use outcrop::simd::{Boxes, LANES, PackedBoxes};

use crate::cases::{self, Random};
use crate::compiling::read_back;
use crate::everywhere::{closest, open, source};

#[test]
fn every_box_contains_its_geometry() {
    // `read_back` asserts it for blocks and sub-boxes while it decodes.
    for case in cases::all() {
        let source = source(&case, 4 << 10);
        let (_, stored) = read_back(&bytes_of(&case));
        assert_eq!(stored.len(), case.triangles.len(), "{}", case.name);
        let mut whole = Aabb::EMPTY;
        for entry in &source.model().blocks {
            whole.merge(&entry.bounds);
        }
        for (index, (stored, triangle)) in stored.iter().zip(&case.triangles).enumerate() {
            let corners = stored.as_ref().unwrap().corners;
            assert_eq!(corners, *triangle, "{}: triangle {index}", case.name);
            corners.iter().for_each(|p| assert!(whole.contains(&Aabb { min: *p, max: *p })));
        }
    }
}

fn bytes_of(case: &cases::Case) -> Vec<u8> {
    crate::everywhere::compiled_bytes(case, 4 << 10)
}

#[test]
fn packed_boxes_contain_their_cells() {
    let mut random = Random(31);
    for round in 0..20_000 {
        let scale = 2f64.powi((round % 80) - 40);
        let far = [0.0, 1.0, 1e3, 1e7][random.index(4)];
        let at = |random: &mut Random| (scale * (far + random.signed())) as f32;
        let corners = [(); 3].map(|()| [at(&mut random), at(&mut random)]);
        let low = corners.map(|[a, b]| a.min(b));
        let high = corners.map(|[a, b]| a.max(b));
        let mut cells = [[0u8; 6]; LANES];
        for cell in &mut cells {
            for axis in 0..3 {
                let (a, b) = (random.index(256) as u8, random.index(256) as u8);
                (cell[axis], cell[axis + 3]) = (a.min(b), a.max(b));
            }
        }
        let boxes: Boxes = PackedBoxes::new(low, high, &cells).unpack();
        for (lane, cell) in cells.iter().enumerate() {
            for axis in 0..3 {
                // The exact side of a cell: low + (high - low) * n / 256, in f64 with an error below 2^-50 of it.
                let side = |n: f64| {
                    let (low, high) = (f64::from(low[axis]), f64::from(high[axis]));
                    low + (high - low) * (n / 256.0)
                };
                assert!(f64::from(boxes[axis][lane]) <= side(f64::from(cell[axis])));
                assert!(f64::from(boxes[axis + 3][lane]) >= side(f64::from(cell[axis + 3]) + 1.0));
            }
        }
    }
}

#[test]
fn no_hit_lies_before_the_box_that_holds_it() {
    // If a hit's t came out below the entry of its box, a query that ends at t would prune the box and lose the hit; so
    // would one that has another hit at t.
    for case in cases::all() {
        let octree = open(&source(&case, 4 << 10), OctreeOptions::default());
        let hits = closest(&octree, &case.rays);
        let (ended, kept): (Vec<Ray>, Vec<_>) = case
            .rays
            .iter()
            .zip(&hits)
            .filter_map(|(ray, hit)| hit.map(|hit| (Ray { t_max: hit.t, ..*ray }, Some(hit))))
            .unzip();
        assert_eq!(closest(&octree, &ended), kept, "{}", case.name);
    }
}
