//! Which primitives a scene has, and where.

use glam::{DMat3, DMat4, DQuat, DVec3};
use gltf::mesh::Mode;
use gltf::scene::Transform;
use gltf::{Node, Primitive, Scene, Semantic};

use super::bytes::Bytes;
use super::copies::copies;
use super::document::Opened;
use super::part::GltfPart;
use crate::error::ImportError;
use crate::geom::Affine;

/// A primitive of a mesh where a node puts it.
pub(super) struct Placed<'d> {
    pub primitive: Primitive<'d>,
    /// The mesh's number.
    pub mesh: usize,
    /// Whether it is the first of its mesh there.
    pub is_first: bool,
    /// From the primitive's space to the scene's.
    matrix: DMat4,
    pub vertex_count: u64,
    /// Whether the node has a skin.
    pub is_skinned: bool,
    /// Bytes of positions and indices.
    pub bytes: u64,
}

impl Placed<'_> {
    /// Where it stands in the document.
    pub fn name(&self) -> String {
        format!("meshes[{}].primitives[{}]", self.mesh, self.primitive.index())
    }

    /// The matrix, as instances have it.
    pub fn affine(&self) -> Affine {
        let [x, y, z, shift] = self.matrix.to_cols_array_2d();
        Affine::from_rows([0, 1, 2].map(|axis| [x[axis], y[axis], z[axis], shift[axis]]))
    }

    /// Whether nothing moves.
    pub fn is_in_place(&self) -> bool {
        self.matrix == DMat4::IDENTITY
    }

    /// Whether left and right change sides.
    pub fn is_mirrored(&self) -> bool {
        self.matrix.determinant() < 0.0
    }

    /// Where a position of the primitive is.
    pub fn at(&self, position: [f32; 3]) -> [f64; 3] {
        if self.is_in_place() {
            return position.map(f64::from);
        }
        self.matrix.transform_point3(DVec3::from_array(position.map(f64::from))).to_array()
    }

    /// A normal of the primitive, turned as its surface is; of unit length, or zero if it has none.
    pub fn normal(&self, normal: [f32; 3]) -> [f32; 3] {
        let linear = DMat3::from_mat4(self.matrix);
        // Of the matrix of cofactors, which turns normals as the matrix turns surfaces, also where it has no inverse.
        let [x, y, z] = [linear.x_axis, linear.y_axis, linear.z_axis];
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        let turned = cofactors * DVec3::from_array(normal.map(f64::from));
        let turned = if self.is_mirrored() { -turned } else { turned };
        turned.normalize_or_zero().as_vec3().to_array()
    }
}

/// The scene that a file shows: its default one, or the first, or none.
pub(super) fn scene(opened: &Opened) -> Option<Scene<'_>> {
    opened.document.default_scene().or_else(|| opened.document.scenes().next())
}

/// A node's matrix, from its own space to its parent's.
pub(super) fn matrix(node: &Node<'_>) -> DMat4 {
    match node.transform() {
        Transform::Matrix { matrix } => {
            DMat4::from_cols_array_2d(&matrix.map(|column| column.map(f64::from)))
        }
        Transform::Decomposed { translation, rotation, scale } => {
            let rotation = DQuat::from_array(rotation.map(f64::from));
            DMat4::from_scale_rotation_translation(
                DVec3::from_array(scale.map(f64::from)),
                // Files round; a zero quaternion turns nothing.
                if rotation.length_squared() > 0.0 { rotation.normalize() } else { DQuat::IDENTITY },
                DVec3::from_array(translation.map(f64::from)),
            )
        }
    }
}

/// Visits the nodes of the scene, parents before children, in the order of the document, with their matrices.
pub(crate) fn visit<'d>(
    opened: &'d Opened,
    mut with: impl FnMut(&Node<'d>, DMat4) -> Result<(), ImportError>,
) -> Result<(), ImportError> {
    let Some(scene) = scene(opened) else { return Ok(()) };
    let mut is_met = vec![false; opened.document.nodes().len()];
    let mut waiting: Vec<(Node<'d>, DMat4)> = scene.nodes().map(|node| (node, DMat4::IDENTITY)).collect();
    waiting.reverse();
    while let Some((node, above)) = waiting.pop() {
        let name = || format!("nodes[{}]", node.index());
        // Also what keeps this from going on for ever.
        if std::mem::replace(&mut is_met[node.index()], true) {
            return Err(opened.error(name(), "it has more than one parent"));
        }
        let matrix = above * matrix(&node);
        if !matrix.is_finite() {
            return Err(opened.error(name(), "its matrix is not finite"));
        }
        with(&node, matrix)?;
        let first = waiting.len();
        waiting.extend(node.children().map(|child| (child, matrix)));
        waiting[first..].reverse();
    }
    Ok(())
}

/// Most primitives that a scene may place: some 250 MB of what is known of them.
pub(super) const PLACED_MAX: usize = 1 << 20;

/// The triangles of a part of the scene, in the order of its nodes.
pub(super) fn placements<'d>(
    opened: &'d Opened,
    bytes: &mut Bytes<'_>,
    part: &GltfPart,
) -> Result<Vec<Placed<'d>>, ImportError> {
    let mut placed = Vec::new();
    let mut is_done = false;
    visit(opened, |node, matrix| {
        let Some(mesh) = node.mesh() else { return Ok(()) };
        if !part.has(mesh.index()) {
            return Ok(());
        }
        let mut places = vec![matrix];
        if let Some(copies) = copies(opened, node, bytes)? {
            places = copies.into_iter().map(|copy| matrix * copy).collect();
            if !places.iter().all(DMat4::is_finite) {
                return Err(opened.error(format!("nodes[{}]", node.index()), "a copy's matrix is not finite"));
            }
        }
        if let GltfPart::Mesh(_) = part {
            // By itself, and once.
            places.truncate(usize::from(!is_done));
            places.fill(DMat4::IDENTITY);
            is_done |= !places.is_empty();
        }
        let primitive_count = places.len().saturating_mul(mesh.primitives().len());
        if primitive_count > PLACED_MAX - placed.len() {
            let reason = format!("the scene places more than {PLACED_MAX} primitives; split the file");
            return Err(opened.error(format!("nodes[{}]", node.index()), reason));
        }
        for matrix in places {
            let mut is_first = true;
            for primitive in mesh.primitives() {
                if !matches!(primitive.mode(), Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
                    continue;
                }
                let element = || format!("meshes[{}].primitives[{}]", mesh.index(), primitive.index());
                for extension in ["KHR_draco_mesh_compression", "EXT_meshopt_compression"] {
                    if primitive.extension_value(extension).is_some() {
                        return Err(opened.error(element(), format!("{extension} is not supported")));
                    }
                }
                let bytes = |accessor: gltf::Accessor<'_>| {
                    (accessor.count() as u64).saturating_mul(accessor.size() as u64)
                };
                let Some(positions) = primitive.get(&Semantic::Positions) else { continue };
                let vertex_count = positions.count() as u64;
                let bytes = bytes(positions).saturating_add(primitive.indices().map_or(0, bytes));
                let is_skinned = node.skin().is_some();
                let mesh = mesh.index();
                placed.push(Placed { primitive, mesh, is_first, matrix, vertex_count, is_skinned, bytes });
                is_first = false;
            }
        }
        Ok(())
    })?;
    Ok(placed)
}
