//! What an image file holds beside its pixels takes no memory that nothing has reserved (I1). In a binary of its own, since the
//! system tells the peak of a whole process.
#![cfg(target_os = "linux")]

use std::borrow::Cow;
use std::fs;

use outcrop::MemoryBudget;
use outcrop::model::{ImageMap, MaterialImages, MaterialRecord};
use outcrop::texture::Textures;
use outcrop::units::Bytes;

/// The most memory that the process had since it was asked to forget, in KiB.
fn peak() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
    peak.trim().trim_end_matches(" kB").parse().unwrap()
}

/// A picture of one pixel with a colour profile of 60 MiB, which is packed into some 60 KB.
#[test]
fn a_small_file_with_a_large_profile_takes_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let mut info = png::Info::with_size(1, 1);
    info.color_type = png::ColorType::Rgba;
    info.icc_profile = Some(Cow::Owned(vec![0; 60 << 20]));
    let file = fs::File::create(folder.path().join("a.png")).unwrap();
    let mut writer = png::Encoder::with_info(file, info).unwrap().write_header().unwrap();
    writer.write_image_data(&[1, 2, 3, 4]).unwrap();
    writer.finish().unwrap();
    assert!(fs::metadata(folder.path().join("a.png")).unwrap().len() < 1 << 20);

    let images = MaterialImages { diffuse: Some(ImageMap::new("a.png")), ..MaterialImages::default() };
    let materials = [MaterialRecord { images: Some(Box::new(images)), ..MaterialRecord::default() }];
    // Forgets the peak of what was done so far.
    fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = peak();
    let budget = MemoryBudget::new(Bytes::mib(4));
    Textures::open(&materials, folder.path(), &folder.path().join("tiles"), &budget).unwrap();
    let grown = peak() - before;
    assert!(grown < 16 << 10, "{grown} KiB");
}
