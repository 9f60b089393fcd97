//! What examples add to the standard view of the procedural gears.

pub const LOOK_AT: [f64; 3] = [0.0; 3];
pub const UP: [f64; 3] = [0.0, 0.0, 1.0];
pub const FOV_DEGREES: f64 = 45.0;
/// Of each lamp.
pub const INTENSITY: f32 = 0.25;
pub const BACKGROUND: [f32; 3] = [0.45, 0.55, 0.68];
pub const AMBIENT: [f32; 3] = [0.08; 3];
