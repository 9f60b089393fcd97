//! OpenEXR with three 32-bit float channels, compressed without loss.

use std::io::{self, Seek, Write};

use exr::prelude::*;

use crate::render::Film;

pub(super) fn encode(film: &Film, out: &mut (impl Write + Seek)) -> io::Result<()> {
    let channels = SpecificChannels::rgb(|position: Vec2<usize>| {
        let [red, green, blue] = film.row(position.y() as u32)[position.x()];
        (red, green, blue)
    });
    let size = (film.width() as usize, film.height() as usize);
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new(size, LayerAttributes::default(), encoding, channels);
    // One thread: the caller did not ask for more (I8).
    Image::from_layer(layer).write().non_parallel().to_buffered(out).map_err(|error| match error {
        exr::error::Error::Io(error) => error,
        other => io::Error::other(other),
    })
}
