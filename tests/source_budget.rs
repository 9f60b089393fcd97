//! A source asks the budget before it allocates a model's directory (I1).

use std::path::{Path, PathBuf};

use outcrop::compile::{CompileOptions, Control, compile_shape};
use outcrop::error::{ModelError, SourceError};
use outcrop::model::ModelReader;
use outcrop::procedural::Icosphere;
use outcrop::source::{DiskSource, PageCache};
use outcrop::units::Bytes;
use outcrop::{BlockSource, MemoryBudget};

/// A model of many small blocks.
fn compiled(folder: &Path) -> PathBuf {
    let path = folder.join("sphere.outcrop");
    let sphere = Icosphere::new(1.0, [0.0; 3], 5).unwrap();
    let options = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_shape(&sphere, &path, &options, &budget, &mut |_| Control::Continue).unwrap();
    path
}

#[test]
fn a_budget_without_room_for_the_directory_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let path = compiled(folder.path());
    for page_cache in [PageCache::Use, PageCache::Bypass] {
        let roomy = MemoryBudget::new(Bytes::mib(64));
        let source = DiskSource::open_in(&path, page_cache, &roomy).unwrap();
        assert!(source.model().blocks.len() > 50);
        // What was asked for covers what stays, and was given back.
        let asked = roomy.peak();
        assert!(asked >= source.model().resident_bytes(), "{asked}");
        assert_eq!(roomy.available(), roomy.limit());

        // One byte less is too little.
        let tight = MemoryBudget::new(Bytes(asked.0 - 1));
        let error = DiskSource::open_in(&path, page_cache, &tight).unwrap_err();
        let SourceError::Budget(error) = error else { panic!("{error}") };
        assert_eq!((error.needed, error.limit), (asked, tight.limit()));
        assert_eq!(tight.peak(), Bytes(0));
        DiskSource::open_in(&path, page_cache, &MemoryBudget::new(asked)).unwrap();
    }
}

#[test]
fn nothing_but_the_header_is_read_when_there_is_no_room() {
    let folder = tempfile::tempdir().unwrap();
    let file = std::fs::read(compiled(folder.path())).unwrap();
    let mut parts = Vec::new();
    let refused = ModelError::Limit { reason: "no room" };
    let result = ModelReader::read_if(
        file.len() as u64,
        |_| Err(refused.clone()),
        |part, offset, into: &mut [u8]| {
            parts.push(part);
            into.copy_from_slice(&file[offset as usize..][..into.len()]);
            Ok(())
        },
    );
    assert_eq!(result.unwrap_err(), refused);
    assert_eq!(parts, ["the header"]);
}
