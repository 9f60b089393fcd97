//! The fixed header of a compiled file. `docs/format.md` has the same table.

use super::attributes::PAGE_ENTRY_BYTES;
use super::directory::{ENTRY_BYTES, Fields, is_sound, put_aabb};
use super::{CompileRecord, PrecisionOrigin, SourceRecord};
use crate::block::{BLOCK_HEADER_BYTES, BlockLimits, Codec, checksum};
use crate::error::ModelError;
use crate::geom::{Aabb, Lattice, Precision};

/// Bytes of the header; the first block starts here.
pub const HEADER_BYTES: usize = 256;

/// The version of the format that this library writes and reads.
pub const FORMAT_VERSION: u32 = 3;

/// First bytes of a compiled file. The high bit, the line ends and the control-Z show a file that went through a text
/// conversion, as in PNG.
pub(super) const SIGNATURE: [u8; 12] = *b"\x89outcrop\r\n\x1a\n";

/// Blocks of the file may be compressed with zstd.
pub(super) const FEATURE_ZSTD: u64 = 1;

/// The file has pages of attributes.
pub(super) const FEATURE_ATTRIBUTES: u64 = 2;

/// Materials name images.
pub(super) const FEATURE_IMAGES: u64 = 4;

/// The header tells with which options the file was compiled.
pub(super) const FEATURE_RECORD: u64 = 8;

const FEATURES_KNOWN: u64 = FEATURE_ZSTD | FEATURE_ATTRIBUTES | FEATURE_IMAGES | FEATURE_RECORD;

/// Where the header's own checksum starts: its last eight bytes.
const CHECKSUM_AT: usize = HEADER_BYTES - 8;

/// Bytes in use before the reserved ones.
const USED_BYTES: usize = 180;

/// Bytes in use in a file with attributes, and in one with images.
const USED_WITH_ATTRIBUTES: usize = 208;
const USED_WITH_IMAGES: usize = 232;

/// The header in memory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Header {
    pub features: u64,
    pub precision: Precision,
    pub limits: BlockLimits,
    pub bounds: Aabb,
    pub triangle_count: u64,
    pub block_count: u32,
    pub material_count: u32,
    /// Start, length and checksum.
    pub directory: Section,
    pub materials: Section,
    pub source: SourceRecord,
    /// The directory of the pages of attributes, and how many there are; none without [`FEATURE_ATTRIBUTES`].
    pub attributes: Option<(Section, u32)>,
    /// The table of the materials' images; none without [`FEATURE_IMAGES`].
    pub images: Option<Section>,
    /// How the file was compiled; none without [`FEATURE_RECORD`].
    pub compiled: Option<CompileRecord>,
}

/// A part of the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Section {
    pub offset: u64,
    pub bytes: u64,
    pub checksum: u64,
}

impl Section {
    pub fn end(self) -> Option<u64> {
        self.offset.checked_add(self.bytes)
    }
}

/// The shortest entry of the material table.
pub(super) const MATERIAL_BYTES_MIN: u64 = 76;

impl Header {
    pub fn to_bytes(self) -> [u8; HEADER_BYTES] {
        let mut out = Vec::with_capacity(HEADER_BYTES);
        out.extend_from_slice(&SIGNATURE);
        out.extend_from_slice(&FORMAT_VERSION.to_le_bytes());
        out.extend_from_slice(&self.features.to_le_bytes());
        out.extend_from_slice(&(HEADER_BYTES as u32).to_le_bytes());
        out.extend_from_slice(&self.limits.block_bytes_max.to_le_bytes());
        let (kind, exponent) = match self.precision {
            Precision::Float32 => (0u32, 0),
            Precision::Lattice(lattice) => (1, lattice.exponent),
        };
        out.extend_from_slice(&kind.to_le_bytes());
        out.extend_from_slice(&exponent.to_le_bytes());
        put_aabb(&self.bounds, &mut out);
        out.extend_from_slice(&self.triangle_count.to_le_bytes());
        out.extend_from_slice(&self.block_count.to_le_bytes());
        out.extend_from_slice(&self.material_count.to_le_bytes());
        for section in [self.directory, self.materials] {
            let fields = [section.offset, section.bytes, section.checksum];
            out.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
        }
        let SourceRecord { file_bytes, modified_ns, fingerprint } = self.source;
        out.extend([file_bytes, modified_ns, fingerprint].iter().flat_map(|field| field.to_le_bytes()));
        out.extend_from_slice(&(BLOCK_HEADER_BYTES as u16).to_le_bytes());
        out.extend_from_slice(&(ENTRY_BYTES as u16).to_le_bytes());
        debug_assert_eq!(out.len(), USED_BYTES);
        if let Some((section, page_count)) = self.attributes {
            let fields = [section.offset, section.bytes, section.checksum];
            out.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
            out.extend_from_slice(&page_count.to_le_bytes());
            debug_assert_eq!(out.len(), USED_WITH_ATTRIBUTES);
        }
        if let Some(section) = self.images {
            out.resize(USED_WITH_ATTRIBUTES, 0);
            let fields = [section.offset, section.bytes, section.checksum];
            out.extend(fields.iter().flat_map(|field| field.to_le_bytes()));
            debug_assert_eq!(out.len(), USED_WITH_IMAGES);
        }
        if let Some(CompileRecord { precision, skipped }) = self.compiled {
            out.resize(USED_WITH_IMAGES, 0);
            out.extend_from_slice(&origin_code(precision).to_le_bytes());
            out.extend_from_slice(&skipped.to_le_bytes());
            debug_assert_eq!(out.len(), CHECKSUM_AT);
        }
        out.resize(CHECKSUM_AT, 0);
        out.extend_from_slice(&checksum(&out).to_le_bytes());
        let mut bytes = [0; HEADER_BYTES];
        bytes.copy_from_slice(&out);
        bytes
    }

    /// Reads the header of a file of `file_bytes` bytes. Signature and version come first, so that another kind of
    /// file or a newer version is called that and not damaged.
    pub fn parse(bytes: &[u8; HEADER_BYTES], file_bytes: u64) -> Result<Header, ModelError> {
        let damaged = |offset, reason| ModelError::Damaged { part: "header", offset, reason };
        let require = |holds, offset, reason| if holds { Ok(()) } else { Err(damaged(offset, reason)) };
        let mut fields = Fields(bytes);
        if fields.take() != SIGNATURE {
            return Err(ModelError::NotCompiled);
        }
        let version = fields.u32();
        if version != FORMAT_VERSION {
            return Err(ModelError::Version { found: version, supported: FORMAT_VERSION });
        }
        let mut stored = [0; 8];
        stored.copy_from_slice(&bytes[CHECKSUM_AT..]);
        let intact = u64::from_le_bytes(stored) == checksum(&bytes[..CHECKSUM_AT]);
        require(intact, CHECKSUM_AT as u64, "its checksum is wrong")?;
        let features = fields.u64();
        if features & !FEATURES_KNOWN != 0 {
            return Err(ModelError::Feature { feature: "a feature of a later version" });
        }
        if features & FEATURE_ZSTD != 0 && !Codec::Zstd.is_available() {
            return Err(ModelError::Feature { feature: "the block codec zstd (feature `zstd`)" });
        }
        require(fields.u32() as usize == HEADER_BYTES, 24, "it has a wrong length")?;
        let limits = BlockLimits { block_bytes_max: fields.u32() };
        limits.validate().map_err(|reason| damaged(28, reason))?;
        let precision = match (fields.u32(), fields.u32() as i32) {
            (0, 0) => Precision::Float32,
            (1, exponent @ Lattice::EXPONENT_MIN..=Lattice::EXPONENT_MAX) => {
                Precision::Lattice(Lattice { exponent })
            }
            _ => return Err(damaged(32, "its precision is unknown")),
        };
        let bounds = fields.aabb();
        require(is_sound(&bounds), 40, "the box of the model is not a box")?;
        let triangle_count = fields.u64();
        let (block_count, material_count) = (fields.u32(), fields.u32());
        let mut section = || Section { offset: fields.u64(), bytes: fields.u64(), checksum: fields.u64() };
        let (directory, materials) = (section(), section());
        let source =
            SourceRecord { file_bytes: fields.u64(), modified_ns: fields.u64(), fingerprint: fields.u64() };
        let sizes = [usize::from(fields.u16()), usize::from(fields.u16())];
        require(sizes == [BLOCK_HEADER_BYTES, ENTRY_BYTES], 176, "it has entries of a wrong length")?;
        let has_attributes = features & FEATURE_ATTRIBUTES != 0;
        let attributes = has_attributes.then(|| {
            let section = Section { offset: fields.u64(), bytes: fields.u64(), checksum: fields.u64() };
            (section, fields.u32())
        });
        let has_images = features & FEATURE_IMAGES != 0;
        let mut fields = Fields(&bytes[USED_WITH_ATTRIBUTES..]);
        let images =
            has_images.then(|| Section { offset: fields.u64(), bytes: fields.u64(), checksum: fields.u64() });
        let has_record = features & FEATURE_RECORD != 0;
        let mut fields = Fields(&bytes[USED_WITH_IMAGES..]);
        let compiled = if has_record {
            let precision = origin_of(fields.u64());
            let precision = precision.ok_or(damaged(232, "how its precision was chosen is unknown"))?;
            Some(CompileRecord { precision, skipped: fields.u64() })
        } else {
            None
        };
        let is_clear = |from: usize, to: usize| bytes[from..to].iter().all(|byte| *byte == 0);
        let first = if has_attributes { USED_WITH_ATTRIBUTES } else { USED_BYTES };
        let second = if has_images { USED_WITH_IMAGES } else { USED_WITH_ATTRIBUTES };
        let third = if has_record { CHECKSUM_AT } else { USED_WITH_IMAGES };
        let are_clear = is_clear(first, USED_WITH_ATTRIBUTES)
            && is_clear(second, USED_WITH_IMAGES)
            && is_clear(third, CHECKSUM_AT);
        require(are_clear, first as u64, "a reserved byte is not zero")?;

        // Counts are refuted by the length of the file before anything is allocated by them (I5).
        require(block_count >= 1, 96, "it has no blocks")?;
        require((1..=1 << 16).contains(&material_count), 100, "it has an impossible number of materials")?;
        let directory_bytes = u64::from(block_count) * ENTRY_BYTES as u64;
        require(
            directory.bytes == directory_bytes,
            112,
            "the directory does not have one entry for each block",
        )?;
        require(
            materials.bytes >= u64::from(material_count) * MATERIAL_BYTES_MIN,
            136,
            "the material table is shorter than its count",
        )?;
        let block_bytes_min = u64::from(block_count) * BLOCK_HEADER_BYTES as u64;
        let blocks_end = directory.offset.checked_sub(HEADER_BYTES as u64);
        require(
            blocks_end.is_some_and(|bytes| bytes >= block_bytes_min),
            104,
            "the blocks do not fit before it",
        )?;
        require(directory.end() == Some(materials.offset), 128, "the materials do not follow the directory")?;
        let mut end = materials.end();
        if let Some((section, page_count)) = attributes {
            require(end == Some(section.offset), 180, "the pages' directory does not follow the materials")?;
            let bytes = u64::from(page_count) * PAGE_ENTRY_BYTES as u64;
            require(page_count >= 1 && section.bytes == bytes, 188, "there is not one entry for each page")?;
            end = section.end();
        }
        if let Some(section) = images {
            require(end == Some(section.offset), 208, "the images do not follow what is before them")?;
            require(section.bytes >= 1, 216, "there are no images")?;
            end = section.end();
        }
        require(end == Some(file_bytes), 136, "the file has not the length that it should have")?;
        Ok(Header {
            features,
            precision,
            limits,
            bounds,
            triangle_count,
            block_count,
            material_count,
            directory,
            materials,
            source,
            attributes,
            images,
            compiled,
        })
    }
}

fn origin_code(origin: PrecisionOrigin) -> u64 {
    match origin {
        PrecisionOrigin::Given => 0,
        PrecisionOrigin::Automatic { tolerance_met: true } => 1,
        PrecisionOrigin::Automatic { tolerance_met: false } => 2,
    }
}

fn origin_of(code: u64) -> Option<PrecisionOrigin> {
    match code {
        0 => Some(PrecisionOrigin::Given),
        1 => Some(PrecisionOrigin::Automatic { tolerance_met: true }),
        2 => Some(PrecisionOrigin::Automatic { tolerance_met: false }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(compiled: Option<CompileRecord>) -> Header {
        let blocks = BLOCK_HEADER_BYTES as u64;
        let directory =
            Section { offset: HEADER_BYTES as u64 + blocks, bytes: ENTRY_BYTES as u64, checksum: 1 };
        let materials =
            Section { offset: directory.offset + directory.bytes, bytes: MATERIAL_BYTES_MIN, checksum: 2 };
        Header {
            features: if compiled.is_some() { FEATURE_RECORD } else { 0 },
            precision: Precision::Float32,
            limits: BlockLimits { block_bytes_max: 65536 },
            bounds: Aabb { min: [0.0; 3], max: [1.0; 3] },
            triangle_count: 1,
            block_count: 1,
            material_count: 1,
            directory,
            materials,
            source: SourceRecord::default(),
            attributes: None,
            images: None,
            compiled,
        }
    }

    fn parse(bytes: &[u8; HEADER_BYTES]) -> Result<Header, ModelError> {
        let at = header(None).materials;
        Header::parse(bytes, at.offset + at.bytes)
    }

    #[test]
    fn what_the_compile_tells_comes_back() {
        let origins = [
            PrecisionOrigin::Given,
            PrecisionOrigin::Automatic { tolerance_met: true },
            PrecisionOrigin::Automatic { tolerance_met: false },
        ];
        let records = origins.map(|precision| Some(CompileRecord { precision, skipped: u64::MAX }));
        for compiled in records.into_iter().chain([None]) {
            assert_eq!(parse(&header(compiled).to_bytes()).unwrap(), header(compiled));
        }
    }

    #[test]
    fn who_chose_the_precision_is_known_or_reserved() {
        let record = CompileRecord { precision: PrecisionOrigin::Given, skipped: 0 };
        for (compiled, at) in [(Some(record), 232), (None, 180)] {
            let mut bytes = header(compiled).to_bytes();
            bytes[USED_WITH_IMAGES] = 3;
            let sum = checksum(&bytes[..CHECKSUM_AT]);
            bytes[CHECKSUM_AT..].copy_from_slice(&sum.to_le_bytes());
            let refused = parse(&bytes);
            let found =
                matches!(refused, Err(ModelError::Damaged { part: "header", offset, .. }) if offset == at);
            assert!(found, "{refused:?}");
        }
    }
}
