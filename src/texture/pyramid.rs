//! Rows of a picture to tiles of all its sizes, in the memory of one row of tiles for each size.

use super::Encoding;
use super::layout::{Level, TILE_BYTES, TILE_SIDE, levels};
use super::srgb::Table;
use crate::block::checksum;

/// Where tiles go: number, bytes.
pub(super) type Sink<'s, E> = dyn FnMut(u32, &[u8]) -> Result<(), E> + 's;

/// Takes the rows of one picture, from the top.
pub(super) struct Pyramid {
    sizes: Vec<Size>,
    table: Table,
    pub has_alpha: bool,
    /// The least and the greatest byte of each channel so far.
    pub extremes: [[u8; 4]; 2],
}

/// A size of the picture on its way to tiles.
struct Size {
    level: Level,
    /// Rows so far.
    rows: u32,
    /// The rows of the current row of tiles, RGBA.
    bytes: Vec<u8>,
    /// The row above, in linear numbers, if the one that comes belongs with it.
    above: Vec<f32>,
    has_above: bool,
}

impl Pyramid {
    pub fn new(width: u32, height: u32, first_tile: u32, encoding: Encoding) -> Pyramid {
        let sizes = levels(width, height, first_tile).map(|level| Size {
            level,
            rows: 0,
            bytes: Vec::with_capacity(4 * (level.width * TILE_SIDE) as usize),
            above: Vec::with_capacity(4 * level.width as usize),
            has_above: false,
        });
        Pyramid {
            sizes: sizes.collect(),
            table: Table::new(encoding),
            has_alpha: false,
            extremes: [[255; 4], [0; 4]],
        }
    }

    /// What it allocates, and the tile that is on its way.
    pub fn bytes_needed(width: u32) -> u64 {
        // A row of tiles, the row above and one that is made; all sizes together are less than twice the first.
        2 * u64::from(width) * u64::from(4 * TILE_SIDE + 16 + 16) + TILE_BYTES as u64 + (64 << 10)
    }

    /// Takes a row: four bytes for each texel.
    pub fn push<E>(&mut self, row: &[u8], sink: &mut Sink<'_, E>) -> Result<(), E> {
        for texel in row.as_chunks::<4>().0 {
            let [least, most] = &mut self.extremes;
            for ((least, most), byte) in least.iter_mut().zip(most).zip(texel) {
                (*least, *most) = ((*least).min(*byte), (*most).max(*byte));
            }
        }
        self.has_alpha = self.extremes[0][3] != 255;
        let mut numbers = Vec::new();
        if self.sizes.len() > 1 {
            let texels = row.as_chunks::<4>().0.iter();
            let number = |texel: &[u8; 4]| {
                let [r, g, b, a] = *texel;
                let color = [r, g, b].map(|byte| self.table.decode(byte));
                [color[0], color[1], color[2], f32::from(a) / 255.0]
            };
            numbers = texels.flat_map(number).collect();
        }
        self.push_to(0, row, numbers, sink)
    }

    fn push_to<E>(
        &mut self,
        place: usize,
        row: &[u8],
        numbers: Vec<f32>,
        sink: &mut Sink<'_, E>,
    ) -> Result<(), E> {
        let size = &mut self.sizes[place];
        size.bytes.extend_from_slice(row);
        size.rows += 1;
        let is_last = size.rows == size.level.height;
        if is_last || size.rows.is_multiple_of(TILE_SIDE) {
            size.flush(sink)?;
        }
        if place + 1 == self.sizes.len() {
            return Ok(());
        }
        let size = &mut self.sizes[place];
        if !size.has_above && !is_last {
            size.above = numbers;
            size.has_above = true;
            return Ok(());
        }
        // The last row of an odd number counts twice.
        let above = if size.has_above { std::mem::take(&mut size.above) } else { numbers.clone() };
        size.has_above = false;
        let smaller = halve(&above, &numbers);
        let texels = smaller.as_chunks::<4>().0.iter();
        let byte = |texel: &[f32; 4]| {
            let [r, g, b, a] = *texel;
            let [r, g, b] = [r, g, b].map(|number| self.table.encode(number));
            [r, g, b, (a * 255.0 + 0.5) as u8]
        };
        let bytes: Vec<u8> = texels.flat_map(byte).collect();
        self.push_to(place + 1, &bytes, smaller, sink)
    }
}

/// Two rows to one of half the length. Colours count by their alpha, so that what is not seen does not bleed into what is.
fn halve(above: &[f32], below: &[f32]) -> Vec<f32> {
    let rows = [above, below].map(|row| row.as_chunks::<4>().0);
    let count = rows[0].len();
    let mut out = Vec::with_capacity(4 * count.div_ceil(2));
    for left in (0..count).step_by(2) {
        let right = (left + 1).min(count - 1);
        let four = [rows[0][left], rows[0][right], rows[1][left], rows[1][right]];
        let alpha: f32 = four.iter().map(|texel| texel[3]).sum();
        for channel in 0..3 {
            out.push(if alpha > 0.0 {
                four.iter().map(|texel| texel[channel] * texel[3]).sum::<f32>() / alpha
            } else {
                four.iter().map(|texel| texel[channel]).sum::<f32>() / 4.0
            });
        }
        out.push(alpha / 4.0);
    }
    out
}

impl Size {
    /// Sends the current row of tiles; texels beyond the picture are zero.
    fn flush<E>(&mut self, sink: &mut Sink<'_, E>) -> Result<(), E> {
        let across = self.level.tiles_across();
        let tile_row = (self.rows - 1) / TILE_SIDE;
        let (row_bytes, side_bytes) = (4 * self.level.width as usize, 4 * TILE_SIDE as usize);
        let mut tile = vec![0; TILE_BYTES];
        for column in 0..across {
            tile.fill(0);
            let start = column as usize * side_bytes;
            let length = side_bytes.min(row_bytes - start);
            for (row, place) in self.bytes.chunks_exact(row_bytes).zip(tile.chunks_exact_mut(side_bytes)) {
                place[..length].copy_from_slice(&row[start..start + length]);
            }
            sink(self.level.first_tile + tile_row * across + column, &tile)?;
        }
        self.bytes.clear();
        Ok(())
    }
}

/// The checksum of a tile.
pub(super) fn tile_checksum(tile: &[u8]) -> u64 {
    checksum(tile)
}
