//! Any bytes as a picture: of the surroundings (Radiance, OpenEXR) or of a texture (PNG, JPEG, either also as base64 text in a
//! document). The first byte says as which.
#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use outcrop::MemoryBudget;
use outcrop::model::{ImageMap, MaterialImages, MaterialRecord};
use outcrop::scene::EnvironmentImage;
use outcrop::texture::Textures;
use outcrop::units::Bytes;

fuzz_target!(|input: &[u8]| {
    let [kind, bytes @ ..] = input else { return };
    let name = ["fuzz.hdr", "fuzz.exr", "fuzz.png", "fuzz.jpg"][usize::from(kind % 4)];
    let Ok(folder) = tempfile::tempdir() else { return };
    let path = folder.path().join(name);
    if fs::write(&path, bytes).is_err() {
        return;
    }
    let budget = MemoryBudget::new(Bytes::mib(16));
    if kind % 4 < 2 {
        if let Ok(image) = EnvironmentImage::read(&path, &budget) {
            assert!(image.radiance_max().iter().all(|radiance| radiance.is_finite() && *radiance >= 0.0));
        }
        return;
    }
    let map = match kind & 4 {
        0 => ImageMap::new(name),
        _ => ImageMap::base64_inside(name, 0..bytes.len() as u64),
    };
    let images = MaterialImages { diffuse: Some(map), ..MaterialImages::default() };
    let material = MaterialRecord { images: Some(Box::new(images)), ..MaterialRecord::default() };
    let tiles = folder.path().join("fuzz.tiles");
    if let Ok(textures) = Textures::open(&[material], folder.path(), &tiles, &budget) {
        assert_eq!(textures.image_count(), 1);
    }
});
