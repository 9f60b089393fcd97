//! The document of a file, and where its buffers are.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};

use gltf::Document;
use gltf::json::Root;
use gltf::json::camera::Type as CameraType;
use gltf::json::extensions::scene::khr_lights_punctual::Type as LightType;
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;

use super::data_uri::DataPlaces;
use crate::error::ImportError;

/// Longest JSON text, 64 MiB. While it is read it takes about ten times as much memory.
pub const JSON_BYTES_MAX: u64 = 64 << 20;

/// Length of the header of a `.glb` file.
const HEADER_BYTES: u64 = 12;
/// Length of what stands before a chunk.
const CHUNK_HEADER_BYTES: u64 = 8;
const MAGIC: &[u8; 4] = b"glTF";
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BINARY_CHUNK: u32 = 0x004e_4942;

/// A file whose document was read and checked. Buffers were not looked at.
pub(crate) struct Opened {
    path: PathBuf,
    pub document: Document,
    /// Where the binary chunk of a `.glb` is.
    pub chunk: Option<Range<u64>>,
    /// Where in the file the text of each buffer and of each image is that is a data URI.
    pub buffer_texts: Vec<Option<Range<u64>>>,
    pub image_texts: Vec<Option<Range<u64>>>,
}

impl Opened {
    /// Opens a file. It is a `.glb` if it starts like one, whatever its name.
    pub fn new(path: &Path) -> Result<Opened, ImportError> {
        let io = |error| ImportError::Io { path: path.to_path_buf(), error };
        let mut file = File::open(path).map_err(io)?;
        let file_bytes = file.metadata().map_err(io)?.len();
        let mut front = Vec::new();
        file.by_ref().take(HEADER_BYTES + CHUNK_HEADER_BYTES).read_to_end(&mut front).map_err(io)?;
        let (json_range, chunk) = if front.starts_with(MAGIC) {
            let container = container(path, &front, file_bytes)?;
            let after = container.json.end;
            let chunk = match after < container.end {
                true => binary_chunk(path, &mut file, after..container.end)?,
                false => None,
            };
            (container.json, chunk)
        } else {
            (0..file_bytes, None)
        };
        let json_bytes = json_range.end - json_range.start;
        if json_bytes > JSON_BYTES_MAX {
            let reason = format!("the JSON text has {json_bytes} bytes; at most {JSON_BYTES_MAX} are read");
            return Err(byte_error(path, json_range.start, reason));
        }
        let mut json = Vec::new();
        file.seek(SeekFrom::Start(json_range.start)).map_err(io)?;
        file.take(json_bytes).read_to_end(&mut json).map_err(io)?;
        let document = parse(path, json_range.start, &json)?;
        check_version(path, &document)?;
        let texts = DataPlaces::find(&json, json_range.start);
        let buffer_text = |buffer: gltf::Buffer<'_>| match buffer.source() {
            gltf::buffer::Source::Uri(uri) => texts.of(uri),
            gltf::buffer::Source::Bin => None,
        };
        let image_text = |image: gltf::Image<'_>| match image.source() {
            gltf::image::Source::Uri { uri, .. } => texts.of(uri),
            gltf::image::Source::View { .. } => None,
        };
        let buffer_texts = document.buffers().map(buffer_text).collect();
        let image_texts = document.images().map(image_text).collect();
        Ok(Opened { path: path.to_path_buf(), document, chunk, buffer_texts, image_texts })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's own name, from which paths of what is inside it start.
    pub fn file_name(&self) -> Option<&str> {
        self.path.file_name()?.to_str()
    }

    /// An error about a part of the document.
    pub fn error(&self, element: String, reason: impl Into<String>) -> ImportError {
        ImportError::Element { path: self.path.clone(), element, reason: reason.into() }
    }

    /// A reference without its escapes, if it is relative to this file.
    pub fn relative(&self, uri: &str) -> Option<String> {
        let decoded = percent_encoding::percent_decode_str(uri).decode_utf8().ok()?;
        // A scheme, or a path from the root: nothing that moves with the file.
        let is_local = !decoded.contains(':') && !decoded.starts_with(['/', '\\']);
        is_local.then(|| decoded.into_owned())
    }

    /// The path of a buffer that is named by a relative reference.
    pub fn file_beside(&self, uri: &str) -> Option<PathBuf> {
        Some(self.path.parent().unwrap_or(Path::new("")).join(self.relative(uri)?))
    }

    /// The buffers that are files and are there.
    pub fn buffer_files(&self) -> Vec<PathBuf> {
        let uri = |source| match source {
            gltf::buffer::Source::Uri(uri) => self.file_beside(uri),
            gltf::buffer::Source::Bin => None,
        };
        self.document
            .buffers()
            .filter_map(|buffer| uri(buffer.source()))
            .filter(|path| path.is_file())
            .collect()
    }
}

/// Refuses what is not for readers of version 2.0 (glTF 2.0, section 3.2): the least version that it names, or else its own, counts.
fn check_version(path: &Path, document: &gltf::Document) -> Result<(), ImportError> {
    let asset = &document.as_json().asset;
    let (name, version) = match &asset.min_version {
        Some(version) => ("minVersion", version),
        None => ("version", &asset.version),
    };
    // A later minor version may only be told from a least one.
    let is_read = version == "2.0" || (name == "version" && version.split('.').next() == Some("2"));
    if is_read {
        return Ok(());
    }
    Err(ImportError::Element {
        path: path.to_path_buf(),
        element: "asset".into(),
        reason: format!("its {name} is {version:?}; version 2.0 is read"),
    })
}

fn byte_error(path: &Path, offset: u64, reason: impl Into<String>) -> ImportError {
    ImportError::Byte { path: path.to_path_buf(), offset, reason: reason.into() }
}

fn number(bytes: &[u8], offset: usize) -> Option<u64> {
    let bytes = bytes.get(offset..)?.first_chunk::<4>()?;
    Some(u64::from(u32::from_le_bytes(*bytes)))
}

/// The parts of a `.glb` file.
struct Container {
    json: Range<u64>,
    /// Where the container ends; the file may go on.
    end: u64,
}

fn container(path: &Path, front: &[u8], file_bytes: u64) -> Result<Container, ImportError> {
    let field = |offset| {
        number(front, offset).ok_or_else(|| byte_error(path, front.len() as u64, "the file ends here"))
    };
    let version = field(4)?;
    if version != 2 {
        return Err(byte_error(path, 4, format!("glTF version {version}; only version 2 is read")));
    }
    let end = field(8)?;
    if end > file_bytes {
        let reason =
            format!("the container should have {end} bytes, the file has {file_bytes}: it is cut short");
        return Err(byte_error(path, 8, reason));
    }
    let (length, kind) = (field(12)?, field(16)?);
    let start = HEADER_BYTES + CHUNK_HEADER_BYTES;
    if kind != u64::from(JSON_CHUNK) || length > end.saturating_sub(start) {
        return Err(byte_error(path, 12, "the first chunk is no JSON text inside the container"));
    }
    Ok(Container { json: start..start + length, end })
}

/// The binary chunk in `range`, if the first one there is one.
fn binary_chunk(path: &Path, file: &mut File, range: Range<u64>) -> Result<Option<Range<u64>>, ImportError> {
    let io = |error| ImportError::Io { path: path.to_path_buf(), error };
    let mut front = Vec::new();
    file.seek(SeekFrom::Start(range.start)).map_err(io)?;
    file.by_ref().take(CHUNK_HEADER_BYTES).read_to_end(&mut front).map_err(io)?;
    let (Some(length), Some(kind)) = (number(&front, 0), number(&front, 4)) else {
        return Err(byte_error(path, range.start, "the file ends inside a chunk's header"));
    };
    let start = range.start + CHUNK_HEADER_BYTES;
    if length > range.end.saturating_sub(start) {
        return Err(byte_error(path, range.start, "a chunk reaches past the end of the container"));
    }
    Ok((kind == u64::from(BINARY_CHUNK)).then(|| start..start + length))
}

/// Extensions that a file may require beside those that the crate knows. Quantized positions must be required by the files that have
/// them.
const EXTENSIONS_READ: [&str; 3] =
    [super::copies::NAME, super::material::TEXTURE_TRANSFORM, "KHR_mesh_quantization"];

/// Reads the JSON text and has its indices checked.
fn parse(path: &Path, offset: u64, json: &[u8]) -> Result<Document, ImportError> {
    let refused =
        |element: String, reason: String| ImportError::Element { path: path.to_path_buf(), element, reason };
    let mut root: Root = gltf::json::deserialize::from_slice(json).map_err(|error| {
        byte_error(path, offset, format!("the JSON text is no document of glTF 2.0: {error}"))
    })?;
    // The crate does not know them, but what they say is read here.
    root.extensions_required.retain(|extension| !EXTENSIONS_READ.contains(&extension.as_str()));
    if let Some((element, reason)) = missing(&root) {
        return Err(refused(element, reason.into()));
    }
    Document::from_json(root).map_err(|error| match error {
        gltf::Error::Validation(errors) => match errors.into_iter().next() {
            Some((place, error)) => refused(place.to_string(), error.to_string()),
            None => refused("the document".into(), "it is not valid".into()),
        },
        error => refused("the document".into(), error.to_string()),
    })
}

/// What a document lacks that the crate takes for granted, in its own checks (a primitive's positions) or after them.
fn missing(root: &Root) -> Option<(String, &'static str)> {
    for (mesh, part) in root.meshes.iter().enumerate() {
        for (primitive, part) in part.primitives.iter().enumerate() {
            let positions = part.attributes.get(&Checked::Valid(Semantic::Positions));
            if positions.is_some_and(|index| index.value() >= root.accessors.len()) {
                let element = format!("meshes[{mesh}].primitives[{primitive}].attributes.POSITION");
                return Some((element, "there is no such accessor"));
            }
        }
    }
    for (image, part) in root.images.iter().enumerate() {
        if part.uri.is_none() && (part.buffer_view.is_none() || part.mime_type.is_none()) {
            return Some((format!("images[{image}]"), "it has neither a uri nor a buffer view with a type"));
        }
    }
    for (camera, part) in root.cameras.iter().enumerate() {
        let is_there = match part.type_ {
            Checked::Valid(CameraType::Perspective) => part.perspective.is_some(),
            Checked::Valid(CameraType::Orthographic) => part.orthographic.is_some(),
            // Refused by the crate.
            Checked::Invalid => true,
        };
        if !is_there {
            return Some((format!("cameras[{camera}]"), "the part that its type names is not there"));
        }
    }
    let lights = root.extensions.as_ref().and_then(|extensions| extensions.khr_lights_punctual.as_ref());
    for (light, part) in lights.iter().flat_map(|lights| &lights.lights).enumerate() {
        if part.type_ == Checked::Valid(LightType::Spot) && part.spot.is_none() {
            return Some((
                format!("extensions.KHR_lights_punctual.lights[{light}]"),
                "a spot light has no cone",
            ));
        }
    }
    None
}
