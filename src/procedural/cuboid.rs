//! The corners and faces of a box.

/// The twelve faces of a box by its corners: corner `x + 2 y + 4 z`, each coordinate 0 or 1; seen counter-clockwise from outside.
pub const CUBOID_FACES: [[u32; 3]; 12] = [
    [0, 2, 3],
    [0, 3, 1],
    [4, 5, 7],
    [4, 7, 6],
    [0, 1, 5],
    [0, 5, 4],
    [2, 6, 7],
    [2, 7, 3],
    [0, 4, 6],
    [0, 6, 2],
    [1, 3, 7],
    [1, 7, 5],
];

/// The corners of a box, in the order that [`CUBOID_FACES`] counts them in.
pub fn cuboid_corners<T: Copy>(low: [T; 3], high: [T; 3]) -> [[T; 3]; 8] {
    std::array::from_fn(|corner| {
        std::array::from_fn(|axis| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] })
    })
}

#[cfg(test)]
mod tests {
    use super::super::open_edges;
    use super::super::random::cross;
    use super::*;

    #[test]
    fn boxes_are_closed_and_turned_outward() {
        let corners = cuboid_corners([-1.0, 2.0, -4.0], [1.0, 5.0, 3.0]);
        assert_eq!((corners[0], corners[7]), ([-1.0, 2.0, -4.0], [1.0, 5.0, 3.0]));
        assert_eq!(open_edges(&CUBOID_FACES), 0);
        let volume: f64 = CUBOID_FACES
            .iter()
            .map(|face| {
                let [a, b, c] = face.map(|corner| corners[corner as usize]);
                let n = cross(b, c);
                (a[0] * n[0] + a[1] * n[1] + a[2] * n[2]) / 6.0
            })
            .sum();
        assert!((volume - 2.0 * 3.0 * 7.0).abs() < 1e-12, "{volume}");
    }
}
