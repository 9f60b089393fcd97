//! Portable float map: a text header, then rows from the bottom, f32 little-endian (Debevec's PFM).

use std::io::{self, Write};

use crate::render::Film;

pub(super) fn encode(film: &Film, out: &mut impl Write) -> io::Result<()> {
    // A negative scale says little-endian.
    write!(out, "PF\n{} {}\n-1.0\n", film.width(), film.height())?;
    for y in (0..film.height()).rev() {
        for channel in film.row(y).as_flattened() {
            out.write_all(&channel.to_le_bytes())?;
        }
    }
    Ok(())
}
