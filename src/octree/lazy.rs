//! [`LazyOctree`]: what a query needs, set up inside the budget.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use super::build::BuildScratch;
use super::coarse::CoarseTree;
use super::fine::FineLayout;
use super::frame::{Frame, Space};
use super::grown::Reached;
use super::touched::TouchedBlocks;
use super::{LeafLayout, OctreeOptions, Tier, TreeQuality};
use crate::access::AccessRecorder;
use crate::block::{BlockData, BlockLimits, DecodeScratch};
use crate::budget::{MemoryBudget, Reservation};
use crate::cache::{GeometryCache, Policy};
use crate::error::{AccessTraceError, BudgetError, LoadError, TraceError};
use crate::geom::Precision;
use crate::model::{BlockEntry, Model};
use crate::simd::{PackedBoxes, SimdLevel};
use crate::source::BlockSource;
use crate::units::{BlockId, Bytes};

/// An octree over a compiled model, of which only the upper part exists at first: a tree over the blocks' boxes. The
/// part inside a block is built when a ray first reaches it, in a slot of the cache, and is forgotten with the slot.
///
/// Shared by all threads; each makes its own tracer with [`LazyOctree::tracer`].
///
/// Hits do not depend on how the model is cut into blocks, on the cache, on the layout of leaves, on the instructions
/// used (`Tier::Certified`) or on the order of rays (I2).
pub struct LazyOctree {
    pub(crate) source: Arc<dyn BlockSource>,
    pub(crate) model: Arc<Model>,
    pub(crate) cache: Arc<dyn GeometryCache>,
    pub(crate) coarse: CoarseTree,
    pub(crate) space: Space,
    pub(crate) layout: FineLayout,
    pub(crate) level: SimdLevel,
    pub(crate) tier: Tier,
    pub(crate) quality: TreeQuality,
    pub(crate) budget: MemoryBudget,
    pub(crate) touched: TouchedBlocks,
    /// Where tracers write down which blocks they enter, if anywhere.
    pub(crate) accesses: Option<Arc<AccessRecorder>>,
    tracers_max: u32,
    tracer_count: AtomicU32,
    /// Whether no block that was loaded has to make room for another one.
    keeps_all_blocks: bool,
    _directory: Reservation,
}

/// One of the `tracers_max` tracers; given back on drop.
pub(crate) struct TracerPermit<'o>(&'o AtomicU32);

impl Drop for TracerPermit<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl LazyOctree {
    /// Opens an octree with a cache of as many slots as the budget still holds after the directory, the coarse
    /// tree and the scratch of `tracers_max` tracers (never more than blocks, nor than `slots_max`). Reserve what else must fit
    /// in the budget before.
    ///
    /// # Errors
    /// [`TraceError::Budget`] if the budget cannot hold directory and coarse tree, and then one slot and the scratch for each tracer,
    /// [`TraceError::TooFewSlots`] if `slots_max` is less than one for each.
    pub fn open(
        source: Arc<dyn BlockSource>,
        budget: &MemoryBudget,
        options: OctreeOptions,
    ) -> Result<LazyOctree, TraceError> {
        let parts = Parts::new(&source, budget, &options)?;
        let block_count = parts.model.block_id_count();
        let tracers = u64::from(options.tracers_max.max(1));
        let aside = tracers.saturating_mul(tracer_bytes(&*source).0);
        let available = budget.available().0.saturating_sub(aside);
        let slots_max = options.slots_max.unwrap_or(u32::MAX).min(block_count);
        // Fewer slots than tracers can leave a tracer without any.
        let slots_least = options.tracers_max.max(1).min(block_count);
        if slots_max < slots_least {
            return Err(TraceError::TooFewSlots { slot_count: slots_max, needed: slots_least });
        }

        let slots_of = |expanded: bool| {
            let bytes = parts.slot_bytes(expanded);
            slots_that_fit(available, bytes, block_count, options.policy).min(slots_max)
        };
        let expanded = match options.leaf_layout {
            LeafLayout::Expanded => true,
            LeafLayout::Indexed => false,
            LeafLayout::Auto => {
                let quarter = parts.model.expected_block_count().div_ceil(4);
                slots_of(true) >= slots_max.min(quarter).max(slots_least)
            }
        };
        let slot_count = slots_of(expanded);
        if slot_count < slots_least {
            let least = options.policy.bytes_needed(slots_least, parts.slot_bytes(expanded), block_count);
            let needed = least.0.saturating_add(aside);
            return Err(TraceError::Budget(BudgetError {
                purpose: "one cache slot and the scratch of each tracer",
                needed: Bytes(needed),
                available: budget.available(),
                limit: budget.limit(),
            }));
        }
        let slot_bytes = parts.slot_bytes(expanded);
        let follow = options.follow_free_memory.map(|follow| (follow, slots_least));
        let cache = options.policy.cache(slot_count, slot_bytes, block_count, budget, follow)?;
        // A cache that follows the free memory may shrink.
        let keeps_all_blocks = slot_count == block_count && options.follow_free_memory.is_none();
        Ok(parts.finish(source, cache, expanded, keeps_all_blocks, budget, &options))
    }

    /// Opens an octree over a cache that the caller made, for example with a replacement policy of its own. The cache must
    /// be for this model's blocks and used for nothing else; its slots must have at least [`LazyOctree::slot_bytes`].
    /// `slots_max`, `policy` and `follow_free_memory` are not used, and `LeafLayout::Auto` means expanded if the slots are large enough.
    ///
    /// # Errors
    /// [`TraceError::Budget`] if the coarse tree does not fit in the budget, [`TraceError::SlotsTooSmall`], or
    /// [`TraceError::TooFewSlots`] if there are fewer of them than tracers.
    pub fn with_cache(
        source: Arc<dyn BlockSource>,
        cache: Arc<dyn GeometryCache>,
        budget: &MemoryBudget,
        options: OctreeOptions,
    ) -> Result<LazyOctree, TraceError> {
        let parts = Parts::new(&source, budget, &options)?;
        let expanded = match options.leaf_layout {
            LeafLayout::Expanded => true,
            LeafLayout::Indexed => false,
            LeafLayout::Auto => cache.slot_bytes() >= parts.slot_bytes(true),
        };
        let slots_least = options.tracers_max.max(1).min(parts.model.block_id_count());
        let (slot_bytes, needed) = (cache.slot_bytes(), parts.slot_bytes(expanded));
        if slot_bytes < needed {
            return Err(TraceError::SlotsTooSmall { slot_bytes, needed });
        }
        let slot_count = cache.slot_count();
        if slot_count < slots_least {
            return Err(TraceError::TooFewSlots { slot_count, needed: slots_least });
        }
        // The caller's cache may shrink.
        Ok(parts.finish(source, cache, expanded, false, budget, &options))
    }

    /// From now on, tracers write down which blocks each of their queries enters; see [`access`](crate::access). Call
    /// [`AccessRecorder::finish`] when the tracers are dropped.
    ///
    /// A recorded trace does not depend on the cache, except that of a [`RayPool`](crate::trace::RayPool): there a ray is one query
    /// more each time that it goes on, and a block that is loaded for rays that wait is entered by the query before. Hits are as ever;
    /// recording tracers keep no block pinned from query to query, so they are slower, and their own loads are those of such tracers.
    ///
    /// # Errors
    /// As for [`AccessRecorder::new`].
    pub fn record_accesses(
        &mut self,
        writer: Box<dyn Write + Send>,
    ) -> Result<Arc<AccessRecorder>, AccessTraceError> {
        let block_count = self.model.block_id_count();
        let recorder = AccessRecorder::new(writer, block_count, self.cache.slot_bytes())?;
        self.accesses = Some(Arc::clone(&recorder));
        Ok(recorder)
    }

    /// How many blocks a tracer keeps pinned, as a power of two from 1 to 64: a quarter of its share of the slots, so that most
    /// slots stay free to be replaced; if there is a slot for every block for good, as many as there are blocks.
    pub fn pins_per_tracer(&self) -> u32 {
        const PIN_COUNT_MAX: u32 = 64;
        if self.keeps_all_blocks {
            return self.model.block_id_count().clamp(1, PIN_COUNT_MAX).next_power_of_two();
        }
        let share = self.cache.slot_count() / self.tracers_max.max(1).saturating_mul(4);
        1 << share.clamp(1, PIN_COUNT_MAX).ilog2()
    }

    /// Bytes of a slot that holds the tree of any block of `model`. `layout`: `Auto` is taken as `Expanded`.
    pub fn slot_bytes(model: &Model, layout: LeafLayout) -> Bytes {
        FineLayout { expanded: layout != LeafLayout::Indexed, scale: scale_of(model) }.for_model(model)
    }

    /// What the source says about the model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// Where the blocks come from.
    pub fn source(&self) -> &Arc<dyn BlockSource> {
        &self.source
    }

    /// The slots; for their number, size and statistics.
    pub fn cache(&self) -> &dyn GeometryCache {
        &*self.cache
    }

    /// The layout of leaves that was chosen; never `Auto`.
    pub fn leaf_layout(&self) -> LeafLayout {
        if self.layout.expanded { LeafLayout::Expanded } else { LeafLayout::Indexed }
    }

    /// How sure hits are.
    pub fn tier(&self) -> Tier {
        self.tier
    }

    /// The instructions in use.
    pub fn simd_level(&self) -> SimdLevel {
        self.level
    }

    /// What is known of a block: of any in a compiled model, of one whose cell a ray has reached in one that is compiled lazily.
    pub(crate) fn entry(&self, block: BlockId) -> Option<&BlockEntry> {
        self.model.entry(block).or_else(|| self.coarse.grown_entry(block))
    }

    /// What a leaf beyond those of the tree stands for; cuts a cell that no ray has reached before.
    ///
    /// # Panics
    /// If the model is not compiled lazily.
    #[inline(never)]
    pub(crate) fn reach(&self, leaf: u32) -> Result<Reached<'_>, LoadError> {
        self.coarse.grown().reach(leaf, self.coarse.frame, &*self.source)
    }

    /// Whether [`LazyOctree::reach`] would cut a cell for that leaf, which is one beyond those of the tree.
    #[inline(never)]
    pub(crate) fn would_cut(&self, leaf: u32) -> bool {
        self.coarse.grown().would_cut(leaf)
    }

    /// The sub-boxes of a block that a ray has come to; `None` if there is no such block yet.
    #[inline(always)]
    pub(crate) fn sub_boxes(&self, block: BlockId) -> Option<&PackedBoxes> {
        self.coarse.sub_boxes.get(block.0 as usize).or_else(|| self.coarse.grown_sub_boxes(block))
    }

    /// The right to make one more tracer.
    pub(crate) fn permit(&self) -> Result<TracerPermit<'_>, TraceError> {
        let tracers_max = self.tracers_max.max(1);
        let one_more = |count| (count < tracers_max).then_some(count + 1);
        match self.tracer_count.fetch_update(Ordering::Relaxed, Ordering::Relaxed, one_more) {
            Ok(_) => Ok(TracerPermit(&self.tracer_count)),
            Err(count) => Err(TraceError::TooManyTracers { wanted: count.saturating_add(1), tracers_max }),
        }
    }

    /// How many distinct blocks were brought in since the octree was opened: without a warm cache, those that a ray
    /// entered. Does not depend on cache size, load order or threads.
    pub fn blocks_touched(&self) -> u64 {
        self.touched.count()
    }

    /// How many blocks there are; of a model that is compiled lazily, how many there are in the cells that rays have reached.
    pub fn block_count(&self) -> u64 {
        self.model.blocks.len() as u64 + self.coarse.grown_block_count()
    }

    /// How many tracers may live at once.
    pub fn tracers_max(&self) -> u32 {
        self.tracers_max
    }
}

/// What one tracer takes from the budget.
pub(crate) fn tracer_bytes(source: &dyn BlockSource) -> Bytes {
    bytes_with_buffer(source.model(), source.buffer_bytes().0)
}

/// Much the same for a source of which nothing is known but its model.
pub(crate) fn tracer_bytes_about(model: &Model) -> Bytes {
    /// What sources need beyond a block: reads that bypass the page cache begin and end at pages.
    const BEYOND: u64 = 16 << 10;
    bytes_with_buffer(model, u64::from(model.limits.block_bytes_max) + BEYOND)
}

fn bytes_with_buffer(model: &Model, buffer: u64) -> Bytes {
    let limits = model.limits;
    Bytes(
        DecodeScratch::bytes_needed(limits).0
            + BlockData::bytes_needed(limits).0
            + buffer
            + BuildScratch::bytes(limits.triangle_count_max(), limits.vertex_count_max())
            // Stacks, pins, hits that wait and the struct itself.
            + (24 << 10),
    )
}

/// What both ways of opening share.
struct Parts {
    model: Arc<Model>,
    coarse: CoarseTree,
    scale: f64,
    level: SimdLevel,
    directory: Reservation,
}

impl Parts {
    fn new(
        source: &Arc<dyn BlockSource>,
        budget: &MemoryBudget,
        options: &OctreeOptions,
    ) -> Result<Parts, TraceError> {
        let model = Arc::clone(source.model());
        let directory = budget.reserve(
            Bytes(model.resident_bytes().0 + TouchedBlocks::bytes_needed(model.block_id_count() as usize).0),
            "the model's directory and materials",
        )?;
        let level = match options.simd {
            Some(level) => level.min(SimdLevel::best()),
            None => SimdLevel::best(),
        };
        let scale = scale_of(&model);
        let coarse = CoarseTree::build(&model, scale, level, budget)?;
        Ok(Parts { model, coarse, scale, level, directory })
    }

    fn slot_bytes(&self, expanded: bool) -> Bytes {
        FineLayout { expanded, scale: self.scale }.for_model(&self.model)
    }

    fn finish(
        self,
        source: Arc<dyn BlockSource>,
        cache: Arc<dyn GeometryCache>,
        expanded: bool,
        keeps_all_blocks: bool,
        budget: &MemoryBudget,
        options: &OctreeOptions,
    ) -> LazyOctree {
        LazyOctree {
            source,
            touched: TouchedBlocks::new(self.model.block_id_count() as usize),
            accesses: None,
            space: Space::new(self.model.bounds, self.coarse.frame, self.coarse.is_shared),
            model: self.model,
            cache,
            coarse: self.coarse,
            layout: FineLayout { expanded, scale: self.scale },
            level: self.level,
            tier: options.tier,
            quality: options.quality,
            budget: budget.clone(),
            tracers_max: options.tracers_max,
            tracer_count: AtomicU32::new(0),
            keeps_all_blocks,
            _directory: self.directory,
        }
    }
}

impl FineLayout {
    fn for_model(self, model: &Model) -> Bytes {
        // Lattice blocks of great extent and scaled blocks keep exact positions beside the rounded ones.
        let wide = self.scale != 1.0 || model.precision != Precision::Float32;
        let bytes = |triangles, vertices| self.slot_bytes(triangles as usize, vertices as usize, wide);
        let sizes = model.blocks.iter().map(|entry| bytes(entry.triangle_count, entry.vertex_count));
        let largest = sizes.max().unwrap_or(Bytes(0));
        if model.cells.is_empty() { largest } else { largest.max(self.for_any_block(model.limits, wide)) }
    }

    /// For every block that keeps to the limits: the more triangles, the fewer vertices.
    fn for_any_block(self, limits: BlockLimits, wide: bool) -> Bytes {
        let sizes = (1..=limits.triangle_count_max()).map(|triangles| {
            let left = (limits.block_bytes_max as usize)
                .saturating_sub(BlockLimits::decoded_bytes(0, triangles, false));
            let vertices = (left / 12).min(limits.vertex_count_max()).min(3 * triangles);
            self.slot_bytes(triangles, vertices, wide)
        });
        sizes.max().unwrap_or(Bytes(0))
    }
}

/// The scale of the model's trees.
fn scale_of(model: &Model) -> f64 {
    let from_zero = matches!(model.precision, Precision::Float32);
    let reach = (0..3).fold(0.0f64, |reach, axis| {
        let (min, max) = (model.bounds.min[axis], model.bounds.max[axis]);
        reach.max(if from_zero { min.abs().max(max.abs()) } else { max - min })
    });
    Frame::scale_for(reach)
}

/// How many slots of `slot_bytes`, with the table over `block_count` blocks, fit in `available` bytes.
fn slots_that_fit(available: u64, slot_bytes: Bytes, block_count: u32, policy: Policy) -> u32 {
    let fits = |count: u32| policy.bytes_needed(count, slot_bytes, block_count).0 <= available;
    // What is needed grows with the count: search for the last that fits.
    let (mut fitting, mut beyond) = (0u32, block_count.saturating_add(1));
    while beyond - fitting > 1 {
        let middle = fitting + (beyond - fitting) / 2;
        if fits(middle) {
            fitting = middle;
        } else {
            beyond = middle;
        }
    }
    fitting
}

impl std::fmt::Debug for LazyOctree {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("LazyOctree")
            .field("block_count", &self.block_count())
            .field("slot_count", &self.cache.slot_count())
            .field("leaf_layout", &self.leaf_layout())
            .field("tier", &self.tier)
            .field("tracers_max", &self.tracers_max)
            .finish_non_exhaustive()
    }
}
