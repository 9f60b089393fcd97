//! A model of many small blocks, for tests of this room.

use crate::block::{BlockLimits, Codec};
use crate::geom::Precision;
use crate::procedural::random::Random;
use crate::source::MemorySource;
use crate::source::testing::memory_model;

/// So many random triangles in blocks of at most 4 KiB.
pub(super) fn small_blocks(triangle_count: u32, seed: u64) -> MemorySource {
    let mut random = Random::new(seed);
    let mut corner = || [0; 3].map(|_| (random.next_u64() % 1024) as f64);
    let triangles: Vec<[[f64; 3]; 3]> = (0..triangle_count).map(|_| [0; 3].map(|_| corner())).collect();
    let limits = BlockLimits { block_bytes_max: 4096 };
    let bytes = memory_model(&triangles, limits, Codec::Raw, Precision::Float32).unwrap();
    MemorySource::new(bytes).unwrap()
}
