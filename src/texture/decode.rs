//! Image files to rows of RGBA bytes. The files are untrusted (I5): sizes are checked and reserved before anything is allocated by them.

use std::fs::File;
use std::ops::Range;
use std::path::Path;

use super::layout::SIDE_MAX;
use super::part::Part;
use crate::budget::MemoryBudget;
use crate::error::TextureError;
use crate::units::Bytes;

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

/// Where in a file an image is.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    /// The base64 text that is taken in the file's place, if any.
    pub text: Option<Range<u64>>,
    /// The bytes of that or of the file; all without it.
    pub part: Option<Range<u64>>,
}

/// Reads an image file, or the part of a file that is one; its kind is told by its first bytes. A text in base64 is decoded as a
/// whole, in memory of the budget.
pub(super) fn decode(
    path: &Path,
    place: Place,
    budget: &MemoryBudget,
    rows: &mut dyn Rows,
) -> Result<(), TextureError> {
    use std::io::{Cursor, Read, Seek};
    let io = |error| TextureError::Io { path: path.to_path_buf(), error };
    let file = File::open(path).map_err(io)?;
    let file_bytes = file.metadata().map_err(io)?.len();
    let inside = |place: Option<Range<u64>>, length: u64| {
        let place = place.unwrap_or(0..length);
        let reason = || format!("ends at byte {length}; an image should be at bytes {place:?}");
        if place.end > length { Err(refused(path, reason())) } else { Ok(place) }
    };
    let Place { text, part } = place;
    let (mut file, _memory): (Box<dyn Source>, _) = match text {
        None => (Box::new(Part::new(file, inside(part, file_bytes)?).map_err(io)?), None),
        Some(text) => {
            let text = inside(Some(text), file_bytes)?;
            // The text, up to three copies while it is freed of escapes, and what it says.
            let memory = budget
                .reserve(Bytes((text.end.saturating_sub(text.start)).saturating_mul(4)), "an image in base64")
                .map_err(TextureError::Budget)?;
            let bytes = base64(path, Part::new(file, text).map_err(io)?)?;
            let part = inside(part, bytes.len() as u64)?;
            (Box::new(Part::new(Cursor::new(bytes), part).map_err(io)?), Some(memory))
        }
    };
    let mut start = [0; 4];
    let count = file.read(&mut start).map_err(io)?;
    file.rewind().map_err(io)?;
    match &start[..count] {
        [0x89, b'P', b'N', b'G'] => png(path, file, budget, rows),
        [0xff, 0xd8, 0xff, _] => jpeg(path, file, budget, rows),
        _ => Err(refused(path, "is neither a PNG nor a JPEG image; convert it")),
    }
}

/// What decoders read from.
trait Source: std::io::Read + std::io::Seek {}
impl<S: std::io::Read + std::io::Seek> Source for S {}

#[cfg(feature = "gltf")]
fn base64(path: &Path, mut part: Part<File>) -> Result<Vec<u8>, TextureError> {
    use std::io::Read;
    // Its length was compared with the file's, and is reserved.
    let mut text = Vec::with_capacity(part.len() as usize);
    part.read_to_end(&mut text).map_err(|error| TextureError::Io { path: path.to_path_buf(), error })?;
    crate::import::gltf::decode_json(&text)
        .ok_or_else(|| refused(path, "holds an image that is not in base64"))
}

#[cfg(not(feature = "gltf"))]
fn base64(path: &Path, _: Part<File>) -> Result<Vec<u8>, TextureError> {
    Err(refused(path, "holds an image in base64; build with the feature `gltf`"))
}

fn check_size(path: &Path, width: u32, height: u32) -> Result<(), TextureError> {
    let sides = 1..=SIDE_MAX;
    if sides.contains(&width) && sides.contains(&height) {
        return Ok(());
    }
    Err(refused(path, format!("has {width} x {height} pixels; each side must be between 1 and {SIDE_MAX}")))
}

#[cfg(feature = "png")]
fn png(
    path: &Path,
    file: Box<dyn Source>,
    budget: &MemoryBudget,
    rows: &mut dyn Rows,
) -> Result<(), TextureError> {
    let failed = |error: png::DecodingError| refused(path, format!("cannot be decoded: {error}"));
    let mut decoder = png::Decoder::new(std::io::BufReader::new(file));
    // Not used, and a small file can hold one of 64 MiB, which nothing has reserved.
    decoder.set_ignore_iccp_chunk(true);
    decoder.set_ignore_text_chunk(true);
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
fn png(path: &Path, _: Box<dyn Source>, _: &MemoryBudget, _: &mut dyn Rows) -> Result<(), TextureError> {
    Err(refused(path, "is a PNG image; build with the feature `png`"))
}

#[cfg(feature = "jpeg")]
fn jpeg(
    path: &Path,
    file: Box<dyn Source>,
    budget: &MemoryBudget,
    rows: &mut dyn Rows,
) -> Result<(), TextureError> {
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
fn jpeg(path: &Path, _: Box<dyn Source>, _: &MemoryBudget, _: &mut dyn Rows) -> Result<(), TextureError> {
    Err(refused(path, "is a JPEG image; build with the feature `jpeg`, or convert it to PNG"))
}
