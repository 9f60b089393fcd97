//! Any bytes as a OBJ file: a mesh whose triangles name its vertices, or a typed error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use outcrop::import::{ImportOptions, MeshBuffer, read_obj};

fuzz_target!(|bytes: &[u8]| {
    let mut mesh = MeshBuffer::new();
    if let Ok(report) = read_obj(bytes, Path::new("fuzz.obj"), &ImportOptions::default(), &mut mesh) {
        assert_eq!(report.vertices, mesh.vertices.len() as u64);
        assert_eq!(report.triangles, mesh.triangles.len() as u64);
    }
});
