//! The same picture by any tracer: the standard view, diffuse, with a shadow ray to each light.

use std::path::Path;

use outcrop::procedural::Gears;

use crate::engine::Engine;
use crate::numbers::dot;
use crate::rays::{RAYS_PER_CALL, Rays, lift_surface, primary};

/// Diffuse reflectance of everything, outcrop's default material; the lights share unit irradiance.
const REFLECTANCE: f64 = 0.7 / Gears::LAMPS.len() as f64;

/// Linear brightness, row by row from the top.
pub fn trace(engine: &mut dyn Engine, size: usize) -> Vec<f32> {
    let (rays, pixels) = primary(size);
    let mut picture = vec![0.0; size * size];
    let mut surfaces = vec![None; RAYS_PER_CALL];
    for call in rays.calls() {
        let surfaces = &mut surfaces[..call.len()];
        engine.surfaces(&rays, call.clone(), surfaces);
        let mut shadows = Rays::default();
        // Which pixel each shadow ray is for, and what it brings there.
        let mut shares = Vec::new();
        for ((ray, pixel), surface) in rays.double[call.clone()].iter().zip(&pixels[call]).zip(surfaces) {
            let Some(lifted) = surface.and_then(|surface| lift_surface(ray, surface)) else { continue };
            for light in Gears::LAMPS {
                let toward = [0, 1, 2].map(|axis| light[axis] - lifted.origin[axis]);
                let cosine = dot(toward, lifted.normal) / dot(toward, toward).sqrt();
                if cosine > 0.0 {
                    shadows.push(lifted.origin, toward, 1.0);
                    shares.push((pixel[1] * size + pixel[0], REFLECTANCE * cosine));
                }
            }
        }
        let mut blocked = vec![false; shadows.len()];
        for range in shadows.calls() {
            engine.occluded(&shadows, range.clone(), &mut blocked[range]);
        }
        for ((pixel, share), blocked) in shares.into_iter().zip(blocked) {
            if !blocked {
                picture[pixel] += share as f32;
            }
        }
    }
    picture
}

/// As an 8-bit grey PNG.
pub fn write(picture: &[f32], size: usize, path: &Path) -> Result<(), String> {
    let encoded: Vec<u8> = picture.iter().map(|linear| srgb(*linear)).collect();
    let text = |error: &dyn std::fmt::Display| format!("cannot write {}: {error}", path.display());
    let file = std::fs::File::create(path).map_err(|error| text(&error))?;
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), size as u32, size as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|error| text(&error))?;
    writer.write_image_data(&encoded).map_err(|error| text(&error))?;
    writer.finish().map_err(|error| text(&error))
}

/// Reads what [`write`] or outcrop's renderer wrote; of colours, the red.
pub fn read(path: &Path) -> Result<Vec<u8>, String> {
    let text = |error: &dyn std::fmt::Display| format!("cannot read {}: {error}", path.display());
    let file = std::fs::File::open(path).map_err(|error| text(&error))?;
    let mut reader =
        png::Decoder::new(std::io::BufReader::new(file)).read_info().map_err(|error| text(&error))?;
    let mut pixels = vec![0; reader.output_buffer_size().ok_or_else(|| text(&"too large"))?];
    let info = reader.next_frame(&mut pixels).map_err(|error| text(&error))?;
    Ok(pixels.into_iter().step_by(info.color_type.samples()).collect())
}

fn srgb(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (255.0 * encoded).round() as u8
}
