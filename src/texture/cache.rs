//! Tiles in slots, and lookups in them.

use std::sync::Arc;

use super::file::Textures;
use super::layout::{Level, TILE_BYTES, TILE_SIDE};
use super::srgb::Table;
use super::{Encoding, TextureId};
use crate::budget::{MemoryBudget, Reservation};
use crate::cache::{CacheStats, GeometryCache, Lru, Pin, SlotCache};
use crate::error::{BudgetError, LoadError};
use crate::units::{BlockId, Bytes};

/// Tiles that a reader keeps pinned.
const PINS: usize = 8;

/// What is beyond the borders of a picture.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Address {
    /// The picture again.
    #[default]
    Repeat,
    /// Its border.
    Clamp,
}

/// The tiles of pictures, as far as they are in memory. Shared by all threads; each makes its own [`TextureReader`].
pub struct TextureCache {
    textures: Arc<Textures>,
    cache: SlotCache<Lru>,
    tables: [Table; 2],
    levels: Vec<Vec<Level>>,
    _memory: Reservation,
}

impl TextureCache {
    /// A cache for at most `readers` readers at a time: as many slots as `share` holds, but at least eight for each reader, and no
    /// more than there are tiles.
    ///
    /// # Errors
    /// [`BudgetError`] if the budget does not hold [`TextureCache::bytes_needed`].
    pub fn open(
        textures: Arc<Textures>,
        share: Bytes,
        readers: u32,
        budget: &MemoryBudget,
    ) -> Result<TextureCache, BudgetError> {
        let memory = budget.reserve(Bytes(own_bytes(&textures)), "the sizes of textures")?;
        let slots = slot_count(&textures, share, readers);
        let renamed = |error| BudgetError { purpose: "the cache of textures", ..error };
        let tiles = textures.tile_count();
        let cache =
            SlotCache::new(slots, Bytes(TILE_BYTES as u64), tiles, Lru::new(), budget).map_err(renamed)?;
        let ids = (0..textures.image_count() as u32).map(TextureId);
        let levels = ids.map(|id| textures.levels(id).collect()).collect();
        let tables = [Encoding::Srgb, Encoding::Linear].map(Table::new);
        Ok(TextureCache { textures, cache, tables, levels, _memory: memory })
    }

    /// What [`TextureCache::open`] takes from the budget.
    pub fn bytes_needed(textures: &Textures, share: Bytes, readers: u32) -> Bytes {
        let slots = slot_count(textures, share, readers);
        let slots = SlotCache::<Lru>::bytes_needed(slots, Bytes(TILE_BYTES as u64), textures.tile_count());
        Bytes(slots.0.saturating_add(own_bytes(textures)))
    }

    /// The pictures.
    pub fn textures(&self) -> &Arc<Textures> {
        &self.textures
    }

    /// What was read and what was found here.
    pub fn stats(&self) -> CacheStats {
        self.cache.stats()
    }

    /// A reader for one thread.
    pub fn reader(&self) -> TextureReader<'_> {
        TextureReader { cache: self, pins: std::array::from_fn(|_| None) }
    }
}

impl std::fmt::Debug for TextureCache {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TextureCache").field("textures", &self.textures).finish_non_exhaustive()
    }
}

fn own_bytes(textures: &Textures) -> u64 {
    let per_image = (17 * size_of::<Level>() + size_of::<Vec<Level>>()) as u64;
    textures.image_count() as u64 * per_image + 2 * size_of::<Table>() as u64
}

fn slot_count(textures: &Textures, share: Bytes, readers: u32) -> u32 {
    let held = u32::try_from(share.0 / TILE_BYTES as u64).unwrap_or(u32::MAX);
    held.max(readers.max(1).saturating_mul(PINS as u32)).min(textures.tile_count())
}

/// Looks up texels for one thread.
pub struct TextureReader<'c> {
    cache: &'c TextureCache,
    /// By the low bits of a tile's number.
    pins: [Option<Pin<'c>>; PINS],
}

impl TextureReader<'_> {
    /// The pictures.
    pub fn textures(&self) -> &Textures {
        &self.cache.textures
    }

    /// Red, green, blue and alpha of a picture at texture coordinates `uv`, where (0, 0) is its lower left corner, linear, from 0 to 1.
    /// `level` 0 is the picture, each next one half as large; in between it is mixed from the two. A pure function of its
    /// arguments (I2).
    ///
    /// # Errors
    /// [`LoadError::Texture`] if a tile cannot be read or is damaged.
    ///
    /// # Panics
    /// If there is no such picture.
    pub fn sample(
        &mut self,
        texture: TextureId,
        uv: [f64; 2],
        level: f64,
        address: Address,
    ) -> Result<[f64; 4], LoadError> {
        let last = self.cache.levels[texture.0 as usize].len() - 1;
        // NaN is level 0.
        let level = if level > 0.0 { level.min(last as f64) } else { 0.0 };
        let floor = level as usize;
        let part = level - floor as f64;
        let near = self.bilinear(texture, uv, floor, address)?;
        if part == 0.0 {
            return Ok(near);
        }
        let far = self.bilinear(texture, uv, (floor + 1).min(last), address)?;
        Ok([0, 1, 2, 3].map(|channel| near[channel] + part * (far[channel] - near[channel])))
    }

    fn bilinear(
        &mut self,
        texture: TextureId,
        [u, v]: [f64; 2],
        level: usize,
        address: Address,
    ) -> Result<[f64; 4], LoadError> {
        let level = self.cache.levels[texture.0 as usize][level];
        let place = |at: f64, size: u32| -> ([u32; 2], f64) {
            let at = match address {
                Address::Repeat => at - at.floor(),
                Address::Clamp => at.clamp(0.0, 1.0),
            };
            // Neither far beyond the picture nor NaN: coordinates are finite.
            let texel = at * f64::from(size) - 0.5;
            let (low, size) = (texel.floor(), i64::from(size));
            let wrap = |texel: i64| match address {
                Address::Repeat => texel.rem_euclid(size) as u32,
                Address::Clamp => texel.clamp(0, size - 1) as u32,
            };
            ([wrap(low as i64), wrap(low as i64 + 1)], texel - low)
        };
        // Rows are counted from the top.
        let ([left, right], x) = place(u, level.width);
        let ([upper, lower], y) = place(1.0 - v, level.height);
        let texels = [
            self.texel(texture, level, left, upper)?,
            self.texel(texture, level, right, upper)?,
            self.texel(texture, level, left, lower)?,
            self.texel(texture, level, right, lower)?,
        ];
        Ok([0, 1, 2, 3].map(|channel| {
            let [a, b, c, d] = texels.map(|texel| f64::from(texel[channel]));
            let (above, below) = (a + x * (b - a), c + x * (d - c));
            above + y * (below - above)
        }))
    }

    fn texel(&mut self, texture: TextureId, level: Level, x: u32, y: u32) -> Result<[f32; 4], LoadError> {
        let tile = level.first_tile + y / TILE_SIDE * level.tiles_across() + x / TILE_SIDE;
        let at = 4 * (y % TILE_SIDE * TILE_SIDE + x % TILE_SIDE) as usize;
        let cache = self.cache;
        let pin = &mut self.pins[tile as usize % PINS];
        if pin.as_ref().is_none_or(|pin| pin.block() != BlockId(tile)) {
            // The old pin goes first: with the least number of slots there is none to spare.
            *pin = None;
            let fill = &mut |slot: &mut [u8]| {
                cache.textures.read_tile(tile, slot).map_err(|error| LoadError::Texture(Box::new(error)))
            };
            *pin = Some(cache.cache.pin(BlockId(tile), fill)?);
        }
        // Filled just now, or before.
        let bytes = pin.as_deref().unwrap_or(&[0; TILE_BYTES]);
        let [r, g, b, a] = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        let encoding = cache.textures.images[texture.0 as usize].key.encoding;
        let table = &cache.tables[usize::from(encoding == Encoding::Linear)];
        let [r, g, b] = [r, g, b].map(|byte| table.decode(byte));
        Ok([r, g, b, f32::from(a) / 255.0])
    }
}

impl std::fmt::Debug for TextureReader<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("TextureReader").finish_non_exhaustive()
    }
}
