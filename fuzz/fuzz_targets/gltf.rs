//! Any document with a buffer in it, or any container, as a glTF file: a mesh whose triangles name its vertices, or a typed error.
#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use outcrop::import::{ImportOptions, import_file};
use outcrop::instance::GltfInstances;
use outcrop_fuzz::check_import;

fuzz_target!(|bytes: &[u8]| {
    let Ok(folder) = tempfile::tempdir() else { return };
    let path = folder.path().join("fuzz.gltf");
    if fs::write(&path, bytes).is_ok() {
        // What is shared of it, if it is one.
        let _ = GltfInstances::read_for(&path, 1);
        check_import(|mesh| import_file(&path, &ImportOptions::default(), mesh));
    }
});
