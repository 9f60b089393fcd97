//! Any bytes as a compiled file; if it opens, every block is decoded. Checksums are made right where the input asks for it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use outcrop::BlockSource;
use outcrop::block::{BlockData, DecodeScratch};
use outcrop::source::MemorySource;
use outcrop::units::BlockId;
use outcrop_fuzz::{HEADER_BYTES, seal};

/// Where the header names directory and materials: offset, length, checksum.
const SECTIONS: [usize; 2] = [104, 128];

fuzz_target!(|input: &[u8]| {
    let [sealed, file @ ..] = input else { return };
    let mut file = file.to_vec();
    if sealed % 4 != 0 && file.len() >= HEADER_BYTES {
        seal(&mut file, HEADER_BYTES, &SECTIONS);
    }
    let Ok(source) = MemorySource::new(file) else { return };
    let model = source.model();
    let mut scratch = DecodeScratch::with_limits(model.limits);
    let (mut bytes, mut data) = (Vec::new(), BlockData::with_limits(model.limits));
    for block in (0..model.blocks.len() as u32).map(BlockId) {
        source.read_block(block, &mut bytes).expect("a source in memory has every block of its directory");
        if model.decode_block(block, &bytes, &mut scratch, &mut data).is_ok() {
            assert!(data.materials.iter().all(|material| usize::from(*material) < model.materials.len()));
        }
    }
});
