//! Samples on their way, and the rays of their trees that wait for a sibling's tree to end.

use glam::DVec3;

use super::places::{NONE, Places};
use crate::geom::Ray;
use crate::render::paths::{Head, Waiting};
use crate::render::walk::Walk;
use crate::trace::Hit;

/// A sample on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    /// Where it belongs: the tile, and which of the samples of the tile's round.
    pub tile: u32,
    pub index: u64,
    pub radiance: DVec3,
    pub lost: f64,
    pub lost_by_shadows: f64,
    /// The ray that is traced, what it is in the tree, and what it hit. Its slot means nothing here.
    pub head: Option<Head>,
    pub ray: Ray,
    pub hit: Option<Hit>,
    /// Answers that are still to come.
    pub open: u32,
    /// Its claims to light, the oldest first.
    pub first_claim: u32,
    pub last_claim: u32,
    /// Its rays that wait for a sibling, the youngest on top.
    pub stack: u32,
}

impl Sample {
    fn new(tile: u32, index: u64) -> Sample {
        Sample {
            tile,
            index,
            radiance: DVec3::ZERO,
            lost: 0.0,
            lost_by_shadows: 0.0,
            head: None,
            ray: Ray::new([0.0; 3], [0.0; 3]),
            hit: None,
            open: 0,
            first_claim: NONE,
            last_claim: NONE,
            stack: NONE,
        }
    }
}

/// The samples on their way.
pub(super) struct Samples {
    samples: Places<Sample>,
    /// The state of each path, in loops that sample effects.
    walks: Vec<Option<Walk>>,
}

impl Samples {
    pub fn new(capacity: u32, with_walks: bool) -> Samples {
        Samples { samples: Places::new(capacity), walks: walks(capacity, with_walks) }
    }

    /// What [`Samples::new`] allocates for each.
    pub fn bytes_of_one(with_walks: bool) -> usize {
        Places::<Sample>::BYTES_OF_ONE + bytes_of_walk(with_walks)
    }

    pub fn count(&self) -> u32 {
        self.samples.count()
    }

    pub fn room(&self) -> u32 {
        self.samples.room()
    }

    /// A place for one more. Who calls it has made sure that there is room.
    pub fn begin(&mut self, tile: u32, index: u64) -> u32 {
        self.samples.add(Sample::new(tile, index))
    }

    /// Gives back the place of a sample that is done.
    pub fn end(&mut self, place: u32) {
        self.samples.remove(place);
    }

    pub fn get(&self, place: u32) -> &Sample {
        self.samples.get(place)
    }

    pub fn get_mut(&mut self, place: u32) -> &mut Sample {
        self.samples.get_mut(place)
    }

    pub fn walk(&self, place: u32) -> Option<Walk> {
        self.walks.get(place as usize).copied().flatten()
    }

    pub fn set_walk(&mut self, place: u32, walk: Walk) {
        if let Some(of_sample) = self.walks.get_mut(place as usize) {
            *of_sample = Some(walk);
        }
    }
}

/// A ray that waits for its sibling's tree to end.
struct Entry {
    ray: Waiting,
    /// The one below it in its stack.
    below: u32,
}

/// The stacks of all samples in one store.
pub(super) struct Stacks {
    entries: Places<Entry>,
    walks: Vec<Option<Walk>>,
}

impl Stacks {
    pub fn new(capacity: u32, with_walks: bool) -> Stacks {
        Stacks { entries: Places::new(capacity), walks: walks(capacity, with_walks) }
    }

    /// What [`Stacks::new`] allocates for each entry.
    pub fn bytes_of_one(with_walks: bool) -> usize {
        Places::<Entry>::BYTES_OF_ONE + bytes_of_walk(with_walks)
    }

    pub fn room(&self) -> u32 {
        self.entries.room()
    }

    /// Puts a ray on top of a stack. Who calls it has made sure that there is room.
    pub fn push(&mut self, stack: &mut u32, ray: Waiting, walk: Option<Walk>) {
        *stack = self.entries.add(Entry { ray, below: *stack });
        if let Some(of_ray) = self.walks.get_mut(*stack as usize) {
            *of_ray = walk;
        }
    }

    /// The ray on top.
    pub fn top(&self, stack: u32) -> Option<(Waiting, Option<Walk>)> {
        (stack != NONE).then(|| {
            let walk = self.walks.get(stack as usize).copied().flatten();
            (self.entries.get(stack).ray, walk)
        })
    }

    /// Takes the ray on top away, if there is one.
    pub fn pop(&mut self, stack: &mut u32) {
        if *stack != NONE {
            let below = self.entries.get(*stack).below;
            self.entries.remove(*stack);
            *stack = below;
        }
    }
}

/// Room for the state of a path beside each place, if there are any.
fn walks(capacity: u32, with_walks: bool) -> Vec<Option<Walk>> {
    vec![None; if with_walks { capacity as usize } else { 0 }]
}

fn bytes_of_walk(with_walks: bool) -> usize {
    if with_walks { size_of::<Option<Walk>>() } else { 0 }
}
