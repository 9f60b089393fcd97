//! glTF files from elsewhere: each loads or says why not. They are no part of this repository, so this is run by hand:
//!
//!     OUTCROP_GLTF_FOLDER=... cargo test --test gltf_files -- --ignored --nocapture

use std::fs;
use std::path::PathBuf;

use outcrop::import::{ImportOptions, MeshBuffer, import_file};

#[test]
#[ignore = "needs a folder of glTF files, named by OUTCROP_GLTF_FOLDER"]
fn files_from_elsewhere_load_or_say_why_not() {
    let mut folders =
        vec![PathBuf::from(std::env::var_os("OUTCROP_GLTF_FOLDER").expect("OUTCROP_GLTF_FOLDER"))];
    let (mut loaded, mut refused) = (0, 0);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|kind| kind == "gltf" || kind == "glb") {
                let mut mesh = MeshBuffer { keep_attributes: true, ..MeshBuffer::new() };
                match import_file(&path, &ImportOptions::default(), &mut mesh) {
                    Ok(report) => {
                        let count = mesh.vertices.len();
                        assert!(
                            mesh.triangles.as_flattened().iter().all(|corner| (*corner as usize) < count)
                        );
                        assert_eq!(report.triangles, mesh.triangles.len() as u64);
                        println!("{}: {} triangles, {:?}", path.display(), report.triangles, report.warnings);
                        loaded += 1;
                    }
                    Err(error) => {
                        println!("refused: {error}");
                        refused += 1;
                    }
                }
            }
        }
    }
    println!("{loaded} loaded, {refused} refused");
    assert!(loaded > 0, "nothing was loaded");
}
