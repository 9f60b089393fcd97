//! The image cut into square tiles, and the orders in which tiles and pixels are visited.
//!
//! Both orders follow space-filling curves: neighbours in time are neighbours on the image, so their rays reach the
//! same blocks. Orders never show in the picture (I2).

use crate::units::Bytes;

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Area {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

/// An image of `width` by `height` pixels in tiles of `tile_size` pixels a side (less at the right and lower border).
#[derive(Clone, Copy, Debug)]
pub(crate) struct TileGrid {
    pub width: u32,
    pub height: u32,
    pub tile_size: u32,
}

impl TileGrid {
    /// How many tiles there are.
    pub fn tile_count(&self) -> usize {
        self.columns() as usize * self.height.div_ceil(self.tile_size) as usize
    }

    fn columns(&self) -> u32 {
        self.width.div_ceil(self.tile_size)
    }

    /// The pixels of the cell numbered row by row.
    pub fn area(&self, cell: u32) -> Area {
        let (x, y) = (cell % self.columns() * self.tile_size, cell / self.columns() * self.tile_size);
        Area { x, y, width: self.tile_size.min(self.width - x), height: self.tile_size.min(self.height - y) }
    }

    /// The number of the cell that a pixel lies in.
    pub fn cell_at(&self, x: u32, y: u32) -> u32 {
        y / self.tile_size * self.columns() + x / self.tile_size
    }

    /// `area` and one pixel around it, as far as the image goes.
    pub fn surroundings(&self, area: &Area) -> Area {
        let (x, y) = (area.x.saturating_sub(1), area.y.saturating_sub(1));
        let right = self.width.min(area.x + area.width + 1);
        let bottom = self.height.min(area.y + area.height + 1);
        Area { x, y, width: right - x, height: bottom - y }
    }

    /// Every cell once, along a Hilbert curve over the enclosing square.
    pub fn hilbert_order(&self) -> Vec<u32> {
        let (columns, rows) = (self.columns(), self.height.div_ceil(self.tile_size));
        let side = columns.max(rows).next_power_of_two();
        let mut cells: Vec<u32> = (0..columns * rows).collect();
        cells.sort_by_cached_key(|cell| hilbert_index(side, cell % columns, cell / columns));
        cells
    }

    /// What [`TileGrid::hilbert_order`] takes while it sorts.
    pub fn order_bytes(&self) -> Bytes {
        // The cells, and a key with an index beside each.
        Bytes(self.tile_count() as u64 * (4 + 16))
    }
}

/// Position of a cell along the Hilbert curve through a square of `side` (a power of two) cells.
pub(crate) fn hilbert_index(side: u32, mut x: u32, mut y: u32) -> u64 {
    let mut index = 0;
    let mut half = side / 2;
    while half > 0 {
        let (right, lower) = (u32::from(x & half != 0), u32::from(y & half != 0));
        index += u64::from(half) * u64::from(half) * u64::from((3 * right) ^ lower);
        // Turn the quadrant so that the curve enters and leaves it where its neighbours expect.
        if lower == 0 {
            if right == 1 {
                x = side - 1 - x;
                y = side - 1 - y;
            }
            std::mem::swap(&mut x, &mut y);
        }
        half /= 2;
    }
    index
}

/// The pixels of a tile of `width` by `height` (each at most 65,535), as offsets from its corner in Morton order.
pub(crate) fn morton_order(width: u32, height: u32, into: &mut Vec<[u16; 2]>) {
    into.clear();
    if width == 0 || height == 0 {
        return;
    }
    into.push([0; 2]);
    let mut side = 1;
    while side < width.max(height) {
        // The square of twice the side is four of this side in a row. What is outside of the tile here is so in all four.
        let count = into.len();
        for [right, down] in [[side, 0], [0, side], [side, side]] {
            for index in 0..count {
                let [x, y] = into[index].map(u32::from);
                let (x, y) = (x + right, y + down);
                if x < width && y < height {
                    into.push([x as u16, y as u16]);
                }
            }
        }
        side *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pixel_belongs_to_one_tile() {
        for (width, height, tile_size) in [(1, 1, 8), (100, 37, 16), (64, 64, 64), (65, 9, 8)] {
            let grid = TileGrid { width, height, tile_size };
            let mut seen = vec![0u8; (width * height) as usize];
            let order = grid.hilbert_order();
            assert_eq!(order.len(), grid.tile_count());
            let mut pixels = Vec::new();
            for cell in order {
                let area = grid.area(cell);
                morton_order(area.width, area.height, &mut pixels);
                for [x, y] in &pixels {
                    seen[((area.y + u32::from(*y)) * width + area.x + u32::from(*x)) as usize] += 1;
                }
            }
            assert!(seen.iter().all(|count| *count == 1), "{width} x {height} / {tile_size}");
        }
    }

    #[test]
    fn pixels_of_a_tile_follow_the_bits_of_their_place() {
        // Even bits of the place in the curve are x, odd ones y.
        let place = |[x, y]: [u16; 2]| {
            (0..16)
                .map(|bit| (u64::from(x >> bit & 1) | u64::from(y >> bit & 1) << 1) << (2 * bit))
                .sum::<u64>()
        };
        for [width, height] in [[1, 1], [32, 32], [5, 32], [31, 2], [1, 300], [7, 0]] {
            let mut pixels = Vec::new();
            morton_order(width, height, &mut pixels);
            assert_eq!(pixels.len(), (width * height) as usize);
            assert!(pixels.iter().all(|[x, y]| u32::from(*x) < width && u32::from(*y) < height));
            assert!(pixels.windows(2).all(|pair| place(pair[0]) < place(pair[1])), "{width} x {height}");
        }
    }

    #[test]
    fn steps_along_the_curve_are_short() {
        let order = TileGrid { width: 64, height: 64, tile_size: 4 }.hilbert_order();
        for pair in order.windows(2) {
            let [a, b] = [pair[0], pair[1]].map(|cell| ((cell % 16) as i32, (cell / 16) as i32));
            assert_eq!((a.0 - b.0).abs() + (a.1 - b.1).abs(), 1);
        }
    }
}
