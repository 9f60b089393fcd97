//! A picture of the surroundings in latitude and longitude, with tables to sample it by.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec3;

use super::table::{accumulate, invert};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::RenderError;
use crate::units::Bytes;

/// A panorama: columns go once around, rows from straight up to straight down, linear RGB radiance at the middles of the
/// pixels and interpolated between them. Drawn from the memory budget until dropped (I1).
#[derive(Debug)]
pub struct EnvironmentImage {
    width: u32,
    height: u32,
    pixels: Vec<[f32; 3]>,
    radiance_max: [f32; 3],
    /// Cumulative sums over rows, and over the columns of each row.
    row_sums: Vec<f64>,
    column_sums: Vec<f64>,
    /// Whether there is anything to sample.
    is_lit: bool,
    _reservation: Reservation,
}

impl PartialEq for EnvironmentImage {
    /// Whether the pictures are equal.
    fn eq(&self, other: &EnvironmentImage) -> bool {
        self.width == other.width && self.pixels == other.pixels
    }
}

impl EnvironmentImage {
    /// Most pixels of a picture.
    pub const PIXELS_MAX: u64 = 1 << 28;

    /// A picture from its pixels, row by row from the top.
    ///
    /// # Errors
    /// [`RenderError::Setting`] if there are no pixels or not `width` times `height`, or a channel is negative or not finite;
    /// [`RenderError::Budget`] if picture and tables (20 bytes per pixel and more) do not fit.
    pub fn new(
        width: u32,
        height: u32,
        pixels: Vec<[f32; 3]>,
        budget: &MemoryBudget,
    ) -> Result<EnvironmentImage, RenderError> {
        let reservation = budget.reserve(Self::bytes_needed(width, height)?, "the environment image")?;
        Self::with_reservation(width, height, pixels, reservation)
    }

    /// Reads a Radiance picture (`.hdr`, `.pic`), or the first layer with red, green and blue of an OpenEXR file (`.exr`, feature `exr`).
    ///
    /// # Errors
    /// [`RenderError::Read`] if the file cannot be read, is damaged, is no picture as [`EnvironmentImage::new`] takes them, or is of a
    /// format that this build does not read; [`RenderError::Budget`]. Memory is reserved before the picture is decoded.
    pub fn read(path: impl AsRef<Path>, budget: &MemoryBudget) -> Result<EnvironmentImage, RenderError> {
        let path = path.as_ref();
        let extension = path.extension().and_then(|extension| extension.to_str()).unwrap_or("");
        let image = match extension.to_ascii_lowercase().as_str() {
            #[cfg(feature = "exr")]
            "exr" => super::exr::read(path, budget),
            "hdr" | "pic" => super::hdr::read(path, budget),
            _ => {
                let reason = if cfg!(feature = "exr") {
                    "only Radiance (.hdr) and OpenEXR (.exr) pictures are read; convert it to one of them"
                } else {
                    "this build reads only Radiance pictures (.hdr); convert it, or build with the feature `exr` for OpenEXR"
                };
                Err(RenderError::Read { path: path.to_path_buf(), reason: reason.to_string() })
            }
        };
        image.map_err(|error| match error {
            // What is wrong with the picture is wrong with this file.
            RenderError::Setting { reason, .. } => RenderError::Read { path: path.to_path_buf(), reason },
            error => error,
        })
    }

    /// What a picture of this size takes from the budget.
    ///
    /// # Errors
    /// [`RenderError::Setting`] for a size of 0 or above [`EnvironmentImage::PIXELS_MAX`].
    pub fn bytes_needed(width: u32, height: u32) -> Result<Bytes, RenderError> {
        let count = u64::from(width) * u64::from(height);
        if count == 0 || count > Self::PIXELS_MAX {
            let reason = format!("{width} x {height} pixels; there must be between 1 and 2^28");
            return Err(RenderError::Setting { what: "environment image", reason });
        }
        Ok(Bytes(count * 20 + u64::from(height) * 24 + 8))
    }

    pub(super) fn with_reservation(
        width: u32,
        height: u32,
        pixels: Vec<[f32; 3]>,
        reservation: Reservation,
    ) -> Result<EnvironmentImage, RenderError> {
        let error = |reason: String| RenderError::Setting { what: "environment image", reason };
        if pixels.len() as u64 != u64::from(width) * u64::from(height) || pixels.is_empty() {
            return Err(error(format!("{} pixels do not make {width} x {height}", pixels.len())));
        }
        let mut radiance_max = [0.0f32; 3];
        for (index, pixel) in pixels.iter().enumerate() {
            if pixel.iter().any(|channel| !(*channel >= 0.0 && channel.is_finite())) {
                let (x, y) = (index as u64 % u64::from(width), index as u64 / u64::from(width));
                return Err(error(format!("pixel ({x}, {y}) is negative or not finite")));
            }
            radiance_max = [0, 1, 2].map(|channel| radiance_max[channel].max(pixel[channel]));
        }
        let mut image = EnvironmentImage {
            width,
            height,
            pixels,
            radiance_max,
            row_sums: Vec::with_capacity(height as usize + 1),
            column_sums: Vec::with_capacity((width as usize + 1) * height as usize),
            is_lit: false,
            _reservation: reservation,
        };
        image.fill_tables();
        Ok(image)
    }

    #[cfg(test)]
    pub(super) fn pixel(&self, x: usize, y: usize) -> [f32; 3] {
        self.pixels[y * self.width as usize + x]
    }

    /// Width and height in pixels.
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Largest value of each channel.
    pub fn radiance_max(&self) -> [f32; 3] {
        self.radiance_max
    }

    /// The weight of a cell is the integral over it of what [`EnvironmentImage::radiance`] interpolates, so no direction with
    /// light has density 0.
    fn fill_tables(&mut self) {
        let brightness = |x: u32, y: u32| {
            let [r, g, b] = self.pixels[y as usize * self.width as usize + x as usize].map(f64::from);
            r + g + b
        };
        let (right, below) = (self.width - 1, self.height - 1);
        let across = |x: u32, y: u32| {
            let before = if x == 0 { right } else { x - 1 };
            let after = if x == right { 0 } else { x + 1 };
            0.125 * (brightness(before, y) + 6.0 * brightness(x, y) + brightness(after, y))
        };
        let cell = |x: u32, y: u32| {
            0.125 * (across(x, y.saturating_sub(1)) + 6.0 * across(x, y) + across(x, below.min(y + 1)))
        };
        let mut rows = Vec::with_capacity(self.height as usize);
        let mut column_sums = std::mem::take(&mut self.column_sums);
        for y in 0..self.height {
            let total = accumulate((0..self.width).map(|x| cell(x, y)), &mut column_sums);
            rows.push(total * self.row_height(y));
        }
        let total = accumulate(rows.iter().copied(), &mut self.row_sums);
        self.column_sums = column_sums;
        self.is_lit = total > 0.0;
    }

    /// Cosine of the angle from up at the upper border of row `y`.
    fn cos_border(&self, y: u32) -> f64 {
        if y == self.height { -1.0 } else { libm::cos(PI * f64::from(y) / f64::from(self.height)) }
    }

    /// What row `y` covers of the cosine's range of 2.
    fn row_height(&self, y: u32) -> f64 {
        // A product, as the difference of cosines loses digits at the poles.
        let half = 0.5 * PI / f64::from(self.height);
        2.0 * libm::sin((2.0 * f64::from(y) + 1.0) * half) * libm::sin(half)
    }

    fn columns_of(&self, y: u32) -> &[f64] {
        let stride = self.width as usize + 1;
        &self.column_sums[y as usize * stride..][..stride]
    }

    /// Column and row of a direction as real numbers, from the upper left corner.
    fn place(&self, [x, y, z]: [f64; 3]) -> [f64; 2] {
        let column = (0.5 + libm::atan2(x, z) / TAU) * f64::from(self.width);
        let row = libm::acos(y.clamp(-1.0, 1.0)) / PI * f64::from(self.height);
        [column, row]
    }

    /// What is seen along a unit vector (right, up, front).
    pub(super) fn radiance(&self, direction: [f64; 3]) -> DVec3 {
        let [column, row] = self.place(direction).map(|x| x - 0.5);
        let (left, top) = (column.floor(), row.floor());
        let (fx, fy) = (column - left, row - top);
        // In -1 ..= width and -1 ..= height.
        let wrap = |x: f64| (x as i64).rem_euclid(i64::from(self.width)) as usize;
        let clamp = |y: f64| (y as i64).clamp(0, i64::from(self.height) - 1) as usize;
        let pixel = |x: f64, y: f64| {
            let [r, g, b] = self.pixels[clamp(y) * self.width as usize + wrap(x)].map(f64::from);
            DVec3::new(r, g, b)
        };
        let line = |y: f64| pixel(left, y) * (1.0 - fx) + pixel(left + 1.0, y) * fx;
        line(top) * (1.0 - fy) + line(top + 1.0) * fy
    }

    /// A unit vector (right, up, front) by importance, and its density over solid angle; `None` if all is black.
    pub(super) fn sample(&self, [u, v]: [f64; 2]) -> Option<([f64; 3], f64)> {
        if !self.is_lit {
            return None;
        }
        let (y, down) = invert(&self.row_sums, v);
        let y = y as u32;
        let (x, across) = invert(self.columns_of(y), u);
        let cos = self.cos_border(y) - down * self.row_height(y);
        let sin = (1.0 - cos * cos).max(0.0).sqrt();
        let angle = ((x as f64 + across) / f64::from(self.width) - 0.5) * TAU;
        let (sin_angle, cos_angle) = libm::sincos(angle);
        let density = self.cell_density(x as u32, y);
        (density > 0.0).then_some(([sin * sin_angle, cos, sin * cos_angle], density))
    }

    /// Density over solid angle with which [`EnvironmentImage::sample`] chooses `direction`.
    pub(super) fn density(&self, direction: [f64; 3]) -> f64 {
        if !self.is_lit {
            return 0.0;
        }
        let [column, row] = self.place(direction);
        self.cell_density(
            (column.max(0.0) as u32).min(self.width - 1),
            (row.max(0.0) as u32).min(self.height - 1),
        )
    }

    fn cell_density(&self, x: u32, y: u32) -> f64 {
        let share = |sums: &[f64], index: u32| sums[index as usize + 1] - sums[index as usize];
        let solid_angle = self.row_height(y) * TAU / f64::from(self.width);
        share(&self.row_sums, y) * share(self.columns_of(y), x) / solid_angle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sky() -> EnvironmentImage {
        let (width, height) = (16u32, 8u32);
        let pixels = (0..width * height).map(|index| {
            let (x, y) = (index % width, index / width);
            match (x, y) {
                (5, 2) => [40.0, 30.0, 20.0],
                (_, 0..4) => [0.5, 0.7, 1.0 + y as f32 * 0.1],
                _ => [0.0, 0.0, 0.0],
            }
        });
        EnvironmentImage::new(width, height, pixels.collect(), &MemoryBudget::new(Bytes::mib(1))).unwrap()
    }

    #[test]
    fn directions_fall_into_cells_by_their_density() {
        let image = sky();
        const SIDE: u32 = 512;
        let mut counts = vec![0u32; 16 * 8];
        let mut flux = DVec3::ZERO;
        for index in 0..SIDE * SIDE {
            let point = [index % SIDE, index / SIDE].map(|i| (f64::from(i) + 0.5) / f64::from(SIDE));
            let (direction, density) = image.sample(point).unwrap();
            assert!((DVec3::from_array(direction).length() - 1.0).abs() < 1e-12);
            assert!((image.density(direction) / density - 1.0).abs() < 1e-9, "{direction:?}");
            let [column, row] = image.place(direction);
            counts[row as usize * 16 + column as usize] += 1;
            flux += image.radiance(direction) / density;
        }
        let total = f64::from(SIDE * SIDE);
        for (index, count) in counts.iter().enumerate() {
            let (x, y) = (index as u32 % 16, index as u32 / 16);
            let expected = image.cell_density(x, y) * image.row_height(y) * TAU / 16.0 * total;
            assert!(
                (f64::from(*count) - expected).abs() <= 2.0 * f64::from(SIDE),
                "{x} {y}: {count} {expected}"
            );
        }
        // The integral of the radiance, against a plain sum over directions.
        let mut plain = DVec3::ZERO;
        for index in 0..SIDE * SIDE {
            let cos = 1.0 - 2.0 * (f64::from(index / SIDE) + 0.5) / f64::from(SIDE);
            let sin = (1.0 - cos * cos).sqrt();
            let angle = TAU * (f64::from(index % SIDE) + 0.5) / f64::from(SIDE);
            plain += image.radiance([sin * libm::sin(angle), cos, sin * libm::cos(angle)]);
        }
        let (flux, plain) = (flux / total, plain * (2.0 * TAU) / total);
        assert!((flux / plain - DVec3::ONE).abs().max_element() < 5e-3, "{flux} {plain}");
    }

    #[test]
    fn no_light_has_density_zero_and_seams_do_not_show() {
        let image = sky();
        for index in 0..20_000u32 {
            let cos = 1.0 - 2.0 * (f64::from(index) + 0.5) / 20_000.0;
            let angle = f64::from(index) * 2.399_963_229_728_653;
            let sin = (1.0 - cos * cos).sqrt();
            let direction = [sin * libm::sin(angle), cos, sin * libm::cos(angle)];
            assert!(
                image.density(direction) > 0.0 || image.radiance(direction) == DVec3::ZERO,
                "{direction:?}"
            );
        }
        // Behind, on both sides of the seam.
        let behind = |x: f64| image.radiance(DVec3::new(x, 0.6, -0.8).normalize().to_array());
        assert!((behind(1e-9) - behind(-1e-9)).length() < 1e-6);
    }

    #[test]
    fn senseless_pictures_are_refused_and_black_ones_sample_nothing() {
        let budget = MemoryBudget::new(Bytes::mib(1));
        for (width, height, pixels) in [
            (0, 1, vec![]),
            (2, 2, vec![[1.0; 3]; 3]),
            (1, 1, vec![[f32::NAN, 0.0, 0.0]]),
            (1, 1, vec![[-1.0, 0.0, 0.0]]),
        ] {
            assert!(EnvironmentImage::new(width, height, pixels, &budget).is_err());
        }
        assert!(EnvironmentImage::bytes_needed(1 << 16, 1 << 16).is_err());
        let large = EnvironmentImage::new(512, 256, vec![[1.0; 3]; 512 * 256], &budget);
        assert!(matches!(large, Err(RenderError::Budget(_))));
        let black = EnvironmentImage::new(4, 2, vec![[0.0; 3]; 8], &budget).unwrap();
        assert!(black.sample([0.3, 0.4]).is_none() && black.density([0.0, 1.0, 0.0]) == 0.0);
        drop(black);
        assert_eq!(budget.used(), Bytes(0));
    }
}
