//! A picture whose pixels come of blocks: the wrong bytes in one of them give another picture.

use std::collections::BTreeMap;
use std::sync::OnceLock;

use outcrop::cluster::{Job, model_key};
use outcrop::render::{Region, RenderSettings};
use outcrop::scene::{Camera, Scene};
use outcrop::units::BlockId;
use outcrop::{BlockSource, source::MemorySource};

use super::super::numbers::{Random, mix};
use super::super::support::model_bytes;

pub const SIZE: [u32; 2] = [171, 130];

/// Blocks that pixels come of; one of them is needed everywhere.
const BLOCKS: u64 = 24;
pub const HOT: u32 = 5;

/// The model; opened once, since there are thousands of nodes.
pub fn file() -> MemorySource {
    static FILE: OnceLock<MemorySource> = OnceLock::new();
    FILE.get_or_init(|| MemorySource::new(model_bytes().clone()).unwrap()).clone()
}

pub fn key() -> u64 {
    static KEY: OnceLock<u64> = OnceLock::new();
    *KEY.get_or_init(|| model_key(file().model()))
}

/// The stored bytes of the blocks that are needed, as they should be.
pub fn sound() -> &'static [Vec<u8>] {
    static SOUND: OnceLock<Vec<Vec<u8>>> = OnceLock::new();
    SOUND.get_or_init(|| {
        let read = |block| {
            let mut bytes = Vec::new();
            file().read_block(BlockId(block), &mut bytes).unwrap();
            bytes
        };
        (0..BLOCKS as u32).map(read).collect()
    })
}

pub fn job() -> Job {
    let camera = Camera::pinhole([0.0, 0.0, 5.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
    Job::new(Scene::new(camera), RenderSettings::new(SIZE[0], SIZE[1]), key())
}

/// A number that depends on all bytes of a block.
pub fn digest(bytes: &[u8]) -> u64 {
    bytes.chunks(8).fold(bytes.len() as u64, |sum, chunk| {
        let mut eight = [0; 8];
        eight[..chunk.len()].copy_from_slice(chunk);
        (sum ^ u64::from_le_bytes(eight)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(23)
    })
}

/// The blocks of a pixel: some for its neighbourhood, and the one that all want.
fn blocks_of(x: u32, y: u32) -> [u32; 3] {
    let place = |side: u32| mix(u64::from(x / side) << 32 | u64::from(y / side) << 8 | u64::from(side));
    [(place(24) % BLOCKS) as u32, (place(40) % BLOCKS) as u32, HOT]
}

/// All blocks of a region.
pub fn blocks_of_region(region: Region) -> Vec<u32> {
    let corners = |start: u32, length: u32| (start..start + length).step_by(8);
    let places =
        corners(region.y, region.height).flat_map(|y| corners(region.x, region.width).map(move |x| (x, y)));
    let mut blocks: Vec<u32> = places.flat_map(|(x, y)| blocks_of(x, y)).collect();
    blocks.sort_unstable();
    blocks.dedup();
    blocks
}

/// A pixel from the digests of its blocks.
pub fn pixel(x: u32, y: u32, digests: &BTreeMap<u32, u64>) -> [f32; 3] {
    let blocks = blocks_of(x, y).iter().fold(0u64, |sum, block| sum.rotate_left(7) ^ digests[block]);
    let hash = Random(blocks ^ (u64::from(x) << 32 | u64::from(y))).bits();
    [hash as u8 as f32, (hash >> 8) as u16 as f32, (hash >> 24) as u16 as f32 / 7.0]
}

pub fn pixels(region: Region, digests: &BTreeMap<u32, u64>) -> Vec<[f32; 3]> {
    let rows = region.y..region.y + region.height;
    rows.flat_map(|y| (region.x..region.x + region.width).map(move |x| pixel(x, y, digests))).collect()
}

/// The whole picture, row by row.
pub fn reference() -> &'static [[f32; 3]] {
    static PIXELS: OnceLock<Vec<[f32; 3]>> = OnceLock::new();
    PIXELS.get_or_init(|| {
        let digests =
            sound().iter().enumerate().map(|(block, bytes)| (block as u32, digest(bytes))).collect();
        pixels(Region { x: 0, y: 0, width: SIZE[0], height: SIZE[1] }, &digests)
    })
}
