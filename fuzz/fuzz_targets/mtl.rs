//! Any bytes as the material library of an OBJ file: materials and warnings, or a typed error; never is the geometry lost for it.
#![no_main]

use std::fs;

use libfuzzer_sys::fuzz_target;
use outcrop::import::{ImportOptions, import_file};
use outcrop_fuzz::check_import;

/// Two triangles, whose materials a library may have.
const MODEL: &str = "mtllib fuzz.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 3 2 1\n";

fuzz_target!(|library: &[u8]| {
    let Ok(folder) = tempfile::tempdir() else { return };
    let path = folder.path().join("fuzz.obj");
    if fs::write(&path, MODEL).is_ok() && fs::write(folder.path().join("fuzz.mtl"), library).is_ok() {
        check_import(|mesh| {
            let report = import_file(&path, &ImportOptions::default(), mesh);
            assert!(report.as_ref().is_ok_and(|report| report.triangles == 2), "{report:?}");
            report
        });
    }
});
