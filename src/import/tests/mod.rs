//! Tests of the whole room: what each syntax form gives, what each fault says, and that nothing panics.

mod decimal;
mod files;
#[cfg(feature = "gltf")]
mod gltf;
mod hostile;
mod mtl;
mod number;
mod obj;
mod ply;
mod ply_round_trip;
mod polygon;
mod stl;
mod triangles;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::{ImportOptions, ImportReport, MeshBuffer, read_obj, read_ply, read_stl};
use crate::error::ImportError;

/// Where a test keeps its files.
struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) -> PathBuf {
        let path = self.0.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    }
}

type Outcome = Result<(MeshBuffer, ImportReport), ImportError>;

/// A reader that gives a few bytes at a time.
struct Dribble<'a>(&'a [u8], usize);

impl Read for Dribble<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.0.len().min(buffer.len()).min(self.1);
        buffer[..count].copy_from_slice(&self.0[..count]);
        self.0 = &self.0[count..];
        Ok(count)
    }
}

/// Reads on one thread, and with others, which must give the same.
fn obj(text: impl AsRef<[u8]>) -> Outcome {
    static POOL: OnceLock<Arc<rayon::ThreadPool>> = OnceLock::new();
    let pool = POOL.get_or_init(|| Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap()));
    let read = |options: ImportOptions| {
        let mut mesh = MeshBuffer::new();
        let reader = Dribble(text.as_ref(), 1000);
        let report = read_obj(reader, Path::new("folder/model.obj"), &options, &mut mesh);
        (mesh, report)
    };
    let (mesh, report) = read(ImportOptions::default());
    let (other_mesh, other_report) = read(ImportOptions::default().with_pool(Arc::clone(pool)));
    assert_eq!(mesh, other_mesh, "with other threads");
    match (&report, &other_report) {
        (Ok(report), Ok(other)) => assert_eq!(report, other, "with other threads"),
        (Err(error), Err(other)) => assert_eq!(error.to_string(), other.to_string(), "with other threads"),
        outcomes => panic!("with other threads: {outcomes:?}"),
    }
    let report = report?;
    check(&mesh, &report);
    Ok((mesh, report))
}

fn ply(bytes: impl AsRef<[u8]>) -> Outcome {
    let mut mesh = MeshBuffer::new();
    let report = read_ply(
        Dribble(bytes.as_ref(), 1000),
        Path::new("folder/model.ply"),
        &ImportOptions::default(),
        &mut mesh,
    )?;
    check(&mesh, &report);
    Ok((mesh, report))
}

fn stl(bytes: impl AsRef<[u8]>) -> Outcome {
    let mut mesh = MeshBuffer::new();
    let report = read_stl(
        Dribble(bytes.as_ref(), 1000),
        Path::new("folder/model.stl"),
        &ImportOptions::default(),
        &mut mesh,
    )?;
    check(&mesh, &report);
    Ok((mesh, report))
}

/// What holds for every import that ends well.
fn check(mesh: &MeshBuffer, report: &ImportReport) {
    assert_eq!(report.vertices, mesh.vertices.len() as u64);
    assert_eq!(report.triangles, mesh.triangles.len() as u64);
    assert_eq!(report.materials as usize, mesh.materials.len());
    assert!(report.fans <= report.polygons);
    assert!(mesh.vertices_complete);
}

/// The message of an import that must fail.
fn error(outcome: Outcome) -> String {
    outcome.expect_err("the import must fail").to_string()
}
