//! Samples on their way, and the rays of their trees that wait for a sibling's tree to end.

use glam::DVec3;

use crate::geom::Ray;
use crate::render::bounce::Walk;
use crate::render::paths::{Head, Waiting};
use crate::trace::Hit;

/// Nothing more in a list.
pub(super) const NONE: u32 = u32::MAX;

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
    /// Its rays that wait for a sibling, the youngest on top; for a free place, the next one.
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

/// Places for samples.
pub(super) struct Samples {
    samples: Vec<Sample>,
    /// The state of each path, in loops that sample effects.
    walks: Vec<Option<Walk>>,
    capacity: u32,
    free_list: u32,
    count: u32,
}

impl Samples {
    pub fn new(capacity: u32, with_walks: bool) -> Samples {
        Samples {
            samples: Vec::with_capacity(capacity as usize),
            walks: vec![None; if with_walks { capacity as usize } else { 0 }],
            capacity,
            free_list: NONE,
            count: 0,
        }
    }

    /// What [`Samples::new`] allocates for each.
    pub fn bytes_of_one(with_walks: bool) -> usize {
        size_of::<Sample>() + if with_walks { size_of::<Option<Walk>>() } else { 0 }
    }

    pub fn count(&self) -> u32 {
        self.count
    }

    pub fn room(&self) -> u32 {
        self.capacity - self.count
    }

    /// A place for one more, if there is any.
    pub fn begin(&mut self, tile: u32, index: u64) -> Option<u32> {
        let sample = Sample::new(tile, index);
        let place = match self.free_list {
            NONE if self.samples.len() < self.capacity as usize => {
                self.samples.push(sample);
                self.samples.len() as u32 - 1
            }
            NONE => return None,
            place => {
                self.free_list = self.samples[place as usize].stack;
                self.samples[place as usize] = sample;
                place
            }
        };
        self.count += 1;
        Some(place)
    }

    /// Gives back the place of a sample that is done.
    pub fn end(&mut self, place: u32) {
        self.samples[place as usize].stack = self.free_list;
        self.free_list = place;
        self.count -= 1;
    }

    pub fn get(&self, place: u32) -> &Sample {
        &self.samples[place as usize]
    }

    pub fn get_mut(&mut self, place: u32) -> &mut Sample {
        &mut self.samples[place as usize]
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
    /// The one below it in its stack, or the next free one.
    below: u32,
}

/// The stacks of all samples in one store.
pub(super) struct Stacks {
    entries: Vec<Entry>,
    walks: Vec<Option<Walk>>,
    capacity: u32,
    free_list: u32,
    count: u32,
}

impl Stacks {
    pub fn new(capacity: u32, with_walks: bool) -> Stacks {
        Stacks {
            entries: Vec::with_capacity(capacity as usize),
            walks: vec![None; if with_walks { capacity as usize } else { 0 }],
            capacity,
            free_list: NONE,
            count: 0,
        }
    }

    /// What [`Stacks::new`] allocates for each entry.
    pub fn bytes_of_one(with_walks: bool) -> usize {
        size_of::<Entry>() + if with_walks { size_of::<Option<Walk>>() } else { 0 }
    }

    pub fn room(&self) -> u32 {
        self.capacity - self.count
    }

    /// Puts a ray on top of a stack. Who calls it has made sure that there is room.
    pub fn push(&mut self, stack: &mut u32, ray: Waiting, walk: Option<Walk>) {
        let entry = Entry { ray, below: *stack };
        let place = match self.free_list {
            NONE => {
                debug_assert!(self.entries.len() < self.capacity as usize);
                self.entries.push(entry);
                self.entries.len() as u32 - 1
            }
            place => {
                self.free_list = self.entries[place as usize].below;
                self.entries[place as usize] = entry;
                place
            }
        };
        if let Some(of_ray) = self.walks.get_mut(place as usize) {
            *of_ray = walk;
        }
        self.count += 1;
        *stack = place;
    }

    /// The ray on top.
    pub fn top(&self, stack: u32) -> Option<(Waiting, Option<Walk>)> {
        let entry = self.entries.get(stack as usize)?;
        Some((entry.ray, self.walks.get(stack as usize).copied().flatten()))
    }

    /// Takes the ray on top away.
    pub fn pop(&mut self, stack: &mut u32) {
        if let Some(entry) = self.entries.get_mut(*stack as usize) {
            let below = std::mem::replace(&mut entry.below, self.free_list);
            self.free_list = std::mem::replace(stack, below);
            self.count -= 1;
        }
    }
}
