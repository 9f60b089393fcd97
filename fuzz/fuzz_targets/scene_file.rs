//! Any text as a scene file: a scene whose parts name each other rightly, or a typed error. No file that it names is opened.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use outcrop::scene_file::SceneFile;

fuzz_target!(|text: &str| {
    let Ok(file) = SceneFile::parse(text, Path::new("fuzz.toml")) else { return };
    let instances = file.instances();
    let count = instances.as_ref().map_or(0, Vec::len);
    if let Some(instances) = instances {
        assert!(instances.iter().all(|instance| (instance.model as usize) < file.models.len()));
    }
    assert!(file.movements().iter().all(|(moved, _)| *moved < count));
});
