//! Model files by name: which reader takes them, compression, and the record by which a change is noticed.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use xxhash_rust::xxh3::Xxh3;

#[cfg(feature = "gltf")]
use super::gltf;
use super::library;
use super::meter::Meter;
use super::obj;
use super::ply;
use super::report::{ImportOptions, ImportReport};
use super::sink::MeshSink;
use super::stl;
use super::text::{is_blank, trimmed};
use crate::error::ImportError;
use crate::model::SourceRecord;

/// Opens the same bytes again, for files that name vertices before they come.
pub(super) type Reopen<'a> = &'a mut dyn FnMut() -> Result<(Box<dyn Read>, Meter), ImportError>;

/// The formats that can be imported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Obj,
    Ply,
    Stl,
    #[cfg(feature = "gltf")]
    Gltf,
}

/// Format of a file by its extension, in any case, and whether it is compressed.
fn kind(path: &Path) -> Option<(Format, bool)> {
    let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
    let (stem, compressed) = match name.strip_suffix(".gz") {
        Some(stem) => (stem, true),
        None => (name.as_str(), false),
    };
    let format = match stem.rsplit_once('.')?.1 {
        "obj" => Format::Obj,
        "ply" => Format::Ply,
        "stl" => Format::Stl,
        #[cfg(feature = "gltf")]
        "gltf" | "glb" if !compressed => Format::Gltf,
        _ => return None,
    };
    Some((format, compressed))
}

/// Imports a model file into `sink`. The format follows from the extension, in upper or lower case: `.obj`,
/// `.ply`, `.stl`, each also with `.gz` behind it (feature `gzip`), `.gltf` and `.glb` (feature `gltf`).
///
/// The sink is left with part of the mesh if this fails.
///
/// # Errors
/// What cannot be opened or read ([`ImportError::Io`]), understood ([`ImportError::Line`], [`ImportError::Byte`],
/// [`ImportError::UnknownKind`]) or received ([`ImportError::Sink`]).
pub fn import_file(
    path: impl AsRef<Path>,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    let path = path.as_ref();
    let (format, compressed) = kind(path).ok_or_else(|| ImportError::UnknownKind { path: path.into() })?;
    let mut open = || open(path, compressed);
    match format {
        Format::Obj => {
            let (reader, meter) = open()?;
            obj::read(reader, meter, path, options, Some(&mut open), sink)
        }
        Format::Ply => {
            let (reader, meter) = open()?;
            ply::read(reader, meter, path, options, Some(&mut open), sink)
        }
        Format::Stl => {
            let (reader, meter) = open()?;
            stl::read(reader, meter, path, options, sink)
        }
        #[cfg(feature = "gltf")]
        Format::Gltf => gltf::read(path, options, sink),
    }
}

/// Opens a model file for reading from its start.
fn open(path: &Path, compressed: bool) -> Result<(Box<dyn Read>, Meter), ImportError> {
    let file = File::open(path).map_err(io_error(path))?;
    let total_bytes = file.metadata().map_err(io_error(path))?.len();
    if !compressed {
        return Ok((Box::new(file), Meter::plain(total_bytes)));
    }
    #[cfg(feature = "gzip")]
    {
        let (meter, counted) = Meter::compressed(file, total_bytes);
        let buffered = io::BufReader::with_capacity(1 << 16, counted);
        Ok((Box::new(super::gzip::Members::new(buffered)), meter))
    }
    #[cfg(not(feature = "gzip"))]
    {
        let error = io::Error::new(
            io::ErrorKind::Unsupported,
            "it is compressed, and outcrop was built without the feature `gzip`; unpack it first",
        );
        Err(io_error(path)(error))
    }
}

/// Wraps an error of the operating system.
fn io_error(path: &Path) -> impl Fn(io::Error) -> ImportError + '_ {
    |error| ImportError::Io { path: path.to_path_buf(), error }
}

/// Bytes at each end of a file that a fingerprint covers.
const FINGERPRINT_BYTES: u64 = 64 << 10;

/// What a compiled file keeps to notice that the model file changed. The modification time is the latest of the model
/// file and of the material libraries that it names in its first 64 KiB (an OBJ file's `mtllib`, a PLY file's
/// `comment mtllib`), where writers put them, or of the buffers of a glTF file; the fingerprint covers all of these.
///
/// # Errors
/// [`ImportError::Io`] for the model file. A library that is not there is left out, as [`import_file`] leaves it out.
pub fn source_record(path: impl AsRef<Path>) -> Result<SourceRecord, ImportError> {
    let path = path.as_ref();
    let mut file = File::open(path).map_err(io_error(path))?;
    let metadata = file.metadata().map_err(io_error(path))?;
    let mut modified_ns = modified_ns(&metadata).map_err(io_error(path))?;
    let mut hash = Xxh3::new();
    add_ends(&mut hash, &mut file, metadata.len()).map_err(io_error(path))?;
    if let Some((format, compressed)) = kind(path) {
        let mut front = Vec::new();
        let (reader, _) = open(path, compressed)?;
        // A compressed file that is damaged here will say so when it is imported.
        let _ = reader.take(FINGERPRINT_BYTES).read_to_end(&mut front);
        for library in named_libraries(format, path, &front) {
            // One that cannot be read costs the import its materials, not the model.
            let Ok((mut library, metadata)) = opened(&library) else { continue };
            modified_ns = modified_ns.max(self::modified_ns(&metadata).unwrap_or(0));
            // Unpacked or copied files keep times that may be older than the model's, so that the latest time stays.
            let _ = add_ends(&mut hash, &mut library, metadata.len());
        }
    }
    Ok(SourceRecord { file_bytes: metadata.len(), modified_ns, fingerprint: hash.digest() })
}

/// [`source_record`] of what `options` have read: the same file read in another part has another fingerprint.
///
/// # Errors
/// As for [`source_record`].
pub fn source_record_of(
    path: impl AsRef<Path>,
    options: &ImportOptions,
) -> Result<SourceRecord, ImportError> {
    let record = source_record(path)?;
    #[cfg(feature = "gltf")]
    if options.gltf_part != gltf::GltfPart::Scene {
        let mut hash = Xxh3::new();
        hash.update(&record.fingerprint.to_le_bytes());
        hash.update(format!("{:?}", options.gltf_part).as_bytes());
        return Ok(SourceRecord { fingerprint: hash.digest(), ..record });
    }
    let _ = options;
    Ok(record)
}

/// A file and what the system says of it. Opening a pipe would wait for whoever writes to it.
fn opened(path: &Path) -> io::Result<(File, std::fs::Metadata)> {
    let metadata = path.metadata()?;
    if !metadata.is_file() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "is not a file"));
    }
    Ok((File::open(path)?, metadata))
}

/// Adds the size and both ends of a file to a fingerprint.
fn add_ends(hash: &mut Xxh3, file: &mut File, file_bytes: u64) -> io::Result<()> {
    hash.update(&file_bytes.to_le_bytes());
    let mut bytes = Vec::new();
    file.take(FINGERPRINT_BYTES).read_to_end(&mut bytes)?;
    hash.update(&bytes);
    if file_bytes > FINGERPRINT_BYTES {
        file.seek(SeekFrom::Start(file_bytes - FINGERPRINT_BYTES))?;
        bytes.clear();
        file.take(FINGERPRINT_BYTES).read_to_end(&mut bytes)?;
        hash.update(&bytes);
    }
    Ok(())
}

/// Modification time in nanoseconds since 1970; 0 for times before that.
fn modified_ns(metadata: &std::fs::Metadata) -> io::Result<u64> {
    let since = metadata.modified()?.duration_since(UNIX_EPOCH).unwrap_or_default();
    Ok(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
}

/// Material libraries that the first bytes of a model file name and that are there, or buffers; each once.
fn named_libraries(format: Format, model: &Path, front: &[u8]) -> BTreeSet<PathBuf> {
    let keywords: &[&[u8]] = match format {
        Format::Obj => &[b"mtllib"],
        Format::Ply => &[b"comment", b"mtllib"],
        Format::Stl => return BTreeSet::new(),
        #[cfg(feature = "gltf")]
        Format::Gltf => return gltf::named_files(model).into_iter().collect(),
    };
    let names = front.split(|byte| matches!(byte, b'\n' | b'\r')).filter_map(|line| {
        let mut rest = trimmed(line);
        for keyword in keywords {
            rest = trimmed(rest.strip_prefix(*keyword).filter(|rest| rest.first().is_some_and(is_blank))?);
        }
        Some(rest)
    });
    names.flat_map(|names| library::libraries(model, names)).filter_map(|(_, path)| path).collect()
}
