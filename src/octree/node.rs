//! The node of both levels: one 8-wide box test.

use crate::simd::{Boxes, LANES};

/// No tree is deeper: after this many levels of planes the builder splits by order, into eighths.
pub(super) const PLANE_DEPTH_MAX: u32 = 24;

/// Room for a traversal of the tree over cells, of one over the blocks of a cell, and of one inside a block: each level of a tree leaves
/// at most seven children waiting. Splitting by order ends within 11 levels for 2^31 primitives.
pub(crate) const STACK_MAX: usize = 3 * (7 * LEVELS_MAX + 2);

/// Most levels of one tree, leaves included.
pub(crate) const LEVELS_MAX: usize = PLANE_DEPTH_MAX as usize + 12;

/// Eight children with tight boxes, in 256 bytes.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// Boxes of the children, in the frame of the tree.
    pub bounds: Boxes,
    /// What each child is.
    pub children: [Child; LANES],
    pub _padding: [u32; LANES],
}

impl Node {
    /// A node whose lanes are all empty.
    pub const EMPTY: Node = Node {
        bounds: [
            [f32::INFINITY; LANES],
            [f32::INFINITY; LANES],
            [f32::INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
            [f32::NEG_INFINITY; LANES],
        ],
        children: [Child(0); LANES],
        _padding: [0; LANES],
    };
}

/// An inner node, or a leaf: a block in the coarse tree, a run of triangles in a fine one.
///
/// In a coarse tree it holds the number of the node or block. In a fine one it holds where the node or leaf lies in the
/// slot, in units of 16 bytes, and how many triangles the leaf has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub(crate) struct Child(pub u32);

const LEAF: u32 = 1 << 31;
const PLACE_BITS: u32 = 17;
/// Unit of places in a slot.
pub(super) const PLACE_BYTES: usize = 16;

impl Child {
    /// No child: a leaf that no tree has, with more triangles or a greater number than any.
    pub const NONE: Child = Child(u32::MAX);

    /// The first node of a coarse tree.
    pub const COARSE_ROOT: Child = Child(0);

    /// A coarse node.
    pub fn node(index: u32) -> Child {
        debug_assert!(index < LEAF);
        Child(index)
    }

    pub fn block(block: u32) -> Child {
        debug_assert!(block < LEAF);
        Child(LEAF | block)
    }

    /// A fine node at a place.
    pub fn inner(place: u32) -> Child {
        debug_assert!(place < 1 << PLACE_BITS);
        Child(place)
    }

    /// A leaf of a fine tree at a place. A slot has less than 2 MiB, and no leaf as many as the 16,384
    /// triangles that a block can hold: the root always splits.
    pub fn triangles(place: u32, count: u32) -> Child {
        debug_assert!(place < 1 << PLACE_BITS && count < 1 << (31 - PLACE_BITS));
        Child(LEAF | count << PLACE_BITS | place)
    }

    #[inline(always)]
    pub fn is_leaf(self) -> bool {
        self.0 & LEAF != 0
    }

    #[inline(always)]
    pub fn node_index(self) -> usize {
        self.0 as usize
    }

    #[inline(always)]
    pub fn block_index(self) -> u32 {
        self.0 & !LEAF
    }

    /// Place of a fine node.
    #[inline(always)]
    pub fn inner_place(self) -> usize {
        self.0 as usize
    }

    /// Place of a fine node or leaf.
    #[inline(always)]
    pub fn place(self) -> usize {
        (self.0 & ((1 << PLACE_BITS) - 1)) as usize
    }

    /// Triangles of a fine leaf.
    #[inline(always)]
    pub fn triangle_count(self) -> usize {
        ((self.0 & !LEAF) >> PLACE_BITS) as usize
    }
}
