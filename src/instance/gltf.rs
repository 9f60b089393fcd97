//! Scenes of glTF files as instances: a mesh that many nodes place is compiled once.

use std::path::Path;

use super::instances::{Instance, Instances};
use super::placed::Placed;
use crate::error::ImportError;
use crate::geom::{Aabb, Affine};
use crate::import::{GltfMesh, GltfPart, gltf_meshes};

/// The parts of a glTF file that become models, and where they stand.
///
/// Each mesh that is placed more than once, with enough triangles to be worth it, is a model of its own, in its own space; all else
/// of the scene is one more, written out as [`import_file`](crate::import::import_file) does. Compile each with
/// [`compile_file_with`](crate::compile::compile_file_with), and give them to [`Instances::open`] in this order.
///
/// Vertices of a shared mesh are those of the file, moved in f64 where rays meet them. In a scene that is written out they are
/// moved and then rounded to the compiled file's precision: up to that the two are the same, and to the bit where nothing is
/// rounded.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfInstances {
    /// What to compile, by the number of the model.
    pub parts: Vec<GltfPart>,
    /// Where the models stand, in the order in which the file's nodes first place them.
    pub instances: Vec<Instance>,
    /// Triangles that need not be compiled and held because meshes are shared, as the file's accessors promise.
    pub triangles_saved: u64,
}

impl GltfInstances {
    /// As many triangles must sharing a mesh save: below, the tree and the cache slots of a model of its own take more than the copies.
    pub const TRIANGLES_SAVED_MIN: u64 = 16_384;

    /// Looks for meshes of the file that are worth sharing; `None` if there are none. Geometry is not read.
    ///
    /// # Errors
    /// As for [`gltf_meshes`].
    pub fn read(path: impl AsRef<Path>) -> Result<Option<GltfInstances>, ImportError> {
        GltfInstances::read_for(path, GltfInstances::TRIANGLES_SAVED_MIN)
    }

    /// [`GltfInstances::read`] with another least number of triangles that sharing a mesh must save.
    ///
    /// # Errors
    /// As for [`gltf_meshes`].
    pub fn read_for(
        path: impl AsRef<Path>,
        triangles_saved_min: u64,
    ) -> Result<Option<GltfInstances>, ImportError> {
        Ok(GltfInstances::of(&gltf_meshes(path)?, triangles_saved_min))
    }

    fn of(meshes: &[GltfMesh], triangles_saved_min: u64) -> Option<GltfInstances> {
        let saved = |mesh: &GltfMesh| mesh.triangles.saturating_mul(mesh.places.len() as u64 - 1);
        // Longest lists first would be more, but a file with so many copies is rare enough.
        let mut room = Instances::COUNT_MAX - 1;
        let is_shared = |mesh: &&GltfMesh| {
            let is_worth_it = mesh.places.len() > 1 && saved(mesh) >= triangles_saved_min.max(1);
            let fits = mesh.places.len() <= room && mesh.places.iter().all(can_be_placed);
            room -= if is_worth_it && fits { mesh.places.len() } else { 0 };
            is_worth_it && fits
        };
        let shared: Vec<&GltfMesh> = meshes.iter().filter(is_shared).collect();
        if shared.is_empty() {
            return None;
        }
        let mut result = GltfInstances {
            parts: Vec::with_capacity(shared.len() + 1),
            instances: Vec::new(),
            triangles_saved: shared.iter().fold(0, |sum, mesh| saved(mesh).saturating_add(sum)),
        };
        if shared.len() < meshes.len() {
            result.parts.push(GltfPart::Without(shared.iter().map(|mesh| mesh.number).collect()));
            result.instances.push(Instance { model: 0, map: Affine::IDENTITY });
        }
        for mesh in shared {
            let model = result.parts.len() as u32;
            result.parts.push(GltfPart::Mesh(mesh.number));
            result.instances.extend(mesh.places.iter().map(|map| Instance { model, map: *map }));
        }
        Some(result)
    }
}

/// Whether instances can have the map, whatever f32 positions the mesh has. Flat ones they cannot.
fn can_be_placed(map: &Affine) -> bool {
    let everything = Aabb { min: [-f64::from(f32::MAX); 3], max: [f64::from(f32::MAX); 3] };
    Placed::new(&Instance { model: 0, map: *map }, &everything).is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_are_shared_where_it_saves_enough_and_can_be_done() {
        let at = |x: f64| Affine::translation([x, 0.0, 0.0]);
        let mesh =
            |number, triangles, places: &[Affine]| GltfMesh { number, triangles, places: places.to_vec() };
        let flat = Affine::scale([1.0, 0.0, 1.0]);
        let meshes = [
            mesh(0, 1000, &[at(0.0)]),
            mesh(3, 50, &[at(1.0), at(2.0), at(3.0)]),
            mesh(1, 49, &[at(4.0), at(5.0), at(6.0)]),
            mesh(2, 1000, &[at(7.0), flat]),
            mesh(7, 200, &[at(8.0), at(9.0)]),
        ];
        let found = GltfInstances::of(&meshes, 100).unwrap();
        let rest = GltfPart::Without([3, 7].into());
        assert_eq!(found.parts, [rest, GltfPart::Mesh(3), GltfPart::Mesh(7)]);
        let models: Vec<u32> = found.instances.iter().map(|instance| instance.model).collect();
        assert_eq!(models, [0, 1, 1, 1, 2, 2]);
        assert_eq!((found.instances[0].map, found.instances[5].map), (Affine::IDENTITY, at(9.0)));
        assert_eq!(found.triangles_saved, 2 * 50 + 200);
        // Without anything else there is no model for it.
        let alone = GltfInstances::of(&meshes[1..2], 100).unwrap();
        assert_eq!((alone.parts, alone.instances.len()), (vec![GltfPart::Mesh(3)], 3));
        assert_eq!(GltfInstances::of(&meshes, 1001), None);
        assert_eq!(GltfInstances::of(&meshes[..1], 0), None);
        assert_eq!(GltfInstances::of(&[], 0), None);
    }
}
