//! Where the workers' central points lie.

use crate::schedule::options::CentralPoints;

/// The point of the worker number `index` of `count`, in an image of `width` by `height` (any unit). Workers beyond `count` get
/// points from a sequence that fills the image evenly.
pub(in crate::schedule) fn central_point(
    points: CentralPoints,
    index: u32,
    count: u32,
    [width, height]: [f64; 2],
) -> [f64; 2] {
    if index >= count {
        // Roberts' R2 sequence: multiples of the powers of the plastic number's inverse.
        let along = |step: f64| (0.5 + f64::from(index - count + 1) * step).fract();
        return [along(0.754_877_666_246_692_8) * width, along(0.569_840_290_998_053_3) * height];
    }
    let (index, count) = (f64::from(index), f64::from(count));
    match points {
        CentralPoints::Even => {
            // Rows of nearly square rectangles; a row with more of them is higher, so that all have the same area.
            let rows = (count * height / width).sqrt().round().clamp(1.0, count);
            let first_of = |row: f64| (row * count / rows).floor();
            let mut row = (index * rows / count).floor();
            while first_of(row + 1.0) <= index {
                row += 1.0;
            }
            let (first, next) = (first_of(row), first_of(row + 1.0));
            [width * (index - first + 0.5) / (next - first), height * (first + next) / 2.0 / count]
        }
        CentralPoints::Diagonals => {
            // In turns on the one and the other, so that none share the middle.
            let steps = (count / 2.0).ceil();
            let step = (index / 2.0).floor();
            if index % 2.0 == 0.0 {
                let along = (step + 0.25) / steps;
                [width * along, height * along]
            } else {
                let along = (step + 0.75) / steps;
                [width * along, height * (1.0 - along)]
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_lie_in_the_image_and_apart() {
        for points in [CentralPoints::Even, CentralPoints::Diagonals] {
            for count in [1, 2, 3, 5, 6, 7, 64, 100] {
                for size in [[1.0, 1.0], [16.0, 9.0], [1.0, 50.0]] {
                    let all: Vec<[f64; 2]> =
                        (0..count + 5).map(|index| central_point(points, index, count, size)).collect();
                    for (index, [x, y]) in all.iter().enumerate() {
                        assert!((0.0..size[0]).contains(x) && (0.0..size[1]).contains(y), "{points:?}");
                        assert!(all[..index].iter().all(|other| other != &all[index]), "{points:?} {count}");
                    }
                }
            }
        }
    }

    #[test]
    fn even_points_stand_in_rectangles_of_equal_area() {
        // 5 in a square: a row of 2 and a row of 3.
        let all: Vec<[f64; 2]> =
            (0..5).map(|index| central_point(CentralPoints::Even, index, 5, [30.0, 30.0])).collect();
        let expected = [[7.5, 6.0], [22.5, 6.0], [5.0, 21.0], [15.0, 21.0], [25.0, 21.0]];
        for (point, expected) in all.iter().zip(expected) {
            assert!((point[0] - expected[0]).abs() + (point[1] - expected[1]).abs() < 1e-9, "{all:?}");
        }
    }
}
