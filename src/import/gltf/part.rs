//! Parts of a file that are read by themselves, so that a mesh that is placed many times is read once.

use std::path::Path;
use std::sync::Arc;

use gltf::Primitive;
use gltf::mesh::Mode;

use super::bytes::Bytes;
use super::document::Opened;
use super::placement::{Placed, placements};
use crate::error::ImportError;
use crate::geom::Affine;

/// Which part of a file's scene is read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub enum GltfPart {
    /// All of it: each mesh wherever a node places it.
    #[default]
    Scene,
    /// The mesh of this number in the document, once and not moved.
    Mesh(usize),
    /// The scene without the meshes of these numbers.
    Without(Arc<[usize]>),
}

impl GltfPart {
    /// Whether a node's mesh belongs to it.
    pub(super) fn has(&self, mesh: usize) -> bool {
        match self {
            GltfPart::Scene => true,
            GltfPart::Mesh(number) => *number == mesh,
            GltfPart::Without(numbers) => !numbers.contains(&mesh),
        }
    }
}

/// A mesh of a glTF file, and where its scene has it.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfMesh {
    /// Its number in the document.
    pub number: usize,
    /// Triangles of one of it, as its accessors promise.
    pub triangles: u64,
    /// From the mesh to the scene, once for each time that it is placed, in the order of the nodes.
    pub places: Vec<Affine>,
}

/// The meshes that the default scene of a file places, or its first one, in the order in which they are first placed. Positions and
/// indices are not read.
///
/// # Errors
/// As for [`import_file`](crate::import::import_file), of what is looked at.
pub fn gltf_meshes(path: impl AsRef<Path>) -> Result<Vec<GltfMesh>, ImportError> {
    let opened = Opened::new(path.as_ref())?;
    let mut meshes: Vec<GltfMesh> = Vec::new();
    let mut places = vec![None; opened.document.meshes().len()];
    for placed in placements(&opened, &mut Bytes::new(&opened), &GltfPart::Scene)? {
        let place = *places[placed.mesh].get_or_insert_with(|| {
            meshes.push(GltfMesh { number: placed.mesh, triangles: 0, places: Vec::new() });
            meshes.len() - 1
        });
        let mesh = &mut meshes[place];
        if placed.is_first {
            mesh.places.push(placed.affine());
        }
        // Of the first time that it is placed.
        if mesh.places.len() == 1 {
            mesh.triangles = mesh.triangles.saturating_add(triangle_count(&placed));
        }
    }
    Ok(meshes)
}

fn triangle_count(Placed { primitive, vertex_count, .. }: &Placed<'_>) -> u64 {
    let corners = Primitive::indices(primitive).map_or(*vertex_count, |indices| indices.count() as u64);
    match primitive.mode() {
        Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
        _ => corners / 3,
    }
}
