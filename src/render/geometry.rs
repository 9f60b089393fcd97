//! What a picture is of: one model, or instances of several. Decided where a picture is set up and once per call of a query, never per ray
//! (I6).

use std::borrow::Cow;
use std::sync::Arc;

use crate::attributes::AttributeCache;
use crate::budget::MemoryBudget;
use crate::cache::CacheStats;
use crate::error::{RenderError, TraceError};
use crate::instance::Instances;
use crate::model::{MaterialRecord, Model};
use crate::octree::LazyOctree;
use crate::render::query::SceneTracer;
use crate::render::waiting::PoolQuery;
use crate::scene::{AttributeKinds, EffectOptions, EffectPlan, Scene};
use crate::trace::RayPool;
use crate::units::Bytes;

/// What surfaces there are, as far as directories tell.
pub(crate) struct Surfaces<'m> {
    /// As hits number them.
    pub materials: Cow<'m, [MaterialRecord]>,
    /// Which of them may be on a triangle.
    used: Vec<bool>,
    /// The models that are shown.
    models: Vec<&'m Model>,
    /// Whether any moves while the shutter is open.
    pub are_moving: bool,
}

impl<'m> From<&'m Model> for Surfaces<'m> {
    fn from(model: &'m Model) -> Surfaces<'m> {
        let mut surfaces = Surfaces {
            materials: Cow::Borrowed(&model.materials),
            used: vec![false; model.materials.len()],
            models: Vec::new(),
            are_moving: false,
        };
        surfaces.show(model, 0);
        surfaces
    }
}

impl<'m> From<&'m Instances> for Surfaces<'m> {
    fn from(instances: &'m Instances) -> Surfaces<'m> {
        let materials = instances.materials();
        let used = vec![false; materials.len()];
        let are_moving = instances.are_moving();
        let mut surfaces =
            Surfaces { materials: Cow::Borrowed(materials), used, models: Vec::new(), are_moving };
        for (number, model) in instances.shown_models() {
            surfaces.show(model, usize::from(instances.first_material(number)));
        }
        surfaces
    }
}

impl<'m> From<&[&'m Model]> for Surfaces<'m> {
    /// Of instances of all these models, one at least of each.
    fn from(models: &[&'m Model]) -> Surfaces<'m> {
        let materials: Vec<_> = models.iter().flat_map(|model| model.materials.iter().cloned()).collect();
        let used = vec![false; materials.len()];
        // They may move: then it takes a little more.
        let mut surfaces =
            Surfaces { materials: Cow::Owned(materials), used, models: Vec::new(), are_moving: true };
        let mut first = 0;
        for model in models {
            surfaces.show(model, first);
            first += model.materials.len();
        }
        surfaces
    }
}

impl<'m> Surfaces<'m> {
    /// Adds a model whose materials begin at `first`.
    fn show(&mut self, model: &'m Model, first: usize) {
        let used = &mut self.used[first..][..model.materials.len()];
        for range in model.material_ranges() {
            let [low, high] = range.map(usize::from);
            let end = used.len().min(high + 1);
            used[low.min(end)..end].fill(true);
        }
        self.models.push(model);
    }

    pub fn have_uvs(&self) -> bool {
        self.models.iter().any(|model| model.attributes.have_uvs())
    }

    pub fn plan(&self, scene: &Scene, options: &EffectOptions) -> EffectPlan {
        let used = self.materials.iter().zip(&self.used).filter(|(_, used)| **used).map(|(record, _)| record);
        let normals = self.models.iter().any(|model| model.attributes.have_normals());
        let attributes = AttributeKinds { uvs: self.have_uvs(), normals };
        EffectPlan::of_surfaces(scene, used, attributes, self.are_moving, options)
    }

    /// What the caches of attributes take for so many readers.
    pub fn attribute_bytes(&self, share: Bytes, readers: u32) -> Bytes {
        let with_attributes: Vec<_> =
            self.models.iter().filter(|model| !model.attributes.is_empty()).collect();
        let share = Bytes(share.0 / with_attributes.len().max(1) as u64);
        let bytes = with_attributes.iter().map(|model| AttributeCache::bytes_needed(model, share, readers).0);
        Bytes(bytes.sum())
    }
}

/// See the module's text.
#[derive(Clone, Copy)]
pub(crate) enum Geometry<'a> {
    Model(&'a LazyOctree),
    Instances(&'a Instances),
}

impl<'a> Geometry<'a> {
    pub fn surfaces(self) -> Surfaces<'a> {
        match self {
            Geometry::Model(octree) => Surfaces::from(octree.model()),
            Geometry::Instances(instances) => Surfaces::from(instances),
        }
    }

    fn octrees(self) -> &'a [LazyOctree] {
        match self {
            Geometry::Model(octree) => std::slice::from_ref(octree),
            Geometry::Instances(instances) => instances.octrees(),
        }
    }

    /// How many threads may trace at once.
    pub fn tracers_max(self) -> u32 {
        self.octrees().iter().map(|octree| octree.tracers_max().max(1)).min().unwrap_or(u32::MAX)
    }

    /// A cache of attributes for each model that has any, out of `share`.
    pub fn open_attributes(
        self,
        share: Bytes,
        readers: u32,
        budget: &MemoryBudget,
    ) -> Result<Vec<Option<AttributeCache>>, RenderError> {
        let has_some = |octree: &LazyOctree| !octree.model().attributes.is_empty();
        let count = self.octrees().iter().filter(|octree| has_some(octree)).count();
        let share = Bytes(share.0 / count.max(1) as u64);
        let open = |octree: &LazyOctree| {
            let source = Arc::clone(octree.source());
            let cache = has_some(octree).then(|| AttributeCache::open(source, share, readers, budget));
            Ok(cache.transpose().map_err(TraceError::Load)?)
        };
        self.octrees().iter().map(open).collect()
    }

    /// A query for one thread. `attributes`: what [`Geometry::open_attributes`] gave, or nothing if the picture needs none.
    pub fn query(self, attributes: &'a [Option<AttributeCache>]) -> Result<SceneTracer<'a>, TraceError> {
        let mut readers = attributes.iter().map(|cache| cache.as_ref().map(AttributeCache::reader));
        Ok(match self {
            Geometry::Model(octree) => {
                SceneTracer::Model { tracer: octree.tracer()?, attributes: readers.next().flatten() }
            }
            Geometry::Instances(instances) => SceneTracer::Instances {
                instances,
                tracer: instances.tracer()?,
                attributes: readers.collect(),
                time: 0.0,
            },
        })
    }

    /// A query for one thread through a pool of its own.
    pub fn pool_query(pool: RayPool<'a>, attributes: &'a [Option<AttributeCache>]) -> PoolQuery<'a> {
        let attributes = attributes.first().and_then(|cache| cache.as_ref().map(AttributeCache::reader));
        PoolQuery { pool, attributes }
    }

    /// What the caches of blocks did, together.
    pub fn cache_stats(self) -> CacheStats {
        sum_of(self.octrees().iter().map(|octree| octree.cache().stats()))
    }

    pub fn blocks_touched(self) -> u64 {
        self.octrees().iter().map(LazyOctree::blocks_touched).sum()
    }

    pub fn block_count(self) -> u64 {
        self.octrees().iter().map(LazyOctree::block_count).sum()
    }
}

/// Several caches as one.
pub(super) fn sum_of(stats: impl Iterator<Item = CacheStats>) -> CacheStats {
    stats.fold(CacheStats::default(), |sum, stats| CacheStats {
        hits: sum.hits + stats.hits,
        misses: sum.misses + stats.misses,
        evictions: sum.evictions + stats.evictions,
        stalls: sum.stalls + stats.stalls,
        filled_bytes: sum.filled_bytes + stats.filled_bytes,
    })
}
