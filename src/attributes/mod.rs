//! Attributes of triangle corners while rays are traced: pages in cache slots, found by a triangle's id.
//!
//! A page is read, checked and decoded when a hit on one of its triangles is first shaded with it, and forgotten with its slot. The slots
//! are those of the [`cache`](crate::cache) room and come out of the same memory budget (I1) as the blocks', but are never mixed with
//! them: what is shaded does not push out what is traced.

use std::sync::Arc;

use crate::block::attributes::{CornerAttributes, PageDecodeScratch, corner_attributes, decode_page};
use crate::budget::{MemoryBudget, Reservation};
use crate::cache::{CacheStats, GeometryCache, Lru, Pin, SlotCache};
use crate::error::{BudgetError, LoadError, SourceError};
use crate::model::Model;
use crate::source::BlockSource;
use crate::units::{BlockId, Bytes, TriangleId};

/// The pages of a model's attributes, as far as they are in memory. Shared by all threads; each makes its own
/// [`AttributeReader`].
pub struct AttributeCache {
    source: Arc<dyn BlockSource>,
    cache: SlotCache<Lru>,
    _readers: Reservation,
}

impl AttributeCache {
    /// A cache for at most `readers` readers at a time: slots of as many bytes as `share` has, but at least one slot for each reader,
    /// and no more than there are pages.
    ///
    /// # Errors
    /// [`LoadError::Source`] if the source cannot give the model's attributes, [`LoadError::Budget`] if the budget does not hold
    /// [`AttributeCache::bytes_needed`].
    pub fn open(
        source: Arc<dyn BlockSource>,
        share: Bytes,
        readers: u32,
        budget: &MemoryBudget,
    ) -> Result<AttributeCache, LoadError> {
        let model = Arc::clone(source.model());
        if !source.gives_attributes() && !model.attributes.is_empty() {
            let name = "the source of the model".to_owned();
            return Err(SourceError::NoAttributes { page: 0, name }.into());
        }
        let (slots, slot_bytes, pages) = sizes(&model, share, readers);
        let scratch = Bytes(reader_bytes(&model).saturating_mul(u64::from(readers)));
        let memory = budget.reserve(scratch, "reading the attributes of triangles")?;
        let renamed = |error| BudgetError { purpose: "the cache of attributes", ..error };
        let cache = SlotCache::new(slots, slot_bytes, pages, Lru::new(), budget).map_err(renamed)?;
        Ok(AttributeCache { source, cache, _readers: memory })
    }

    /// What [`AttributeCache::open`] takes from the budget.
    pub fn bytes_needed(model: &Model, share: Bytes, readers: u32) -> Bytes {
        let (slots, slot_bytes, pages) = sizes(model, share, readers);
        let scratch = reader_bytes(model).saturating_mul(u64::from(readers));
        Bytes(SlotCache::<Lru>::bytes_needed(slots, slot_bytes, pages).0.saturating_add(scratch))
    }

    /// What is known about the model.
    pub fn model(&self) -> &Model {
        self.source.model()
    }

    /// What was read and what was found here.
    pub fn stats(&self) -> CacheStats {
        self.cache.stats()
    }

    /// A reader for one thread.
    pub fn reader(&self) -> AttributeReader<'_> {
        AttributeReader {
            cache: self,
            pin: None,
            scratch: PageDecodeScratch::default(),
            stored: Vec::with_capacity(stored_bytes(self.source.model())),
        }
    }
}

/// Slots, their size, and pages.
fn sizes(model: &Model, share: Bytes, readers: u32) -> (u32, Bytes, u32) {
    // A file has at most 2^32 - 1 pages.
    let pages = model.attributes.entries().len() as u32;
    let slot_bytes = model.attributes.page_bytes_max();
    let held = u32::try_from(share.0 / slot_bytes.0.max(1)).unwrap_or(u32::MAX);
    (held.max(readers).max(1).min(pages), slot_bytes, pages)
}

/// What one reader takes from the budget.
fn reader_bytes(model: &Model) -> u64 {
    PageDecodeScratch::BYTES + stored_bytes(model) as u64
}

/// The largest page, and what a source needs beside it when it reads past the page cache.
fn stored_bytes(model: &Model) -> usize {
    const SLACK_BYTES: u64 = 16 << 10;
    Bytes(model.attributes.stored_bytes_max().0 + SLACK_BYTES).as_usize()
}

/// Finds attributes for one thread; keeps the page that it used last.
pub struct AttributeReader<'c> {
    cache: &'c AttributeCache,
    pin: Option<Pin<'c>>,
    scratch: PageDecodeScratch,
    stored: Vec<u8>,
}

impl AttributeReader<'_> {
    /// Whether the corners of `triangle` may have normals, as far as the directory tells; reads nothing.
    pub fn may_have_normals(&self, triangle: TriangleId) -> bool {
        self.cache.model().attributes.may_have_normals(triangle)
    }

    /// The attributes of the corners of `triangle`: none if it has none, or is none of the model's.
    ///
    /// # Errors
    /// [`LoadError`] if its page cannot be read or is damaged.
    pub fn get(&mut self, triangle: TriangleId) -> Result<CornerAttributes, LoadError> {
        let AttributeReader { cache, pin, scratch, stored } = self;
        let model = cache.source.model();
        let Some((page, index)) = model.attributes.place_of(triangle) else {
            return Ok(CornerAttributes::default());
        };
        let block = BlockId(page);
        if let Some(pin) = pin.as_ref().filter(|pin| pin.block() == block) {
            return Ok(corner_attributes(pin, index));
        }
        // The old pin goes first: with one slot for each reader there is none to spare.
        *pin = None;
        let found = cache.cache.pin(block, &mut |slot| {
            cache.source.read_attributes(page, stored)?;
            // `place_of` gives only pages that hold something.
            let check = model.attributes.check(page);
            let check =
                check.ok_or_else(|| SourceError::NoAttributes { page, name: "the model".to_owned() })?;
            Ok(decode_page(stored, &check, scratch, slot)?)
        })?;
        Ok(corner_attributes(pin.insert(found), index))
    }
}

impl std::fmt::Debug for AttributeCache {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AttributeCache").finish_non_exhaustive()
    }
}

impl std::fmt::Debug for AttributeReader<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("AttributeReader").finish_non_exhaustive()
    }
}
