//! What opens a working file, what does not, and what happens when the disk is full.

use std::fs;
use std::sync::Arc;

use outcrop::block::Codec;
use outcrop::compile::{Compiler, Control, LazyModel, LazyOptions, PrecisionChoice};
use outcrop::error::{CompileError, LoadError, TraceError};
use outcrop::model::SourceRecord;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::export::write_ply;
use outcrop::procedural::{Gears, Tessellation};
use outcrop::trace::{Answers, ClosestRequest, OnMissing, PoolOptions};
use outcrop::units::{Bytes, CellId};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use super::compiling::{Mesh, Place, Vertices};
use super::{SOURCE, budget, eager, gears, octree, open, rays, small, trace};

#[test]
fn a_second_one_is_refused_by_name_while_the_first_lives() {
    let (mesh, place) = (gears(), Place::new());
    let first = open(&mesh, &place.output(), &small(), &budget()).unwrap();
    let error = open(&mesh, &place.output(), &small(), &budget()).unwrap_err();
    let working = LazyModel::working_path(place.output());
    assert!(matches!(&error, CompileError::Locked { path } if *path == working), "{error}");
    assert!(error.to_string().contains("model.outcrop.working"), "{error}");
    drop(first);
    assert!(open(&mesh, &place.output(), &small(), &budget()).unwrap().report().was_reopened);
}

#[test]
fn another_source_or_other_options_start_anew() {
    let (mesh, place) = (gears(), Place::new());
    let cut_one = |options: &LazyOptions, source: SourceRecord| {
        let budget = budget();
        let emit = |compiler: &mut Compiler<'_>| mesh.emit(compiler);
        let go_on = &mut |_| Control::Continue;
        let model = LazyModel::from_mesh(source, place.output(), options, &budget, go_on, emit).unwrap();
        let report = model.report();
        model.cut_cell(CellId(0)).unwrap();
        (report.was_reopened, report.cells_cut)
    };
    assert_eq!(cut_one(&small(), SOURCE), (false, 0));
    assert_eq!(cut_one(&small(), SOURCE), (true, 1));
    assert_eq!(cut_one(&small(), SourceRecord { fingerprint: 9, ..SOURCE }), (false, 0));
    let change = |change: fn(&mut LazyOptions)| {
        let mut options = small();
        change(&mut options);
        options
    };
    let others = [
        change(|options| options.cell_triangles = 300),
        change(|options| options.compile.block_bytes = 8 << 10),
        change(|options| options.compile.codec = Codec::Raw),
        change(|options| options.compile.precision = PrecisionChoice::Lattice { exponent: -20 }),
        change(|options| options.compile.skip_not_finite = true),
        change(|options| options.anew = true),
    ];
    for options in others {
        cut_one(&small(), SOURCE);
        assert!(cut_one(&small(), SOURCE).0);
        assert_eq!(cut_one(&options, SOURCE), (false, 0), "{options:?}");
    }
    // Nobody knows what it is: never taken for the same.
    assert_eq!(cut_one(&small(), SourceRecord::default()), (false, 0));
    assert_eq!(cut_one(&small(), SourceRecord::default()), (false, 0));
}

#[test]
fn a_model_file_that_changed_is_read_again() {
    let place = Place::new();
    let input = place.path().join("model.ply");
    let go_on = &mut |_| Control::Continue;
    for (tessellation, times) in [(4, 2), (9, 2)] {
        let shape = Gears::with_tessellation(1, Tessellation::new(tessellation).unwrap()).unwrap();
        write_ply(&shape, &input, false).unwrap();
        for time in 0..times {
            let model = LazyModel::open(&input, place.output(), &small(), &budget(), go_on).unwrap();
            assert_eq!(model.report().was_reopened, time > 0);
            assert_eq!(model.report().triangles, Mesh::of(&shape).triangles.len() as u64);
        }
    }
}

#[test]
fn a_first_pass_that_is_broken_off_leaves_nothing_that_opens() {
    let (mesh, place) = (gears(), Place::new());
    let budget = budget();
    let emit = |compiler: &mut Compiler<'_>| {
        mesh.emit(compiler)?;
        Err(CompileError::Cancelled)
    };
    let go_on = &mut |_| Control::Continue;
    let result = LazyModel::from_mesh(SOURCE, place.output(), &small(), &budget, go_on, emit);
    assert!(matches!(result, Err(CompileError::Cancelled)));
    assert_eq!(budget.used(), Bytes(0));
    assert!(place.files().is_empty(), "{:?}", place.files());
    assert!(!open(&mesh, &place.output(), &small(), &budget).unwrap().report().was_reopened);
}

#[test]
fn a_full_disk_is_named_and_what_was_cut_stays() {
    let mesh = gears();
    let expected = eager(&mesh, &small().compile);
    let rays = rays(&expected, 400, 8);
    let answers = trace(&expected, &rays).unwrap();
    let place = Place::new();
    let limited = |limit: u64| {
        let mut options = small();
        options.compile.disk_limit = Some(Bytes(limit));
        options
    };
    let cells = {
        let model = open(&mesh, &place.output(), &small(), &budget()).unwrap();
        model.report().working_bytes
    };
    // No room for the cells themselves.
    fs::remove_file(LazyModel::working_path(place.output())).unwrap();
    let error = open(&mesh, &place.output(), &limited(cells / 2), &budget()).unwrap_err();
    assert!(matches!(error, CompileError::Write { .. }), "{error}");
    // What is of no use does not keep the disk full.
    assert!(place.files().is_empty(), "{:?}", place.files());
    // Room for them and for some that are cut.
    let budget = MemoryBudget::new(Bytes::mib(64));
    let model = open(&mesh, &place.output(), &limited(cells + (40 << 10)), &budget).unwrap();
    let tree = octree(&model, &budget, 1);
    let error = trace(&tree, &rays).unwrap_err();
    let TraceError::Load(LoadError::Cut(error)) = &error else { panic!("{error}") };
    assert!(matches!(**error, CompileError::Write { .. }), "{error}");
    assert!(error.to_string().contains("model.outcrop.working"), "{error}");
    let cut = model.report().cells_cut;
    assert!(cut > 0);
    let error = model.finish(&mut |_| Control::Continue).unwrap_err();
    assert!(matches!(error, CompileError::Write { .. }), "{error}");
    assert_eq!(place.files(), ["model.outcrop.working"]);
    drop((tree, model));
    // With room again it goes on.
    let model = open(&mesh, &place.output(), &small(), &budget).unwrap();
    assert_eq!((model.report().was_reopened, model.report().cells_cut), (true, cut));
    assert_eq!(trace(&octree(&model, &budget, 1), &rays).unwrap(), answers);
}

/// Rays that wait go on through cells that cannot be cut: an error like any other.
#[test]
fn a_full_disk_is_named_to_rays_that_go_on() {
    let (mesh, place) = (gears(), Place::new());
    let rays = rays(&eager(&mesh, &small().compile), 400, 8);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let mut options = small();
    {
        let model = open(&mesh, &place.output(), &options, &budget).unwrap();
        options.compile.disk_limit = Some(Bytes(model.report().working_bytes + (40 << 10)));
    }
    let model = open(&mesh, &place.output(), &options, &budget).unwrap();
    let source = Arc::clone(&model) as Arc<dyn BlockSource>;
    let slots = OctreeOptions { slots_max: Some(2), ..Default::default() };
    let octree = LazyOctree::open(source, &budget, slots).unwrap();
    let mut errors = 0;
    for ray in rays {
        let mut pool = octree.ray_pool(PoolOptions { suspended: 100, ..PoolOptions::default() }).unwrap();
        let mut answers = Answers::with_capacity(1);
        let request = ClosestRequest { ray, after: None, tag: 0 };
        if pool.closest_hits(&[request], OnMissing::Wait { weight: 1 }, &mut answers).is_err() {
            continue;
        }
        let error = loop {
            match pool.resume(&mut answers) {
                Ok(true) => {}
                Ok(false) => break None,
                Err(error) => break Some(error),
            }
        };
        if let Some(error) = error {
            assert!(matches!(error, TraceError::Load(LoadError::Cut(_))), "{error}");
            errors += 1;
        }
    }
    assert!(errors > 0);
}

#[test]
fn a_budget_that_is_too_small_is_refused() {
    let (mesh, place) = (gears(), Place::new());
    let budget = MemoryBudget::new(Bytes::mib(4));
    let error = open(&mesh, &place.output(), &small(), &budget).unwrap_err();
    assert!(matches!(error, CompileError::Budget(_)), "{error}");
    assert_eq!(budget.used(), Bytes(0));
}

#[test]
fn nothing_and_triangles_that_are_not_finite() {
    let place = Place::new();
    let empty = Mesh::new(Vertices::Float32(Vec::new()), Vec::new());
    assert!(matches!(open(&empty, &place.output(), &small(), &budget()), Err(CompileError::Empty)));
    let points = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [f32::NAN, 0.0, 0.0]];
    let mesh = Mesh::new(Vertices::Float32(points), vec![[0, 1, 3], [0, 1, 2]]);
    let error = open(&mesh, &place.output(), &small(), &budget()).unwrap_err();
    assert!(matches!(error, CompileError::NotFinite { triangle: 0 }), "{error}");
    let mut options = small();
    options.compile.skip_not_finite = true;
    let model = open(&mesh, &place.output(), &options, &budget()).unwrap();
    assert_eq!((model.report().triangles, model.report().skipped), (1, 1));
    assert_eq!(model.finish(&mut |_| Control::Continue).unwrap().skipped, 1);
}

#[test]
fn a_cell_or_a_block_that_is_not_there() {
    let (mesh, place) = (gears(), Place::new());
    let model = open(&mesh, &place.output(), &small(), &budget()).unwrap();
    let source = Arc::clone(&model) as Arc<dyn BlockSource>;
    assert!(source.cut_cell(CellId(model.report().cells)).is_err());
    let mut bytes = Vec::new();
    let block = model.model().cells.entries()[0].first_block;
    // Not before its cell is cut.
    assert!(source.read_block(block, &mut bytes).is_err());
    let entries = source.cut_cell(CellId(0)).unwrap();
    source.read_block(block, &mut bytes).unwrap();
    assert_eq!(bytes.len(), entries[0].stored_bytes as usize);
}
