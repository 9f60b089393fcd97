//! Bringing blocks in: read, check, decode, build; and the pins that a tracer keeps.

use std::time::{Duration, Instant};

use crate::access::{AccessLog, BlockSketch, QueryKind};
use crate::block::{BlockData, DecodeScratch};
use crate::cache::Pin;
use crate::error::{BlockError, LoadError};
use crate::octree::{BuildScratch, LazyOctree, build};
use crate::source::BlockSource;
use crate::stats::TraceCounters;
use crate::units::BlockId;

/// How the loads of a tracer or a pool went; how many there were and what was read stands in its [`TraceCounters`]. Not exact:
/// it depends on the clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LoadStats {
    /// How long its thread did not trace because of loads: reading, decoding and building blocks itself, and `stall`.
    pub loading: Duration,
    /// Of that, how long the thread waited: for its own reads, for a loader because no other ray could run, for loads of other
    /// threads, for slots.
    pub stall: Duration,
    /// Most loads that were asked of a loader, or had ended and waited for their turn, at one time.
    pub in_flight_peak: u32,
}

impl LoadStats {
    /// Adds what another thread did; the peak is that of either.
    pub(crate) fn merge(&mut self, other: &LoadStats) {
        self.loading += other.loading;
        self.stall += other.stall;
        self.in_flight_peak = self.in_flight_peak.max(other.in_flight_peak);
    }
}

/// Memory for loading one block, allocated once.
pub(super) struct LoadScratch {
    stored: Vec<u8>,
    /// The block whose bytes are in `stored` before it is filled.
    ahead: Option<BlockId>,
    decode: DecodeScratch,
    data: BlockData,
    build: BuildScratch,
    /// Blocks that were filled since the list was last emptied; what finds no room is left out.
    filled: Vec<BlockId>,
    stats: LoadStats,
}

/// How many blocks the list of those filled holds.
const FILLED_MAX: usize = 64;

impl LoadScratch {
    pub fn new(source: &dyn BlockSource) -> LoadScratch {
        let limits = source.model().limits;
        LoadScratch {
            stored: Vec::with_capacity(source.buffer_bytes().as_usize()),
            ahead: None,
            decode: DecodeScratch::with_limits(limits),
            data: BlockData::with_limits(limits),
            build: BuildScratch::new(limits.triangle_count_max(), limits.vertex_count_max()),
            filled: Vec::with_capacity(FILLED_MAX),
            stats: LoadStats::default(),
        }
    }

    /// Blocks that were filled since the last call, as far as they were noted.
    pub fn take_filled(&mut self) -> impl Iterator<Item = BlockId> + '_ {
        self.filled.drain(..)
    }

    /// How the loads of this thread went so far.
    pub fn stats(&self) -> LoadStats {
        self.stats
    }

    /// Takes the bytes of a block that were read ahead, until [`LoadScratch::forget_ahead`], and gives a buffer for them.
    pub fn take_ahead(&mut self, block: BlockId, bytes: Vec<u8>) -> Vec<u8> {
        self.ahead = Some(block);
        std::mem::replace(&mut self.stored, bytes)
    }

    /// The next block is read, whichever it is.
    pub fn forget_ahead(&mut self) {
        self.ahead = None;
    }

    /// Fills a slot with the tree of `block`.
    fn fill(
        &mut self,
        octree: &LazyOctree,
        block: BlockId,
        slot: &mut [u8],
        counters: &mut TraceCounters,
    ) -> Result<(), LoadError> {
        if self.ahead.take() != Some(block) {
            let start = Instant::now();
            let read = read(octree, block, &mut self.stored, counters);
            self.stats.stall += start.elapsed();
            read?;
        }
        let entry = octree.entry(block);
        let entry = entry.ok_or(BlockError { block, offset: 0, reason: "the model has no such block" })?;
        octree.model.decode_entry(block, entry, &self.stored, &mut self.decode, &mut self.data)?;
        build(octree.level, entry, &self.data, (octree.layout, octree.quality), slot, &mut self.build);
        octree.touched.insert(block);
        if self.filled.len() < FILLED_MAX {
            self.filled.push(block);
        }
        counters.blocks_loaded += 1;
        counters.triangles_decoded += self.data.triangles.len() as u64;
        Ok(())
    }
}

/// Reads the bytes of a block.
pub(super) fn read(
    octree: &LazyOctree,
    block: BlockId,
    into: &mut Vec<u8>,
    counters: &mut TraceCounters,
) -> Result<(), LoadError> {
    octree.source.read_block(block, into)?;
    counters.bytes_read += into.len() as u64;
    Ok(())
}

/// Pinned blocks, found by the low bits of their number: entering a block again costs no atomic operation.
pub(super) struct Pins<'o> {
    places: Vec<Option<Pin<'o>>>,
    mask: u32,
    /// Where accesses are written down, if anywhere.
    log: Option<Box<AccessLog>>,
    /// Blocks that were pinned since this was taken last.
    touched: BlockSketch,
    sketch_scale: u64,
    /// Whether missing blocks are loaded, by this thread, which waits for them.
    pub loads: bool,
}

impl<'o> Pins<'o> {
    pub fn new(octree: &LazyOctree) -> Pins<'o> {
        let log = octree.accesses.as_ref().map(|recorder| Box::new(recorder.log()));
        // What a recording tracer has pinned would not be written down.
        let count = if log.is_some() { 1 } else { octree.pins_per_tracer() };
        let places = (0..count).map(|_| None).collect();
        let sketch_scale = BlockSketch::scale(octree.model().block_id_count());
        let touched = BlockSketch::default();
        Pins { places, mask: count - 1, log, touched, sketch_scale, loads: true }
    }

    /// Whether accesses are written down.
    pub fn writes_down(&self) -> bool {
        self.log.is_some()
    }

    /// To be called before each query: the log, if there is one, tells queries apart.
    #[inline(always)]
    pub fn begin_query(&mut self, kind: QueryKind) {
        if self.log.is_some() {
            self.begin_logged(kind);
        }
    }

    #[cold]
    fn begin_logged(&mut self, kind: QueryKind) {
        self.clear();
        if let Some(log) = &mut self.log {
            log.begin(kind);
        }
    }

    pub fn clear(&mut self) {
        self.places.fill_with(|| None);
    }

    /// Blocks that were entered since this was called last. Those that are pinned now may be entered again unseen, so they are in the next
    /// sketch too.
    pub fn take_touched(&mut self) -> BlockSketch {
        let mut still = BlockSketch::default();
        for pin in self.places.iter().flatten() {
            still.add_scaled(pin.block(), self.sketch_scale);
        }
        std::mem::replace(&mut self.touched, still)
    }

    /// The slot of `block`. If it is not resident: loaded, or `None` if the pins are not to load.
    #[inline(always)]
    pub fn get(
        &mut self,
        octree: &'o LazyOctree,
        block: BlockId,
        scratch: &mut LoadScratch,
        counters: &mut TraceCounters,
    ) -> Result<Option<&[u8]>, LoadError> {
        let place = &mut self.places[(block.0 & self.mask) as usize];
        if place.as_ref().is_none_or(|pin| pin.block() != block) {
            // The old pin goes first: with one slot for each tracer there is none to spare, for this one or for another.
            *place = None;
            if !self.loads {
                match octree.cache.try_pin(block) {
                    Some(pin) => *place = Some(pin),
                    None => return Ok(None),
                }
            } else {
                *place = Some(pin(octree, block, scratch, counters)?);
            }
            self.touched.add_scaled(block, self.sketch_scale);
            if let Some(log) = &mut self.log {
                log.enter(block);
            }
        }
        Ok(place.as_deref())
    }
}

/// Pins a block, which is loaded if it is not resident.
#[inline(never)]
pub(super) fn pin<'o>(
    octree: &'o LazyOctree,
    block: BlockId,
    scratch: &mut LoadScratch,
    counters: &mut TraceCounters,
) -> Result<Pin<'o>, LoadError> {
    // Most blocks that are entered are there: no clock for them.
    if let Some(pin) = octree.cache.try_pin(block) {
        return Ok(pin);
    }
    let start = Instant::now();
    let mut filling = Duration::ZERO;
    let pinned = octree.cache.pin(block, &mut |slot| {
        let start = Instant::now();
        let filled = scratch.fill(octree, block, slot, counters);
        filling += start.elapsed();
        filled
    });
    let whole = start.elapsed();
    scratch.stats.loading += whole;
    scratch.stats.stall += whole.saturating_sub(filling);
    pinned
}
