//! What an import is asked for and what it reports.

use std::path::PathBuf;
use std::sync::Arc;

/// How a model file is to be imported.
#[derive(Clone, Debug, Default)]
#[non_exhaustive]
pub struct ImportOptions {
    /// A material library (`.mtl`) that takes the place of those that the model file names. A PLY file uses it
    /// through its face property `material_index`; a PLY file without one, and an STL file, take the library's
    /// only material, and none if it holds several. Unlike a library that a model names, it must exist.
    pub materials: Option<PathBuf>,
    /// Threads that parse OBJ text while the calling one reads the file and sends what was parsed; `None` for the calling one alone.
    /// What is sent is the same, in the same order. Up to about 8 MiB more memory. The import must not run on one of these threads, and
    /// none of them may be kept busy by the sink before [`MeshSink::vertices_complete`](super::MeshSink::vertices_complete).
    pub pool: Option<Arc<rayon::ThreadPool>>,
    /// Which part of a glTF file is read; other files have none.
    #[cfg(feature = "gltf")]
    pub gltf_part: super::gltf::GltfPart,
}

impl ImportOptions {
    /// The same options with a material library.
    pub fn with_materials(mut self, path: impl Into<PathBuf>) -> ImportOptions {
        self.materials = Some(path.into());
        self
    }

    /// The same options with threads.
    pub fn with_pool(mut self, pool: Arc<rayon::ThreadPool>) -> ImportOptions {
        self.pool = Some(pool);
        self
    }

    /// The same options for a part of a glTF file.
    #[cfg(feature = "gltf")]
    pub fn with_gltf_part(mut self, part: super::gltf::GltfPart) -> ImportOptions {
        self.gltf_part = part;
        self
    }
}

/// How many warnings a report keeps; the rest are only counted.
pub const WARNINGS_MAX: usize = 64;

/// Something that the import did not use as the file may have meant it, but that did not stop it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Warning {
    /// The file that it is about.
    pub path: PathBuf,
    /// The line that it is about, counted from 1, where there is one.
    pub line: Option<u64>,
    /// What was found and what was done about it.
    pub text: String,
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.line {
            Some(line) => write!(f, "{}:{line}: {}", self.path.display(), self.text),
            None => write!(f, "{}: {}", self.path.display(), self.text),
        }
    }
}

/// Parts of a file that were left out, counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IgnoredCounts {
    /// Vertex normals (OBJ `vn`, PLY vertices with `nx`) and facet normals (STL).
    pub normals: u64,
    /// Texture coordinates (OBJ `vt`, PLY vertices or faces with them).
    pub texture_coordinates: u64,
    /// Vertices with a colour.
    pub vertex_colors: u64,
    /// OBJ lines and points (`l`, `p`), PLY edges.
    pub lines_and_points: u64,
    /// OBJ statements of unknown or unsupported kinds, and records of unknown PLY elements.
    pub unknown: u64,
}

/// What an import read and what it did with it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ImportReport {
    /// Vertices sent to the sink.
    pub vertices: u64,
    /// Triangles sent to the sink.
    pub triangles: u64,
    /// Faces with more than three corners, each cut into triangles.
    pub polygons: u64,
    /// Those of `polygons` that are self-intersecting, too long for exact cutting or without area, and so were
    /// cut as a fan from their first corner.
    pub fans: u64,
    /// Faces with fewer than three distinct neighbouring corners; they have no triangles.
    pub degenerate_faces: u64,
    /// Texture coordinates sent to the sink, if it takes them; else they are among the `ignored`.
    pub texture_coordinates: u64,
    /// Normals sent to the sink, if it takes them.
    pub normals: u64,
    /// Materials sent to the sink, the default one included if it was used.
    pub materials: u32,
    /// What was left out.
    pub ignored: IgnoredCounts,
    /// The first [`WARNINGS_MAX`] warnings, in the order of the file.
    pub warnings: Vec<Warning>,
    /// All warnings, those that were not kept included.
    pub warning_count: u64,
    /// Material libraries that were read.
    pub material_files: Vec<PathBuf>,
}

impl ImportReport {
    /// Notes a warning, in bounded memory.
    pub(super) fn warn(&mut self, path: &std::path::Path, line: Option<u64>, text: impl Into<String>) {
        self.warning_count += 1;
        if self.warnings.len() < WARNINGS_MAX {
            self.warnings.push(Warning { path: path.to_path_buf(), line, text: text.into() });
        }
    }

    /// Notes a warning unless it is the same, but for the line, as one that is kept.
    pub(super) fn warn_once(&mut self, path: &std::path::Path, line: Option<u64>, text: String) {
        if !self.warnings.iter().any(|warning| warning.text == text && warning.path == path) {
            self.warn(path, line, text);
        }
    }
}
