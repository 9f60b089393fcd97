//! Image files to one file of tiles beside the compiled model.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::decode::{Place, Rows, decode};
use super::file::{HEADER_BYTES, Textures, sealed};
use super::layout::{Encoding, Image, ImageKey, TILE_BYTES, tile_count};
use super::pyramid::{Pyramid, tile_checksum};
use crate::block::checksum;
use crate::budget::{MemoryBudget, Reservation};
use crate::compile::{TemporaryFile, WriteError, write_at};
use crate::error::TextureError;
use crate::model::{ImageMap, MaterialRecord};
use crate::units::Bytes;

/// Longest path of an image.
const PATH_BYTES_MAX: usize = 1 << 12;

impl Textures {
    /// The pictures that `materials` name: from the file `tiles` if it was made from these images as they are now, else converted to it.
    /// `folder` is the model's, from which relative paths start. Conversion takes about 700 bytes of the budget for each texel of the
    /// widest image's width, and a JPEG or interlaced PNG image as a whole.
    ///
    /// # Errors
    /// [`TextureError`] for an image that cannot be read (which names it), a file that cannot be written, or a budget that is too
    /// small. A file that was at `tiles` before is as it was.
    pub fn open(
        materials: &[MaterialRecord],
        folder: &Path,
        tiles: &Path,
        budget: &MemoryBudget,
    ) -> Result<Arc<Textures>, TextureError> {
        let keys = Textures::named_by(materials);
        let wanted = source_key(&keys, folder)?;
        // What is not sound, or of other images, is made again.
        if let Ok(textures) = Textures::open_file(tiles, budget)
            && textures.key() == wanted
        {
            return Ok(Arc::new(textures));
        }
        // Under a name of its own, as somebody else may convert the same images at this moment.
        let partial = TemporaryFile::beside(tiles, ".partial")?;
        write(&keys, folder, &partial, wanted, budget)?;
        partial.publish(tiles)?;
        Textures::open_file(tiles, budget).map(Arc::new)
    }

    /// The pictures that `materials` name, each once, in the order of the materials.
    pub fn named_by(materials: &[MaterialRecord]) -> Vec<ImageKey> {
        let mut keys: Vec<ImageKey> = Vec::new();
        let maps = materials.iter().filter_map(|record| record.images.as_deref());
        for (map, is_color) in maps.flat_map(|images| images.all()) {
            let encoding = if is_color { Encoding::Srgb } else { Encoding::Linear };
            let key = ImageKey { path: PathBuf::from(&map.path), encoding };
            if !keys.contains(&key) {
                keys.push(key);
            }
        }
        keys
    }
}

/// The file of an image, and where in it the image is.
fn place_of(key: &ImageKey, folder: &Path) -> (PathBuf, Place) {
    match key.path.to_str() {
        Some(path) => {
            let (file, part) = ImageMap::file_of(path);
            let (file, text) = ImageMap::text_of(file);
            (folder.join(file), Place { text, part })
        }
        None => (folder.join(&key.path), Place::default()),
    }
}

/// A number that changes when an image does.
fn source_key(keys: &[ImageKey], folder: &Path) -> Result<u64, TextureError> {
    let mut bytes = Vec::new();
    for key in keys {
        let (path, _) = place_of(key, folder);
        let metadata = fs::metadata(&path).map_err(|error| TextureError::Io { path: path.clone(), error })?;
        // Opening a pipe would wait for whoever writes to it.
        if !metadata.is_file() {
            return Err(TextureError::Image { path, reason: "is not a file".to_owned() });
        }
        if key.path.as_os_str().len() > PATH_BYTES_MAX {
            return Err(TextureError::Image { path, reason: "has too long a path".to_owned() });
        }
        let modified =
            metadata.modified().ok().and_then(|time| time.duration_since(std::time::UNIX_EPOCH).ok());
        bytes.extend_from_slice(key.path.to_string_lossy().as_bytes());
        bytes.push(u8::from(key.encoding == Encoding::Linear));
        bytes.extend_from_slice(&metadata.len().to_le_bytes());
        bytes.extend_from_slice(&modified.map_or(0, |time| time.as_nanos() as u64).to_le_bytes());
    }
    Ok(checksum(&bytes))
}

impl From<WriteError> for TextureError {
    fn from(WriteError { path, error }: WriteError) -> TextureError {
        TextureError::Io { path, error }
    }
}

/// Tiles of one image on their way to the file.
struct ToFile<'a> {
    output: &'a TemporaryFile,
    encoding: Encoding,
    checksums: &'a mut Vec<u64>,
    first_tile: u32,
    size: [u32; 2],
    pyramid: Option<Pyramid>,
    budget: &'a MemoryBudget,
    memory: Vec<Reservation>,
}

impl Rows for ToFile<'_> {
    fn start(&mut self, width: u32, height: u32) -> Result<(), TextureError> {
        let tiles = tile_count(width, height);
        let bytes = Pyramid::bytes_needed(width) + 8 * u64::from(tiles);
        let memory = self.budget.reserve(Bytes(bytes), "converting an image to tiles");
        self.memory.push(memory.map_err(TextureError::Budget)?);
        let count = self.first_tile.checked_add(tiles).filter(|count| *count < u32::MAX);
        let count = count.ok_or_else(|| TextureError::Image {
            path: self.output.path().to_path_buf(),
            reason: "would have more than 2^32 tiles".to_owned(),
        })?;
        self.checksums.resize(count as usize, 0);
        self.size = [width, height];
        self.pyramid = Some(Pyramid::new(width, height, self.first_tile, self.encoding));
        Ok(())
    }

    fn row(&mut self, row: &[u8]) -> Result<(), TextureError> {
        let ToFile { output, checksums, pyramid, .. } = self;
        // `start` comes first.
        let Some(pyramid) = pyramid else { return Ok(()) };
        pyramid.push(row, &mut |tile, texels| {
            checksums[tile as usize] = tile_checksum(texels);
            write_at(output.file(), HEADER_BYTES as u64 + u64::from(tile) * TILE_BYTES as u64, texels)
                .map_err(|error| TextureError::Io { path: output.path().to_path_buf(), error })
        })
    }
}

fn write(
    keys: &[ImageKey],
    folder: &Path,
    output: &TemporaryFile,
    source: u64,
    budget: &MemoryBudget,
) -> Result<(), TextureError> {
    let io = |error| TextureError::Io { path: output.path().to_path_buf(), error };
    let (mut images, mut checksums) = (Vec::new(), Vec::new());
    for key in keys {
        let first_tile = checksums.len() as u32;
        let mut rows = ToFile {
            output,
            encoding: key.encoding,
            checksums: &mut checksums,
            first_tile,
            size: [0; 2],
            pyramid: None,
            budget,
            memory: Vec::new(),
        };
        let (path, place) = place_of(key, folder);
        decode(&path, place, budget, &mut rows)?;
        let found = rows.pyramid.as_ref().map(|pyramid| (pyramid.has_alpha, pyramid.extremes));
        let (has_alpha, extremes) = found.unwrap_or((false, [[0, 0, 0, 255], [255; 4]]));
        let [width, height] = rows.size;
        images.push(Image { key: key.clone(), width, height, first_tile, has_alpha, extremes });
    }
    let (header, directory) = sealed(&images, &checksums, source);
    let offset = HEADER_BYTES as u64 + checksums.len() as u64 * TILE_BYTES as u64;
    write_at(output.file(), offset, &directory).map_err(io)?;
    // Last: before that the file is none.
    write_at(output.file(), 0, &header).map_err(io)
}
