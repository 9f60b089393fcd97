//! Triangles that never were a file.

use crate::import::{MeshBuffer, MeshSink, TriangleSink, import_triangles};
use crate::model::MaterialRecord;

#[test]
fn an_iterator_becomes_a_mesh() {
    let corners = |i: u32| [[i as f32, 0.0, 0.0], [1.0, i as f32, 0.0], [0.0, 1.0, i as f32]];
    let mut mesh = MeshBuffer::new();
    let count = import_triangles((0..100_000).map(corners), None, &mut mesh).unwrap();
    assert_eq!(count, 100_000);
    assert_eq!(mesh.vertices.len(), 300_000);
    assert_eq!(mesh.float32_count, 300_000);
    assert!(mesh.vertices_complete);
    assert_eq!(mesh.materials, [MaterialRecord::default()]);
    for i in [0, 1, 32_767, 32_768, 99_999] {
        assert_eq!(mesh.corners(i), corners(i as u32).map(|p| p.map(f64::from)));
    }
}

#[test]
fn number_types_and_materials_mix() {
    let mut mesh = MeshBuffer::new();
    let red = mesh.material(MaterialRecord { name: "red".into(), ..MaterialRecord::default() }).unwrap();
    let mut triangles = TriangleSink::new(&mut mesh);
    triangles.push([[0.1_f64, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], Some(red)).unwrap();
    triangles.push([[0.1_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], None).unwrap();
    triangles.push([[0.2_f64, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], Some(red)).unwrap();
    assert_eq!(triangles.finish().unwrap(), 3);
    let first: Vec<f64> = (0..3).map(|i| mesh.corners(i)[0][0]).collect();
    assert_eq!(first, [0.1, f64::from(0.1_f32), 0.2]);
    assert_eq!(mesh.triangle_materials.iter().map(|id| id.0).collect::<Vec<_>>(), [0, 1, 0]);
}
