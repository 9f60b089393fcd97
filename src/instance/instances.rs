//! Models, where they stand, and the tree over them.

use std::borrow::Cow;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::placed::Placed;
use super::tree::Tree;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::InstanceError;
use crate::geom::{Aabb, Affine, Motion};
use crate::model::{BlockEntry, MaterialRecord, Model};
use crate::octree::{LazyOctree, OctreeOptions, tracer_bytes};
use crate::source::BlockSource;
use crate::units::{Bytes, TriangleId};

/// A model in one place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Instance {
    /// Number of the model, in the order in which models were given.
    pub model: u32,
    /// From the model to the world. If it mirrors, triangles are turned around, so that what is outside of the model is outside
    /// of the instance.
    pub map: Affine,
}

/// A triangle of an instance, as hits number it: the instance in the upper 24 bits, the triangle's own number in the lower 40.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct InstanceTriangle {
    /// Number of the instance.
    pub instance: u32,
    /// The triangle's number in the model.
    pub triangle: TriangleId,
}

impl InstanceTriangle {
    const TRIANGLE_BITS: u32 = 40;

    /// What the triangle of a hit is.
    pub fn of(number: TriangleId) -> InstanceTriangle {
        InstanceTriangle {
            // 24 bits.
            instance: (number.0 >> Self::TRIANGLE_BITS) as u32,
            triangle: TriangleId(number.0 & ((1 << Self::TRIANGLE_BITS) - 1)),
        }
    }

    /// Its number in a hit; `None` if it has too large a number in its model.
    #[inline(always)]
    pub(super) fn number(self) -> Option<TriangleId> {
        let is_small = self.triangle.0 >> Self::TRIANGLE_BITS == 0;
        is_small.then_some(TriangleId(u64::from(self.instance) << Self::TRIANGLE_BITS | self.triangle.0))
    }
}

/// Instances of models. Shared by all threads; each makes its own [`InstanceTracer`](super::InstanceTracer).
///
/// The models of a scene share one memory budget, each with a cache of its own. Materials are numbered through: those of the first
/// model, then those of the second, and so on.
pub struct Instances {
    octrees: Vec<LazyOctree>,
    /// Per model: the number of its first material.
    first_materials: Vec<u16>,
    materials: Vec<MaterialRecord>,
    instances: Vec<Instance>,
    pub(super) placed: Vec<Placed>,
    /// For each instance, its way until the shutter closes, if any moves.
    motions: Vec<Option<Motion>>,
    pub(super) tree: Tree,
    memory: Reservation,
    _materials: Reservation,
}

impl Instances {
    /// Most instances.
    pub const COUNT_MAX: usize = 1 << 24;

    /// Opens models and places instances of them. What the budget has left goes to the models' caches in proportion to their
    /// blocks; `options` holds for each model (hits are always those of [`Tier::Certified`](crate::octree::Tier::Certified)).
    ///
    /// # Errors
    /// [`InstanceError::Model`] if a model does not fit in its share of the budget; otherwise as for [`Instances::over`].
    pub fn open(
        sources: &[Arc<dyn BlockSource>],
        instances: Vec<Instance>,
        budget: &MemoryBudget,
        options: &OctreeOptions,
    ) -> Result<Instances, InstanceError> {
        // For what is known of the instances, beside the octrees.
        let materials: u64 = sources.iter().map(|source| material_bytes(source.model())).sum();
        let own = budget.reserve(Bytes(bytes_needed(instances.len()) + materials), "instances")?;
        let mut octrees = Vec::with_capacity(sources.len());
        let mut of_tracers = Vec::with_capacity(sources.len());
        for (model, source) in sources.iter().enumerate() {
            let failed = |error| InstanceError::Model { model, error };
            let rest = &sources[model + 1..];
            let least = rest.iter().map(|source| least_bytes(source, options)).sum::<u64>();
            let spare = budget.available().0.saturating_sub(least + least_bytes(source, options));
            let own_blocks = u128::from(blocks(source));
            let all_blocks = own_blocks + rest.iter().map(|source| u128::from(blocks(source))).sum::<u128>();
            // The part of what is spare that those to come get.
            let of_rest = u128::from(spare) * (all_blocks - own_blocks) / all_blocks.max(1);
            let aside = Bytes(least.saturating_add(of_rest as u64).min(budget.available().0));
            let set_aside = budget.reserve(aside, "the other models of the scene")?;
            octrees.push(LazyOctree::open(Arc::clone(source), budget, *options).map_err(failed)?);
            drop(set_aside);
            // What this one left for its tracers is not for the caches of the others.
            let bytes = scratch_bytes(source, options).min(budget.available().0);
            of_tracers.push(budget.reserve(Bytes(bytes), "the tracers of a scene")?);
        }
        drop((own, of_tracers));
        Instances::over(octrees, instances, budget)
    }

    /// Places instances of open models.
    ///
    /// # Errors
    /// [`InstanceError::Instance`] if an instance names no model, or its map is not finite, flat or too large;
    /// [`InstanceError::TooMany`] for more instances or materials than can be numbered; [`InstanceError::Budget`] if what is known
    /// of them does not fit.
    pub fn over(
        octrees: Vec<LazyOctree>,
        instances: Vec<Instance>,
        budget: &MemoryBudget,
    ) -> Result<Instances, InstanceError> {
        let models = octrees.iter().map(LazyOctree::model);
        let bytes: u64 = models.clone().map(material_bytes).sum();
        let reserved = budget.reserve(Bytes(bytes), "the materials of all models")?;
        let mut materials = Vec::new();
        let mut first_materials = Vec::new();
        for model in models {
            // What does not fit is refused below.
            first_materials.push(materials.len() as u16);
            materials.extend(model.materials.iter().cloned());
        }
        let most = u64::from(u16::MAX) + 1;
        if materials.len() as u64 > most {
            let count = materials.len() as u64;
            return Err(InstanceError::TooMany { what: "materials of all models", count, most });
        }
        let mut placed = Instances {
            octrees,
            first_materials,
            materials,
            instances: Vec::new(),
            placed: Vec::new(),
            motions: Vec::new(),
            tree: Tree::default(),
            memory: budget.reserve(Bytes(0), "instances")?,
            _materials: reserved,
        };
        placed.place(instances)?;
        Ok(placed)
    }

    /// What [`Instances::bounds`] will be: for a camera that is wanted before models are opened.
    ///
    /// # Errors
    /// [`InstanceError::Instance`], as for [`Instances::over`].
    pub fn bounds_of(models: &[&Model], instances: &[Instance]) -> Result<Aabb, InstanceError> {
        let mut bounds = Aabb::EMPTY;
        for placed in ready(instances, |model| models.get(model).map(|model| model.bounds)) {
            bounds.merge(&placed?.bounds);
        }
        Ok(bounds)
    }

    /// Places other instances of the same models: for the next frame of a moving scene. Every block that is in memory stays there.
    ///
    /// # Errors
    /// As for [`Instances::over`]; the instances are then what they were. As many as there were before need no more memory than is
    /// reserved for them.
    pub fn place(&mut self, instances: Vec<Instance>) -> Result<(), InstanceError> {
        if instances.len() > Self::COUNT_MAX {
            let (count, most) = (instances.len() as u64, Self::COUNT_MAX as u64);
            return Err(InstanceError::TooMany { what: "instances", count, most });
        }
        let bounds_of = |model: usize| self.octrees.get(model).map(|octree| octree.model().bounds);
        // All are looked at before any is kept: so those there were need not be in memory beside them, and the caches may have all else.
        ready(&instances, bounds_of).try_for_each(|placed| placed.map(drop))?;
        let needed = Bytes(bytes_needed(instances.len()));
        self.memory.grow(needed, "instances")?;
        (self.tree, self.motions, self.placed) = (Tree::default(), Vec::new(), Vec::new());
        let mut placed = Vec::with_capacity(instances.len());
        for one in ready(&instances, bounds_of) {
            placed.push(one?);
        }
        let boxes: Vec<Aabb> = placed.iter().map(|placed| placed.bounds).collect();
        (self.tree, self.instances, self.placed) = (Tree::new(&boxes), instances, placed);
        self.memory.shrink(needed);
        Ok(())
    }

    /// Lets instances move while the shutter is open, from where they were placed to the map that stands beside the instance's
    /// number, as [`Affine::between`] says: bodies that only move and turn keep their shape; where the shape changes, every vertex
    /// moves on a straight line. Those not named rest; so do all after the next [`Instances::place`].
    ///
    /// # Errors
    /// [`InstanceError::Instance`] if there is no such instance, or it would turn too far (170 degrees; about 100 where its shape
    /// changes too) or become flat on its way. All then move as they did before.
    pub fn move_while_open(&mut self, ends: &[(usize, Affine)]) -> Result<(), InstanceError> {
        let mut boxes: Vec<Aabb> = self.placed.iter().map(|placed| placed.bounds).collect();
        for (number, end) in ends {
            let refused = |reason| InstanceError::Instance { instance: *number, reason };
            let Some(start) = self.instances.get(*number) else {
                return Err(refused("there is none of this number"));
            };
            let motion = Motion::new(&start.map, end);
            if !motion.stays_upright() {
                return Err(refused("it turns too far or becomes flat while the shutter is open"));
            }
            let model = self.octrees[start.model as usize].model().bounds;
            boxes[*number] = Placed::bounds_on_way(start, &motion, &model).map_err(refused)?;
        }
        // Nothing is refused any more. What was there before goes first: there is memory for one tree and one list.
        (self.tree, self.motions) = (Tree::default(), Vec::new());
        self.motions = vec![None; self.instances.len()];
        for (number, end) in ends {
            self.motions[*number] = Some(Motion::new(&self.instances[*number].map, end));
        }
        self.tree = Tree::new(&boxes);
        Ok(())
    }

    /// Whether any instance moves while the shutter is open.
    pub fn are_moving(&self) -> bool {
        let moves = |(motion, start): (&Option<Motion>, &Instance)| {
            motion.as_ref().is_some_and(|motion| *motion.end() != start.map)
        };
        self.motions.iter().zip(&self.instances).any(moves)
    }

    /// An instance at `time`, if it moves.
    #[inline(always)]
    pub(super) fn moved(&self, instance: u32, time: f64) -> Option<Placed> {
        let motion = self.motions.get(instance as usize)?.as_ref()?;
        self.moved_along(instance, motion, time)
    }

    #[inline(never)]
    fn moved_along(&self, instance: u32, motion: &Motion, time: f64) -> Option<Placed> {
        let start = &self.instances[instance as usize];
        let model = &self.octrees[start.model as usize].model().bounds;
        // `move_while_open` has refused ends on whose way a map is flat.
        Placed::new(&Instance { map: motion.at(time), ..*start }, model).ok()
    }

    /// The instances, in the order that numbers them.
    pub fn instances(&self) -> &[Instance] {
        &self.instances
    }

    /// The octrees of the models.
    pub fn octrees(&self) -> &[LazyOctree] {
        &self.octrees
    }

    /// The materials of all models, one model after the other, as hits number them.
    pub fn materials(&self) -> &[MaterialRecord] {
        &self.materials
    }

    /// A box around all instances; empty if there are none.
    pub fn bounds(&self) -> Aabb {
        self.tree.bounds()
    }

    /// The number of a model's first material among [`Instances::materials`].
    ///
    /// # Panics
    /// If there is no such model.
    #[inline(always)]
    pub fn first_material(&self, model: u32) -> u16 {
        self.first_materials[model as usize]
    }

    /// An instance at `time`.
    pub(crate) fn placed(&self, instance: u32, time: f64) -> Option<Cow<'_, Placed>> {
        match self.moved(instance, time) {
            Some(moved) => Some(Cow::Owned(moved)),
            None => self.placed.get(instance as usize).map(Cow::Borrowed),
        }
    }

    /// Which model an instance shows.
    pub(crate) fn model_of(&self, instance: u32) -> Option<u32> {
        self.instances.get(instance as usize).map(|instance| instance.model)
    }

    /// Models that at least one instance shows.
    pub(crate) fn shown_models(&self) -> impl Iterator<Item = (u32, &Arc<Model>)> {
        let mut is_shown = vec![false; self.octrees.len()];
        self.instances.iter().for_each(|instance| is_shown[instance.model as usize] = true);
        let models = (0u32..).zip(&self.octrees).zip(is_shown);
        models.filter(|(_, is_shown)| *is_shown).map(|((number, octree), _)| (number, &octree.model))
    }
}

/// Makes instances ready one by one; `bounds_of` knows the models.
fn ready(
    instances: &[Instance],
    bounds_of: impl Fn(usize) -> Option<Aabb>,
) -> impl Iterator<Item = Result<Placed, InstanceError>> {
    instances.iter().enumerate().map(move |(number, instance)| {
        let refused = |reason| InstanceError::Instance { instance: number, reason };
        let bounds = bounds_of(instance.model as usize);
        let bounds = bounds.ok_or_else(|| refused("there is no model of this number"))?;
        Placed::new(instance, &bounds).map_err(refused)
    })
}

/// What is known of so many instances, and what making it takes.
fn bytes_needed(count: usize) -> u64 {
    let each = size_of::<Instance>() + size_of::<Placed>() + size_of::<Aabb>() + size_of::<Option<Motion>>();
    (count * each) as u64 + Tree::bytes(count)
}

/// What a copy of a model's materials takes: no more than the model itself does beside its blocks.
fn material_bytes(model: &Model) -> u64 {
    let of_blocks = (model.blocks.capacity() * size_of::<BlockEntry>()) as u64;
    model.resident_bytes().0.saturating_sub(of_blocks)
}

fn blocks(source: &Arc<dyn BlockSource>) -> u32 {
    source.model().expected_block_count().max(1)
}

/// What a model takes at the least, nearly.
fn least_bytes(source: &Arc<dyn BlockSource>, options: &OctreeOptions) -> u64 {
    let model = source.model();
    let tracers = u64::from(options.tracers_max.max(1));
    let slot = LazyOctree::slot_bytes(model, crate::octree::LeafLayout::Indexed).0;
    // Directory, nodes and sub-boxes of the coarse tree, the table of the cache.
    const PER_BLOCK: u64 = 512;
    let directory = model.resident_bytes().0 + u64::from(model.block_id_count()) * PER_BLOCK;
    let slots = tracers * slot.min(u64::from(model.block_id_count()) * slot);
    directory + scratch_bytes(source, options) + slots
}

/// Scratch of a model's tracers.
fn scratch_bytes(source: &Arc<dyn BlockSource>, options: &OctreeOptions) -> u64 {
    u64::from(options.tracers_max.max(1)).saturating_mul(tracer_bytes(&**source).0)
}

impl std::fmt::Debug for Instances {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Instances")
            .field("models", &self.octrees.len())
            .field("instances", &self.instances.len())
            .finish_non_exhaustive()
    }
}
