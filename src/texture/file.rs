//! The pictures of a model: where their tiles are, and what is known of each.
//!
//! The file, little-endian: header of 64 bytes (signature 12, version u32 = 3, pictures u32, tiles u32, directory offset, length,
//! checksum u64 each, key u64, checksum of all before u64), tiles of 16,384 bytes, directory. A tile is 64 x 64 texels of four
//! bytes, rows from the top. The directory: for each picture its width, height, first tile (u32 each), encoding (u8: 0 sRGB, 1
//! linear), alpha (u8), path length (u16), least and greatest byte of each channel (4 each), path; then a checksum (u64) for each
//! tile. All checksums are XXH3-64. The key tells whether the file was made from these images as they are now.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::layout::{Encoding, Image, ImageKey, Level, SIDE_MAX, TILE_BYTES, TextureId, levels, tile_count};
use super::pyramid::{Pyramid, tile_checksum};
use super::srgb::linear;
use crate::block::checksum;
use crate::budget::{MemoryBudget, Reservation};
use crate::error::TextureError;
use crate::units::Bytes;

pub(super) const HEADER_BYTES: usize = 64;
const SIGNATURE: [u8; 12] = *b"\x89outtiles\r\n\n";
const VERSION: u32 = 3;
/// Longest directory that is read: some million tiles, and paths.
const DIRECTORY_BYTES_MAX: u64 = 1 << 30;

/// A picture in memory: four bytes for each texel (red, green, blue, alpha), rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PixelImage {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// `width * height` texels.
    pub texels: Vec<[u8; 4]>,
}

/// The pictures that the materials of a model name, as tiles. Shared by all who render with them; the tiles themselves come into
/// memory through a [`TextureCache`](super::TextureCache).
pub struct Textures {
    pub(super) images: Vec<Image>,
    pub(super) checksums: Vec<u64>,
    key: u64,
    tiles: Tiles,
    path: PathBuf,
    _memory: Option<Reservation>,
}

enum Tiles {
    File(File),
    Memory(Vec<u8>),
}

impl std::fmt::Debug for Textures {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Textures")
            .field("images", &self.images)
            .field("tiles", &self.checksums.len())
            .finish()
    }
}

impl PartialEq for Textures {
    fn eq(&self, other: &Textures) -> bool {
        (&self.images, &self.checksums) == (&other.images, &other.checksums)
    }
}

/// Where everything is, and the bytes of the two parts that are not tiles.
pub(super) fn sealed(images: &[Image], checksums: &[u64], key: u64) -> ([u8; HEADER_BYTES], Vec<u8>) {
    let mut directory = Vec::new();
    for image in images {
        for field in [image.width, image.height, image.first_tile] {
            directory.extend_from_slice(&field.to_le_bytes());
        }
        directory.push(u8::from(image.key.encoding == Encoding::Linear));
        directory.push(u8::from(image.has_alpha));
        let path = image.key.path.to_string_lossy();
        // Longer ones were refused when they were read.
        directory.extend_from_slice(&(path.len() as u16).to_le_bytes());
        directory.extend_from_slice(image.extremes.as_flattened());
        directory.extend_from_slice(path.as_bytes());
    }
    directory.extend(checksums.iter().flat_map(|sum| sum.to_le_bytes()));
    let offset = HEADER_BYTES as u64 + (checksums.len() * TILE_BYTES) as u64;
    let mut header = Vec::with_capacity(HEADER_BYTES);
    header.extend_from_slice(&SIGNATURE);
    // Pictures and tiles are numbered by 32 bits.
    for field in [VERSION, images.len() as u32, checksums.len() as u32] {
        header.extend_from_slice(&field.to_le_bytes());
    }
    for field in [offset, directory.len() as u64, checksum(&directory), key] {
        header.extend_from_slice(&field.to_le_bytes());
    }
    header.extend_from_slice(&checksum(&header).to_le_bytes());
    let mut bytes = [0; HEADER_BYTES];
    bytes.copy_from_slice(&header);
    (bytes, directory)
}

impl Textures {
    /// Opens a file of tiles.
    ///
    /// # Errors
    /// [`TextureError`] if it cannot be read, is none, is damaged, or its directory does not fit the budget.
    pub(super) fn open_file(path: &Path, budget: &MemoryBudget) -> Result<Textures, TextureError> {
        let io = |error| TextureError::Io { path: path.to_path_buf(), error };
        let damaged = |offset, reason| TextureError::Damaged { path: path.to_path_buf(), offset, reason };
        let file = File::open(path).map_err(io)?;
        let file_bytes = file.metadata().map_err(io)?.len();
        let mut header = [0; HEADER_BYTES];
        if file_bytes < HEADER_BYTES as u64 {
            return Err(damaged(file_bytes, "the file ends inside its header"));
        }
        read_at(&file, 0, &mut header).map_err(io)?;
        let u32_at = |at: usize| u32::from_le_bytes([0, 1, 2, 3].map(|byte| header[at + byte]));
        let u64_at = |at: usize| u64::from(u32_at(at)) | u64::from(u32_at(at + 4)) << 32;
        if header[..12] != SIGNATURE || u32_at(12) != VERSION {
            return Err(damaged(0, "it is not a file of tiles of this version"));
        }
        if checksum(&header[..HEADER_BYTES - 8]) != u64_at(HEADER_BYTES - 8) {
            return Err(damaged(HEADER_BYTES as u64 - 8, "the checksum of its header is wrong"));
        }
        let (image_count, tiles) = (u32_at(16), u32_at(20));
        let (offset, bytes, sum, key) = (u64_at(24), u64_at(32), u64_at(40), u64_at(48));
        let fits = offset == HEADER_BYTES as u64 + u64::from(tiles) * TILE_BYTES as u64
            && offset.checked_add(bytes) == Some(file_bytes)
            && bytes <= DIRECTORY_BYTES_MAX
            && bytes >= 24 * u64::from(image_count) + 8 * u64::from(tiles);
        if !fits {
            return Err(damaged(16, "its counts do not fit its length"));
        }
        let memory =
            budget.reserve(Bytes(3 * bytes), "the directory of textures").map_err(TextureError::Budget)?;
        let mut directory = vec![0; bytes as usize];
        read_at(&file, offset, &mut directory).map_err(io)?;
        if checksum(&directory) != sum {
            return Err(damaged(offset, "the checksum of its directory is wrong"));
        }
        let (images, checksums) =
            parse(&directory, image_count, tiles).ok_or_else(|| damaged(offset, "its directory is wrong"))?;
        let (tiles, path) = (Tiles::File(file), path.to_path_buf());
        Ok(Textures { images, checksums, key, tiles, path, _memory: Some(memory) })
    }

    /// Pictures that never were files, under the names by which materials know them. Takes the tiles' memory from no budget: it
    /// is for small pictures.
    ///
    /// # Errors
    /// [`TextureError::Image`] for a picture whose texels are not as many as its size says, or that is too large.
    pub fn in_memory(
        images: impl IntoIterator<Item = (ImageKey, PixelImage)>,
    ) -> Result<Arc<Textures>, TextureError> {
        let (mut known, mut checksums, mut bytes) = (Vec::new(), Vec::new(), Vec::new());
        for (key, image) in images {
            let PixelImage { width, height, texels } = image;
            let sides = 1..=SIDE_MAX;
            let is_sound = sides.contains(&width)
                && sides.contains(&height)
                && texels.len() as u64 == u64::from(width) * u64::from(height);
            if !is_sound {
                let reason = format!("has {} texels, not {width} x {height}", texels.len());
                return Err(TextureError::Image { path: key.path, reason });
            }
            let first_tile = checksums.len() as u32;
            let mut pyramid = Pyramid::new(width, height, first_tile, key.encoding);
            let count = checksums.len() + tile_count(width, height) as usize;
            checksums.resize(count, 0);
            bytes.resize(count * TILE_BYTES, 0);
            for row in texels.chunks_exact(width as usize) {
                pyramid
                    .push::<std::convert::Infallible>(row.as_flattened(), &mut |tile, texels| {
                        checksums[tile as usize] = tile_checksum(texels);
                        bytes[tile as usize * TILE_BYTES..][..TILE_BYTES].copy_from_slice(texels);
                        Ok(())
                    })
                    .unwrap_or_else(|never| match never {});
            }
            let Pyramid { has_alpha, extremes, .. } = pyramid;
            known.push(Image { key, width, height, first_tile, has_alpha, extremes });
        }
        let (tiles, path) = (Tiles::Memory(bytes), PathBuf::from("textures in memory"));
        Ok(Arc::new(Textures { images: known, checksums, key: 0, tiles, path, _memory: None }))
    }

    /// What the file was made from.
    pub(super) fn key(&self) -> u64 {
        self.key
    }

    /// How many pictures there are.
    pub fn image_count(&self) -> usize {
        self.images.len()
    }

    /// How many tiles they have together, of 16 KiB each.
    pub fn tile_count(&self) -> u32 {
        self.checksums.len() as u32
    }

    /// The picture of that file and encoding.
    pub fn find(&self, path: &str, encoding: Encoding) -> Option<TextureId> {
        let is_it = |image: &Image| image.key.encoding == encoding && image.key.path == Path::new(path);
        // Pictures are numbered by 32 bits.
        self.images.iter().position(is_it).map(|place| TextureId(place as u32))
    }

    /// Width and height of a picture.
    ///
    /// # Panics
    /// If there is no such picture.
    pub fn size(&self, texture: TextureId) -> [u32; 2] {
        let image = &self.images[texture.0 as usize];
        [image.width, image.height]
    }

    /// Whether any texel of a picture is not opaque.
    ///
    /// # Panics
    /// If there is no such picture.
    pub fn has_alpha(&self, texture: TextureId) -> bool {
        self.images[texture.0 as usize].has_alpha
    }

    /// The least and the greatest number of red, green and blue that any texel of a picture has, as lookups give them. Those
    /// between texels and of smaller sizes are means, and so lie between them up to rounding; where the two are the same, every
    /// lookup gives just that.
    ///
    /// # Panics
    /// If there is no such picture.
    pub(crate) fn color_ranges(&self, texture: TextureId) -> [[f64; 2]; 3] {
        let Image { extremes, key, .. } = &self.images[texture.0 as usize];
        let number = |byte: u8| f64::from(linear(key.encoding, f64::from(byte)));
        [0, 1, 2].map(|channel| extremes.map(|bytes| number(bytes[channel])))
    }

    pub(super) fn levels(&self, texture: TextureId) -> impl Iterator<Item = Level> + Clone + use<> {
        let image = &self.images[texture.0 as usize];
        levels(image.width, image.height, image.first_tile)
    }

    /// Reads and checks a tile.
    pub(super) fn read_tile(&self, tile: u32, into: &mut [u8]) -> Result<(), TextureError> {
        let into = &mut into[..TILE_BYTES];
        let at = u64::from(tile) * TILE_BYTES as u64;
        match &self.tiles {
            Tiles::File(file) => read_at(file, HEADER_BYTES as u64 + at, into)
                .map_err(|error| TextureError::Io { path: self.path.clone(), error })?,
            Tiles::Memory(bytes) => into.copy_from_slice(&bytes[at as usize..][..TILE_BYTES]),
        }
        if tile_checksum(into) == self.checksums[tile as usize] {
            return Ok(());
        }
        let reason = "the checksum of a tile is wrong";
        Err(TextureError::Damaged { path: self.path.clone(), offset: HEADER_BYTES as u64 + at, reason })
    }
}

/// Reads a directory whose length fits the counts; `None` if anything in it is wrong.
fn parse(bytes: &[u8], image_count: u32, tiles: u32) -> Option<(Vec<Image>, Vec<u64>)> {
    let mut rest = bytes;
    let mut images = Vec::new();
    let mut next_tile = 0u32;
    for _ in 0..image_count {
        let (head, after) = rest.split_first_chunk::<24>()?;
        let field = |at: usize| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]);
        let (width, height, first_tile) = (field(0), field(4), field(8));
        let encoding = match head[12] {
            0 => Encoding::Srgb,
            1 => Encoding::Linear,
            _ => return None,
        };
        let (path, after) = after.split_at_checked(usize::from(u16::from_le_bytes([head[14], head[15]])))?;
        let sides = 1..=SIDE_MAX;
        if !sides.contains(&width) || !sides.contains(&height) || first_tile != next_tile || head[13] > 1 {
            return None;
        }
        next_tile = next_tile.checked_add(tile_count(width, height))?;
        let key = ImageKey { path: PathBuf::from(std::str::from_utf8(path).ok()?), encoding };
        let extremes = [16, 20].map(|at| [0, 1, 2, 3].map(|channel| head[at + channel]));
        let has_alpha = head[13] == 1;
        let is_opaque = extremes[0][3] == 255;
        if has_alpha == is_opaque || (0..4).any(|channel| extremes[0][channel] > extremes[1][channel]) {
            return None;
        }
        images.push(Image { key, width, height, first_tile, has_alpha, extremes });
        rest = after;
    }
    let sums = rest.as_chunks::<8>();
    let is_whole = next_tile == tiles && sums.1.is_empty() && sums.0.len() == tiles as usize;
    is_whole.then(|| (images, sums.0.iter().map(|sum| u64::from_le_bytes(*sum)).collect()))
}

/// Fills `into` from `offset` on.
pub(super) fn read_at(file: &File, offset: u64, into: &mut [u8]) -> std::io::Result<()> {
    #[cfg(unix)]
    return std::os::unix::fs::FileExt::read_exact_at(file, into, offset);
    #[cfg(windows)]
    {
        use std::os::windows::fs::FileExt;
        let mut done = 0;
        while done < into.len() {
            match file.seek_read(&mut into[done..], offset + done as u64)? {
                0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
                count => done += count,
            }
        }
        Ok(())
    }
}
