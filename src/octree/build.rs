//! Builds trees of 8-wide nodes: the fine tree of a block into its slot, and the coarse tree over all blocks.
//!
//! A node splits its primitives at one point, the middle of their centres' box, by planes on the axes where that box is
//! at least 0.3 of its longest extent, into octants; each primitive goes to exactly one octant by its centre, and the
//! octants' boxes are tight. Then the largest octants (by surface area) are split again while lanes are free. Where
//! no plane separates the centres, primitives are split by their order.

use super::node::{Child, Node, PLANE_DEPTH_MAX};
use crate::simd::{LANES, Simd};

/// The box of a primitive or of many: lowest x, y, z, an unused lane, then highest x, y, z negated and an unused lane,
/// so that one `min` merges two boxes.
pub(super) type MinBox = [f32; LANES];

/// The box that holds nothing.
pub(super) const EMPTY: MinBox = [f32::INFINITY; LANES];

/// An axis gets a plane if its extent is at least this part of the longest one.
const GATE: f32 = 0.3;

/// Writes leaves.
pub(super) trait LeafSink<S: Simd> {
    /// Largest leaf that is not split further.
    const LEAF_MAX: usize;

    /// Writes the leaf of the primitives `order`, which take places `start ..` in the tree's order. Returns the child
    /// and the value for [`Node::edges`].
    fn leaf(&mut self, simd: S, start: usize, order: &[u32]) -> (Child, f32);
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

    /// Where the boxes of the primitives go before [`build_tree`].
    pub(super) fn primitives(&mut self, count: usize) -> (&mut [MinBox], &[MinBox]) {
        (&mut self.boxes[0][..count], &self.vertices)
    }
}

/// Builds a tree over the first `count` boxes of `scratch` into `nodes`; leaves grow where `nodes` is too short.
/// Returns how many nodes it took (at least one) and the box of everything.
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
) -> (usize, MinBox) {
    let BuildScratch { boxes, order, octants, tasks, .. } = scratch;
    for (i, place) in order[0][..count].iter_mut().enumerate() {
        *place = i as u32;
    }
    let mut tree = Tree { simd, boxes, order, octants };
    let root = tree.measure(0, count, 0);
    tasks.clear();
    tasks.push(Task { run: root, node: 0, depth: 0 });
    let mut node_count = 1;
    while let Some(task) = tasks.pop() {
        let (runs, run_count) = tree.children(&task, L::LEAF_MAX);
        let mut node = Node::EMPTY;
        for (lane, run) in runs[..run_count].iter().enumerate() {
            for axis in 0..3 {
                node.bounds[axis][lane] = run.bounds[axis];
                node.bounds[axis + 3][lane] = -run.bounds[axis + 4];
            }
            if run.count() > L::LEAF_MAX && node_count < nodes.len() {
                node.children[lane] = Child::node(node_count as u32);
                tasks.push(Task { run: *run, node: node_count as u32, depth: task.depth + 1 });
                node_count += 1;
            } else {
                let places = run.start as usize..run.end as usize;
                let order = &tree.order[usize::from(run.copy)][places];
                (node.children[lane], node.edges[lane]) = sink.leaf(simd, run.start as usize, order);
            }
        }
        nodes[task.node as usize] = node;
    }
    (node_count, root.bounds)
}

struct Tree<'a, S> {
    simd: S,
    boxes: &'a mut [Vec<MinBox>; 2],
    order: &'a mut [Vec<u32>; 2],
    octants: &'a mut [u8],
}

impl<S: Simd> Tree<'_, S> {
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
    fn children(&mut self, task: &Task, leaf_max: usize) -> ([Run; LANES], usize) {
        let mut runs = [task.run; LANES];
        let mut count = 1;
        loop {
            // The largest run that is too long for a leaf; at first the node itself.
            let mut largest = None;
            let mut largest_area = f32::NEG_INFINITY;
            for (i, run) in runs[..count].iter().enumerate() {
                let area = run.area();
                // Written so that an area that overflowed to NaN is still taken.
                if run.count() > leaf_max && !(area <= largest_area) {
                    (largest, largest_area) = (Some(i), area);
                }
            }
            let Some(largest) = largest else { break };
            let planes = match LANES - count {
                0 => break,
                1..=2 => 1,
                3..=6 => 2,
                _ => 3,
            };
            let run = runs[largest];
            let mut parts = [run; LANES];
            let part_count = self.split(&run, planes, task.depth, &mut parts);
            runs[largest] = parts[0];
            runs[count..count + part_count - 1].copy_from_slice(&parts[1..part_count]);
            count += part_count - 1;
        }
        (runs, count)
    }

    /// Splits a run of at least two primitives by at most `planes_max` planes into 2 to `2^planes_max` parts, none empty.
    #[inline(always)]
    fn split(&mut self, run: &Run, planes_max: u32, depth: u32, parts: &mut [Run; LANES]) -> usize {
        if depth < PLANE_DEPTH_MAX {
            let part_count = self.split_by_planes(run, planes_max, parts);
            if part_count > 1 {
                return part_count;
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

    /// Returns 1 (and leaves `run` as it is) if no plane separates the centres.
    #[inline(always)]
    fn split_by_planes(&mut self, run: &Run, planes_max: u32, parts: &mut [Run; LANES]) -> usize {
        let simd = self.simd;
        let c = &run.centers;
        let extents = [-c[4] - c[0], -c[5] - c[1], -c[6] - c[2]];
        let longest = extents[0].max(extents[1]).max(extents[2]);
        // Overflow or no extent at all.
        if !(longest > 0.0 && longest < f32::INFINITY) {
            return 1;
        }
        let mut mask = 0u32;
        let mut axes = [0usize, 1, 2];
        for (i, j) in [(0, 1), (1, 2), (0, 1)] {
            if extents[axes[j]] > extents[axes[i]] {
                axes.swap(i, j);
            }
        }
        for axis in &axes[..planes_max as usize] {
            if extents[*axis] >= GATE * longest {
                mask |= 1 << axis;
            }
        }
        let mut middle = [f32::INFINITY; LANES];
        for axis in 0..3 {
            middle[axis] = 0.5 * c[axis] - 0.5 * c[axis + 4];
        }
        let middle = simd.load(&middle);

        let (start, end) = (run.start as usize, run.end as usize);
        let copy = usize::from(run.copy);
        let empty = simd.load(&EMPTY);
        let mut counts = [0u32; LANES];
        let mut bounds = [empty; LANES];
        let mut centers = [empty; LANES];
        let octants = &mut self.octants[start..end];
        for (primitive, octant_of) in self.boxes[copy][start..end].iter().zip(octants.iter_mut()) {
            let primitive = simd.load(primitive);
            let center = double_center(simd, primitive);
            let octant = (simd.bits(simd.lt(middle, center)) & mask) as usize;
            *octant_of = octant as u8;
            counts[octant] += 1;
            bounds[octant] = simd.min(primitive, bounds[octant]);
            centers[octant] = simd.min(center, centers[octant]);
        }
        if counts.iter().any(|count| *count as usize == end - start) {
            return 1;
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
        part_count
    }
}

/// Twice the centre in lanes 0 to 2, its negative in lanes 4 to 6.
#[inline(always)]
fn double_center<S: Simd>(simd: S, bounds: S::F) -> S::F {
    simd.sub(bounds, simd.swap_halves(bounds))
}
