//! The model of machines and network, and what a worker's cache holds.

use std::collections::{HashMap, HashSet};

use super::cost_image::{BlockSize, CostImage};
use crate::cache::{Lru, ReplacementPolicy};
use crate::units::{BlockId, TileId};

/// What a cluster's machines and network can do. Every machine has the model on its own disk (duplication).
#[derive(Clone, Debug, PartialEq)]
pub struct ClusterModel {
    /// Speeds of the workers relative to the machine that the costs stand for, in turns; all 1 if empty.
    pub speeds: Vec<f64>,
    /// From one machine to another, for any message.
    pub latency_seconds: f64,
    /// What a worker's connection carries.
    pub worker_bytes_per_second: f64,
    /// What the coordinator's connection carries in each direction, all workers together.
    pub coordinator_bytes_per_second: f64,
    /// The time of a coordinator, or of a relay, for each message that it gets or sends.
    pub message_seconds: f64,
    /// The coordinator's time for each request, result and notice, however they come.
    pub decision_seconds: f64,
    /// A second level: relays between the coordinator and the workers, which gather what their workers say into one message, and
    /// hand out what comes back in one.
    pub relays: Option<Relays>,
    /// Bytes of a message beside its pixels.
    pub message_bytes: u32,
    /// Bytes of a pixel on its way.
    pub pixel_bytes: u32,
    /// A worker's disk: the time to a block's first byte ...
    pub disk_seconds: f64,
    /// ... and what it carries.
    pub disk_bytes_per_second: f64,
    /// The time to decode and build a block, for each triangle, at speed 1.
    pub triangle_seconds: f64,
    /// Blocks that a worker's cache holds; none for as many as there are. Caches are empty at the start.
    pub slots: Option<u32>,
    /// Whether a worker asks for the next cells when it begins with its last ones, rather than when it is through.
    pub ask_ahead: bool,
    /// Workers that vanish: when, and which.
    pub losses: Vec<(f64, u32)>,
    /// So long after a worker vanished, the coordinator gives it up.
    pub loss_noticed_seconds: f64,
}

/// The second level of a cluster.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relays {
    /// How many there are; workers belong to them in turns of equal length.
    pub count: u32,
    /// How long a relay gathers, from the first thing that it hears.
    pub gather_seconds: f64,
}

impl Default for ClusterModel {
    /// Machines of one kind with SSDs on a 1 Gbit/s network, the coordinator at 10 Gbit/s.
    fn default() -> ClusterModel {
        ClusterModel {
            speeds: Vec::new(),
            latency_seconds: 100e-6,
            worker_bytes_per_second: 125e6,
            coordinator_bytes_per_second: 1.25e9,
            message_seconds: 20e-6,
            decision_seconds: 5e-6,
            relays: None,
            message_bytes: 100,
            pixel_bytes: 12,
            disk_seconds: 100e-6,
            disk_bytes_per_second: 500e6,
            triangle_seconds: 75e-9,
            slots: None,
            ask_ahead: true,
            losses: Vec::new(),
            loss_noticed_seconds: 1.0,
        }
    }
}

impl ClusterModel {
    /// Relative speed of a worker.
    pub fn speed(&self, worker: u32) -> f64 {
        match self.speeds.len() {
            0 => 1.0,
            count => self.speeds[worker as usize % count].max(f64::MIN_POSITIVE),
        }
    }

    /// Time of a worker at `speed` to bring in a block.
    fn load_seconds(&self, block: BlockSize, speed: f64) -> f64 {
        self.disk_seconds
            + f64::from(block.stored_bytes) / self.disk_bytes_per_second
            + f64::from(block.triangles) * self.triangle_seconds / speed
    }
}

/// What one worker spends on cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct CellTime {
    pub render_seconds: f64,
    pub load_seconds: f64,
    pub loads: u64,
}

/// A machine that renders: its speed and its cache.
pub(super) struct Machine {
    speed: f64,
    cache: BlockCache,
}

impl Machine {
    pub fn new(model: &ClusterModel, costs: &CostImage, worker: u32) -> Machine {
        let all = costs.blocks().len() as u32;
        let slots = model.slots.filter(|slots| *slots < all);
        Machine {
            speed: model.speed(worker),
            cache: slots.map_or(BlockCache::Unbounded(HashSet::new()), BlockCache::bounded),
        }
    }

    /// Renders a cell.
    pub fn render(&mut self, model: &ClusterModel, costs: &CostImage, tile: TileId, cell: u32) -> CellTime {
        let mut time =
            CellTime { render_seconds: costs.seconds(tile, cell) / self.speed, ..CellTime::default() };
        for block in costs.accesses(tile, cell) {
            if self.cache.is_loaded_by(*block) {
                time.loads += 1;
                time.load_seconds += model.load_seconds(costs.blocks()[*block as usize], self.speed);
            }
        }
        time
    }
}

enum BlockCache {
    Unbounded(HashSet<u32>),
    Bounded { slot_of: HashMap<u32, u32>, blocks: Vec<u32>, slots: u32, policy: Box<Lru> },
}

impl BlockCache {
    fn bounded(slots: u32) -> BlockCache {
        let slots = slots.max(1);
        let mut policy = Box::new(Lru::new());
        policy.start(slots);
        BlockCache::Bounded { slot_of: HashMap::new(), blocks: Vec::new(), slots, policy }
    }

    /// Whether an access to the block has to load it; it is in then.
    fn is_loaded_by(&mut self, block: u32) -> bool {
        let (slot_of, blocks, slots, policy) = match self {
            BlockCache::Unbounded(blocks) => return blocks.insert(block),
            BlockCache::Bounded { slot_of, blocks, slots, policy } => (slot_of, blocks, slots, policy),
        };
        if let Some(slot) = slot_of.get(&block) {
            policy.hit(*slot);
            return false;
        }
        let mut slot = blocks.len() as u32;
        if slot < *slots {
            blocks.push(block);
        } else {
            policy.victim(&mut |victim| {
                slot = victim;
                true
            });
            slot_of.remove(&std::mem::replace(&mut blocks[slot as usize], block));
        }
        slot_of.insert(block, slot);
        policy.admit(slot, BlockId(block));
        true
    }
}

/// What one machine alone takes for the image, along the curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SequentialRun {
    /// From start to end, loads included.
    pub seconds: f64,
    /// Blocks that it loads.
    pub loads: u64,
    /// Distinct blocks that it enters.
    pub blocks_touched: u64,
}

/// The image on one machine of speed 1 with the model's disk and cache, without any network.
pub fn sequential(model: &ClusterModel, costs: &CostImage) -> SequentialRun {
    let alone = ClusterModel { speeds: Vec::new(), ..model.clone() };
    let mut machine = Machine::new(&alone, costs, 0);
    let mut run = SequentialRun { seconds: 0.0, loads: 0, blocks_touched: 0 };
    let mut touched = vec![false; costs.blocks().len()];
    for tile in (0..costs.grid().tile_count()).map(TileId) {
        for cell in 0..costs.grid().cells_per_tile() {
            let time = machine.render(&alone, costs, tile, cell);
            run.seconds += time.render_seconds + time.load_seconds;
            run.loads += time.loads;
            costs.accesses(tile, cell).iter().for_each(|block| touched[*block as usize] = true);
        }
    }
    run.blocks_touched = touched.iter().filter(|touched| **touched).count() as u64;
    run
}
