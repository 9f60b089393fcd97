//! Bringing blocks in: read, check, decode, build; and the pins that a tracer keeps.

use crate::block::{BlockData, DecodeScratch};
use crate::cache::Pin;
use crate::error::LoadError;
use crate::octree::{BuildScratch, LazyOctree, build};
use crate::source::BlockSource;
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// Most pins that a tracer keeps.
const PIN_COUNT_MAX: u32 = 64;

/// Memory for loading one block, allocated once.
pub(super) struct LoadScratch {
    stored: Vec<u8>,
    decode: DecodeScratch,
    data: BlockData,
    build: BuildScratch,
}

impl LoadScratch {
    pub fn new(source: &dyn BlockSource) -> LoadScratch {
        let limits = source.model().limits;
        LoadScratch {
            stored: Vec::with_capacity(source.buffer_bytes().as_usize()),
            decode: DecodeScratch::with_limits(limits),
            data: BlockData::with_limits(limits),
            build: BuildScratch::new(limits.triangle_count_max(), limits.vertex_count_max()),
        }
    }

    /// Fills a slot with the tree of `block`.
    fn fill(
        &mut self,
        octree: &LazyOctree,
        block: BlockId,
        slot: &mut [u8],
        counters: &mut TraceCounters,
    ) -> Result<(), LoadError> {
        octree.source.read_block(block, &mut self.stored)?;
        octree.model.decode_block(block, &self.stored, &mut self.decode, &mut self.data)?;
        let entry = &octree.model.blocks[block.0 as usize];
        build(octree.level, entry, &self.data, octree.layout, slot, &mut self.build);
        octree.touched.insert(block);
        counters.blocks_loaded += 1;
        counters.bytes_read += self.stored.len() as u64;
        counters.triangles_decoded += self.data.triangles.len() as u64;
        Ok(())
    }
}

/// Pinned blocks, found by the low bits of their number: entering a block again costs no atomic operation.
pub(super) struct Pins<'o> {
    places: Vec<Option<Pin<'o>>>,
    mask: u32,
}

impl<'o> Pins<'o> {
    /// With a quarter of the tracer's share of the slots, so that most slots stay free to be replaced; at least one.
    pub fn new(octree: &LazyOctree) -> Pins<'o> {
        let share = octree.cache.slot_count() / (4 * octree.tracers_max().max(1));
        let count = 1 << share.clamp(1, PIN_COUNT_MAX).ilog2();
        Pins { places: (0..count).map(|_| None).collect(), mask: count - 1 }
    }

    pub fn clear(&mut self) {
        self.places.fill_with(|| None);
    }

    /// The slot of `block`, loaded if it is not resident.
    #[inline(always)]
    pub fn get(
        &mut self,
        octree: &'o LazyOctree,
        block: BlockId,
        scratch: &mut LoadScratch,
        counters: &mut TraceCounters,
    ) -> Result<&[u8], LoadError> {
        let place = &mut self.places[(block.0 & self.mask) as usize];
        if place.as_ref().is_none_or(|pin| pin.block() != block) {
            // The old pin goes first: with one slot for each tracer there is none to spare.
            *place = None;
            *place = Some(pin(octree, block, scratch, counters)?);
        }
        match place {
            Some(pin) => Ok(pin),
            None => unreachable!("set above"),
        }
    }
}

#[inline(never)]
fn pin<'o>(
    octree: &'o LazyOctree,
    block: BlockId,
    scratch: &mut LoadScratch,
    counters: &mut TraceCounters,
) -> Result<Pin<'o>, LoadError> {
    octree.cache.pin(block, &mut |slot| scratch.fill(octree, block, slot, counters))
}
