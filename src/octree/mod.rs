//! The lazy octree: a coarse level over the blocks, always resident, and a fine level per block, built in the block's
//! slot when the first ray reaches it.

/// TODO(octree)
pub struct LazyOctree;
