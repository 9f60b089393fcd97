//! Any bytes as a compiled file; if it opens, every block is decoded. Checksums are made right where the input asks for it.
#![no_main]

use libfuzzer_sys::fuzz_target;
use outcrop::BlockSource;
use outcrop::block::{BlockData, DecodeScratch, checksum};
use outcrop::model::HEADER_BYTES;
use outcrop::source::MemorySource;
use outcrop::units::BlockId;

/// Where the header names directory and materials: offset, length, checksum.
const SECTIONS: [usize; 2] = [104, 128];

fn seal(file: &mut [u8]) {
    if file.len() < HEADER_BYTES {
        return;
    }
    let u64_at = |file: &[u8], at: usize| {
        let mut word = [0; 8];
        word.copy_from_slice(&file[at..at + 8]);
        usize::try_from(u64::from_le_bytes(word)).unwrap_or(usize::MAX)
    };
    for section in SECTIONS {
        let (offset, bytes) = (u64_at(file, section), u64_at(file, section + 8));
        if let Some(part) = file.get(offset..).and_then(|rest| rest.get(..bytes)) {
            let sum = checksum(part);
            file[section + 16..section + 24].copy_from_slice(&sum.to_le_bytes());
        }
    }
    let sum = checksum(&file[..HEADER_BYTES - 8]);
    file[HEADER_BYTES - 8..HEADER_BYTES].copy_from_slice(&sum.to_le_bytes());
}

fuzz_target!(|input: &[u8]| {
    let [sealed, file @ ..] = input else { return };
    let mut file = file.to_vec();
    if sealed % 4 != 0 {
        seal(&mut file);
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
