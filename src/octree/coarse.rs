//! The coarse tree: always resident, over the boxes of all blocks, with each block's sub-boxes below.

use super::build::{BuildScratch, LeafSink, build_tree};
use super::frame::Frame;
use super::node::{Child, Node};
use crate::budget::{MemoryBudget, Reservation};
use crate::error::BudgetError;
use crate::geom::Precision;
use crate::model::Model;
use crate::simd::{AnyOperation, PackedBoxes, Simd, SimdLevel, dispatch};
use crate::units::Bytes;

/// A tree whose leaves are blocks.
#[derive(Debug)]
pub(crate) struct CoarseTree {
    pub frame: Frame,
    /// Whether the blocks of the model have that frame too.
    pub is_shared: bool,
    pub nodes: Vec<Node>,
    /// By block: lets a ray pass a block by without loading it.
    pub sub_boxes: Vec<PackedBoxes>,
    /// By block, then by node: the node that it is a child of. The root is its own.
    parents: Vec<u32>,
    _reservation: Reservation,
}

impl CoarseTree {
    /// Builds the tree from the directory.
    ///
    /// # Errors
    /// The tree, or the memory for building it, does not fit in the budget.
    pub fn build(
        model: &Model,
        scale: f64,
        level: SimdLevel,
        budget: &MemoryBudget,
    ) -> Result<CoarseTree, BudgetError> {
        let block_count = model.blocks.len();
        // f32 files share one base with their blocks, so that entering a block costs a ray nothing.
        let base = match model.precision {
            Precision::Float32 => [0.0; 3],
            Precision::Lattice(_) => model.bounds.center(),
        };
        let frame = Frame { base, scale };
        let is_shared = model.precision == Precision::Float32;
        // Every node has eight children or only leaves, at least two unless it is the root: at most half as many of
        // the latter as blocks, and a seventh of that of the former.
        let node_count_max = 4 * block_count / 7 + 2;
        let purpose = "building the coarse tree";
        let building = BuildScratch::bytes(block_count, 0) + (node_count_max * size_of::<Node>()) as u64;
        let sub_box_bytes = (block_count * size_of::<PackedBoxes>()) as u64;
        let working = budget.reserve(Bytes(building), purpose)?;
        let mut nodes = vec![Node::EMPTY; node_count_max];
        let mut scratch = BuildScratch::new(block_count, 0);
        let node_count = dispatch(level, Build { model, frame, nodes: &mut nodes, scratch: &mut scratch });
        nodes.truncate(node_count);
        nodes.shrink_to_fit();
        drop((scratch, working));
        let parent_bytes = ((node_count + block_count) * size_of::<u32>()) as u64;
        let bytes = (node_count * size_of::<Node>()) as u64 + sub_box_bytes + parent_bytes;
        let reservation = budget.reserve(Bytes(bytes), "the coarse tree")?;
        let sub_boxes = model
            .blocks
            .iter()
            .map(|entry| {
                let (low, high) = frame.box_to_local(&entry.bounds);
                PackedBoxes::new(low, high, &entry.sub_boxes)
            })
            .collect();
        let parents = parents(&nodes, block_count);
        Ok(CoarseTree { frame, is_shared, nodes, sub_boxes, parents, _reservation: reservation })
    }

    /// The node that `child` is a child of; `None` for the root.
    #[inline(always)]
    pub fn parent(&self, child: Child) -> Option<Child> {
        if child == Child::COARSE_ROOT {
            return None;
        }
        let place = if child.is_leaf() {
            child.block_index() as usize
        } else {
            self.sub_boxes.len() + child.node_index()
        };
        Some(Child::node(self.parents[place]))
    }
}

fn parents(nodes: &[Node], block_count: usize) -> Vec<u32> {
    let mut parents = vec![0; block_count + nodes.len()];
    for (index, node) in nodes.iter().enumerate() {
        for (lane, child) in node.children.iter().enumerate() {
            // Lanes that hold nothing name the root or the first block.
            if node.bounds[0][lane] <= node.bounds[3][lane] {
                let place = if child.is_leaf() {
                    child.block_index() as usize
                } else {
                    block_count + child.node_index()
                };
                parents[place] = index as u32;
            }
        }
    }
    parents
}

struct Build<'a> {
    model: &'a Model,
    frame: Frame,
    nodes: &'a mut [Node],
    scratch: &'a mut BuildScratch,
}

impl AnyOperation for Build<'_> {
    type Output = usize;

    /// How many nodes the tree has.
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) -> usize {
        let (boxes, _) = self.scratch.primitives(self.model.blocks.len());
        for (place, entry) in boxes.iter_mut().zip(&self.model.blocks) {
            let (low, high) = self.frame.box_to_local(&entry.bounds);
            *place = [low[0], low[1], low[2], 0.0, -high[0], -high[1], -high[2], 0.0];
        }
        let mut sink = BlockSink { node_count: 1 };
        build_tree(simd, self.scratch, self.model.blocks.len(), self.nodes, &mut sink);
        sink.node_count
    }
}

struct BlockSink {
    node_count: usize,
}

impl<S: Simd> LeafSink<S> for BlockSink {
    const LEAF_MAX: usize = 1;
    const ONE_PLANE: bool = true;

    #[inline(always)]
    fn inner(&mut self, index: usize) -> Child {
        self.node_count = index + 1;
        Child::node(index as u32)
    }

    #[inline(always)]
    fn leaf(&mut self, _: S, order: &[u32]) -> Child {
        debug_assert_eq!(order.len(), 1);
        Child::block(order[0])
    }
}
