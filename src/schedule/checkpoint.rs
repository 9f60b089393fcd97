//! What a restarted coordinator goes on from, as bytes.

use xxhash_rust::xxh3::xxh3_64;

use super::grid::ImageGrid;
use crate::error::ScheduleError;
use crate::units::TileId;

/// Which cells of an image are done. All numbers are stored with the lowest byte first:
///
/// | bytes | what |
/// |---|---|
/// | 8 | `outsched` |
/// | 4 | version: 1 |
/// | 4 x 4 | width, height, tile side, cell side |
/// | 4 | epoch: how often the coordinator was restarted |
/// | 8 per tile | the set of cells that are done, along the curve |
/// | 8 | XXH3-64 of all before |
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ScheduleCheckpoint {
    pub(super) grid: ImageGrid,
    /// How often the coordinator was restarted.
    pub(super) epoch: u32,
    /// Cells that are done, by tile.
    pub(super) done: Vec<u64>,
}

const SIGNATURE: [u8; 8] = *b"outsched";
const VERSION: u32 = 1;
const HEADER_BYTES: usize = 32;
const CHECKSUM_BYTES: usize = 8;

impl ScheduleCheckpoint {
    /// The image's cells.
    pub fn grid(&self) -> &ImageGrid {
        &self.grid
    }

    /// The cells of a tile that are done.
    pub fn done(&self, tile: TileId) -> u64 {
        self.done.get(tile.0 as usize).copied().unwrap_or(0)
    }

    /// Takes cells out again: those whose pixels a restarted coordinator did not find. They are then rendered once more.
    pub fn forget(&mut self, tile: TileId, cells: u64) {
        if let Some(done) = self.done.get_mut(tile.0 as usize) {
            *done &= !cells;
        }
    }

    /// The checkpoint as bytes.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER_BYTES + self.done.len() * 8 + CHECKSUM_BYTES);
        bytes.extend_from_slice(&SIGNATURE);
        let grid = &self.grid;
        for number in [VERSION, grid.width(), grid.height(), grid.tile_side(), grid.cell_side(), self.epoch] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        for done in &self.done {
            bytes.extend_from_slice(&done.to_le_bytes());
        }
        bytes.extend_from_slice(&xxh3_64(&bytes).to_le_bytes());
        bytes
    }

    /// Reads what [`ScheduleCheckpoint::to_bytes`] wrote. The bytes are not trusted: any damage is an error.
    ///
    /// # Errors
    /// [`ScheduleError::Checkpoint`] with what is wrong and where.
    pub fn from_bytes(bytes: &[u8]) -> Result<ScheduleCheckpoint, ScheduleError> {
        let damaged = |at: usize, reason| Err(ScheduleError::Checkpoint { offset: at as u64, reason });
        if bytes.len() < HEADER_BYTES + CHECKSUM_BYTES {
            return damaged(bytes.len(), "it ends before its header does");
        }
        if bytes[..8] != SIGNATURE {
            return damaged(0, "it is not a scheduler's checkpoint");
        }
        let (body, checksum) = bytes.split_at(bytes.len() - CHECKSUM_BYTES);
        if checksum != xxh3_64(body).to_le_bytes() {
            return damaged(body.len(), "the checksum is wrong");
        }
        let number = |at: usize| {
            let mut four = [0; 4];
            four.copy_from_slice(&body[at..at + 4]);
            u32::from_le_bytes(four)
        };
        if number(8) != VERSION {
            return damaged(8, "its version is not known here");
        }
        let [width, height, tile_side, cell_side] = [12, 16, 20, 24].map(number);
        // The cell masks must be there before anything is allocated for them.
        let tiles =
            u64::from(width.div_ceil(tile_side.max(1))) * u64::from(height.div_ceil(tile_side.max(1)));
        let masks = &body[HEADER_BYTES..];
        if masks.len() as u64 != tiles.saturating_mul(8) {
            return damaged(HEADER_BYTES, "it holds another number of tiles than its image has");
        }
        let grid = match ImageGrid::new(width, height, tile_side, cell_side) {
            Ok(grid) => grid,
            Err(_) => return damaged(12, "its image size or tile size makes no sense"),
        };
        let mut done = Vec::with_capacity(grid.tile_count() as usize);
        for (tile, mask) in masks.chunks_exact(8).enumerate() {
            let mut eight = [0; 8];
            eight.copy_from_slice(mask);
            let cells = u64::from_le_bytes(eight);
            if cells & !grid.cells_of(TileId(tile as u32)) != 0 {
                return damaged(HEADER_BYTES + tile * 8, "a cell is done that the image does not have");
            }
            done.push(cells);
        }
        Ok(ScheduleCheckpoint { grid, epoch: number(28), done })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> ScheduleCheckpoint {
        let grid = ImageGrid::new(200, 130, 64, 8).unwrap();
        let done = (0..grid.tile_count())
            .map(|tile| 0x1234_5678_9abc_def0u64.rotate_left(tile) & grid.cells_of(TileId(tile)))
            .collect();
        ScheduleCheckpoint { grid, epoch: 3, done }
    }

    #[test]
    fn bytes_come_back_and_damage_is_found() {
        let checkpoint = sample();
        let bytes = checkpoint.to_bytes();
        assert_eq!(ScheduleCheckpoint::from_bytes(&bytes), Ok(checkpoint));
        for length in 0..bytes.len() {
            assert!(ScheduleCheckpoint::from_bytes(&bytes[..length]).is_err(), "{length}");
        }
        for bit in 0..bytes.len() * 8 {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(ScheduleCheckpoint::from_bytes(&flipped).is_err(), "{bit}");
        }
        let longer = [&bytes[..], &[0; 8]].concat();
        assert!(ScheduleCheckpoint::from_bytes(&longer).is_err());
    }

    /// Whoever makes a checksum fit still gets nothing past the checks.
    #[test]
    fn sound_checksums_over_nonsense_are_refused() {
        let refused = |change: &dyn Fn(&mut Vec<u8>)| {
            let mut bytes = sample().to_bytes();
            bytes.truncate(bytes.len() - CHECKSUM_BYTES);
            change(&mut bytes);
            let checksum = xxh3_64(&bytes);
            bytes.extend_from_slice(&checksum.to_le_bytes());
            ScheduleCheckpoint::from_bytes(&bytes).unwrap_err()
        };
        refused(&|bytes| bytes[8] = 2);
        refused(&|bytes| bytes[20..24].copy_from_slice(&0u32.to_le_bytes()));
        refused(&|bytes| bytes[24..28].copy_from_slice(&7u32.to_le_bytes()));
        refused(&|bytes| bytes[12..20].copy_from_slice(&[0xff; 8]));
        refused(&|bytes| bytes.truncate(HEADER_BYTES));
        // The last tile is a corner of the image with missing cells, whatever its number: set all cells of all.
        refused(&|bytes| bytes[HEADER_BYTES..].fill(0xff));
    }
}
