use std::fs;
use std::io::{self, BufReader};

use super::*;
use crate::budget::MemoryBudget;
use crate::render::tiles::TileGrid;
use crate::units::Bytes;

/// A film with numbers that a sloppy writer would get wrong: not square, dark, bright, negative zero.
fn film() -> Film {
    let grid = TileGrid { width: 7, height: 5, tile_size: 8 };
    let mut film = Film::new(&grid, &MemoryBudget::new(Bytes::mib(1))).unwrap();
    let pixels: Vec<_> = (0..35).map(|i| [i as f32 / 34.0, 1e-7 * i as f32, 3.0 - i as f32 * 0.1]).collect();
    film.set_tile(&grid, 0, &pixels);
    film
}

#[cfg(feature = "png")]
#[test]
fn png_decodes_back() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("picture.PNG");
    let film = film();
    film.write(&path).unwrap();
    let decoder = ::png::Decoder::new(BufReader::new(fs::File::open(&path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    assert!(reader.info().srgb.is_some());
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.width, info.height, info.color_type), (7, 5, ::png::ColorType::Rgb));
    let srgb = srgb::Encoder::new();
    let expected: Vec<u8> =
        film.pixels().as_flattened().iter().map(|channel| srgb.encode(*channel)).collect();
    assert_eq!(bytes, expected);
}

#[cfg(feature = "exr")]
#[test]
fn exr_decodes_back_bit_for_bit() {
    use ::exr::prelude::*;
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("picture.exr");
    let film = film();
    film.write(&path).unwrap();
    let image = read_first_rgba_layer_from_file(
        &path,
        |size, _| vec![[0.0f32; 3]; size.area()],
        |pixels, at, (red, green, blue, _alpha): (f32, f32, f32, f32)| {
            pixels[at.y() * 7 + at.x()] = [red, green, blue];
        },
    )
    .unwrap();
    assert_eq!(image.layer_data.size, Vec2(7, 5));
    assert_eq!(image.layer_data.channel_data.pixels, film.pixels());
}

#[test]
fn pfm_decodes_back_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("picture.pfm");
    let film = film();
    film.write(&path).unwrap();
    let bytes = fs::read(&path).unwrap();
    let header = b"PF\n7 5\n-1.0\n";
    assert!(bytes.starts_with(header));
    let numbers: Vec<f32> = bytes[header.len()..]
        .chunks_exact(4)
        .map(|four| f32::from_le_bytes(four.try_into().unwrap()))
        .collect();
    let rows: Vec<&[f32]> = numbers.chunks_exact(21).rev().collect();
    assert_eq!(rows.concat(), film.pixels().as_flattened());
}

#[test]
fn a_failed_write_leaves_the_old_file_and_no_other() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("picture.pfm");
    fs::write(&path, "old").unwrap();
    let result = publish::atomically(&path, |file| {
        io::Write::write_all(file, b"half of it")?;
        Err(io::ErrorKind::StorageFull.into())
    });
    assert_eq!(result.unwrap_err().kind(), io::ErrorKind::StorageFull);
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
    film().write(&path).unwrap();
    assert_ne!(fs::read(&path).unwrap(), b"old");
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
}

#[cfg(unix)]
#[test]
fn links_stay_and_pipes_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let place = |name: &str| directory.path().join(name);
    fs::write(place("old.pfm"), "old").unwrap();
    for (link, named) in [("a.pfm", "old.pfm"), ("b.pfm", "new.pfm")] {
        std::os::unix::fs::symlink(named, place(link)).unwrap();
        film().write(place(link)).unwrap();
        assert!(fs::symlink_metadata(place(link)).unwrap().is_symlink());
        film().write(place("expected.pfm")).unwrap();
        assert_eq!(fs::read(place(named)).unwrap(), fs::read(place("expected.pfm")).unwrap());
    }
    assert!(std::process::Command::new("mkfifo").arg(place("pipe.pfm")).status().unwrap().success());
    let error = film().write(place("pipe.pfm")).unwrap_err().to_string();
    assert!(error.contains("pipe.pfm: it is a pipe"), "{error}");
    assert!(!fs::metadata(place("pipe.pfm")).unwrap().is_file());
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 6);
}

#[test]
fn errors_name_the_path() {
    let film = film();
    for bad in ["picture", "picture.jpg", ""] {
        assert!(matches!(film.write(Path::new(bad)), Err(RenderError::Setting { .. })), "{bad}");
    }
    let missing = Path::new("no/such/directory/picture.pfm");
    let error = film.write(missing).unwrap_err();
    assert!(error.to_string().contains("no/such/directory/picture.pfm"), "{error}");
}
