//! Environment images from OpenEXR files. The file is untrusted (I5): its size is read, checked and reserved first.

use std::fs::File;
use std::io::{BufReader, Seek};
use std::path::Path;

use exr::meta::header::Header;
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::*;

use super::EnvironmentImage;
use crate::budget::MemoryBudget;
use crate::error::RenderError;
use crate::units::Bytes;

pub(super) fn read(path: &Path, budget: &MemoryBudget) -> std::result::Result<EnvironmentImage, RenderError> {
    let failed = |reason: String| RenderError::Read { path: path.to_path_buf(), reason };
    let file = File::open(path).map_err(|error| failed(error.to_string()))?;
    let mut file = BufReader::new(file);
    // Pedantic: what the specification forbids is refused.
    let meta = MetaData::read_from_buffered(&mut file, true).map_err(|error| failed(error.to_string()))?;
    // The largest part is as good a bound as the first with colours; both parts and channels are few in such files.
    let mut largest = [0u32; 2];
    for header in &meta.headers {
        let size = [header.layer_size.width(), header.layer_size.height()]
            .map(|side| u32::try_from(side).unwrap_or(u32::MAX));
        EnvironmentImage::bytes_needed(size[0], size[1])?;
        largest = [largest[0].max(size[0]), largest[1].max(size[1])];
    }
    let reservation =
        budget.reserve(EnvironmentImage::bytes_needed(largest[0], largest[1])?, "the environment image")?;
    let unpacking = meta.headers.iter().map(unpacking_bytes).max().unwrap_or(0);
    let _unpacking = budget.reserve(Bytes(unpacking), "unpacking the environment image")?;
    file.rewind().map_err(|error| failed(error.to_string()))?;
    struct Pixels {
        width: usize,
        pixels: Vec<[f32; 3]>,
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| Pixels { width: size.width(), pixels: vec![[0.0; 3]; size.area()] },
            |image, at, (red, green, blue): (f32, f32, f32)| {
                image.pixels[at.y() * image.width + at.x()] = [red, green, blue];
            },
        )
        .first_valid_layer()
        .all_attributes()
        // One thread: the caller did not ask for more (I8).
        .non_parallel()
        .from_buffered(file)
        .map_err(|error| failed(error.to_string()))?;
    let size = image.layer_data.size;
    let [width, height] = [size.width(), size.height()].map(|side| side as u32);
    EnvironmentImage::with_reservation(
        width,
        height,
        image.layer_data.channel_data.pixels.pixels,
        reservation,
    )
}

/// What unpacking the pixels that are packed together takes, which is as much as the file likes: they, what they are unpacked from and
/// what stands between the two.
fn unpacking_bytes(header: &Header) -> u64 {
    let [width, height] = [header.layer_size.width(), header.layer_size.height()].map(|side| side as u64);
    let pixels = match header.blocks {
        BlockDescription::ScanLines => {
            width.saturating_mul(height.min(header.compression.scan_lines_per_block() as u64))
        }
        BlockDescription::Tiles(tiles) => {
            let [across, down] = [tiles.tile_size.width(), tiles.tile_size.height()].map(|side| side as u64);
            width.min(across).saturating_mul(height.min(down))
        }
    };
    pixels.saturating_mul(header.channels.bytes_per_pixel as u64).saturating_mul(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(folder: &Path) -> std::path::PathBuf {
        let path = folder.join("sky.exr");
        let channels = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, at.y() as f32, 0.25f32));
        Image::from_channels((6, 4), channels).write().non_parallel().to_file(&path).unwrap();
        path
    }

    #[test]
    fn a_written_picture_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let budget = MemoryBudget::new(Bytes::mib(1));
        let image = EnvironmentImage::read(written(folder.path()), &budget).unwrap();
        assert_eq!((image.size(), image.radiance_max()), ([6, 4], [5.0, 3.0, 0.25]));
        assert_eq!(budget.used(), EnvironmentImage::bytes_needed(6, 4).unwrap());
    }

    #[test]
    fn what_a_file_packs_together_is_reserved_while_it_is_unpacked() {
        let folder = tempfile::tempdir().unwrap();
        let needed = EnvironmentImage::bytes_needed(256, 256).unwrap();
        let path = folder.path().join("tile.exr");
        for blocks in
            [Blocks::ScanLines, Blocks::Tiles(Vec2(256, 256)), Blocks::Tiles(Vec2(1 << 20, 1 << 20))]
        {
            let channels = SpecificChannels::rgb(|_: Vec2<usize>| (1.0f32, 2.0f32, 3.0f32));
            let encoding = exr::image::Encoding { blocks, ..exr::image::Encoding::SMALL_LOSSLESS };
            let layer = Layer::new((256, 256), LayerAttributes::named("sky"), encoding, channels);
            Image::from_layer(layer).write().non_parallel().to_file(&path).unwrap();
            let small = MemoryBudget::new(Bytes(needed.0 + (16 << 10)));
            let refused = EnvironmentImage::read(&path, &small);
            assert!(matches!(refused, Err(RenderError::Budget(_))), "{blocks:?}");
            let budget = MemoryBudget::new(Bytes::mib(8));
            let image = EnvironmentImage::read(&path, &budget).unwrap();
            assert_eq!((image.radiance_max(), budget.used()), ([1.0, 2.0, 3.0], needed), "{blocks:?}");
        }
    }

    #[test]
    fn damaged_files_are_errors_and_reserve_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let budget = MemoryBudget::new(Bytes::mib(1));
        let whole = std::fs::read(written(folder.path())).unwrap();
        let path = folder.path().join("damaged.exr");
        let mut refused = 0;
        for at in 0..whole.len() {
            std::fs::write(&path, &whole[..at]).unwrap();
            assert!(EnvironmentImage::read(&path, &budget).is_err(), "cut at {at}");
            for bit in [0, 5, 7] {
                let mut flipped = whole.clone();
                flipped[at] ^= 1 << bit;
                std::fs::write(&path, &flipped).unwrap();
                // A flipped bit may be a valid picture of other colours; it must not be worse than that.
                refused += u32::from(EnvironmentImage::read(&path, &budget).is_err());
            }
            assert_eq!(budget.used(), Bytes(0));
        }
        assert!(refused > 100, "{refused}");
        let missing = EnvironmentImage::read(folder.path().join("none.exr"), &budget);
        assert!(matches!(missing, Err(RenderError::Read { .. })));
        std::fs::write(folder.path().join("sky.bmp"), b"BM").unwrap();
        assert!(EnvironmentImage::read(folder.path().join("sky.bmp"), &budget).is_err());
    }
}
