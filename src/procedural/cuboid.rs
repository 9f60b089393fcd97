//! The faces of a box.

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
