//! Procedural models come back unchanged through the file formats that they are written to.

use std::path::Path;

use outcrop::import::{ImportOptions, MeshBuffer, import_file};
use outcrop::model::MaterialRecord;
use outcrop::procedural::export::{write_obj, write_ply};
use outcrop::procedural::{Gears, GlassStack, Icosphere, Shape, Soup, Terrain};

fn emitted(shape: &dyn Shape) -> MeshBuffer {
    let mut mesh = MeshBuffer::new();
    shape.emit(&mut mesh).unwrap();
    mesh
}

fn imported(path: &Path) -> MeshBuffer {
    let mut mesh = MeshBuffer::new();
    let report = import_file(path, &ImportOptions::default(), &mut mesh).unwrap();
    assert_eq!(
        (report.vertices, report.triangles),
        (mesh.vertices.len() as u64, mesh.triangles.len() as u64)
    );
    assert_eq!(report.warning_count, 0, "{:?}", report.warnings);
    mesh
}

/// The material of each triangle: a reader may number them in the order of their use.
fn triangle_materials(mesh: &MeshBuffer) -> Vec<&MaterialRecord> {
    mesh.triangle_materials.iter().map(|id| &mesh.materials[usize::from(id.0)]).collect()
}

#[test]
fn through_ply_with_materials() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.ply");
    let shapes: [&dyn Shape; 3] = [
        &Gears::new(1).unwrap(),
        &GlassStack::new(9, 0.1, 0.25, 1.5).unwrap(),
        &Terrain::new(40, 5).unwrap(),
    ];
    for shape in shapes {
        write_ply(shape, &path, true).unwrap();
        let (wrote, read) = (emitted(shape), imported(&path));
        assert!(wrote.vertices == read.vertices);
        assert!(wrote.triangles == read.triangles);
        assert!(triangle_materials(&wrote) == triangle_materials(&read));
        assert_eq!(read.float32_count, read.vertices.len());
    }
}

#[test]
fn through_ply_in_f64() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.ply");
    let sphere = Icosphere::new(1000.0, [1e7, 0.1, -1e4], 3).unwrap();
    write_ply(&sphere, &path, false).unwrap();
    let (wrote, read) = (emitted(&sphere), imported(&path));
    assert!(wrote.vertices == read.vertices);
    assert!(wrote.triangles == read.triangles);
    assert_eq!(read.float32_count, 0);
}

#[test]
fn through_obj() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("model.obj");
    let shapes: [&dyn Shape; 2] = [&Gears::new(2).unwrap(), &Soup::new(1000, 0.1, 1).unwrap()];
    for shape in shapes {
        write_obj(shape, &path).unwrap();
        let (wrote, read) = (emitted(shape), imported(&path));
        // Text is read as f64; the digits are those of the f32.
        let bits = |mesh: &MeshBuffer| -> Vec<u32> {
            mesh.vertices.iter().flatten().map(|&x| (x as f32).to_bits()).collect()
        };
        assert!(bits(&wrote) == bits(&read));
        assert!(wrote.triangles == read.triangles);
        assert!(triangle_materials(&wrote) == triangle_materials(&read));
    }
}
