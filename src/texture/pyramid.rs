//! Rows of a picture to tiles of all its sizes, in the memory of one row of tiles for each size.

use smallvec::SmallVec;

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
    /// Rows that the next row of the smaller size is made of, in linear numbers: three at most.
    held: Vec<Vec<f32>>,
}

impl Pyramid {
    pub fn new(width: u32, height: u32, first_tile: u32, encoding: Encoding) -> Pyramid {
        let sizes = levels(width, height, first_tile).map(|level| Size {
            level,
            rows: 0,
            bytes: Vec::with_capacity(4 * (level.width * TILE_SIDE) as usize),
            held: Vec::with_capacity(3),
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
        // A row of tiles, three rows of numbers and one that is made; all sizes together are less than twice the first.
        2 * u64::from(width) * u64::from(4 * TILE_SIDE + 3 * 16 + 16) + TILE_BYTES as u64 + (64 << 10)
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
        size.held.push(numbers);
        let row = size.rows - 1;
        if row.is_multiple_of(2) && !is_last {
            return Ok(());
        }
        let Level { width, height, .. } = size.level;
        let smaller = halve(&size.held, taps(height, row / 2), width);
        // Of an odd number of rows the lower one is a part of the next row too.
        size.held.drain(..size.held.len() - (height % 2) as usize);
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

/// The texels of a row or column of `count` that texel `index` of the next smaller size is made of, and how much each counts: as much
/// as it covers. An odd number, `2 m - 1`, is cut into `m` equal parts, so that no texel counts more than another in the mean of all,
/// and each size lies where the largest does.
fn taps(count: u32, index: u32) -> impl Iterator<Item = (u32, f32)> + Clone {
    let smaller = count.div_ceil(2);
    let middle = 2 * index;
    // Sides are at most 65,536.
    let share = |parts: u32| parts as f32 / smaller as f32;
    let [before, after] =
        if count.is_multiple_of(2) { [0.0, 1.0] } else { [share(index), share(smaller - 1 - index)] };
    let three = [(middle.wrapping_sub(1), before), (middle, 1.0), (middle + 1, after)];
    three.into_iter().filter(|(_, weight)| *weight > 0.0)
}

/// Rows of `width` texels, as much of each as `weights` says, to one of half the length. Colours count by their alpha, so that what is
/// not seen does not bleed into what is.
fn halve<'r>(
    rows: &'r [Vec<f32>],
    weights: impl Iterator<Item = (u32, f32)> + Clone,
    width: u32,
) -> Vec<f32> {
    let count = width.div_ceil(2);
    let mut out = Vec::with_capacity(4 * count as usize);
    for index in 0..count {
        let of_row = |(row, (_, down)): (&'r Vec<f32>, (u32, f32))| {
            let texels = row.as_chunks::<4>().0;
            taps(width, index).map(move |(column, across)| (&texels[column as usize], across * down))
        };
        let texels: SmallVec<[(&[f32; 4], f32); 9]> =
            rows.iter().zip(weights.clone()).flat_map(of_row).collect();
        let area: f32 = texels.iter().map(|(_, weight)| weight).sum();
        let alpha: f32 = texels.iter().map(|(texel, weight)| texel[3] * weight).sum();
        for channel in 0..3 {
            out.push(if alpha > 0.0 {
                let colors = texels.iter().map(|(texel, weight)| texel[channel] * texel[3] * weight);
                colors.sum::<f32>() / alpha
            } else {
                texels.iter().map(|(texel, weight)| texel[channel] * weight).sum::<f32>() / area
            });
        }
        out.push(alpha / area);
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
