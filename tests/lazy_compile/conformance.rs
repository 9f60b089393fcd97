//! Hits, images and files.

use std::ops::ControlFlow;
use std::sync::Arc;

use outcrop::compile::{CompileOptions, Compiler, Control, LazyModel, LazyOptions, compile_file};
use outcrop::geom::Ray;
use outcrop::octree::OctreeOptions;
use outcrop::procedural::export::{write_obj, write_ply};
use outcrop::procedural::{Gears, Terrain, Tessellation};
use outcrop::render::{RenderSettings, Renderer, Threads};
use outcrop::scene::{Camera, Scene};
use outcrop::source::DiskSource;
use outcrop::trace::{Answers, AnyRequest, ClosestRequest, OnMissing, PoolOptions};
use outcrop::units::{Bytes, CellId};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use super::compiling::{Mesh, Place};
use super::support::may_meet;
use super::{SOURCE, all_options, budget, eager, gears, octree, open, rays, small, soup, trace};

#[test]
fn hits_are_those_of_the_compiled_model() {
    for mesh in [gears(), soup()] {
        for options in all_options() {
            let expected = eager(&mesh, &options.compile);
            let place = Place::new();
            // The least that opens, and more than enough.
            for memory in [Bytes::mib(26), Bytes::mib(128)] {
                let budget = MemoryBudget::new(memory);
                let options = LazyOptions { anew: true, ..options.clone() };
                let model = open(&mesh, &place.output(), &options, &budget).unwrap();
                let octree = octree(&model, &budget, 1);
                assert_eq!(octree.model().bounds, expected.model().bounds);
                assert_eq!(octree.model().precision, expected.model().precision);
                let rays = rays(&octree, 1500, 1);
                assert_eq!(trace(&octree, &rays).unwrap(), trace(&expected, &rays).unwrap());
                assert!(budget.used() <= budget.limit());
                drop((octree, model));
                assert_eq!(budget.used(), Bytes(0), "all of the budget is given back");
            }
        }
    }
}

#[test]
fn all_hits_and_suspended_rays_too() {
    let mesh = gears();
    let expected = eager(&mesh, &small().compile);
    let rays = rays(&expected, 600, 2);
    let all = |octree: &LazyOctree| {
        let mut found = Vec::new();
        let mut tracer = octree.tracer().unwrap();
        tracer
            .all_hits(&rays, |index, hit| {
                found.push((index, *hit));
                ControlFlow::Continue(())
            })
            .unwrap();
        found
    };
    let (place, budget) = (Place::new(), budget());
    let model = open(&mesh, &place.output(), &small(), &budget).unwrap();
    assert_eq!(all(&octree(&model, &budget, 1)), all(&expected));

    // Anew, so that cells are cut while rays wait; few slots, so that many wait, and go back to where they were.
    let budget = MemoryBudget::new(Bytes::mib(64));
    let other = Place::new();
    let model = open(&mesh, &other.output(), &small(), &budget).unwrap();
    let source = Arc::clone(&model) as Arc<dyn BlockSource>;
    let options = OctreeOptions { slots_max: Some(2), ..Default::default() };
    let octree = LazyOctree::open(source, &budget, options).unwrap();
    let mut pool = octree.ray_pool(PoolOptions { suspended: 100, ..PoolOptions::default() }).unwrap();
    let mut answers = Answers::with_capacity(rays.len());
    let requests: Vec<ClosestRequest> =
        (0..).zip(&rays).map(|(tag, ray)| ClosestRequest { ray: *ray, after: None, tag }).collect();
    for requests in requests.chunks(50) {
        pool.closest_hits(requests, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
        while !pool.wants_rays() {
            pool.resume(&mut answers).unwrap();
        }
    }
    while pool.resume(&mut answers).unwrap() {}
    answers.hits.sort_by_key(|(tag, _)| *tag);
    let hits: Vec<_> = answers.hits.iter().map(|(_, hit)| *hit).collect();
    assert_eq!(hits, trace(&expected, &rays).unwrap().0);
}

/// A ray that waits looks at what is there behind the missing block, but has nothing cut that the block may make needless.
#[test]
fn rays_that_wait_cut_no_more_cells_than_others() {
    let mesh = gears();
    let rays = rays(&eager(&mesh, &small().compile), 300, 7);
    let cut = |asks: &dyn Fn(&LazyOctree)| {
        let (place, budget) = (Place::new(), budget());
        let model = open(&mesh, &place.output(), &small(), &budget).unwrap();
        let source = Arc::clone(&model) as Arc<dyn BlockSource>;
        let options = OctreeOptions { slots_max: Some(3), ..Default::default() };
        asks(&LazyOctree::open(source, &budget, options).unwrap());
        (0..model.model().cells.len() as u32).map(|cell| model.is_cut(CellId(cell))).collect::<Vec<bool>>()
    };
    let in_order = cut(&|octree| {
        let mut hits = vec![None; rays.len()];
        octree.tracer().unwrap().closest_hits(&rays, &mut hits).unwrap();
    });
    let waiting = cut(&|octree| {
        let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
        let mut answers = Answers::with_capacity(rays.len());
        let requests: Vec<ClosestRequest> =
            (0..).zip(&rays).map(|(tag, ray)| ClosestRequest { ray: *ray, after: None, tag }).collect();
        pool.closest_hits(&requests, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
        while pool.resume(&mut answers).unwrap() {}
        assert!(pool.counters().suspended_peak > 100);
    });
    assert_eq!(waiting, in_order);
    // Any-hit queries go by what blocks them first; the answers are the same, also where they stopped before a cell.
    let place = Place::new();
    let model = open(&mesh, &place.output(), &small(), &budget()).unwrap();
    let options = OctreeOptions { slots_max: Some(3), ..Default::default() };
    let octree = LazyOctree::open(Arc::clone(&model) as Arc<dyn BlockSource>, &budget(), options).unwrap();
    let mut pool = octree.ray_pool(PoolOptions::default()).unwrap();
    let mut answers = Answers::with_capacity(rays.len());
    let requests: Vec<AnyRequest> =
        (0..).zip(&rays).map(|(tag, ray)| AnyRequest { ray: *ray, tag }).collect();
    pool.occluded(&requests, OnMissing::Wait { weight: 1 }, &mut answers).unwrap();
    while pool.resume(&mut answers).unwrap() {}
    answers.occlusions.sort_by_key(|(tag, _)| *tag);
    let found: Vec<_> = answers.occlusions.iter().map(|(_, found)| *found).collect();
    assert_eq!(found, trace(&eager(&mesh, &small().compile), &rays).unwrap().1);
    assert!(in_order.iter().any(|is_cut| !is_cut));
}

#[test]
fn threads_cut_each_cell_once_and_see_the_same() {
    let mesh = gears();
    let expected = eager(&mesh, &small().compile);
    let rays = rays(&expected, 2000, 3);
    let answers = trace(&expected, &rays).unwrap();
    for cells_at_once in [1, 4] {
        let (place, budget) = (Place::new(), budget());
        let options = LazyOptions { cells_at_once, ..small() };
        let model = open(&mesh, &place.output(), &options, &budget).unwrap();
        let octree = octree(&model, &budget, 4);
        std::thread::scope(|scope| {
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(|| trace(&octree, &rays).unwrap())).collect();
            threads.into_iter().for_each(|thread| assert_eq!(thread.join().unwrap(), answers));
        });
        let report = model.report();
        assert_eq!(report.cells_cut, report.cells_cut_now);
        assert!(report.cells_cut > 10);
    }
}

#[test]
fn only_cells_that_a_ray_reaches_are_cut() {
    let mesh = gears();
    let (place, budget) = (Place::new(), budget());
    let model = open(&mesh, &place.output(), &small(), &budget).unwrap();
    assert_eq!((model.report().cells_cut, model.report().triangles_encoded), (0, 0));
    let octree = octree(&model, &budget, 1);
    let mut tracer = octree.tracer().unwrap();
    let mut reached = vec![false; model.model().cells.len()];
    for ray in rays(&octree, 12, 4) {
        tracer.closest_hit(&ray).unwrap();
        for (reached, cell) in reached.iter_mut().zip(model.model().cells.entries()) {
            *reached |= may_meet(&ray, &cell.bounds, 1e-4);
        }
        for (index, reached) in (0..).zip(&reached) {
            assert!(*reached || !model.is_cut(CellId(index)), "cell {index} was cut for nothing");
        }
    }
    let report = model.report();
    assert!(report.cells_cut > 0 && report.cells_cut < report.cells, "{report:?}");
    assert!(report.triangles_encoded > 0 && report.triangles_encoded < report.triangles, "{report:?}");
    assert_eq!(octree.block_count(), report.blocks);
}

#[test]
fn the_file_is_that_of_a_compile_at_once() {
    // More than one cell of the common size.
    let mesh = Mesh::of(&Terrain::new(260, 5).unwrap());
    let options = LazyOptions { cell_triangles: 64 << 10, ..LazyOptions::default() };
    let (place, budget) = (Place::new(), budget());
    let mut go_on = |_| Control::Continue;
    let mut compiler = Compiler::new(place.output(), options.compile.clone(), &budget, &mut go_on).unwrap();
    compiler.set_source(SOURCE);
    mesh.emit(&mut compiler).unwrap();
    let eager_report = compiler.finish().unwrap();
    let bytes = std::fs::read(place.output()).unwrap();
    std::fs::remove_file(place.output()).unwrap();
    let model = open(&mesh, &place.output(), &options, &budget).unwrap();
    let octree = octree(&model, &budget, 1);
    assert!(model.report().cells > 1);
    // One cell by a ray, the others by the end.
    let bounds = model.model().bounds;
    let at = |axis: usize| bounds.min[axis] + 0.1 * bounds.extent()[axis];
    let ray = Ray::new([at(0), at(1), bounds.max[2] + 1.0], [0.0, 0.0, -1.0]);
    let hit = octree.tracer().unwrap().closest_hit(&ray).unwrap();
    assert_eq!((hit.is_some(), model.is_complete()), (true, false));
    let report = model.finish(&mut |_| Control::Continue).unwrap();
    assert!(std::fs::read(place.output()).unwrap() == bytes, "another file");
    assert_eq!(place.files(), ["model.outcrop"], "the working file is gone");
    assert_eq!(
        (report.triangles, report.blocks, report.vertices, report.file_bytes),
        (eager_report.triangles, eager_report.blocks, eager_report.vertices, eager_report.file_bytes)
    );
    assert_eq!((report.degenerate, report.duplicates), (eager_report.degenerate, eager_report.duplicates));
    assert_eq!((report.error_bound, report.precision), (eager_report.error_bound, eager_report.precision));
    // The octree goes on.
    assert_eq!(octree.tracer().unwrap().closest_hit(&ray).unwrap(), hit);
}

#[test]
fn model_files_of_every_kind_make_the_same_picture() {
    let place = Place::new();
    let shape = Gears::with_tessellation(1, Tessellation::new(4).unwrap()).unwrap();
    let (ply, obj, stl) =
        (place.path().join("a.ply"), place.path().join("a.obj"), place.path().join("a.stl"));
    write_ply(&shape, &ply, true).unwrap();
    write_obj(&shape, &obj).unwrap();
    std::fs::write(&stl, binary_stl(&Mesh::of(&shape))).unwrap();
    for input in [ply, obj, stl] {
        let compile = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
        let eager_path = input.with_extension("eager");
        compile_file(&input, &eager_path, &compile, &budget(), &mut |_| Control::Continue).unwrap();
        let expected = picture(Arc::new(DiskSource::open(&eager_path).unwrap()), &budget(), Threads::One);
        let output = input.with_extension("lazy");
        for threads in [Threads::One, Threads::Count(2)] {
            for run in 0..2 {
                let budget = budget();
                let options = LazyOptions { cells_at_once: 2, ..small() };
                let go_on = &mut |_| Control::Continue;
                let model = Arc::new(LazyModel::open(&input, &output, &options, &budget, go_on).unwrap());
                let source = Arc::clone(&model) as Arc<dyn BlockSource>;
                assert!(picture(source, &budget, threads.clone()) == expected, "{input:?}");
                let report = model.report();
                assert_eq!(report.was_reopened, run == 1);
                assert_eq!(report.cells_cut_now == 0, run == 1, "{report:?}");
            }
            std::fs::remove_file(LazyModel::working_path(&output)).unwrap();
        }
    }
}

/// The bits of a small picture with shadows, mirrors and glass.
fn picture(source: Arc<dyn BlockSource>, budget: &MemoryBudget, threads: Threads) -> Vec<u8> {
    let scene = Scene::new(Camera::framing(&source.model().bounds, 1.0)).with_automatic_lights();
    let settings = RenderSettings::new(48, 48);
    let aside = Renderer::bytes_needed(&scene, source.model(), &settings, &threads).unwrap();
    let aside = budget.reserve(aside, "the picture").unwrap();
    let octree =
        LazyOctree::open(source, budget, OctreeOptions { tracers_max: 2, ..Default::default() }).unwrap();
    drop(aside);
    let renderer = Renderer::new(&octree, &scene, &settings, budget).unwrap();
    let image = renderer.render(&threads, &mut |_| Control::Continue).unwrap().into_complete().unwrap();
    let path = tempfile::Builder::new().suffix(".pfm").tempfile().unwrap();
    image.write(path.path()).unwrap();
    std::fs::read(path.path()).unwrap()
}

fn binary_stl(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend_from_slice(&(mesh.triangles.len() as u32).to_le_bytes());
    for triangle in 0..mesh.triangles.len() {
        bytes.extend_from_slice(&[0; 12]);
        for x in mesh.corners(triangle).as_flattened() {
            bytes.extend_from_slice(&(*x as f32).to_le_bytes());
        }
        bytes.extend_from_slice(&[0; 2]);
    }
    bytes
}
