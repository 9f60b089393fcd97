//! What `compile_file` and a lazy compile say about the model file that they read.

use std::fs;
use std::path::Path;

use outcrop::MemoryBudget;
use outcrop::compile::{
    CompileOptions, CompileReport, Control, LazyModel, LazyOptions, compile_file, compile_shape,
};
use outcrop::error::CompileError;
use outcrop::import::ImportReport;
use outcrop::procedural::Icosphere;
use outcrop::units::Bytes;

fn budget() -> MemoryBudget {
    MemoryBudget::new(Bytes::mib(64))
}

fn compile(input: &Path, options: &CompileOptions) -> Result<CompileReport, CompileError> {
    compile_file(input, input.with_extension("outcrop"), options, &budget(), &mut |_| Control::Continue)
}

fn lazy(input: &Path) -> LazyModel {
    let options = LazyOptions::default();
    let output = input.with_extension("lazy.outcrop");
    LazyModel::open(input, &output, &options, &budget(), &mut |_| Control::Continue).unwrap()
}

/// What every reading of a model reports whose library is missing and that has one line beside its triangle.
fn assert_told(report: Option<&ImportReport>) {
    let report = report.expect("a file was read");
    assert_eq!((report.triangles, report.ignored.lines_and_points), (1, 1));
    assert_eq!(report.warning_count, 1);
    assert_eq!(report.warnings.len(), 1);
    assert!(report.warnings[0].to_string().contains("missing.mtl"), "{}", report.warnings[0]);
}

#[test]
fn what_the_import_left_out_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let narrow = "mtllib missing.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nl 1 2\nf 1 2 3\n";
    // Digits that f32 cannot keep, so that the file is read again: reported once all the same.
    let wide = narrow.replace("v 0 1 0", "v 0 1.00000000000001 0");
    for (name, text) in [("narrow.obj", narrow), ("wide.obj", &wide)] {
        let input = folder.path().join(name);
        fs::write(&input, text).unwrap();
        let report = compile(&input, &CompileOptions::default()).unwrap();
        assert_told(report.import.as_ref());

        let model = lazy(&input);
        assert_told(model.import_report());
        drop(model);
        // The working file is there, so nothing was read that could be reported.
        let model = lazy(&input);
        assert!(model.report().was_reopened);
        assert_eq!(model.import_report(), None);
        assert_eq!(model.finish(&mut |_| Control::Continue).unwrap().import, None);
        assert_told(lazy(&input).finish(&mut |_| Control::Continue).unwrap().import.as_ref());
    }
}

#[test]
fn geometry_that_was_no_file_has_no_import() {
    let folder = tempfile::tempdir().unwrap();
    let sphere = Icosphere::new(1.0, [0.0; 3], 1).unwrap();
    let output = folder.path().join("sphere.outcrop");
    let options = CompileOptions::default();
    let report = compile_shape(&sphere, &output, &options, &budget(), &mut |_| Control::Continue).unwrap();
    assert_eq!(report.import, None);
}

#[test]
fn triangles_that_are_not_finite_are_an_error_or_are_skipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let vertices = |odd: &str| format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nv {odd} 0 0\nf 1 2 3\nf 1 4 3\nf 3 2 1\n");
    for (name, odd) in [("nan.obj", "nan"), ("inf.obj", "-inf"), ("huge.obj", "1e999")] {
        let input = folder.path().join(name);
        fs::write(&input, vertices(odd)).unwrap();
        let error = compile(&input, &CompileOptions::default()).unwrap_err();
        assert!(matches!(error, CompileError::NotFinite { triangle: 1 }), "{name}: {error}");
        // What the message says to do is what there is.
        assert!(error.to_string().contains("`CompileOptions::skip_not_finite`"), "{error}");
        let options = CompileOptions { skip_not_finite: true, ..CompileOptions::default() };
        let report = compile(&input, &options).unwrap();
        assert_eq!((report.triangles, report.skipped), (2, 1), "{name}");
        assert_eq!(report.import.unwrap().triangles, 3, "{name}: the reader sends it, the compiler skips it");

        let options = LazyOptions { compile: options, ..LazyOptions::default() };
        let output = input.with_extension("lazy.outcrop");
        let model =
            LazyModel::open(&input, &output, &options, &budget(), &mut |_| Control::Continue).unwrap();
        assert_eq!((model.report().triangles, model.report().skipped), (2, 1), "{name}");
    }
}
