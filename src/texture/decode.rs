//! Image files to rows of RGBA bytes. The files are untrusted (I5): sizes are checked and reserved before anything is allocated by them.

use std::fs::File;
use std::ops::Range;
use std::path::Path;

use super::layout::SIDE_MAX;
use super::part::FilePart;
use crate::budget::MemoryBudget;
use crate::error::TextureError;

/// What is told about an image before its rows, and each row from the top.
pub(super) trait Rows {
    /// The size; sides are between 1 and [`SIDE_MAX`].
    fn start(&mut self, width: u32, height: u32) -> Result<(), TextureError>;
    /// Four bytes for each texel.
    fn row(&mut self, row: &[u8]) -> Result<(), TextureError>;
}

fn refused(path: &Path, reason: impl Into<String>) -> TextureError {
    TextureError::Image { path: path.to_path_buf(), reason: reason.into() }
}

/// Reads an image file, or the part of a file that is one; its kind is told by its first bytes.
pub(super) fn decode(
    path: &Path,
    place: Option<Range<u64>>,
    budget: &MemoryBudget,
    rows: &mut dyn Rows,
) -> Result<(), TextureError> {
    use std::io::{Read, Seek};
    let io = |error| TextureError::Io { path: path.to_path_buf(), error };
    let file = File::open(path).map_err(io)?;
    let file_bytes = file.metadata().map_err(io)?.len();
    let place = place.unwrap_or(0..file_bytes);
    if place.end > file_bytes {
        let reason = format!("ends at byte {file_bytes}; an image should be at bytes {place:?}");
        return Err(refused(path, reason));
    }
    let mut file = FilePart::new(file, place).map_err(io)?;
    let mut start = [0; 4];
    let count = file.read(&mut start).map_err(io)?;
    file.rewind().map_err(io)?;
    match &start[..count] {
        [0x89, b'P', b'N', b'G'] => png(path, file, budget, rows),
        [0xff, 0xd8, 0xff, _] => jpeg(path, file, budget, rows),
        _ => Err(refused(path, "is neither a PNG nor a JPEG image; convert it")),
    }
}

fn check_size(path: &Path, width: u32, height: u32) -> Result<(), TextureError> {
    let sides = 1..=SIDE_MAX;
    if sides.contains(&width) && sides.contains(&height) {
        return Ok(());
    }
    Err(refused(path, format!("has {width} x {height} pixels; each side must be between 1 and {SIDE_MAX}")))
}

#[cfg(feature = "png")]
fn png(path: &Path, file: FilePart, budget: &MemoryBudget, rows: &mut dyn Rows) -> Result<(), TextureError> {
    use crate::units::Bytes;
    let failed = |error: png::DecodingError| refused(path, format!("cannot be decoded: {error}"));
    let mut decoder = png::Decoder::new(std::io::BufReader::new(file));
    // Palettes, fewer and more than eight bits: all to eight bits for each channel.
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(failed)?;
    let (width, height) = (reader.info().width, reader.info().height);
    check_size(path, width, height)?;
    let (color, _) = reader.output_color_type();
    let is_interlaced = reader.info().interlaced;
    let channels = color.samples();
    let line = width as usize * channels;
    let held = if is_interlaced { line as u64 * u64::from(height) } else { 4 * line as u64 };
    let _memory = budget
        .reserve(Bytes(held + 4 * u64::from(width) + (256 << 10)), "decoding an image")
        .map_err(TextureError::Budget)?;
    rows.start(width, height)?;
    let mut texels = vec![0; 4 * width as usize];
    let mut send = |line: &[u8]| {
        for (texel, samples) in texels.as_chunks_mut::<4>().0.iter_mut().zip(line.chunks_exact(channels)) {
            *texel = match *samples {
                [grey] => [grey, grey, grey, 255],
                [grey, alpha] => [grey, grey, grey, alpha],
                [r, g, b] => [r, g, b, 255],
                [r, g, b, a] => [r, g, b, a],
                _ => [0; 4],
            };
        }
        rows.row(&texels)
    };
    if is_interlaced {
        let mut whole = vec![0; line * height as usize];
        reader.next_frame(&mut whole).map_err(failed)?;
        return whole.chunks_exact(line).try_for_each(send);
    }
    for _ in 0..height {
        let row = reader.next_row().map_err(failed)?;
        let row = row.ok_or_else(|| refused(path, "ends before its last row"))?;
        send(row.data())?;
    }
    Ok(())
}

#[cfg(not(feature = "png"))]
fn png(path: &Path, _: FilePart, _: &MemoryBudget, _: &mut dyn Rows) -> Result<(), TextureError> {
    Err(refused(path, "is a PNG image; build with the feature `png`"))
}

#[cfg(feature = "jpeg")]
fn jpeg(path: &Path, file: FilePart, budget: &MemoryBudget, rows: &mut dyn Rows) -> Result<(), TextureError> {
    use crate::units::Bytes;
    use zune_jpeg::JpegDecoder;
    use zune_jpeg::zune_core::colorspace::ColorSpace;
    use zune_jpeg::zune_core::options::DecoderOptions;
    let failed =
        |error: zune_jpeg::errors::DecodeErrors| refused(path, format!("cannot be decoded: {error:?}"));
    let side = SIDE_MAX as usize - 1;
    let options = DecoderOptions::default()
        .set_max_width(side)
        .set_max_height(side)
        .jpeg_set_out_colorspace(ColorSpace::RGB);
    let mut decoder = JpegDecoder::new_with_options(std::io::BufReader::new(file), options);
    decoder.decode_headers().map_err(failed)?;
    let (width, height) = decoder.dimensions().ok_or_else(|| refused(path, "says no size"))?;
    let (width, height) = (width as u32, height as u32);
    check_size(path, width, height)?;
    let pixels = u64::from(width) * u64::from(height);
    // The picture, and the coefficients of a progressive one.
    let _memory = budget
        .reserve(Bytes(pixels * 12 + (1 << 20)), "decoding a JPEG image")
        .map_err(TextureError::Budget)?;
    let mut whole = vec![0; pixels as usize * 3];
    decoder.decode_into(&mut whole).map_err(failed)?;
    rows.start(width, height)?;
    let mut texels = vec![0; 4 * width as usize];
    for line in whole.chunks_exact(3 * width as usize) {
        for (texel, [r, g, b]) in texels.as_chunks_mut::<4>().0.iter_mut().zip(line.as_chunks::<3>().0) {
            *texel = [*r, *g, *b, 255];
        }
        rows.row(&texels)?;
    }
    Ok(())
}

#[cfg(not(feature = "jpeg"))]
fn jpeg(path: &Path, _: FilePart, _: &MemoryBudget, _: &mut dyn Rows) -> Result<(), TextureError> {
    Err(refused(path, "is a JPEG image; build with the feature `jpeg`, or convert it to PNG"))
}
