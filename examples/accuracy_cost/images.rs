//! Pictures, and pictures of differences, as PNG.

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use outcrop::accuracy::{Metric, flip_map};
use outcrop::render::Film;

/// A pair of pictures that was written, and how much they differ.
pub struct Pair {
    pub caption: String,
    /// File names: the picture, the difference, FLIP.
    pub files: [String; 3],
    /// In the order of [`Metric::ALL`].
    pub errors: [f64; 3],
    /// What differences are multiplied by.
    pub gain: f64,
}

pub fn write(
    folder: &Path,
    index: usize,
    caption: &str,
    against: &Film,
    film: &Film,
) -> Result<Pair, Box<dyn Error>> {
    write_pixels(folder, index, caption, against.pixels(), film.pixels(), film.width())
}

/// Writes `pixels`, their difference from `against`, and FLIP between both.
pub fn write_pixels(
    folder: &Path,
    index: usize,
    caption: &str,
    against: &[[f32; 3]],
    pixels: &[[f32; 3]],
    width: u32,
) -> Result<Pair, Box<dyn Error>> {
    let errors = Metric::ALL.map(|metric| metric.distance(against, pixels, width));
    // So that a typical difference can be seen.
    let gain =
        (0.25 / (4.0 * errors[Metric::Rmse as usize]).max(1e-6)).log2().round().exp2().clamp(1.0, 65536.0);
    let files = ["picture", "difference", "flip"].map(|what| format!("{what}-{index}.png"));
    let display = |x: f32| (255.0 * srgb(f64::from(x).clamp(0.0, 1.0))).round() as u8;
    let picture: Vec<u8> = pixels.iter().flatten().map(|x| display(*x)).collect();
    let difference: Vec<u8> = against
        .iter()
        .flatten()
        .zip(pixels.iter().flatten())
        .map(|(a, b)| (255.0 * (gain * (f64::from(*a) - f64::from(*b)).abs()).min(1.0)).round() as u8)
        .collect();
    let flip: Vec<u8> = flip_map(against, pixels, width).into_iter().flat_map(heat).collect();
    for (name, bytes) in files.iter().zip([&picture, &difference, &flip]) {
        png(&folder.join(name), bytes, width)?;
    }
    Ok(Pair { caption: caption.to_string(), files, errors, gain })
}

fn png(path: &Path, bytes: &[u8], width: u32) -> Result<(), Box<dyn Error>> {
    let file = File::create(path).map_err(|error| format!("cannot write {}: {error}", path.display()))?;
    let mut encoder = png::Encoder::new(BufWriter::new(file), width, (bytes.len() / 3) as u32 / width);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header()?.write_image_data(bytes)?;
    Ok(())
}

fn srgb(x: f64) -> f64 {
    if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

/// Black over violet and orange to pale yellow.
fn heat(x: f64) -> [u8; 3] {
    const STOPS: [[f64; 3]; 5] = [
        [0.0, 0.0, 4.0],
        [81.0, 18.0, 124.0],
        [183.0, 55.0, 121.0],
        [252.0, 137.0, 97.0],
        [252.0, 253.0, 191.0],
    ];
    let at = x.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let index = (at as usize).min(STOPS.len() - 2);
    let share = at - index as f64;
    [0, 1, 2].map(|channel| {
        (STOPS[index][channel] * (1.0 - share) + STOPS[index + 1][channel] * share).round() as u8
    })
}
