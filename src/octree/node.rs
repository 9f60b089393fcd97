//! The node of both levels: one 8-wide box test.

use crate::simd::{Boxes, LANES};

/// The first node of a tree.
pub(crate) const ROOT: u32 = 0;

/// No tree is deeper: after this many levels of planes the builder splits by order, into eighths.
pub(super) const PLANE_DEPTH_MAX: u32 = 24;

/// Room for a traversal of both levels: each level of a tree leaves at most seven children waiting. Splitting by order
/// ends within 11 levels for 2^31 primitives.
pub(crate) const STACK_MAX: usize = 2 * 7 * (PLANE_DEPTH_MAX as usize + 12);

/// Eight children with tight boxes, in 256 bytes.
#[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(64))]
pub(crate) struct Node {
    /// Boxes of the children, in the frame of the tree.
    pub bounds: Boxes,
    /// What each child is.
    pub children: [Child; LANES],
    /// For a leaf child of a fine tree: a bound on the magnitude of its triangles' edge components.
    pub edges: [f32; LANES],
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
        edges: [0.0; LANES],
    };
}

/// An inner node by index, or a leaf: a block in the coarse tree, a run of triangles in a fine one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub(crate) struct Child(pub u32);

const LEAF: u32 = 1 << 31;
const START_BITS: u32 = 15;

impl Child {
    pub fn node(index: u32) -> Child {
        debug_assert!(index < LEAF);
        Child(index)
    }

    pub fn block(block: u32) -> Child {
        debug_assert!(block < LEAF);
        Child(LEAF | block)
    }

    /// A block holds at most 16,384 triangles, so both numbers fit.
    pub fn triangles(start: u32, count: u32) -> Child {
        debug_assert!(start < 1 << START_BITS && count < 1 << START_BITS);
        Child(LEAF | count << START_BITS | start)
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

    /// First triangle and count.
    #[inline(always)]
    pub fn triangle_range(self) -> (usize, usize) {
        let mask = (1 << START_BITS) - 1;
        ((self.0 & mask) as usize, (self.0 >> START_BITS & mask) as usize)
    }
}
