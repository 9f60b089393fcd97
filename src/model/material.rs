//! Materials as the compiled file holds them.

/// A material in the terms of MTL (and of the 2004 paper). Colours are linear RGB.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialRecord {
    /// Name in the source; empty for the default material.
    pub name: String,
    /// Diffuse reflectance (`Kd`).
    pub diffuse: [f32; 3],
    /// Specular reflectance (`Ks`): highlight, and mirror where `mirror` is set.
    pub specular: [f32; 3],
    /// Phong exponent (`Ns`).
    pub shininess: f32,
    /// Emitted radiance (`Ke`).
    pub emission: [f32; 3],
    /// 1 for opaque (`d`); below 1 the rest is transmitted.
    pub opacity: f32,
    /// Colour of transmitted light per unit length inside (`Tf`): Beer-Lambert; white for none.
    pub transmission: [f32; 3],
    /// Refractive index (`Ni`); values below 1 or 0 in the source mean 1: light passes straight.
    pub refractive_index: f32,
    /// Whether `specular` reflects the scene like a mirror (`illum` 3 and up).
    pub mirror: bool,
}

impl Default for MaterialRecord {
    /// Opaque mid-grey, as used where the source names no material.
    fn default() -> MaterialRecord {
        MaterialRecord {
            name: String::new(),
            diffuse: [0.7; 3],
            specular: [0.0; 3],
            shininess: 1.0,
            emission: [0.0; 3],
            opacity: 1.0,
            transmission: [1.0; 3],
            refractive_index: 1.0,
            mirror: false,
        }
    }
}
