//! Pictures to tiles and back: every texel, every size, in any memory.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::file::HEADER_BYTES;
use super::layout::TILE_BYTES;
use super::*;
use crate::budget::MemoryBudget;
use crate::error::{LoadError, TextureError};
use crate::model::{ImageMap, MaterialImages, MaterialRecord};
use crate::units::Bytes;

fn image(width: u32, height: u32, texel: impl Fn(u32, u32) -> [u8; 4]) -> PixelImage {
    let texels =
        (0..height).flat_map(|y| (0..width).map(move |x| (x, y))).map(|(x, y)| texel(x, y)).collect();
    PixelImage { width, height, texels }
}

fn key(name: &str, encoding: Encoding) -> ImageKey {
    ImageKey { path: PathBuf::from(name), encoding }
}

fn open(textures: &Arc<Textures>, share: Bytes) -> TextureCache {
    TextureCache::open(Arc::clone(textures), share, 1, &MemoryBudget::new(Bytes::mib(64))).unwrap()
}

fn pattern(x: u32, y: u32) -> [u8; 4] {
    [(x * 7) as u8, (y * 5) as u8, (x ^ y) as u8, 255 - (x / 40) as u8]
}

fn write_png(path: &Path, image: &PixelImage, color: png::ColorType, bytes: &[u8]) {
    let mut encoder = png::Encoder::new(fs::File::create(path).unwrap(), image.width, image.height);
    encoder.set_color(color);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(bytes).unwrap();
}

fn named(path: &str) -> MaterialRecord {
    let images = MaterialImages { diffuse: Some(ImageMap::new(path)), ..MaterialImages::default() };
    MaterialRecord { images: Some(Box::new(images)), ..MaterialRecord::default() }
}

#[test]
fn every_texel_of_a_picture_comes_back_through_one_slot_as_through_many() {
    for (width, height) in [(1, 1), (3, 200), (64, 64), (130, 67)] {
        let picture = image(width, height, pattern);
        let textures = Textures::in_memory([
            (key("other", Encoding::Srgb), image(70, 3, pattern)),
            (key("a", Encoding::Linear), picture.clone()),
        ])
        .unwrap();
        let id = textures.find("a", Encoding::Linear).unwrap();
        assert_eq!((textures.size(id), textures.find("a", Encoding::Srgb)), ([width, height], None));
        let [small, large] = [Bytes(0), Bytes::mib(8)].map(|share| open(&textures, share));
        let (mut few, mut many) = (small.reader(), large.reader());
        for y in 0..height {
            for x in 0..width {
                let uv =
                    [(f64::from(x) + 0.5) / f64::from(width), 1.0 - (f64::from(y) + 0.5) / f64::from(height)];
                let found = many.sample(id, uv, 0.0, Address::Repeat).unwrap();
                assert_eq!(found, few.sample(id, uv, 0.0, Address::Repeat).unwrap());
                for (found, byte) in found.iter().zip(pattern(x, y)) {
                    assert!((found - f64::from(byte) / 255.0).abs() < 1e-4, "{x} {y} of {width} x {height}");
                }
            }
        }
    }
}

#[test]
fn colours_are_averaged_as_light_and_by_their_alpha() {
    // Black and white, and red that is seen beside green that is not.
    let picture = image(4, 2, |x, _| match x {
        0 => [0, 0, 0, 255],
        1 => [255, 255, 255, 255],
        2 => [255, 0, 0, 255],
        _ => [0, 255, 0, 0],
    });
    let textures = Textures::in_memory([(key("a", Encoding::Srgb), picture)]).unwrap();
    assert!(textures.has_alpha(TextureId(0)));
    let cache = open(&textures, Bytes::mib(1));
    let mut reader = cache.reader();
    let mut at = |u: f64| reader.sample(TextureId(0), [u, 0.5], 1.0, Address::Clamp).unwrap();
    let (grey, red) = (at(0.25), at(0.75));
    // Half the light: 188 of 255 in sRGB, not 128.
    assert!((grey[0] - 0.5).abs() < 0.005 && grey[3] == 1.0, "{grey:?}");
    assert!(red[0] > 0.99 && red[1] == 0.0 && (red[3] - 0.5).abs() < 0.005, "{red:?}");
}

#[test]
fn every_texel_counts_the_same_in_the_mean_whatever_the_size() {
    for (width, height) in [(2, 2), (3, 3), (65, 65), (600, 3), (1, 129), (75, 1), (37, 50)] {
        // One border is white, on the right or below.
        for is_right in [true, false] {
            let last = |x, y| if is_right { x + 1 == width } else { y + 1 == height };
            let picture = image(width, height, |x, y| [if last(x, y) { 255 } else { 0 }, 0, 0, 255]);
            let textures = Textures::in_memory([(key("a", Encoding::Linear), picture)]).unwrap();
            let cache = open(&textures, Bytes::mib(1));
            let found =
                cache.reader().sample(TextureId(0), [0.3, 0.3], f64::INFINITY, Address::Repeat).unwrap();
            let mean = 1.0 / f64::from(if is_right { width } else { height });
            assert!((found[0] - mean).abs() < 0.0025, "{width} x {height}: {} {mean}", found[0]);
        }
    }
    // What grows evenly does so in every size, at the same places.
    for width in [64, 75, 129, 200] {
        let picture = image(width, 1, |x, _| [(255 * (2 * x + 1) / (2 * width)) as u8, 0, 0, 255]);
        let textures = Textures::in_memory([(key("a", Encoding::Linear), picture)]).unwrap();
        let cache = open(&textures, Bytes::mib(1));
        let mut reader = cache.reader();
        for level in 0..6 {
            for u in [0.25, 0.4, 0.5, 0.75] {
                let found =
                    reader.sample(TextureId(0), [u, 0.5], f64::from(level), Address::Clamp).unwrap()[0];
                assert!((found - u).abs() < 0.015, "{width} at {u} in size {level}: {found}");
            }
        }
    }
}

#[test]
fn lookups_wrap_or_stop_at_the_border_and_mix_between_sizes() {
    let picture = image(64, 64, |x, _| [if x < 32 { 0 } else { 255 }, 0, 0, 255]);
    let textures = Textures::in_memory([(key("a", Encoding::Linear), picture)]).unwrap();
    let cache = open(&textures, Bytes::mib(1));
    let mut reader = cache.reader();
    let mut red =
        |uv: [f64; 2], level: f64, address| reader.sample(TextureId(0), uv, level, address).unwrap()[0];
    use Address::{Clamp, Repeat};
    assert_eq!([red([0.0, 0.5], 0.0, Repeat), red([0.0, 0.5], 0.0, Clamp)], [0.5, 0.0]);
    assert_eq!([red([1.0, 0.5], 0.0, Repeat), red([1.0, 0.5], 0.0, Clamp)], [0.5, 1.0]);
    assert_eq!([red([-3.25, 9.0], 0.0, Repeat), red([-3.25, 9.0], 0.0, Clamp)], [1.0, 0.0]);
    // The smallest size is one texel of the mean; beyond it there is none.
    for level in [6.0, 7.0, 1e9, f64::INFINITY] {
        assert!((red([0.1, 0.1], level, Repeat) - 0.5).abs() < 0.005);
    }
    let (near, far) = (red([0.45, 0.5], 3.0, Repeat), red([0.45, 0.5], 4.0, Repeat));
    assert!((red([0.45, 0.5], 3.25, Repeat) - (0.75 * near + 0.25 * far)).abs() < 1e-12 && near != far);
    for level in [-1.0, f64::NAN, f64::NEG_INFINITY] {
        assert_eq!(red([0.3, 0.3], level, Repeat), red([0.3, 0.3], 0.0, Repeat));
    }
    assert!(red([3e38, -3e38], 0.0, Repeat).is_finite());
}

#[test]
fn images_inside_files_are_those_of_files() {
    let place = tempfile::tempdir().unwrap();
    let (folder, tiles) = (place.path(), place.path().join("tiles"));
    let picture = image(70, 9, pattern);
    let alone = folder.join("a.png");
    write_png(&alone, &picture, png::ColorType::Rgba, picture.texels.as_flattened());
    let png = fs::read(&alone).unwrap();
    let whole = [&[1, 2, 3], &*png, &[4; 20]].concat();
    fs::write(folder.join("whole.glb"), &whole).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(2));
    let open = |start: u64, length: u64| {
        let path = ImageMap::inside("whole.glb", start..start + length).path;
        Textures::open(&[named(&path)], folder, &tiles, &budget).map(|textures| (textures, path))
    };
    let length = png.len() as u64;
    let (textures, path) = open(3, length).unwrap();
    assert_eq!(textures, Textures::in_memory([(key(&path, Encoding::Srgb), picture)]).unwrap());
    // Not a picture, too short, beyond the end, nothing, nowhere.
    let far = u64::MAX - length;
    for (start, length) in [(2, length), (3, length / 2), (3, length + 21), (3, 0), (far, length)] {
        let error = open(start, length).unwrap_err();
        assert!(matches!(error, TextureError::Image { .. }), "{start} {length}: {error}");
        assert!(error.to_string().contains("whole.glb"), "{error}");
    }
}

#[cfg(feature = "gltf")]
#[test]
fn images_in_base64_are_those_of_files() {
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;
    let place = tempfile::tempdir().unwrap();
    let (folder, tiles) = (place.path(), place.path().join("tiles"));
    let picture = image(70, 9, pattern);
    let alone = folder.join("a.png");
    write_png(&alone, &picture, png::ColorType::Rgba, picture.texels.as_flattened());
    let png = fs::read(&alone).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(2));
    let open = |path: String, budget: &MemoryBudget| {
        Textures::open(&[named(&path)], folder, &tiles, budget).map(|textures| (textures, path))
    };
    let text_at = |start: u64, length: u64| ImageMap::base64_inside("a.gltf", start..start + length).path;
    // The picture, then with something around it; plain, and as some write it into JSON.
    let around = [&[1, 2][..], &png, &[4; 9]].concat();
    let length = png.len() as u64;
    for (bytes, part) in [(&png, None), (&around, Some(2..2 + length))] {
        let plain = STANDARD.encode(bytes);
        for text in [plain.replace('/', r"\/").replace('=', r"\u003d"), plain] {
            fs::write(folder.join("a.gltf"), format!("[\"{text}\"]")).unwrap();
            let path = text_at(2, text.len() as u64);
            let path = part.clone().map_or(path.clone(), |part| ImageMap::inside(&path, part).path);
            let (textures, path) = open(path, &budget).unwrap();
            let expected = Textures::in_memory([(key(&path, Encoding::Srgb), picture.clone())]);
            assert_eq!(textures, expected.unwrap());
        }
    }
    // The last text stands there plainly.
    let text_length = STANDARD.encode(&around).len() as u64;
    let whole = text_at(2, text_length);
    let far = u64::MAX - text_length;
    for path in [
        text_at(1, text_length),
        text_at(2, text_length + 1),
        text_at(2, text_length / 2 / 4 * 4),
        text_at(2, text_length + 3),
        text_at(far, text_length),
        text_at(2, 0),
        whole.clone(),
        ImageMap::inside(&whole, 2..around.len() as u64 + 1).path,
        ImageMap::inside(&whole, 2..length / 2).path,
    ] {
        let error = open(path.clone(), &budget).unwrap_err();
        assert!(matches!(error, TextureError::Image { .. }), "{path}: {error}");
        assert!(error.to_string().contains("a.gltf"), "{error}");
    }
    // A text that the budget has no room for is not read.
    fs::write(folder.join("a.gltf"), vec![b'A'; 1 << 20]).unwrap();
    assert!(matches!(open(text_at(0, 1 << 20), &budget), Err(TextureError::Budget(_))));
    assert_eq!(budget.used(), Bytes(0));
}

#[test]
fn image_files_are_converted_once_and_again_when_they_change() {
    let place = tempfile::tempdir().unwrap();
    let (folder, tiles) = (place.path(), place.path().join("model.tiles"));
    let picture = image(150, 90, pattern);
    write_png(&folder.join("a.png"), &picture, png::ColorType::Rgba, picture.texels.as_flattened());
    let grey = image(10, 10, |x, y| [(x * y) as u8; 4]);
    let bytes: Vec<u8> = grey.texels.iter().map(|texel| texel[0]).collect();
    write_png(&folder.join("b.png"), &grey, png::ColorType::Grayscale, &bytes);
    let materials = [named("a.png"), named("b.png"), named("a.png")];
    let budget = MemoryBudget::new(Bytes::mib(2));
    let textures = Textures::open(&materials, folder, &tiles, &budget).unwrap();
    let expected = Textures::in_memory([
        (key("a.png", Encoding::Srgb), picture),
        (
            key("b.png", Encoding::Srgb),
            image(10, 10, |x, y| [(x * y) as u8, (x * y) as u8, (x * y) as u8, 255]),
        ),
    ]);
    assert_eq!(textures, expected.unwrap());
    assert!(textures.has_alpha(TextureId(0)) && !textures.has_alpha(TextureId(1)));
    let written = fs::metadata(&tiles).unwrap().modified().unwrap();
    drop(textures);
    assert_eq!(budget.used(), Bytes(0));
    drop(Textures::open(&materials, folder, &tiles, &budget).unwrap());
    assert_eq!(fs::metadata(&tiles).unwrap().modified().unwrap(), written);
    let other = image(3, 3, pattern);
    write_png(&folder.join("b.png"), &other, png::ColorType::Rgba, other.texels.as_flattened());
    let textures = Textures::open(&materials, folder, &tiles, &budget).unwrap();
    assert_eq!(textures.size(TextureId(1)), [3, 3]);
}

#[test]
fn a_file_that_somebody_else_converts_to_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let picture = image(8, 8, pattern);
    let bytes: Vec<u8> = picture.texels.iter().flatten().copied().collect();
    write_png(&folder.path().join("a.png"), &picture, png::ColorType::Rgba, &bytes);
    let [tiles, partial] = ["tiles", "tiles.partial"].map(|name| folder.path().join(name));
    let open = || {
        Textures::open(&[named("a.png")], folder.path(), &tiles, &MemoryBudget::new(Bytes::mib(8))).unwrap()
    };
    // A lock holds between files opened in one process, too.
    let other = crate::compile::open_locked(&partial).unwrap().unwrap();
    other.set_len(5).unwrap();
    open();
    assert_eq!(fs::metadata(&partial).unwrap().len(), 5);
    // What nobody holds is stale, and taken over.
    drop(other);
    fs::remove_file(&tiles).unwrap();
    open();
    assert!(!partial.exists() && tiles.exists());
}

#[test]
fn what_cannot_be_read_is_named() {
    let place = tempfile::tempdir().unwrap();
    let (folder, tiles) = (place.path(), place.path().join("tiles"));
    let budget = MemoryBudget::new(Bytes::mib(2));
    let open = |name: &str, budget: &MemoryBudget| {
        Textures::open(&[named(name)], folder, &tiles, budget).unwrap_err()
    };
    assert!(matches!(open("missing.png", &budget), TextureError::Io { .. }));
    fs::write(folder.join("text.png"), "no image").unwrap();
    assert!(open("text.png", &budget).to_string().contains("text.png is neither a PNG nor a JPEG image"));
    let picture = image(500, 40, pattern);
    write_png(&folder.join("a.png"), &picture, png::ColorType::Rgba, picture.texels.as_flattened());
    assert!(matches!(open("a.png", &MemoryBudget::new(Bytes::kib(300))), TextureError::Budget(_)));
    let bytes = fs::read(folder.join("a.png")).unwrap();
    for length in [4, 20, 60, bytes.len() / 2] {
        fs::write(folder.join("short.png"), &bytes[..length]).unwrap();
        assert!(matches!(open("short.png", &budget), TextureError::Image { .. }), "{length}");
    }
    // Nothing is left behind.
    assert!(!tiles.exists() && fs::read_dir(folder).unwrap().count() == 3);
    let few = PixelImage { width: 2, height: 2, texels: vec![[0; 4]; 3] };
    assert!(Textures::in_memory([(key("few", Encoding::Srgb), few)]).is_err());
}

/// Opening a pipe waits until somebody writes to it.
#[cfg(unix)]
#[test]
fn an_image_that_is_a_pipe_is_refused() {
    let place = tempfile::tempdir().unwrap();
    let folder = place.path().to_path_buf();
    let made = std::process::Command::new("mkfifo").arg(folder.join("a.png")).status().unwrap();
    assert!(made.success());
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let budget = MemoryBudget::new(Bytes::mib(2));
        let opened = Textures::open(&[named("a.png")], &folder, &folder.join("tiles"), &budget);
        let _ = sender.send(opened.map(|_| ()));
    });
    let outcome = receiver.recv_timeout(std::time::Duration::from_secs(20)).expect("it waits for the pipe");
    assert!(matches!(outcome, Err(TextureError::Image { .. })), "{outcome:?}");
}

#[test]
fn damaged_files_of_tiles_are_noticed() {
    let place = tempfile::tempdir().unwrap();
    let (folder, tiles) = (place.path(), place.path().join("tiles"));
    let picture = image(100, 70, pattern);
    write_png(&folder.join("a.png"), &picture, png::ColorType::Rgba, picture.texels.as_flattened());
    let budget = MemoryBudget::new(Bytes::mib(4));
    let textures = Textures::open(&[named("a.png")], folder, &tiles, &budget).unwrap();
    let tile_count = textures.tile_count() as usize;
    let file = fs::read(&tiles).unwrap();
    let damaged = folder.join("damaged");
    let open = |bytes: &[u8]| {
        fs::write(&damaged, bytes).unwrap();
        Textures::open_file(&damaged, &budget)
    };
    open(&file).unwrap();
    let tiles_end = HEADER_BYTES + tile_count * TILE_BYTES;
    for length in (0..HEADER_BYTES).chain((tiles_end - 5..file.len()).step_by(3)) {
        assert!(matches!(open(&file[..length]), Err(TextureError::Damaged { .. })), "{length}");
    }
    assert!(open(&[&file[..], &[0]].concat()).is_err());
    for at in (0..HEADER_BYTES).chain(tiles_end..file.len()) {
        let mut bytes = file.clone();
        bytes[at] ^= 1 << (at % 8);
        assert!(matches!(open(&bytes), Err(TextureError::Damaged { .. })), "{at}");
    }
    // In a tile: told when it is looked up.
    let mut bytes = file.clone();
    bytes[HEADER_BYTES + 100] ^= 4;
    let textures = Arc::new(open(&bytes).unwrap());
    let cache = TextureCache::open(textures, Bytes(0), 1, &budget).unwrap();
    let mut reader = cache.reader();
    let upper_left = reader.sample(TextureId(0), [0.01, 0.99], 0.0, Address::Clamp);
    assert!(matches!(upper_left, Err(LoadError::Texture(_))));
    reader.sample(TextureId(0), [0.99, 0.01], 0.0, Address::Clamp).unwrap();
    assert!(matches!(
        TextureCache::open(Arc::clone(cache.textures()), Bytes(0), 1, &MemoryBudget::new(Bytes::kib(100))),
        Err(error) if error.needed > error.available
    ));
}

#[cfg(feature = "jpeg")]
#[test]
fn jpeg_images_are_read() {
    // A grey square of 8 x 8 pixels, the shortest that a common encoder writes.
    let bytes = include_bytes!("tests_grey.jpg");
    let place = tempfile::tempdir().unwrap();
    fs::write(place.path().join("a.jpg"), bytes).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(4));
    let tiles = place.path().join("tiles");
    let textures = Textures::open(&[named("a.jpg")], place.path(), &tiles, &budget).unwrap();
    assert_eq!((textures.size(TextureId(0)), textures.has_alpha(TextureId(0))), ([8, 8], false));
    let cache = open(&textures, Bytes::mib(1));
    let grey = cache.reader().sample(TextureId(0), [0.5, 0.5], 0.0, Address::Clamp).unwrap();
    // 128 in sRGB.
    assert!(grey[..3].iter().all(|channel| (channel - 0.2158).abs() < 0.01), "{grey:?}");
}
