//! The coarse tree: always resident, over the boxes of all blocks, with each block's sub-boxes below.
//!
//! Over a model that is compiled lazily it is at first a tree over the boxes of cells; see [`GrownCells`] for what grows below it. That
//! costs the tree of a compiled model nothing: what has grown has numbers beyond its arrays, where looking would panic otherwise.

use std::sync::Arc;

use super::build::{BuildScratch, LeafSink, build_tree};
use super::frame::Frame;
use super::grown::{GrownCells, Place};
use super::node::{Child, Node};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::BudgetError;
use crate::geom::{Aabb, Precision};
use crate::model::{BlockEntry, Model};
use crate::simd::{AnyOperation, PackedBoxes, Simd, SimdLevel, dispatch};
use crate::units::{BlockId, Bytes};

/// A tree whose leaves are blocks.
#[derive(Debug)]
pub(crate) struct CoarseTree {
    pub frame: Frame,
    /// Whether the blocks of the model have that frame too.
    pub is_shared: bool,
    pub nodes: Vec<Node>,
    /// By block: lets a ray pass a block by without loading it. None if the leaves are cells.
    pub sub_boxes: Vec<PackedBoxes>,
    /// By leaf, then by node: the node that it is a child of. The root is its own.
    parents: Vec<u32>,
    /// If the leaves are cells: what has grown below them.
    grown: Option<GrownCells>,
    _reservation: Reservation,
}

impl CoarseTree {
    /// Builds the tree from the directory.
    ///
    /// # Errors
    /// The tree, or the memory for building it, does not fit in the budget.
    pub fn build(
        model: &Arc<Model>,
        scale: f64,
        level: SimdLevel,
        budget: &MemoryBudget,
    ) -> Result<CoarseTree, BudgetError> {
        let leaf_count = model.blocks.len() + model.cells.len();
        // f32 files share one base with their blocks, so that entering a block costs a ray nothing.
        let base = match model.precision {
            Precision::Float32 => [0.0; 3],
            Precision::Lattice(_) => model.bounds.center(),
        };
        let frame = Frame { base, scale };
        let is_shared = model.precision == Precision::Float32;
        // Every node has eight children or only leaves, at least two unless it is the root: at most half as many of
        // the latter as leaves, and a seventh of that of the former.
        let node_count_max = 4 * leaf_count / 7 + 2;
        let purpose = "building the coarse tree";
        let building = BuildScratch::bytes(leaf_count, 0) + (node_count_max * size_of::<Node>()) as u64;
        let sub_box_bytes = (model.blocks.len() * size_of::<PackedBoxes>()) as u64;
        let working = budget.reserve(Bytes(building), purpose)?;
        let mut nodes = vec![Node::EMPTY; node_count_max];
        let mut scratch = BuildScratch::new(leaf_count, 0);
        let cells = model.cells.entries().iter().map(|cell| cell.bounds);
        let boxes = model.blocks.iter().map(|entry| entry.bounds).chain(cells);
        let first_leaf = if model.cells.is_empty() { 0 } else { model.block_id_count() };
        let base = TreeBase { first_node: 0, first_leaf };
        let node_count = build_over_boxes(level, frame, boxes, base, &mut nodes, &mut scratch);
        nodes.truncate(node_count);
        nodes.shrink_to_fit();
        drop((scratch, working));
        let parent_bytes = ((node_count + leaf_count) * size_of::<u32>()) as u64;
        let bytes = (node_count * size_of::<Node>()) as u64 + sub_box_bytes + parent_bytes;
        let reservation = budget.reserve(Bytes(bytes), "the coarse tree")?;
        let sub_boxes = model.blocks.iter().map(|entry| packed(frame, entry)).collect();
        let parents = parents(&nodes, leaf_count, base);
        let grown = match model.cells.is_empty() {
            true => None,
            false => Some(GrownCells::new(model, nodes.len(), level, budget)?),
        };
        Ok(CoarseTree { frame, is_shared, nodes, sub_boxes, parents, grown, _reservation: reservation })
    }

    /// An inner child.
    #[inline(always)]
    pub fn node(&self, child: Child) -> &Node {
        match self.nodes.get(child.node_index()) {
            Some(node) => node,
            None => self.grown().node(child),
        }
    }

    /// Asks for what a ray looks at first in a child.
    #[inline(always)]
    pub fn prefetch<S: Simd>(&self, simd: S, child: Child) {
        if child.is_leaf() {
            simd.prefetch(&self.sub_boxes, child.block_index() as usize);
        } else {
            simd.prefetch(&self.nodes, child.node_index());
        }
    }

    /// How many blocks have grown.
    pub fn grown_block_count(&self) -> u64 {
        self.grown.as_ref().map_or(0, GrownCells::block_count)
    }

    /// What has grown. Only for trees over cells: others have no child beyond their arrays.
    ///
    /// # Panics
    /// For other trees.
    #[inline(never)]
    pub fn grown(&self) -> &GrownCells {
        self.grown.as_ref().expect("the tree of a compiled model has all its nodes and leaves")
    }

    /// What is known of a block of a cell; `None` if the cell is not cut.
    pub fn grown_entry(&self, block: BlockId) -> Option<&BlockEntry> {
        self.grown.as_ref()?.entry(block)
    }

    /// The sub-boxes of a block of a cell; `None` if the cell is not cut.
    pub fn grown_sub_boxes(&self, block: BlockId) -> Option<&PackedBoxes> {
        self.grown.as_ref()?.sub_boxes(block)
    }

    /// The node that `child` is a child of, or the cell whose root it is; `None` for the root.
    #[inline(always)]
    pub fn parent(&self, child: Child) -> Option<Child> {
        if child == Child::COARSE_ROOT {
            return None;
        }
        let leaf_count = self.parents.len() - self.nodes.len();
        let place = match &self.grown {
            Some(grown) => match grown.place(child) {
                Place::Grown(parent) => return Some(parent),
                Place::Leaf(cell) => cell,
                Place::Node(node) => leaf_count + node,
            },
            None if child.is_leaf() => child.block_index() as usize,
            None => leaf_count + child.node_index(),
        };
        Some(Child::node(self.parents[place]))
    }
}

/// The sub-boxes of a block in the tree's space.
pub(super) fn packed(frame: Frame, entry: &BlockEntry) -> PackedBoxes {
    let (low, high) = frame.box_to_local(&entry.bounds);
    PackedBoxes::new(low, high, &entry.sub_boxes)
}

/// By leaf, then by node: the number of the node that it is a child of, both counted from where those of the tree begin.
pub(super) fn parents(nodes: &[Node], leaf_count: usize, base: TreeBase) -> Vec<u32> {
    let mut parents = vec![0; leaf_count + nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for (lane, child) in node.children.iter().enumerate() {
            // Lanes that hold nothing name anything.
            if node.bounds[0][lane] <= node.bounds[3][lane] {
                let place = if child.is_leaf() {
                    (child.block_index() - base.first_leaf) as usize
                } else {
                    leaf_count + child.node_index() - base.first_node as usize
                };
                parents[place] = index as u32;
            }
        }
    }
    parents
}

/// Where the numbers of a tree's nodes and leaves begin.
#[derive(Clone, Copy, Debug)]
pub(super) struct TreeBase {
    pub first_node: u32,
    pub first_leaf: u32,
}

/// Builds a tree whose leaves are `boxes`, one each, into `nodes`, the root first; returns how many nodes it has. There must be as
/// many boxes as `scratch` was made for.
pub(super) fn build_over_boxes(
    level: SimdLevel,
    frame: Frame,
    boxes: impl Iterator<Item = Aabb>,
    base: TreeBase,
    nodes: &mut [Node],
    scratch: &mut BuildScratch,
) -> usize {
    let mut count = 0;
    let (places, _) = scratch.primitives(scratch.capacity());
    for (place, bounds) in places.iter_mut().zip(boxes) {
        let (low, high) = frame.box_to_local(&bounds);
        *place = [low[0], low[1], low[2], 0.0, -high[0], -high[1], -high[2], 0.0];
        count += 1;
    }
    dispatch(level, Build { count, base, nodes, scratch })
}

struct Build<'a> {
    count: usize,
    base: TreeBase,
    nodes: &'a mut [Node],
    scratch: &'a mut BuildScratch,
}

impl AnyOperation for Build<'_> {
    type Output = usize;

    /// How many nodes the tree has.
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> usize {
        let mut sink = BoxSink { node_count: 1, base: self.base };
        build_tree(simd, self.scratch, self.count, self.nodes, &mut sink);
        sink.node_count
    }
}

struct BoxSink {
    node_count: usize,
    base: TreeBase,
}

impl<S: Simd> LeafSink<S> for BoxSink {
    const ONE_PLANE: bool = true;

    #[inline(always)]
    fn leaf_max(&self) -> usize {
        1
    }

    #[inline(always)]
    fn inner(&mut self, index: usize) -> Child {
        self.node_count = index + 1;
        Child::node(self.base.first_node + index as u32)
    }

    #[inline(always)]
    fn leaf(&mut self, _: S, order: &[u32]) -> Child {
        debug_assert_eq!(order.len(), 1);
        Child::block(self.base.first_leaf + order[0])
    }
}
