//! What callers see of errors: their own types, causes that can be asked for, one type for all of them.

use std::error::Error as _;
use std::io;
use std::path::Path;
use std::sync::Arc;

use outcrop::accuracy::{Knobs, Sampling, TileThreshold};
use outcrop::cache::{Lru, SlotCache};
use outcrop::compile::{CompileOptions, Control, Threads, compile_file, compile_shape};
use outcrop::error::{Error, InstanceError, RenderError, SceneFileError, TextureError, TraceError};
use outcrop::octree::{LeafLayout, OctreeOptions, Tier};
use outcrop::procedural::Icosphere;
use outcrop::render::{RenderSettings, Renderer};
use outcrop::scene::Scene;
use outcrop::source::DiskSource;
use outcrop::units::{Bytes, TileId};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

fn sphere(folder: &Path) -> Arc<dyn BlockSource> {
    let path = folder.join("sphere.outcrop");
    let sphere = Icosphere::new(1.0, [0.0; 3], 2).unwrap();
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_shape(&sphere, &path, &CompileOptions::default(), &budget, &mut |_| Control::Continue).unwrap();
    Arc::new(DiskSource::open(&path).unwrap())
}

#[test]
fn too_many_tracers_are_told_from_too_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let source = sphere(folder.path());
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = OctreeOptions { tracers_max: 2, slots_max: Some(2), ..OctreeOptions::default() };
    let octree = LazyOctree::open(Arc::clone(&source), &budget, options).unwrap();

    let tracers = [octree.tracer().unwrap(), octree.tracer().unwrap()];
    let error = octree.tracer().map(|_| ()).unwrap_err();
    assert!(matches!(error, TraceError::TooManyTracers { wanted: 3, tracers_max: 2 }), "{error}");
    let text = error.to_string();
    assert!(text.contains("`OctreeOptions::tracers_max` at least 3") && !text.contains("budget"), "{text}");
    drop(tracers);

    // A render knows its threads, and says so before it draws anything.
    let scene = Scene::automatic(&source.model().bounds, 1.0);
    let renderer = Renderer::new(&octree, &scene, &RenderSettings::new(64, 64), &budget).unwrap();
    let mut calls = 0;
    let refused = renderer.render(&Threads::Count(4), &mut |_| {
        calls += 1;
        Control::Continue
    });
    let error = refused.map(|_| ()).unwrap_err();
    let expected = TraceError::TooManyTracers { wanted: 4, tracers_max: 2 };
    assert_eq!(error.to_string(), expected.to_string());
    assert!(matches!(error, RenderError::Trace(TraceError::TooManyTracers { .. })));
    assert_eq!(calls, 0);
    renderer.render(&Threads::Count(2), &mut |_| Control::Continue).unwrap();
}

/// The first cause of an error that is the system's.
fn system_kind(error: &dyn std::error::Error) -> Option<io::ErrorKind> {
    let mut next = error.source();
    while let Some(cause) = next {
        if let Some(cause) = cause.downcast_ref::<io::Error>() {
            return Some(cause.kind());
        }
        next = cause.source();
    }
    None
}

#[test]
fn what_the_system_said_can_be_asked_for() {
    let missing = Path::new("there is no such folder/model.obj");
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = CompileOptions::default();
    let output = Path::new("there is no such folder/model.outcrop");
    let compile = compile_file(missing, output, &options, &budget, &mut |_| Control::Continue).unwrap_err();
    let source = DiskSource::open(output).unwrap_err();
    for error in [Error::from(compile), Error::from(source)] {
        assert_eq!(system_kind(&error), Some(io::ErrorKind::NotFound), "{error}");
    }
}

#[test]
fn one_type_joins_them() {
    fn joined<E: Into<Error>>(error: E) -> String {
        error.into().to_string()
    }
    let path = || "x".into();
    let full = || io::Error::from(io::ErrorKind::StorageFull);
    assert!(joined(TextureError::Io { path: path(), error: full() }).contains("cannot read or write x"));
    assert!(joined(SceneFileError::Io { path: path(), error: full() }).contains("cannot read x"));
    let instance = InstanceError::Instance { instance: 7, reason: "is flat" };
    assert!(instance.source().is_none());
    assert_eq!(joined(instance), "instance 7: is flat");
}

#[test]
fn knobs_come_back_from_json_bit_for_bit() {
    for tier in Tier::ALL {
        // Numbers with digits to the last bit.
        let error = f64::from_bits(0.1_f64.to_bits() + 1);
        let thresholds = vec![
            TileThreshold { first_tile: TileId(0), error },
            TileThreshold { first_tile: TileId(17), error: f64::MIN_POSITIVE / 3.0 },
        ];
        let confidence = 1.0 - f64::EPSILON / 2.0;
        let sampling = Sampling::Adaptive { samples_min: 2, samples_max: 4096, confidence, thresholds };
        for sampling in [sampling, Sampling::Fixed { samples: 9 }] {
            let contribution_bound = 1e-3 / 3.0;
            let knobs = Knobs { tier, contribution_bound, work_budget: u64::MAX, sampling, tile_size: 32 };
            let text = serde_json::to_string(&knobs).unwrap();
            assert!(text.contains(&format!("\"tier\":\"{}\"", tier.name())), "{text}");
            assert_eq!(serde_json::from_str::<Knobs>(&text).unwrap(), knobs, "{text}");
        }
    }
}

#[test]
fn what_an_octree_is_can_be_printed() {
    let folder = tempfile::tempdir().unwrap();
    let source = sphere(folder.path());
    let budget = MemoryBudget::new(Bytes::mib(64));
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    let text = format!("{octree:?}");
    assert!(text.contains("tier: Certified") && text.contains("tracers_max: 1"), "{text}");
}

#[test]
fn too_few_slots_are_told_from_too_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sphere.outcrop");
    let sphere = Icosphere::new(1.0, [0.0; 3], 5).unwrap();
    let options = CompileOptions { block_bytes: 4096, ..CompileOptions::default() };
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_shape(&sphere, &path, &options, &budget, &mut |_| Control::Continue).unwrap();
    let source: Arc<dyn BlockSource> = Arc::new(DiskSource::open(&path).unwrap());
    for slots_max in [0, 2] {
        let options =
            OctreeOptions { tracers_max: 3, slots_max: Some(slots_max), ..OctreeOptions::default() };
        let error = LazyOctree::open(Arc::clone(&source), &budget, options).map(|_| ()).unwrap_err();
        let expected = TraceError::TooFewSlots { slot_count: slots_max, needed: 3 };
        assert_eq!(error.to_string(), expected.to_string());
    }
}

#[test]
fn any_number_of_tracers_may_be_allowed() {
    let folder = tempfile::tempdir().unwrap();
    let source = sphere(folder.path());
    let budget = MemoryBudget::new(Bytes(u64::MAX));
    let slot_bytes = LazyOctree::slot_bytes(source.model(), LeafLayout::Expanded);
    for tracers_max in [1 << 30, u32::MAX] {
        let cache =
            SlotCache::new(4, slot_bytes, source.model().block_id_count(), Lru::new(), &budget).unwrap();
        let options = OctreeOptions { tracers_max, ..OctreeOptions::default() };
        let octree = LazyOctree::with_cache(Arc::clone(&source), Arc::new(cache), &budget, options).unwrap();
        assert_eq!(octree.pins_per_tracer(), 1);
        octree.tracer().unwrap();
    }
}
