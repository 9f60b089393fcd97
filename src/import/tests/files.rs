//! Files by name: kinds, libraries, compression, second passes, and the record of a source.

use std::fs;
use std::path::Path;

use super::Folder;
use crate::error::ImportError;
use crate::import::{ImportOptions, ImportReport, MeshBuffer, import_file, source_record};

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

fn import(path: &Path) -> Result<(MeshBuffer, ImportReport), ImportError> {
    import_with(path, &ImportOptions::default())
}

fn import_with(path: &Path, options: &ImportOptions) -> Result<(MeshBuffer, ImportReport), ImportError> {
    let mut mesh = MeshBuffer::new();
    let report = import_file(path, options, &mut mesh)?;
    super::check(&mesh, &report);
    Ok((mesh, report))
}

#[test]
fn kinds_follow_extensions() {
    let folder = Folder::new();
    let path = folder.write("MODEL.Obj", format!("{SQUARE}f 1 2 3\n"));
    assert_eq!(import(&path).unwrap().0.triangles, [[0, 1, 2]]);
    for name in ["model", "model.xyz", "model.gz", "obj", "model.obj.zip"] {
        let path = folder.write(name, "");
        assert!(matches!(import(&path), Err(ImportError::UnknownKind { .. })), "{name}");
    }
    assert!(matches!(import(Path::new("absent.ply")), Err(ImportError::Io { .. })));
}

#[test]
fn libraries_are_found_beside_the_model() {
    let folder = Folder::new();
    folder.write("a.mtl", "newmtl red\nKd 1 0 0\n");
    folder.write("with blank.mtl", "newmtl green\nKd 0 1 0\n");
    let text = format!(
        "mtllib absent.mtl a.mtl with blank.mtl\nmtllib C:\\x\\a.mtl\n{SQUARE}f 1 2 3\nusemtl green\nf 1 2 3\n\
         usemtl red\nf 1 3 4\n"
    );
    let (mesh, report) = import(&folder.write("x.obj", text)).unwrap();
    assert_eq!(report.warning_count, 1);
    assert_eq!(report.material_files.len(), 2);
    let diffuse: Vec<[f32; 3]> =
        mesh.triangle_materials.iter().map(|id| mesh.materials[usize::from(id.0)].diffuse).collect();
    assert_eq!(diffuse, [[0.7; 3], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]);
}

#[test]
fn the_callers_library_goes_first() {
    let folder = Folder::new();
    folder.write("a.mtl", "newmtl red\nKd 1 0 0\n");
    let mine = folder.write("mine.mtl", "newmtl red\nKd 0 0 1\n");
    let options = ImportOptions::default().with_materials(&mine);
    let obj = folder.write("x.obj", format!("mtllib a.mtl\n{SQUARE}usemtl red\nf 1 2 3\n"));
    assert_eq!(import_with(&obj, &options).unwrap().0.materials[0].diffuse, [0.0, 0.0, 1.0]);
    let stl = folder.write(
        "x.stl",
        "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n",
    );
    assert_eq!(import_with(&stl, &options).unwrap().0.materials[0].diffuse, [0.0, 0.0, 1.0]);
    let absent = ImportOptions::default().with_materials("absent.mtl");
    assert!(matches!(import_with(&obj, &absent), Err(ImportError::Io { .. })));
}

#[test]
fn ply_faces_take_materials_by_index() {
    let folder = Folder::new();
    folder.write("a.mtl", "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n");
    let text = "ply\nformat ascii 1.0\ncomment mtllib a.mtl\nelement vertex 3\nproperty float x\nproperty float y\n\
        property float z\nelement face 4\nproperty short material_index\nproperty list uchar int vertex_indices\n\
        end_header\n0 0 0\n1 0 0\n1 1 0\n1 3 0 1 2\n0 3 0 1 2\n-1 3 0 1 2\n2 3 0 1 2\n";
    let (mesh, report) = import(&folder.write("x.ply", text)).unwrap();
    assert_eq!(mesh.triangle_materials.iter().map(|id| id.0).collect::<Vec<_>>(), [1, 0, 2, 2]);
    assert_eq!(report.warning_count, 1);
}

#[test]
fn faces_before_vertices_take_two_passes() {
    let folder = Folder::new();
    let ply = "ply\nformat ascii 1.0\nelement face 1\nproperty list uchar int vertex_indices\nelement vertex 3\n\
        property float x\nproperty float y\nproperty float z\nend_header\n3 0 1 2\n0 0 0\n1 0 0\n1 1 0\n";
    assert_eq!(import(&folder.write("x.ply", ply)).unwrap().0.triangles, [[0, 1, 2]]);

    folder.write("a.mtl", "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n");
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl red\nf 1 2 3\nf 1 2 4\nv 5 5 5\nusemtl blue\nf -1 -2 -3\n\
        vn 0 0 1\nf 1 2 5\nv 6 6 6\nxyzzy\n";
    let (mesh, report) = import(&folder.write("x.obj", obj)).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 3], [3, 2, 1], [0, 1, 4]]);
    assert_eq!(mesh.triangle_materials.iter().map(|id| id.0).collect::<Vec<_>>(), [0, 0, 1, 1]);
    assert_eq!(mesh.vertices.len(), 5);
    assert_eq!((report.ignored.normals, report.ignored.unknown), (1, 1));
    let error = import(&folder.write("y.obj", "v 0 0 0\nf 1 1 3\nv 1 1 1\n")).unwrap_err().to_string();
    assert!(error.ends_with("y.obj:2: a face names vertex 3, but the file has 2"), "{error}");
}

#[cfg(feature = "gzip")]
#[test]
fn compressed_files_of_several_members() {
    use std::io::Write;
    let pack = |text: &str| {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        encoder.write_all(text.as_bytes()).unwrap();
        encoder.finish().unwrap()
    };
    let folder = Folder::new();
    let whole = [pack(SQUARE), pack("f 1 2 3\nf 1 2 5\n"), pack("v 7 7 7\n")].concat();
    let (mesh, _) = import(&folder.write("x.obj.GZ", &whole)).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 1, 4]]);
    for cut in [1, 10, whole.len() / 2, whole.len() - 1] {
        let outcome = import(&folder.write("cut.obj.gz", &whole[..cut]));
        assert!(matches!(outcome, Err(ImportError::Io { .. } | ImportError::Line { .. })), "{cut}");
    }
}

#[test]
fn source_records_notice_changes() {
    let folder = Folder::new();
    let mtl = folder.write("a.mtl", "newmtl red\nKd 1 0 0\n");
    let path = folder.write("x.obj", format!("mtllib a.mtl\n{SQUARE}f 1 2 3\n{}", "# x\n".repeat(100_000)));
    let record = source_record(&path).unwrap();
    assert_eq!(record.file_bytes, fs::metadata(&path).unwrap().len());
    assert_eq!(record, source_record(&path).unwrap());
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(1000);
    fs::File::options().write(true).open(&mtl).unwrap().set_modified(later).unwrap();
    let touched = source_record(&path).unwrap();
    assert!(touched.modified_ns > record.modified_ns);
    assert_eq!(touched.fingerprint, record.fingerprint);
    let mut bytes = fs::read(&path).unwrap();
    for place in [0, bytes.len() - 1] {
        bytes[place] ^= 1;
        fs::write(&path, &bytes).unwrap();
        assert_ne!(source_record(&path).unwrap().fingerprint, record.fingerprint);
        bytes[place] ^= 1;
    }
    assert!(source_record(Path::new("absent.obj")).is_err());
}

/// Archives and copies keep times, which are often older than the model's own.
#[test]
fn source_records_notice_libraries_that_are_older_than_the_model() {
    let folder = Folder::new();
    let path = folder.write("x.obj", format!("mtllib a.mtl\n{SQUARE}f 1 2 3\n"));
    let missing = source_record(&path).unwrap();
    let earlier = std::time::SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1000);
    let mut records = vec![missing];
    for text in ["newmtl red\nKd 1 0 0\n", "newmtl red\nKd 0 0 1\n"] {
        let mtl = folder.write("a.mtl", text);
        fs::File::options().write(true).open(&mtl).unwrap().set_modified(earlier).unwrap();
        let record = source_record(&path).unwrap();
        assert_eq!(record.modified_ns, missing.modified_ns);
        assert!(!records.contains(&record), "{text}");
        records.push(record);
    }
    // Whatever blanks are about its name.
    let tabs = folder.write("tabs.obj", format!("\u{B}mtllib\ta.mtl\n{SQUARE}f 1 2 3\n"));
    let with = source_record(&tabs).unwrap();
    folder.write("a.mtl", "newmtl red\nKd 0 1 1\n");
    assert_ne!(source_record(&tabs).unwrap().fingerprint, with.fingerprint);
    // The reader takes it and its materials by the same blanks.
    let uses = folder.write("uses.obj", format!("\u{B}mtllib\u{B}a.mtl\n{SQUARE}usemtl\u{B}red\nf 1 2 3\n"));
    assert_eq!(import(&uses).unwrap().1.warning_count, 0);
    // A pipe is none; opening it would wait for whoever writes to it.
    #[cfg(unix)]
    {
        let mtl = path.with_file_name("a.mtl");
        fs::remove_file(&mtl).unwrap();
        let made = std::process::Command::new("mkfifo").arg(&mtl).status().unwrap();
        assert!(made.success());
        assert_eq!(source_record(&path).unwrap(), missing);
    }
}

/// Names in an encoding of one's own country are no UTF-8, and differ all the same.
#[test]
fn materials_with_names_in_other_encodings_are_told_apart() {
    let folder = Folder::new();
    folder.write("x.mtl", b"newmtl gr\xFCn\nKd 0 1 0\nnewmtl gr\xE4n\nKd 1 0 0\n");
    let text = b"mtllib x.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl gr\xFCn\nf 1 2 3\n";
    let mut mesh = MeshBuffer::new();
    import_file(folder.write("x.obj", text), &ImportOptions::default(), &mut mesh).unwrap();
    assert_eq!(mesh.materials[mesh.triangle_materials[0].0 as usize].diffuse, [0.0, 1.0, 0.0]);
}
