//! Any bytes as a file of texture tiles; if it opens, every picture is looked up. Checksums are made right where the input asks for it.
#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use outcrop::MemoryBudget;
use outcrop::block::checksum;
use outcrop::texture::{Address, TextureCache, TextureId, Textures};
use outcrop::units::Bytes;
use outcrop_fuzz::seal;

const HEADER_BYTES: usize = 64;
/// Where the header names the directory: offset, length, checksum.
const DIRECTORY: usize = 24;
/// Says of which images the tiles are; here of none, so that nothing is converted.
const KEY: usize = 48;

fuzz_target!(|input: &[u8]| {
    let [sealed, file @ ..] = input else { return };
    let mut file = file.to_vec();
    if sealed % 4 != 0 && file.len() >= HEADER_BYTES {
        file[KEY..KEY + 8].copy_from_slice(&checksum(&[]).to_le_bytes());
        seal(&mut file, HEADER_BYTES, &[DIRECTORY]);
    }
    let Ok(folder) = tempfile::tempdir() else { return };
    let tiles = folder.path().join("fuzz.tiles");
    if fs::write(&tiles, &file).is_err() {
        return;
    }
    let budget = MemoryBudget::new(Bytes::mib(16));
    let Ok(textures) = Textures::open(&[], folder.path(), &tiles, &budget) else { return };
    let Ok(cache) = TextureCache::open(textures, Bytes(0), 1, &budget) else { return };
    let mut reader = cache.reader();
    for picture in 0..reader.textures().image_count() as u32 {
        for level in [0.0, 1.5, 99.0] {
            if let Ok(texel) = reader.sample(TextureId(picture), [0.3, 0.7], level, Address::Repeat) {
                assert!(texel.iter().all(|channel| (0.0..=1.0).contains(channel)));
            }
        }
    }
});
