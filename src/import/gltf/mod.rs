//! glTF 2.0: `.gltf` with its buffers beside it or in it, and `.glb`.
//!
//! A scene is a tree of nodes that place meshes. Each placement is read as geometry of its own: its positions are multiplied by the
//! node's matrix in f64 and its triangles get ids in the order of the tree, so a mesh that is placed twice is there twice, unless
//! only a part is asked for ([`GltfPart`]). Only the JSON text is held in memory ([`JSON_BYTES_MAX`] at most); buffers are read in
//! pieces.
//!
//! Normals and the first set of texture coordinates go along, if the sink takes them. Skins and morph targets stay at rest; the report says
//! so, and what else was left out.

mod accessor;
mod bytes;
mod copies;
mod data_uri;
mod document;
mod material;
mod part;
mod placement;

use std::path::{Path, PathBuf};

use gltf::mesh::Mode;
use gltf::{Primitive, Semantic};

use self::accessor::Elements;
use self::bytes::Bytes;
pub(crate) use self::data_uri::decode_json;
pub use self::document::JSON_BYTES_MAX;
pub(crate) use self::document::Opened;
pub use self::part::{GltfMesh, GltfPart, gltf_meshes};
pub(crate) use self::placement::visit;
use self::placement::{Placed, placements};
use super::feed::Feed;
use super::report::{ImportOptions, ImportReport};
use super::sink::{MeshSink, NO_INDEX};
use crate::error::ImportError;
use crate::units::MaterialId;

/// Reads the default scene of a file, or the first one, or a part of it, into `sink`.
///
/// # Errors
/// [`ImportError::Io`] for the file or a buffer that it names, [`ImportError::Byte`] for a container that makes no sense,
/// [`ImportError::Element`] for anything in the document that does, or that is not supported; [`ImportError::Sink`].
pub(super) fn read(
    path: &Path,
    options: &ImportOptions,
    sink: &mut dyn MeshSink,
) -> Result<ImportReport, ImportError> {
    let opened = Opened::new(path)?;
    let mut bytes = Bytes::new(&opened);
    let mut feed = Feed::new(sink);
    let mut materials = Materials::new(path, options, &mut feed)?;
    let placed: Vec<Placed<'_>> = placements(&opened, &mut bytes, &options.gltf_part)?;
    let total = placed.iter().fold(0u64, |total, placed| total.saturating_add(placed.bytes));
    let mut progress = (0, Some(total));

    // Vertices first: a sink that knows them all places triangles as they come.
    let moves = placed.iter().any(|placed| !placed.is_in_place());
    let mut firsts = Vec::with_capacity(placed.len());
    let mut vectors = Vec::new();
    for placed in &placed {
        let attributes = Attributes::send(&opened, placed, &mut bytes, &mut feed)?;
        firsts.push((feed.vertex_count(), attributes));
        note_ignored(&opened, placed, &mut feed);
        let mut positions = Elements::positions(&opened, placed)?;
        while let Some(read) = positions.next_vectors(&mut bytes, &mut vectors)? {
            progress.0 += read;
            for position in &vectors {
                match moves {
                    true => feed.vertex64(placed.at(*position))?,
                    false => feed.vertex32(*position)?,
                }
            }
            feed.progress(progress)?;
        }
    }
    feed.vertices_complete()?;
    let mut indices = Vec::new();
    for (placed, (first, attributes)) in placed.iter().zip(firsts) {
        let material = materials.of(&opened, &placed.primitive, &mut feed)?;
        feed.set_material(material)?;
        // More vertices are refused by the feed.
        let mut faces = Faces::new(placed, first as u32, attributes);
        match Elements::indices(&opened, placed)? {
            None => {
                for index in 0..placed.vertex_count {
                    faces.corner(index as u32, &mut feed)?;
                }
            }
            Some(mut elements) => {
                while let Some(read) = elements.next_indices(&mut bytes, &mut indices)? {
                    progress.0 += read;
                    for index in &indices {
                        if u64::from(*index) >= placed.vertex_count {
                            let reason = format!("it names vertex {index} of {}", placed.vertex_count);
                            return Err(opened.error(placed.name(), reason));
                        }
                        faces.corner(*index, &mut feed)?;
                    }
                    feed.progress(progress)?;
                }
            }
        }
        feed.report.degenerate_faces += u64::from(faces.is_cut_short());
    }
    feed.finish(progress)
}

/// The files that a glTF file names as its buffers and that are there.
pub(super) fn named_files(path: &Path) -> Vec<PathBuf> {
    Opened::new(path).map(|opened| opened.buffer_files()).unwrap_or_default()
}

/// Says what a placement has that is not used.
fn note_ignored(opened: &Opened, placed: &Placed<'_>, feed: &mut Feed<'_>) {
    let count = placed.vertex_count;
    let is_taken = feed.takes_attributes();
    for (semantic, _) in placed.primitive.attributes() {
        match semantic {
            Semantic::Normals if !is_taken => feed.report.ignored.normals += count,
            Semantic::TexCoords(set) if set > 0 || !is_taken => {
                feed.report.ignored.texture_coordinates += count
            }
            Semantic::Colors(_) => feed.report.ignored.vertex_colors += count,
            _ => {}
        }
    }
    if placed.is_skinned {
        feed.report.warn_once(opened.path(), None, "skins are not used: what they move stays at rest".into());
    }
    if placed.primitive.morph_targets().len() > 0 {
        feed.report.warn_once(opened.path(), None, "morph targets are not used".into());
    }
}

/// The first texture coordinate and the first normal of a placement, where it has them.
#[derive(Clone, Copy)]
struct Attributes([Option<u32>; 2]);

impl Attributes {
    /// Sends what a placement has, if the sink has a use for it.
    fn send(
        opened: &Opened,
        placed: &Placed<'_>,
        bytes: &mut Bytes<'_>,
        feed: &mut Feed<'_>,
    ) -> Result<Attributes, ImportError> {
        let mut firsts = [None; 2];
        if !feed.takes_attributes() {
            return Ok(Attributes(firsts));
        }
        // Attributes are numbered like vertices, of which there are fewer than 2^32.
        let [uvs, normals] = feed.attribute_counts().map(|count| count as u32);
        if let Some(mut elements) = Elements::vectors(opened, placed, &Semantic::TexCoords(0))? {
            firsts[0] = Some(uvs);
            let mut vectors = Vec::new();
            while elements.next_vectors(bytes, &mut vectors)?.is_some() {
                for [u, v] in &vectors {
                    // From the upper left corner of an image in the file, from the lower left one here.
                    feed.uv([*u, 1.0 - v])?;
                }
            }
        }
        if let Some(mut elements) = Elements::vectors(opened, placed, &Semantic::Normals)? {
            firsts[1] = Some(normals);
            let mut vectors = Vec::new();
            while elements.next_vectors(bytes, &mut vectors)?.is_some() {
                for normal in &vectors {
                    feed.normal(placed.normal(*normal))?;
                }
            }
        }
        Ok(Attributes(firsts))
    }

    /// Those of one vertex.
    fn of(self, index: u32) -> [u32; 2] {
        self.0.map(|first| first.map_or(NO_INDEX, |first| first.wrapping_add(index)))
    }
}

/// Corners in the order of a primitive, made triangles.
struct Faces {
    mode: Mode,
    first_vertex: u32,
    attributes: Attributes,
    /// A mirroring matrix turns a triangle's sides around; its corners are turned back.
    is_mirrored: bool,
    /// The last two corners, and how many came.
    before: [u32; 2],
    count: u64,
}

impl Faces {
    fn new(placed: &Placed<'_>, first_vertex: u32, attributes: Attributes) -> Faces {
        Faces {
            mode: placed.primitive.mode(),
            first_vertex,
            attributes,
            is_mirrored: placed.is_mirrored(),
            before: [0; 2],
            count: 0,
        }
    }

    fn corner(&mut self, corner: u32, feed: &mut Feed<'_>) -> Result<(), ImportError> {
        let [a, b] = self.before;
        let place = self.count;
        self.count += 1;
        match self.mode {
            Mode::TriangleStrip => {
                self.before = [b, corner];
                match place {
                    0 | 1 => Ok(()),
                    // Every other triangle of a strip is the other way around.
                    _ if place % 2 == 1 => self.send([b, a, corner], feed),
                    _ => self.send([a, b, corner], feed),
                }
            }
            Mode::TriangleFan => {
                self.before = if place == 0 { [corner, corner] } else { [a, corner] };
                if place < 2 { Ok(()) } else { self.send([a, b, corner], feed) }
            }
            // Triangles; others are not placed.
            _ => {
                self.before = [b, corner];
                if place % 3 == 2 { self.send([a, b, corner], feed) } else { Ok(()) }
            }
        }
    }

    fn send(&self, [a, b, c]: [u32; 3], feed: &mut Feed<'_>) -> Result<(), ImportError> {
        let corners = if self.is_mirrored { [a, c, b] } else { [a, b, c] };
        let vertices = corners.map(|corner| self.first_vertex.wrapping_add(corner));
        match self.attributes.0 {
            [None, None] => feed.triangle(vertices),
            _ => feed.triangle_with(vertices, corners.map(|corner| self.attributes.of(corner))),
        }
    }

    /// Whether corners are left that make no triangle.
    fn is_cut_short(&self) -> bool {
        match self.mode {
            Mode::TriangleStrip | Mode::TriangleFan => matches!(self.count, 1 | 2),
            _ => !self.count.is_multiple_of(3),
        }
    }
}

/// Which materials the sink has.
struct Materials {
    /// The material that the options' library gives, for everything.
    replaced: Option<Option<MaterialId>>,
    /// By index in the document.
    sent: Vec<Option<MaterialId>>,
}

impl Materials {
    fn new(path: &Path, options: &ImportOptions, feed: &mut Feed<'_>) -> Result<Materials, ImportError> {
        let replaced = match &options.materials {
            Some(_) => Some(super::library::Materials::new(path, options, feed)?.only(feed)),
            None => None,
        };
        Ok(Materials { replaced, sent: Vec::new() })
    }

    /// The material of a primitive; `None` for the default one.
    fn of(
        &mut self,
        opened: &Opened,
        primitive: &Primitive<'_>,
        feed: &mut Feed<'_>,
    ) -> Result<Option<MaterialId>, ImportError> {
        if let Some(replaced) = self.replaced {
            return Ok(replaced);
        }
        let material = primitive.material();
        let Some(index) = material.index() else { return Ok(None) };
        // There is a material of that index: the document was checked.
        if self.sent.len() <= index {
            self.sent.resize(index + 1, None);
        }
        if self.sent[index].is_none() {
            let record = material::record(opened, &material, &mut feed.report)?;
            self.sent[index] = Some(feed.add_material(record)?);
        }
        Ok(self.sent[index])
    }
}
