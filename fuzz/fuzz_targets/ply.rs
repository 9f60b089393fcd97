//! Any bytes as a PLY file: a mesh whose triangles name its vertices, or a typed error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use outcrop::import::{ImportOptions, read_ply};
use outcrop_fuzz::check_import;

fuzz_target!(|bytes: &[u8]| {
    check_import(|mesh| read_ply(bytes, Path::new("fuzz.ply"), &ImportOptions::default(), mesh));
});
