//! Builds trees of 8-wide nodes: the fine tree of a block into its slot, and the coarse tree over all blocks.
//!
//! A fine node splits its primitives at one point into octants, by planes where the surface area heuristic puts them, on
//! the axes where that gains at least 0.9 of what the best axis gains; each primitive goes to exactly one octant by its
//! centre, and the octants' boxes are tight. Then the largest octants (by surface area) are split again while lanes are
//! free. Where no plane separates the centres, primitives are split by their order. The coarse tree, which every ray
//! passes, is built once and so with more care: by one plane at a time.

use super::node::{Child, Node, PLANE_DEPTH_MAX};
use super::options::TreeQuality;
use super::sah::{BIN_COUNT_AT_ONCE, BIN_COUNT_ONE, best_plane, middle_planes, octant_planes};
use crate::simd::{Boxes, LANES, Simd};

/// The box of a primitive or of many: lowest x, y, z, an unused lane, then highest x, y, z negated and an unused lane,
/// so that one `min` merges two boxes.
pub(super) type MinBox = [f32; LANES];

/// The box that holds nothing.
pub(super) const EMPTY: MinBox = [f32::INFINITY; LANES];

/// Writes leaves.
pub(super) trait LeafSink<S: Simd> {
    /// Whether to split by one plane at a time, with more bins, instead of into octants.
    const ONE_PLANE: bool;

    /// Largest leaf that is not split further.
    fn leaf_max(&self) -> usize;

    /// What stands for the node at `index`; indices ascend.
    fn inner(&mut self, index: usize) -> Child;

    /// Writes the leaf of the primitives `order`.
    fn leaf(&mut self, simd: S, order: &[u32]) -> Child;
}

/// Memory for building trees, allocated once.
#[derive(Clone, Debug, Default)]
pub(crate) struct BuildScratch {
    /// Two copies that primitives move between.
    boxes: [Vec<MinBox>; 2],
    order: [Vec<u32>; 2],
    octants: Vec<u8>,
    tasks: Vec<Task>,
    /// For the fine tree: each vertex as a box.
    pub(super) vertices: Vec<MinBox>,
}

/// A run of primitives in one of the two copies.
#[derive(Clone, Copy, Debug)]
struct Run {
    start: u32,
    end: u32,
    copy: u8,
    /// Tight.
    bounds: MinBox,
    /// Box of twice the centres, in the same form.
    centers: MinBox,
}

impl Run {
    fn count(&self) -> usize {
        (self.end - self.start) as usize
    }

    fn area(&self) -> f32 {
        let b = &self.bounds;
        let [x, y, z] = [-b[4] - b[0], -b[5] - b[1], -b[6] - b[2]];
        x * y + y * z + z * x
    }
}

#[derive(Clone, Copy, Debug)]
struct Task {
    run: Run,
    node: u32,
    depth: u32,
}

/// Most tasks that wait at once: seven for each level, and the one in hand.
const TASK_COUNT_MAX: usize = 8 * (PLANE_DEPTH_MAX as usize + 12);

impl BuildScratch {
    /// For trees of at most `primitives` primitives over at most `vertices` vertices.
    pub fn new(primitives: usize, vertices: usize) -> BuildScratch {
        BuildScratch {
            boxes: [vec![EMPTY; primitives], vec![EMPTY; primitives]],
            order: [vec![0; primitives], vec![0; primitives]],
            octants: vec![0; primitives],
            tasks: Vec::with_capacity(TASK_COUNT_MAX),
            vertices: vec![EMPTY; vertices],
        }
    }

    /// What [`BuildScratch::new`] allocates.
    pub fn bytes(primitives: usize, vertices: usize) -> u64 {
        let per_primitive = 2 * (size_of::<MinBox>() + 4) + 1;
        (primitives * per_primitive + vertices * size_of::<MinBox>() + TASK_COUNT_MAX * size_of::<Task>())
            as u64
    }

    /// How many primitives there is room for.
    pub(super) fn capacity(&self) -> usize {
        self.octants.len()
    }

    /// Where the boxes of the primitives go before [`build_tree`].
    pub(super) fn primitives(&mut self, count: usize) -> (&mut [MinBox], &[MinBox]) {
        (&mut self.boxes[0][..count], &self.vertices)
    }
}

/// Builds a tree over the first `count` boxes of `scratch` into `nodes`, the root first; leaves grow where `nodes` is too
/// short.
///
/// # Panics
/// If `nodes` is empty or `scratch` is too small.
#[inline(always)]
pub(super) fn build_tree<S: Simd, L: LeafSink<S>>(
    simd: S,
    scratch: &mut BuildScratch,
    count: usize,
    nodes: &mut [Node],
    sink: &mut L,
) {
    let mut tree = Tree::new(simd, scratch, count, TreeQuality::Best, nodes);
    let run = tree.measure(0, count, 0);
    tree.node_count = 1;
    tree.tasks.push(Task { run, node: 0, depth: 0 });
    tree.grow(sink);
}

/// The first children of a forest, by group.
pub(super) struct Groups {
    pub children: [Child; LANES],
    /// Bit `i`: group `i` has primitives.
    pub used: u32,
    /// The box of everything.
    pub bounds: MinBox,
}

/// Builds one tree for each of up to eight groups of primitives: each primitive belongs to the first of `boxes` that
/// holds it, or to the last group if none does. Otherwise as [`build_tree`].
#[inline(always)]
pub(super) fn build_groups<S: Simd, L: LeafSink<S>>(
    simd: S,
    scratch: &mut BuildScratch,
    count: usize,
    boxes: &Boxes,
    quality: TreeQuality,
    nodes: &mut [Node],
    sink: &mut L,
) -> Groups {
    let mut tree = Tree::new(simd, scratch, count, quality, nodes);
    let run = tree.measure(0, count, 0);
    let mut parts = [run; LANES];
    let zero = simd.splat(0.0);
    let [low_x, low_y, low_z, high_x, high_y, high_z] = boxes;
    let holds = ByGroup {
        low: [simd.load(low_x), simd.load(low_y), simd.load(low_z)],
        negative_high: [
            simd.sub(zero, simd.load(high_x)),
            simd.sub(zero, simd.load(high_y)),
            simd.sub(zero, simd.load(high_z)),
        ],
    };
    let used = tree.partition(&run, &holds, &mut parts);
    let mut groups = Groups { children: [Child::NONE; LANES], used, bounds: run.bounds };
    let mut lanes = used;
    for part in &parts[..used.count_ones() as usize] {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        groups.children[lane] = tree.child(part, 0, sink);
    }
    tree.grow(sink);
    groups
}

struct Tree<'a, S> {
    simd: S,
    boxes: &'a mut [Vec<MinBox>; 2],
    order: &'a mut [Vec<u32>; 2],
    octants: &'a mut [u8],
    tasks: &'a mut Vec<Task>,
    nodes: &'a mut [Node],
    node_count: usize,
    quality: TreeQuality,
}

/// Sorts primitives into at most eight parts.
trait Classify<S: Simd> {
    /// The part of a primitive; the sides of its box in lanes, and twice its centre in the same form.
    fn part(&self, simd: S, primitive: &MinBox, center: S::F) -> usize;
}

/// By which side of up to three planes the centre is on.
struct ByPlanes<F> {
    /// Twice the position of each plane.
    middle: F,
    /// Bit `i`: axis `i` has a plane.
    mask: u32,
}

impl<S: Simd> Classify<S> for ByPlanes<S::F> {
    #[inline(always)]
    fn part(&self, simd: S, _: &MinBox, center: S::F) -> usize {
        (simd.bits(simd.lt(self.middle, center)) & self.mask) as usize
    }
}

/// By which of eight boxes holds the primitive.
struct ByGroup<F> {
    low: [F; 3],
    negative_high: [F; 3],
}

impl<S: Simd> Classify<S> for ByGroup<S::F> {
    #[inline(always)]
    fn part(&self, simd: S, primitive: &MinBox, _: S::F) -> usize {
        let mut holds = simd.le(self.low[0], simd.splat(primitive[0]));
        holds = simd.and(holds, simd.le(self.low[1], simd.splat(primitive[1])));
        holds = simd.and(holds, simd.le(self.low[2], simd.splat(primitive[2])));
        holds = simd.and(holds, simd.le(self.negative_high[0], simd.splat(primitive[4])));
        holds = simd.and(holds, simd.le(self.negative_high[1], simd.splat(primitive[5])));
        holds = simd.and(holds, simd.le(self.negative_high[2], simd.splat(primitive[6])));
        (simd.bits(holds) | 0x80).trailing_zeros() as usize
    }
}

impl<'a, S: Simd> Tree<'a, S> {
    #[inline(always)]
    fn new(
        simd: S,
        scratch: &'a mut BuildScratch,
        count: usize,
        quality: TreeQuality,
        nodes: &'a mut [Node],
    ) -> Tree<'a, S> {
        let BuildScratch { boxes, order, octants, tasks, .. } = scratch;
        for (i, place) in order[0][..count].iter_mut().enumerate() {
            *place = i as u32;
        }
        tasks.clear();
        Tree { simd, boxes, order, octants, tasks, nodes, node_count: 0, quality }
    }

    /// Finishes all tasks.
    #[inline(always)]
    fn grow<L: LeafSink<S>>(&mut self, sink: &mut L) {
        while let Some(task) = self.tasks.pop() {
            let (runs, run_count) = self.children::<L>(&task, sink.leaf_max());
            let mut node = Node::EMPTY;
            for (lane, run) in runs[..run_count].iter().enumerate() {
                for axis in 0..3 {
                    node.bounds[axis][lane] = run.bounds[axis];
                    node.bounds[axis + 3][lane] = -run.bounds[axis + 4];
                }
                node.children[lane] = self.child(run, task.depth + 1, sink);
            }
            self.nodes[task.node as usize] = node;
        }
    }

    /// A run as a child: a leaf if it is short or there are no nodes left, else a node and the task to fill it.
    #[inline(always)]
    fn child<L: LeafSink<S>>(&mut self, run: &Run, depth: u32, sink: &mut L) -> Child {
        if run.count() > sink.leaf_max() && self.node_count < self.nodes.len() {
            let node = self.node_count;
            self.node_count += 1;
            self.tasks.push(Task { run: *run, node: node as u32, depth });
            return sink.inner(node);
        }
        let places = run.start as usize..run.end as usize;
        sink.leaf(self.simd, &self.order[usize::from(run.copy)][places])
    }

    /// A run's boxes, from its primitives.
    #[inline(always)]
    fn measure(&self, start: usize, end: usize, copy: u8) -> Run {
        let simd = self.simd;
        let (mut bounds, mut centers) = (simd.load(&EMPTY), simd.load(&EMPTY));
        for primitive in &self.boxes[usize::from(copy)][start..end] {
            let primitive = simd.load(primitive);
            bounds = simd.min(primitive, bounds);
            centers = simd.min(double_center(simd, primitive), centers);
        }
        Run {
            start: start as u32,
            end: end as u32,
            copy,
            bounds: simd.to_array(bounds),
            centers: simd.to_array(centers),
        }
    }

    /// The children of a node: its octants, the largest of them split again.
    #[inline(always)]
    fn children<L: LeafSink<S>>(&mut self, task: &Task, leaf_max: usize) -> ([Run; LANES], usize) {
        let mut runs = [task.run; LANES];
        let mut count = 1;
        loop {
            // The largest run that is too long for a leaf; at first the node itself. Then lanes that are still free take
            // leaves apart that would be more than one packet: that costs no further node, and a ray tests only the part
            // that it meets.
            let largest = largest_run(&runs[..count], leaf_max)
                .or_else(|| largest_run(&runs[..count], leaf_max.min(LANES)));
            let Some(largest) = largest else { break };
            let planes = match LANES - count {
                0 => break,
                1..=2 => 1,
                3..=6 => 2,
                _ => 3,
            };
            let run = runs[largest];
            let mut parts = [run; LANES];
            let planes = if L::ONE_PLANE || self.quality == TreeQuality::Finest { 1 } else { planes };
            let part_count = self.split::<L>(&run, planes, task.depth, &mut parts);
            runs[largest] = parts[0];
            runs[count..count + part_count - 1].copy_from_slice(&parts[1..part_count]);
            count += part_count - 1;
        }
        (runs, count)
    }

    /// Splits a run of at least two primitives by at most `planes_max` planes into 2 to `2^planes_max` parts, none empty.
    #[inline(always)]
    fn split<L: LeafSink<S>>(
        &mut self,
        run: &Run,
        planes_max: u32,
        depth: u32,
        parts: &mut [Run; LANES],
    ) -> usize {
        let planes = if depth >= PLANE_DEPTH_MAX {
            None
        } else {
            let boxes = &self.boxes[usize::from(run.copy)][run.start as usize..run.end as usize];
            if L::ONE_PLANE {
                best_plane(boxes, &run.centers)
            } else {
                let (bounds, centers) = (&run.bounds, &run.centers);
                match self.quality {
                    TreeQuality::Quick => middle_planes(centers, planes_max),
                    TreeQuality::Best => {
                        octant_planes::<S, BIN_COUNT_AT_ONCE>(self.simd, boxes, bounds, centers, planes_max)
                    }
                    TreeQuality::Finest => {
                        octant_planes::<S, BIN_COUNT_ONE>(self.simd, boxes, bounds, centers, planes_max)
                    }
                }
            }
        };
        if let Some((middle, mask)) = planes {
            let by_planes = ByPlanes { middle: self.simd.load(&middle), mask };
            let used = self.partition(run, &by_planes, parts);
            if used.count_ones() > 1 {
                return used.count_ones() as usize;
            }
        }
        // All centres in one place, or too deep: equal shares in the order at hand.
        let share_count = (1usize << planes_max).min(run.count());
        let (start, end, count) = (run.start as usize, run.end as usize, run.count());
        for (i, part) in parts[..share_count].iter_mut().enumerate() {
            *part = self.measure(
                start + count * i / share_count,
                start + count * (i + 1) / share_count,
                run.copy,
            );
        }
        debug_assert!(parts[share_count - 1].end as usize == end);
        share_count
    }

    /// Moves the primitives of a run to the other copy, sorted into parts, none of them empty. Returns a bit for each
    /// part that has primitives. If only one has, nothing is moved and `parts[0]` is the run as it was.
    #[inline(always)]
    fn partition(&mut self, run: &Run, classify: &impl Classify<S>, parts: &mut [Run; LANES]) -> u32 {
        let simd = self.simd;
        let (start, end) = (run.start as usize, run.end as usize);
        let copy = usize::from(run.copy);
        let empty = simd.load(&EMPTY);
        let mut counts = [0u32; LANES];
        let mut bounds = [empty; LANES];
        let mut centers = [empty; LANES];
        let octants = &mut self.octants[start..end];
        for (sides, octant_of) in self.boxes[copy][start..end].iter().zip(octants.iter_mut()) {
            let primitive = simd.load(sides);
            let center = double_center(simd, primitive);
            let octant = classify.part(simd, sides, center) & 7;
            *octant_of = octant as u8;
            counts[octant] += 1;
            bounds[octant] = simd.min(primitive, bounds[octant]);
            centers[octant] = simd.min(center, centers[octant]);
        }
        let mut used = 0u32;
        for (octant, count) in counts.iter().enumerate() {
            used |= u32::from(*count > 0) << octant;
        }
        if used.count_ones() == 1 {
            parts[0] = *run;
            return used;
        }

        let mut places = [0u32; LANES];
        let mut next = run.start;
        let mut part_count = 0;
        for octant in 0..LANES {
            places[octant] = next;
            if counts[octant] > 0 {
                parts[part_count] = Run {
                    start: next,
                    end: next + counts[octant],
                    copy: 1 - run.copy,
                    bounds: simd.to_array(bounds[octant]),
                    centers: simd.to_array(centers[octant]),
                };
                part_count += 1;
                next += counts[octant];
            }
        }
        let [first, second] = &mut *self.boxes;
        let (from, to) = if copy == 0 { (first, second) } else { (second, first) };
        let [first, second] = &mut *self.order;
        let (order_from, order_to) = if copy == 0 { (first, second) } else { (second, first) };
        let sources = from[start..end].iter().zip(&order_from[start..end]).zip(octants.iter());
        for ((primitive, index), octant) in sources {
            let place = &mut places[usize::from(*octant & 7)];
            to[*place as usize] = *primitive;
            order_to[*place as usize] = *index;
            *place += 1;
        }
        used
    }
}

/// The run with the largest box of those with more than `count_min` primitives.
fn largest_run(runs: &[Run], count_min: usize) -> Option<usize> {
    let mut largest = None;
    let mut largest_area = f32::NEG_INFINITY;
    for (i, run) in runs.iter().enumerate() {
        let area = run.area();
        // An area that overflowed to NaN is still taken.
        if run.count() > count_min && (area.is_nan() || area > largest_area) {
            (largest, largest_area) = (Some(i), area);
        }
    }
    largest
}

/// Twice the centre in lanes 0 to 2, its negative in lanes 4 to 6.
#[inline(always)]
pub(super) fn double_center<S: Simd>(simd: S, bounds: S::F) -> S::F {
    simd.sub(bounds, simd.swap_halves(bounds))
}
