//! Any bytes as a STL file: a mesh whose triangles name its vertices, or a typed error.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use outcrop::import::{ImportOptions, read_stl};
use outcrop_fuzz::check_import;

fuzz_target!(|bytes: &[u8]| {
    check_import(|mesh| read_stl(bytes, Path::new("fuzz.stl"), &ImportOptions::default(), mesh));
});
