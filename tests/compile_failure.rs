//! A compile that fails, is cancelled or is killed leaves nothing that opens, and what was there stays.

#[path = "support/compiling.rs"]
mod compiling;

use std::fs;
use std::io;

use compiling::{Mesh, Place, Vertices, assert_same, compile, compile_with};
use outcrop::MemoryBudget;
use outcrop::compile::{CompileOptions, Compiler, Control, Phase, Threads, compile_file};
use outcrop::error::{CompileError, ImportError};
use outcrop::import::{MeshSink, VertexBatch};
use outcrop::model::MaterialRecord;
use outcrop::procedural::{Gears, Tessellation};
use outcrop::units::{Bytes, MaterialId};

const ROOMY: Bytes = Bytes::mib(256);
const TIGHT: Bytes = Bytes::mib(18);

fn gears() -> Mesh {
    Mesh::of(&Gears::with_tessellation(3, Tessellation::new(12).unwrap()).unwrap())
}

#[test]
fn cancelled_in_any_phase_it_leaves_what_was_there() {
    let mut mesh = gears();
    for (phase, complete_first) in [
        (Phase::Read, true),
        (Phase::Read, false),
        (Phase::Scatter, false),
        (Phase::Cut, true),
        (Phase::Seal, true),
    ] {
        mesh.complete_first = complete_first;
        for threads in [Threads::One, Threads::Count(2)] {
            let place = Place::new();
            fs::write(place.output(), b"what was there").unwrap();
            let options = CompileOptions { threads, ..CompileOptions::default() };
            let mut asked = 0;
            let result = compile_with(&mesh, &options, TIGHT, &place.output(), &mut |progress| {
                assert!(progress.fraction.is_none_or(|fraction| (0.0..=1.0).contains(&fraction)));
                asked += u32::from(progress.phase == phase);
                if progress.phase == phase { Control::Cancel } else { Control::Continue }
            });
            assert!(matches!(result, Err(CompileError::Cancelled)), "{phase:?}: {result:?}");
            assert_eq!(asked, 1, "{phase:?}: nothing goes on after it was cancelled");
            assert_eq!(place.files(), ["model.outcrop"], "{phase:?}");
            assert_eq!(fs::read(place.output()).unwrap(), b"what was there");
        }
    }
}

#[test]
fn a_panic_in_the_callback_leaves_nothing() {
    let mesh = gears();
    for phase in [Phase::Read, Phase::Cut, Phase::Seal] {
        let place = Place::new();
        let run = std::panic::AssertUnwindSafe(|| {
            let options = CompileOptions { threads: Threads::Count(2), ..CompileOptions::default() };
            compile_with(&mesh, &options, TIGHT, &place.output(), &mut |progress| {
                assert!(progress.phase != phase, "stop here");
                Control::Continue
            })
        });
        assert!(std::panic::catch_unwind(run).is_err());
        assert!(place.files().is_empty(), "{phase:?}: {:?}", place.files());
    }
}

#[test]
fn a_full_disk_is_named_wherever_it_strikes() {
    let mut mesh = gears();
    let needed = {
        let (report, bytes) = compile(&mesh, &CompileOptions::default(), TIGHT);
        report.spill_bytes + bytes.len() as u64
    };
    for complete_first in [true, false] {
        mesh.complete_first = complete_first;
        for part in 0..20 {
            let place = Place::new();
            let disk_limit = Some(Bytes(needed * part / 20));
            let options = CompileOptions { disk_limit, ..CompileOptions::default() };
            match compile_with(&mesh, &options, TIGHT, &place.output(), &mut |_| Control::Continue) {
                Err(CompileError::Write { path, error }) => {
                    assert_eq!(error.kind(), io::ErrorKind::StorageFull);
                    assert!(path.starts_with(place.path()));
                }
                other => panic!("{part}/20: {other:?}"),
            }
            assert!(place.files().is_empty());
        }
    }
    mesh.complete_first = true;
    let place = Place::new();
    let options = CompileOptions { disk_limit: Some(Bytes(needed)), ..CompileOptions::default() };
    compile_with(&mesh, &options, TIGHT, &place.output(), &mut |_| Control::Continue).expect("just enough");
}

#[test]
fn an_output_that_cannot_be_written_is_named() {
    let place = Place::new();
    let output = place.path().join("no such directory").join("model");
    let mesh = gears();
    let result = compile_with(&mesh, &CompileOptions::default(), ROOMY, &output, &mut |_| Control::Continue);
    let Err(CompileError::Write { path, error }) = result else { panic!("{result:?}") };
    assert_eq!(error.kind(), io::ErrorKind::NotFound);
    assert!(path.starts_with(output.parent().unwrap()));
    // A directory in the output's place is found out when the file is published.
    let result =
        compile_with(&mesh, &CompileOptions::default(), ROOMY, place.path(), &mut |_| Control::Continue);
    assert!(matches!(result, Err(CompileError::Write { .. })), "{result:?}");
}

#[test]
fn a_stale_temporary_is_taken_over_and_a_live_one_is_not() {
    let mesh = gears();
    let place = Place::new();
    // What a killed run leaves: its files without their locks.
    for name in ["model.outcrop.partial", "model.outcrop.spill", "model.outcrop.vertices"] {
        fs::write(place.path().join(name), vec![7; 5_000_000]).unwrap();
    }
    let live = fs::File::create(place.path().join("model.outcrop.partial-1")).unwrap();
    live.lock().unwrap();
    let options = CompileOptions::default();
    compile_with(&mesh, &options, TIGHT, &place.output(), &mut |_| Control::Continue).expect("compiles");
    assert_same(&mesh, &fs::read(place.output()).unwrap());
    assert!(!place.files().contains(&"model.outcrop.partial".to_string()));
    assert!(place.files().contains(&"model.outcrop.partial-1".to_string()));

    // Two at once, one in the other's callback: both finish, the later one's file stays.
    let small =
        Mesh::new(Vertices::Float32(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), vec![[0, 1, 2]]);
    let mut inner = false;
    compile_with(&mesh, &options, ROOMY, &place.output(), &mut |progress| {
        if progress.phase == Phase::Cut && !inner {
            inner = true;
            let report =
                compile_with(&small, &options, ROOMY, &place.output(), &mut |_| Control::Continue).unwrap();
            assert_eq!(report.triangles, 1);
        }
        Control::Continue
    })
    .expect("compiles");
    assert!(inner);
    assert_same(&mesh, &fs::read(place.output()).unwrap());
}

#[test]
fn an_unfinished_file_does_not_open() {
    let mesh = gears();
    let place = Place::new();
    let mut seen = 0;
    compile_with(&mesh, &CompileOptions::default(), ROOMY, &place.output(), &mut |progress| {
        if matches!(progress.phase, Phase::Cut | Phase::Seal) {
            let partial = fs::read(place.path().join("model.outcrop.partial")).unwrap();
            assert!(outcrop::model::ModelReader::parse(&partial).is_err());
            assert!(!place.output().exists());
            seen += 1;
        }
        Control::Continue
    })
    .unwrap();
    assert!(seen > 1);
}

#[test]
fn inputs_that_are_not_there_or_say_nothing() {
    let place = Place::new();
    let budget = MemoryBudget::new(ROOMY);
    let mut go_on = |_| Control::Continue;
    let options = CompileOptions::default();
    let missing = place.path().join("missing.ply");
    match compile_file(&missing, place.output(), &options, &budget, &mut go_on) {
        Err(CompileError::Import(ImportError::Io { path, error })) => {
            assert_eq!((path, error.kind()), (missing, io::ErrorKind::NotFound));
        }
        other => panic!("{other:?}"),
    }
    let compiler = Compiler::new(place.output(), options.clone(), &budget, &mut go_on).unwrap();
    assert!(matches!(compiler.finish(), Err(CompileError::Empty)));
    let mut compiler = Compiler::new(place.output(), options, &budget, &mut go_on).unwrap();
    compiler.vertices(VertexBatch::Float32(&[[f32::NAN; 3], [0.0; 3]])).unwrap();
    let error = compiler.triangles(&[[0, 1, 2]], MaterialId(0)).unwrap_err();
    assert!(error.to_string().contains("vertex 2"), "{error}");
    assert!(compiler.position(2).is_err() && compiler.position(1).unwrap() == [0.0; 3]);
    drop(compiler);
    assert!(place.files().is_empty());
}

#[test]
fn a_budget_that_is_too_small_says_so() {
    let mesh = gears();
    for mib in [1, 4, 12, 15] {
        let place = Place::new();
        let result =
            compile_with(&mesh, &CompileOptions::default(), Bytes::mib(mib), &place.output(), &mut |_| {
                Control::Continue
            });
        assert!(matches!(result, Err(CompileError::Budget(_))), "{mib}: {result:?}");
        assert!(place.files().is_empty());
    }
}

#[test]
fn options_that_make_no_sense_are_refused() {
    let place = Place::new();
    let budget = MemoryBudget::new(ROOMY);
    let precision = outcrop::compile::PrecisionChoice::Lattice { exponent: 1000 };
    for options in [
        CompileOptions { block_bytes: 100, ..CompileOptions::default() },
        CompileOptions { block_bytes: 1 << 20, ..CompileOptions::default() },
        CompileOptions { precision, ..CompileOptions::default() },
    ] {
        let result = Compiler::new(place.output(), options, &budget, &mut |_| Control::Continue).map(drop);
        assert!(matches!(result, Err(CompileError::Limit { .. })), "{result:?}");
    }
}

/// Gives a material and four vertices, of which the last is not finite.
fn begin_with_a_bad_vertex(sink: &mut dyn MeshSink) {
    sink.material(MaterialRecord::default()).unwrap();
    let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f32::NAN, 0.0, 0.0]];
    sink.vertices(VertexBatch::Float32(&vertices)).unwrap();
    sink.vertices_complete().unwrap();
}

#[test]
fn what_comes_after_an_error_of_a_thread_is_refused() {
    let place = Place::new();
    let budget = MemoryBudget::new(ROOMY);
    let options = CompileOptions { threads: Threads::Count(2), ..CompileOptions::default() };
    let mut progress = |_| Control::Continue;
    let mut compiler = Compiler::new(place.output(), options, &budget, &mut progress).unwrap();
    begin_with_a_bad_vertex(&mut compiler);
    compiler.triangles(&[[0, 1, 3]], MaterialId(0)).unwrap();
    // The thread that meets the first triangle stops; when that shows depends on the threads.
    let batch = vec![[0, 1, 2]; 16 << 10];
    let error = loop {
        if let Err(error) = compiler.triangles(&batch, MaterialId(0)) {
            break error;
        }
    };
    assert!(matches!(error, CompileError::NotFinite { triangle: 0 }), "{error}");
    for _ in 0..2 {
        let result = (0..3).try_for_each(|_| compiler.triangles(&batch, MaterialId(0)));
        assert!(matches!(result, Err(CompileError::Limit { .. })), "{result:?}");
    }
    assert!(matches!(compiler.finish(), Err(CompileError::Limit { .. })));
    assert!(place.files().is_empty());
}

#[test]
fn what_comes_after_an_error_is_refused() {
    let place = Place::new();
    let budget = MemoryBudget::new(ROOMY);
    let options = CompileOptions { threads: Threads::One, ..CompileOptions::default() };
    let mut progress = |_| Control::Continue;
    let mut compiler = Compiler::new(place.output(), options, &budget, &mut progress).unwrap();
    begin_with_a_bad_vertex(&mut compiler);
    let mut batch = vec![[0, 1, 2]; 16 << 10];
    // Nothing of these is taken, and nothing is lost.
    assert!(compiler.triangles(&[[0, 1, 4]], MaterialId(0)).is_err());
    compiler.triangles(&batch, MaterialId(0)).unwrap();
    batch[9] = [0, 1, 3];
    let error = compiler.triangles(&batch, MaterialId(0)).unwrap_err();
    assert!(matches!(error, CompileError::NotFinite { .. }), "{error}");
    batch[9] = [0, 1, 2];
    let result = compiler.triangles(&batch, MaterialId(0));
    assert!(matches!(result, Err(CompileError::Limit { .. })), "{result:?}");
    let result = compiler.finish();
    assert!(matches!(result, Err(CompileError::Limit { .. })), "{result:?}");
    assert!(place.files().is_empty());
}
