//! From the bytes of a file to a [`Model`]. The bytes are untrusted (I5).

use super::attributes::{AttributePages, PAGE_ENTRY_BYTES, PageEntry};
use super::directory::BlockEntry;
use super::directory::{DirectoryReader, ENTRY_BYTES, EntryContext};
use super::header::{HEADER_BYTES, Header, Section};
use super::material::parse_table;
use super::{Cells, MaterialImages, MaterialRecord, Model};
use crate::error::ModelError;
use crate::units::Bytes;

/// Directory entries that are read at a time.
const CHUNK_BYTES: usize = 512 * ENTRY_BYTES;

/// Reads a model through a function that copies bytes of the file, so that every kind of source parses in the same way.
#[derive(Clone, Copy, Debug)]
pub struct ModelReader;

impl ModelReader {
    /// Reads and checks everything but the blocks. `file_bytes` is the length of the file; `read(what, offset, into)`
    /// fills `into` from `offset`, which lies inside the file together with its end, or fails.
    ///
    /// Allocates the directory (128 bytes for each block), the materials, and 64 KiB; no count is believed before the
    /// length of the file allows for it.
    ///
    /// # Errors
    /// What `read` returned, or [`ModelError`] turned into the caller's error.
    pub fn read<E: From<ModelError>>(
        file_bytes: u64,
        read: impl FnMut(&'static str, u64, &mut [u8]) -> Result<(), E>,
    ) -> Result<Model, E> {
        ModelReader::read_if(file_bytes, |_| Ok(()), read)
    }

    /// As [`ModelReader::read`], but asks first: once the header is read, and before anything that grows with the model is allocated,
    /// `claim` is called with the bytes that the rest takes at most.
    ///
    /// # Errors
    /// As for [`ModelReader::read`], or what `claim` returned: then nothing but the header was read.
    pub fn read_if<E: From<ModelError>>(
        file_bytes: u64,
        claim: impl FnOnce(Bytes) -> Result<(), E>,
        mut read: impl FnMut(&'static str, u64, &mut [u8]) -> Result<(), E>,
    ) -> Result<Model, E> {
        let mut header = [0; HEADER_BYTES];
        let present = usize::try_from(file_bytes).unwrap_or(HEADER_BYTES).min(HEADER_BYTES);
        read("the header", 0, &mut header[..present])?;
        if present < HEADER_BYTES {
            return Err(too_short(&header[..present]).into());
        }
        let header = Header::parse(&header, file_bytes)?;
        claim(bytes_at_most(&header))?;

        let mut chunk = vec![0; CHUNK_BYTES.min(section_bytes(header.directory)?)];
        let mut blocks = Vec::with_capacity(header.block_count as usize);
        let mut directory = DirectoryReader::new(EntryContext {
            limits: header.limits,
            bounds: header.bounds,
            material_count: header.material_count,
        });
        let mut hash = xxhash_rust::xxh3::Xxh3Default::new();
        let Section { offset, bytes, checksum } = header.directory;
        let end = offset + bytes;
        let mut at = offset;
        // The checksum is known only after the last chunk; an entry that is wrong before that is an error either way,
        // and the checksum is the better reason.
        let mut parsed = Ok(());
        while at < end {
            let length = (end - at).min(chunk.len() as u64) as usize;
            let piece = &mut chunk[..length];
            read("the directory", at, piece)?;
            hash.update(piece);
            if parsed.is_ok() {
                parsed = directory.parse(piece, at, &mut blocks);
            }
            at += length as u64;
        }
        let damaged = |part, offset, reason| ModelError::Damaged { part, offset, reason };
        if hash.digest() != checksum {
            return Err(damaged("directory", offset, "its checksum is wrong").into());
        }
        parsed?;
        let blocks_end = directory.end();
        let pages = read_pages(&header, blocks_end, &mut read)?;
        directory
            .finish(if header.attributes.is_some() { blocks_end } else { offset }, header.triangle_count)
            .map_err(|reason| damaged("directory", offset, reason))?;

        let Section { offset, bytes: _, checksum } = header.materials;
        let mut table = vec![0; section_bytes(header.materials)?];
        read("the material table", offset, &mut table)?;
        if crate::block::checksum(&table) != checksum {
            return Err(damaged("material table", offset, "its checksum is wrong").into());
        }
        let mut materials = parse_table(&table, header.material_count, offset)?;
        if let Some(section) = header.images {
            let Section { offset, bytes: _, checksum } = section;
            let mut table = vec![0; section_bytes(section)?];
            read("the table of images", offset, &mut table)?;
            if crate::block::checksum(&table) != checksum {
                return Err(damaged("table of images", offset, "its checksum is wrong").into());
            }
            super::images::parse_table(&table, offset, &mut materials)?;
        }
        Ok(Model {
            precision: header.precision,
            limits: header.limits,
            bounds: header.bounds,
            triangle_count: header.triangle_count,
            blocks,
            cells: Cells::default(),
            materials,
            source: header.source,
            compiled: header.compiled,
            attributes: pages,
        })
    }

    /// As [`ModelReader::read`], from a whole file in memory.
    ///
    /// # Errors
    /// [`ModelError`].
    pub fn parse(file: &[u8]) -> Result<Model, ModelError> {
        ModelReader::read(file.len() as u64, |_, offset, into| {
            // The reader asks only for bytes inside the length that it was given, so `offset` fits.
            let start = offset as usize;
            into.copy_from_slice(&file[start..start + into.len()]);
            Ok(())
        })
    }
}

/// Reads the directory of the pages of attributes, if there is one. The pages lie between the blocks and their directory.
fn read_pages<E: From<ModelError>>(
    header: &Header,
    blocks_end: u64,
    read: &mut impl FnMut(&'static str, u64, &mut [u8]) -> Result<(), E>,
) -> Result<AttributePages, E> {
    let mut pages = AttributePages::default();
    let Some((section, page_count)) = header.attributes else { return Ok(pages) };
    let damaged =
        |reason| ModelError::Damaged { part: "directory of attributes", offset: section.offset, reason };
    let mut chunk = vec![0; (512 * PAGE_ENTRY_BYTES).min(section_bytes(section)?)];
    // The length of the file allows for it: the parser of the header has compared the two.
    pages.reserve(page_count as usize);
    let mut hash = xxhash_rust::xxh3::Xxh3Default::new();
    let (mut at, end) = (section.offset, section.offset + section.bytes);
    let mut next = Ok(blocks_end);
    while at < end {
        let length = (end - at).min(chunk.len() as u64) as usize;
        let piece = &mut chunk[..length];
        read("the directory of attributes", at, piece)?;
        hash.update(piece);
        next = next.and_then(|next| pages.parse(piece, next));
        at += length as u64;
    }
    if hash.digest() != section.checksum {
        return Err(damaged("its checksum is wrong").into());
    }
    if next.map_err(damaged)? != header.directory.offset {
        return Err(damaged("the pages do not end where the directory starts").into());
    }
    Ok(pages)
}

/// What reading the rest of a file takes, with what stays of it.
fn bytes_at_most(header: &Header) -> Bytes {
    let each = |count: u32, bytes: usize| u64::from(count) * bytes as u64;
    let images = header.images.map_or(0, |section| section.bytes);
    let page_count = header.attributes.map_or(0, |(_, count)| count);
    // The tables are held as they are and as what they say; only then is the one let go.
    let tables = header.materials.bytes.saturating_add(images).saturating_mul(2);
    let records = each(header.material_count, size_of::<MaterialRecord>() + size_of::<MaterialImages>());
    let rows = each(header.block_count, size_of::<BlockEntry>()) + each(page_count, size_of::<PageEntry>());
    Bytes((rows + records + 2 * CHUNK_BYTES as u64 + size_of::<Model>() as u64).saturating_add(tables))
}

/// The length of a part, which the header's parser has compared with the length of the file.
fn section_bytes(section: Section) -> Result<usize, ModelError> {
    usize::try_from(section.bytes).map_err(|_| ModelError::Limit {
        reason: "the file is too large for the address space of this machine",
    })
}

fn too_short(start: &[u8]) -> ModelError {
    let signature = &super::header::SIGNATURE;
    let common = start.len().min(signature.len());
    if start.is_empty() || start[..common] != signature[..common] {
        ModelError::NotCompiled
    } else {
        ModelError::Damaged { part: "header", offset: start.len() as u64, reason: "the file ends inside it" }
    }
}
