//! PNG with 8 bits per channel and an sRGB chunk.

use std::io::{self, Write};

use super::srgb::Encoder;
use crate::render::Film;

pub(super) fn encode(film: &Film, out: &mut impl Write) -> io::Result<()> {
    let mut info = png::Encoder::new(out, film.width(), film.height());
    info.set_color(png::ColorType::Rgb);
    info.set_depth(png::BitDepth::Eight);
    info.set_source_srgb(png::SrgbRenderingIntent::RelativeColorimetric);
    let mut writer = info.write_header()?;
    // Row by row, so that no second picture stands in memory (I1).
    let mut rows = writer.stream_writer()?;
    let srgb = Encoder::new();
    let mut bytes = Vec::with_capacity(film.width() as usize * 3);
    for y in 0..film.height() {
        bytes.clear();
        bytes.extend(film.row(y).as_flattened().iter().map(|channel| srgb.encode(*channel)));
        rows.write_all(&bytes)?;
    }
    rows.finish()?;
    writer.finish()?;
    Ok(())
}
