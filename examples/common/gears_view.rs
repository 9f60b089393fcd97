//! The standard view of the procedural gears.

pub const EYE: [f64; 3] = [-1.1, -2.1, 2.6];
pub const LOOK_AT: [f64; 3] = [0.0; 3];
pub const UP: [f64; 3] = [0.0, 0.0, 1.0];
pub const FOV_DEGREES: f64 = 45.0;
/// Where the five lamps are; each has `INTENSITY`.
pub const LAMPS: [[f64; 3]; 5] =
    [[2.0, 4.0, 4.0], [-2.0, 4.0, 3.0], [2.0, -2.5, 2.5], [-1.0, -4.0, 2.0], [-1.111, -2.121, 2.626]];
pub const INTENSITY: f32 = 0.25;
pub const BACKGROUND: [f32; 3] = [0.45, 0.55, 0.68];
pub const AMBIENT: [f32; 3] = [0.08; 3];
