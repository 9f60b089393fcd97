//! What grows below a coarse tree over cells: a small tree over the blocks of each cell that was cut.
//!
//! Nodes and leaves have one space of numbers in all of them, so that a traversal needs no third level. Leaves: first the numbers of
//! all blocks that there can be, cell by cell, then the cells themselves. Nodes: first those of the tree over the cells, then as many
//! for each cell as it has block numbers. So a cell is found from any number of its own, and nothing moves when another one is cut.

use std::sync::{Arc, OnceLock};

use super::build::BuildScratch;
use super::coarse::{TreeBase, build_over_boxes, packed, parents};
use super::frame::Frame;
use super::node::{Child, Node};
use crate::budget::{Allowance, MemoryBudget, Reservation};
use crate::error::{BudgetError, LoadError};
use crate::model::{BlockEntry, Model};
use crate::simd::{PackedBoxes, SimdLevel};
use crate::source::BlockSource;
use crate::units::{BlockId, Bytes, CellId};

/// See the module's text. Shared by all threads; a cell grows once.
#[derive(Debug)]
pub(crate) struct GrownCells {
    model: Arc<Model>,
    /// Nodes of the tree over the cells.
    node_count: u32,
    level: SimdLevel,
    trees: Box<[OnceLock<CellTree>]>,
    allowance: Allowance,
    _memory: Reservation,
}

/// The tree over the blocks of one cell.
#[derive(Debug)]
struct CellTree {
    nodes: Box<[Node]>,
    sub_boxes: Box<[PackedBoxes]>,
    /// By block, then by node: the node that it is a child of, counted within the cell.
    parents: Box<[u32]>,
    entries: Arc<[BlockEntry]>,
    _memory: Reservation,
}

/// What a leaf of the tree stands for.
pub(crate) enum Reached<'a> {
    /// A block, with its sub-boxes.
    Block(&'a PackedBoxes),
    /// A cell, with the root of the tree over its blocks.
    Cell(Child),
}

/// Where the parent of a child is to be looked up.
pub(crate) enum Place {
    /// It is this.
    Grown(Child),
    /// With this leaf of the tree over the cells.
    Leaf(usize),
    /// With this node of the tree over the cells.
    Node(usize),
}

impl CellTree {
    /// Memory of the tree over `block_count` blocks.
    fn bytes(block_count: usize, node_count: usize) -> u64 {
        let nodes = node_count * (size_of::<Node>() + size_of::<u32>());
        (block_count * (size_of::<PackedBoxes>() + size_of::<u32>()) + nodes) as u64
    }

    fn node_count_max(block_count: usize) -> usize {
        // As for the tree above; no more than there are numbers, which are at least sixteen.
        4 * block_count / 7 + 2
    }
}

impl GrownCells {
    /// Nothing has grown yet below a tree of `node_count` nodes.
    pub fn new(
        model: &Arc<Model>,
        node_count: usize,
        level: SimdLevel,
        budget: &MemoryBudget,
    ) -> Result<GrownCells, BudgetError> {
        let cell_count = model.cells.len();
        let purpose = "the cells of the coarse tree";
        let memory = budget.reserve(Bytes((cell_count * size_of::<OnceLock<CellTree>>()) as u64), purpose)?;
        // Half more blocks than expected, with as many nodes as trees have in practice; the budget has the rest.
        let blocks = model.expected_block_count() as usize;
        let expected = Bytes(CellTree::bytes(blocks + blocks / 2, blocks / 2 + cell_count));
        let allowance = Allowance::new(budget, expected, purpose)?;
        Ok(GrownCells {
            model: Arc::clone(model),
            // Cells have less than 2^30 block numbers, so at least a sixteenth of that is their number.
            node_count: node_count as u32,
            level,
            trees: (0..cell_count).map(|_| OnceLock::new()).collect(),
            allowance,
            _memory: memory,
        })
    }

    /// What the leaf `leaf` stands for. A cell that nobody has reached before is cut.
    #[inline(never)]
    pub fn reach(&self, leaf: u32, frame: Frame, source: &dyn BlockSource) -> Result<Reached<'_>, LoadError> {
        if let Some((cell, index)) = self.model.cells.cell_of(BlockId(leaf)) {
            // Only a cell that has grown has such a leaf.
            return Ok(Reached::Block(&self.tree(cell).sub_boxes[index]));
        }
        let cell = CellId(leaf - self.model.cells.block_id_count());
        if self.trees[cell.0 as usize].get().is_none() {
            self.grow(cell, frame, source)?;
        }
        let first_node = self.node_count + self.model.cells.entries()[cell.0 as usize].first_block.0;
        Ok(Reached::Cell(Child::node(first_node)))
    }

    /// Whether `leaf` is a cell that nobody has reached.
    pub fn would_cut(&self, leaf: u32) -> bool {
        match self.model.cells.cell_of(BlockId(leaf)) {
            Some(_) => false,
            None => self.trees[(leaf - self.model.cells.block_id_count()) as usize].get().is_none(),
        }
    }

    /// The sub-boxes of a block.
    #[inline(never)]
    pub fn sub_boxes(&self, block: BlockId) -> Option<&PackedBoxes> {
        let (cell, index) = self.model.cells.cell_of(block)?;
        self.trees[cell.0 as usize].get()?.sub_boxes.get(index)
    }

    /// A node of the tree of a cell.
    #[inline(never)]
    pub fn node(&self, child: Child) -> &Node {
        let (cell, index) = self.cell_of_node(child);
        &self.tree(cell).nodes[index]
    }

    /// How many blocks there are in cells that have grown.
    pub fn block_count(&self) -> u64 {
        self.trees.iter().filter_map(OnceLock::get).map(|tree| tree.entries.len() as u64).sum()
    }

    /// What is known of a block.
    pub fn entry(&self, block: BlockId) -> Option<&BlockEntry> {
        let (cell, index) = self.model.cells.cell_of(block)?;
        self.trees[cell.0 as usize].get()?.entries.get(index)
    }

    /// Where the parent of `child` is to be looked up.
    pub fn place(&self, child: Child) -> Place {
        let cells = &self.model.cells;
        let (cell, index) = if child.is_leaf() {
            match cells.cell_of(BlockId(child.block_index())) {
                Some(found) => found,
                None => return Place::Leaf((child.block_index() - cells.block_id_count()) as usize),
            }
        } else if child.node_index() < self.node_count as usize {
            return Place::Node(child.node_index());
        } else {
            let (cell, index) = self.cell_of_node(child);
            if index == 0 {
                return Place::Grown(Child::block(cells.block_id_count() + cell.0));
            }
            (cell, self.tree(cell).entries.len() + index)
        };
        let first_node = self.node_count + cells.entries()[cell.0 as usize].first_block.0;
        Place::Grown(Child::node(first_node + self.tree(cell).parents[index]))
    }

    /// The cell of a node beyond the tree over the cells, and which of its nodes it is.
    fn cell_of_node(&self, child: Child) -> (CellId, usize) {
        let number = child.node_index() as u32 - self.node_count;
        self.model.cells.cell_of(BlockId(number)).expect("nodes are numbered as the blocks of their cell")
    }

    fn tree(&self, cell: CellId) -> &CellTree {
        self.trees[cell.0 as usize].get().expect("only a cell that has grown has nodes and leaves")
    }

    #[cold]
    fn grow(&self, cell: CellId, frame: Frame, source: &dyn BlockSource) -> Result<(), LoadError> {
        let entries = source.cut_cell(cell)?;
        let base = &self.model.cells.entries()[cell.0 as usize];
        let base =
            TreeBase { first_node: self.node_count + base.first_block.0, first_leaf: base.first_block.0 };
        let count = entries.len();
        let mut nodes = vec![Node::EMPTY; CellTree::node_count_max(count)];
        let mut scratch = BuildScratch::new(count, 0);
        let boxes = entries.iter().map(|entry| entry.bounds);
        let node_count = build_over_boxes(self.level, frame, boxes, base, &mut nodes, &mut scratch);
        nodes.truncate(node_count);
        let bytes = Bytes(CellTree::bytes(count, node_count));
        let memory = self.allowance.reserve(bytes, "the coarse tree of a cell")?;
        let tree = CellTree {
            parents: parents(&nodes, count, base).into(),
            nodes: nodes.into(),
            sub_boxes: entries.iter().map(|entry| packed(frame, entry)).collect(),
            entries,
            _memory: memory,
        };
        // Another thread may have been faster; its tree is the same.
        let _ = self.trees[cell.0 as usize].set(tree);
        Ok(())
    }
}
