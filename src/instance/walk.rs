//! The way through the octree of one instance's model.

use super::goal::{Candidate, Goal};
use super::instances::{InstanceTriangle, Instances};
use super::moved_ray::moved;
use super::placed::Placed;
use crate::error::{BlockError, LoadError};
use crate::geom::RayFrame;
use crate::octree::{
    Child, Fine, LazyOctree, LocalRay, QueryRay, Reached, STACK_MAX, TriangleLocation, prepare_moved,
    splat_interval,
};
use crate::simd::{LANES, Operation, Simd};
use crate::stats::TraceCounters;
use crate::trace::{Tracer, lanes_in_use};
use crate::units::{BlockId, MaterialId, TriangleId};

/// Children that wait, the next one last, with where the ray enters their boxes.
pub(super) struct Stack {
    entries: Box<[(f32, Child); STACK_MAX]>,
    len: usize,
}

impl Stack {
    pub fn new() -> Stack {
        Stack { entries: Box::new([(0.0, Child::NONE); _]), len: 0 }
    }

    /// Pushes the children in `hits`, the nearest last.
    #[inline(always)]
    fn push<S: Simd>(&mut self, simd: S, children: &[Child; LANES], near: S::F, hits: u32) {
        let near = simd.to_array(near);
        let base = self.len;
        let mut hits = hits;
        while hits != 0 {
            let lane = hits.trailing_zeros() as usize % LANES;
            hits &= hits - 1;
            let mut place = self.len;
            while place > base && self.entries[place - 1].0 < near[lane] {
                self.entries[place] = self.entries[place - 1];
                place -= 1;
            }
            self.entries[place] = (near[lane], children[lane]);
            self.len += 1;
        }
    }

    /// The last child above `base` that begins at `high` or before.
    #[inline(always)]
    fn pop(&mut self, base: usize, high: f32) -> Option<Child> {
        while self.len > base {
            self.len -= 1;
            let (near, child) = self.entries[self.len];
            if near <= high {
                return Some(child);
            }
        }
        None
    }
}

/// A ray on its way through an instance.
pub(super) struct Walk<'w, 'o, G> {
    pub instances: &'o Instances,
    /// Number of the instance.
    pub index: u32,
    pub placed: &'w Placed,
    pub octree: &'o LazyOctree,
    pub tracer: &'w mut Tracer<'o>,
    pub stack: &'w mut Stack,
    pub goal: &'w mut G,
    /// The ray in the world.
    pub frame: &'w mut RayFrame,
    pub counters: &'w mut TraceCounters,
}

/// Offers the goal every triangle of the instance that the ray may meet; gives whether the goal is reached. A function of its own,
/// entered with the instructions of `simd`.
impl<S: Simd, G: Goal> Operation<S> for Walk<'_, '_, G> {
    type Output = Result<bool, LoadError>;

    #[inline(always)]
    fn run(mut self, simd: S) -> Result<bool, LoadError> {
        let octree = self.octree;
        let coarse = &octree.coarse;
        let (mut query, mut local) = (QueryRay::UNSET, LocalRay::UNSET);
        prepare_moved(simd, &moved(self.frame, self.placed), &octree.space, &mut query, &mut local);
        let (low, mut high) = (query.local_low(self.frame.t_min), query.local_high(self.frame.t_max));
        self.stack.len = 0;
        let mut next = Some(Child::COARSE_ROOT);
        while let Some(child) = next {
            let interval = splat_interval(simd, low, high);
            if child.is_leaf() {
                let block = child.block_index();
                let sub_boxes = match coarse.sub_boxes.get(block as usize) {
                    Some(sub_boxes) => sub_boxes,
                    None => match octree.reach(block)? {
                        Reached::Block(sub_boxes) => sub_boxes,
                        Reached::Cell(root) => {
                            next = Some(root);
                            continue;
                        }
                    },
                };
                self.counters.box_tests += 1;
                let (near, hits) = local.test.boxes.test_packed(simd, sub_boxes, interval.low, interval.high);
                if hits != 0 {
                    if self.block(simd, BlockId(block), &query, &mut local, (low, high), (near, hits))? {
                        return Ok(true);
                    }
                    local.enter_frame(simd, &query, &octree.space.frame);
                    high = query.local_high(self.frame.t_max);
                }
            } else {
                let node = coarse.node(child);
                self.counters.box_tests += 1;
                let (near, hits) = local.test.boxes.test(simd, &node.bounds, interval.low, interval.high);
                self.stack.push(simd, &node.children, near, hits);
            }
            next = self.stack.pop(0, high);
        }
        Ok(false)
    }
}

impl<G: Goal> Walk<'_, '_, G> {
    /// The same in a block, from the sub-boxes in `hits` on.
    #[inline(always)]
    fn block<S: Simd>(
        &mut self,
        simd: S,
        block: BlockId,
        query: &QueryRay,
        local: &mut LocalRay,
        (low, mut high): (f32, f32),
        (near, hits): (S::F, u32),
    ) -> Result<bool, LoadError> {
        let fine = Fine::new(self.tracer.slot(block)?);
        self.counters.block_visits += 1;
        local.enter_frame(simd, query, &fine.frame());
        let bounds = local.bounds(simd, query, fine.extents(), fine.vertex_error());
        let base = self.stack.len;
        let (groups, used) = fine.groups();
        self.stack.push(simd, groups, near, hits & used);
        while let Some(child) = self.stack.pop(base, high) {
            let interval = splat_interval(simd, low, high);
            if !child.is_leaf() {
                let node = fine.node(child);
                self.counters.box_tests += 1;
                let (near, hits) = local.test.boxes.test(simd, &node.bounds, interval.low, interval.high);
                self.stack.push(simd, &node.children, near, hits);
                continue;
            }
            let count = child.triangle_count();
            self.counters.triangle_tests += count as u64;
            let edge = fine.edge(child);
            let leaf = fine.leaf(None, child);
            let mut first = 0;
            while first < count {
                let packet = leaf.packet(simd, first);
                let triangles = &local.test.triangles;
                let mut survivors = triangles.survivors(simd, &packet, (&bounds, edge), &interval)
                    & lanes_in_use(count - first);
                while survivors != 0 {
                    let lane = survivors.trailing_zeros() as usize;
                    survivors &= survivors - 1;
                    let at = TriangleLocation { leaf: child, lane: first + lane };
                    let material = MaterialId(
                        self.instances.first_material(self.placed.model).wrapping_add(fine.material(at).0),
                    );
                    if !self.goal.wants(material) {
                        continue;
                    }
                    let candidate = Candidate {
                        triangle: numbered(self.index, fine.id(at), block)?,
                        material,
                        vertices: self.placed.vertices(&fine.exact_vertices(at)),
                    };
                    self.counters.decisions += 1;
                    if self.goal.take(candidate, self.frame, &mut self.counters.exact_fallbacks) {
                        return Ok(true);
                    }
                    high = query.local_high(self.frame.t_max);
                }
                first += LANES;
            }
        }
        Ok(false)
    }
}

#[inline(always)]
fn numbered(instance: u32, triangle: TriangleId, block: BlockId) -> Result<TriangleId, LoadError> {
    let of_instance = InstanceTriangle { instance, triangle };
    let reason = "a triangle's number is too large to be told apart from those of other instances";
    Ok(of_instance.number().ok_or(BlockError { block, offset: 0, reason })?)
}
