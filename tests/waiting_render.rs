//! Pictures whose rays wait for missing blocks are those of rays that load what they need, bit for bit, for any slots, threads, places and
//! loaders; they take fewer loads; and they end as other renders end.

#[path = "support/compiling.rs"]
mod compiling;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use compiling::{Mesh, compile};
use outcrop::compile::{CompileOptions, Compiler, Control, LazyModel, LazyOptions, Threads};
use outcrop::error::{RenderError, TraceError};
use outcrop::import::MeshBuffer;
use outcrop::model::{MaterialRecord, SourceRecord};
use outcrop::octree::OctreeOptions;
use outcrop::procedural::{Gears, Shape, Tessellation};
use outcrop::render::{
    AdaptiveSampling, Outcome, PathEnd, Region, RegionCounters, RenderSettings, RenderedImage, Renderer,
    WaitingRays,
};
use outcrop::scene::{Camera, EffectSet, Environment, Finish, Light, LightShape, Scene};
use outcrop::source::MemorySource;
use outcrop::source::testing::{FaultRates, FaultySource};
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

fn small_blocks() -> CompileOptions {
    CompileOptions { block_bytes: 8 << 10, ..CompileOptions::default() }
}

fn wheels(per_edge: u32, tessellation: u32) -> Mesh {
    let shape = Gears::with_tessellation(per_edge, Tessellation::new(tessellation).unwrap()).unwrap();
    let mut buffer = MeshBuffer::new();
    shape.emit(&mut buffer).unwrap();
    Mesh { records: buffer.materials, ..Mesh::of(&shape) }
}

/// Toothed wheels with these changes to their materials.
fn gears(change: impl Fn(&mut MaterialRecord)) -> Mesh {
    let mut mesh = wheels(2, 9);
    mesh.records.iter_mut().for_each(change);
    mesh
}

fn compiled(mesh: &Mesh) -> Vec<u8> {
    compile(mesh, &small_blocks(), Bytes::mib(64)).1
}

fn source(bytes: &[u8]) -> Arc<dyn BlockSource> {
    Arc::new(MemorySource::new(bytes.to_vec()).unwrap())
}

/// The standard view.
fn view() -> Scene {
    Scene::new(Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0).unwrap())
        .with_background([0.1, 0.2, 0.3])
}

fn with_lamps(scene: Scene) -> Scene {
    scene.with_lights(Gears::LAMPS.map(|position| Light::point(position, [0.5; 3])))
}

fn is_coloured(record: &MaterialRecord) -> bool {
    record.name.starts_with("colour")
}

/// Another setting, and how it is rendered.
#[derive(Clone, Copy, Debug)]
struct Way {
    slots: Option<u32>,
    threads: usize,
    waiting: WaitingRays,
    loaders: u32,
}

const IN_MEMORY: Way = Way { slots: None, threads: 1, waiting: WaitingRays::Never, loaders: 0 };

fn render_in(
    budget: &MemoryBudget,
    source: Arc<dyn BlockSource>,
    scene: &Scene,
    settings: &RenderSettings,
    way: Way,
    progress: &mut (dyn FnMut(outcrop::render::Progress) -> Control + Send),
) -> Result<RenderedImage, RenderError> {
    let Way { slots, threads, waiting, loaders } = way;
    let settings = RenderSettings { waiting, loader_threads: loaders, ..*settings };
    let threads = if threads == 1 { Threads::One } else { Threads::Count(threads) };
    let needed = Renderer::bytes_needed(scene, source.model(), &settings, &threads)?;
    let aside = budget.reserve(needed, "the picture").map_err(RenderError::Budget)?;
    let tracers_max = if let Threads::Count(count) = threads { count as u32 } else { 1 };
    let options = OctreeOptions { tracers_max, slots_max: slots, ..OctreeOptions::default() };
    let octree = LazyOctree::open(source, budget, options).map_err(RenderError::Trace)?;
    drop(aside);
    let renderer = Renderer::new(&octree, scene, &settings, budget)?;
    let image = renderer.render(&threads, progress)?;
    // What was set aside was enough.
    assert!(budget.peak() <= budget.limit());
    Ok(image)
}

fn render(bytes: &[u8], scene: &Scene, settings: &RenderSettings, way: Way) -> RenderedImage {
    let budget = MemoryBudget::new(Bytes::mib(128));
    render_in(&budget, source(bytes), scene, settings, way, &mut |_| Control::Continue).unwrap()
}

/// Ways with hardly any slots: each ray loads most of its blocks itself, which takes its time.
const TIGHT: [Way; 2] = [
    Way { slots: Some(2), threads: 1, waiting: WaitingRays::Count(1), loaders: 0 },
    Way { slots: Some(3), threads: 1, waiting: WaitingRays::Count(60), loaders: 0 },
];

/// Ways of which none has many slots.
const WAYS: [Way; 5] = [
    Way { slots: Some(10), threads: 1, waiting: WaitingRays::Count(1), loaders: 0 },
    Way { slots: Some(7), threads: 1, waiting: WaitingRays::Count(60), loaders: 0 },
    Way { slots: Some(8), threads: 1, waiting: WaitingRays::Count(700), loaders: 1 },
    Way { slots: Some(12), threads: 2, waiting: WaitingRays::Count(5000), loaders: 2 },
    Way { slots: None, threads: 3, waiting: WaitingRays::Count(300), loaders: 0 },
];

fn assert_the_same(name: &str, bytes: &[u8], scene: &Scene, settings: &RenderSettings) -> RenderedImage {
    assert_the_same_in(&WAYS, name, bytes, scene, settings)
}

/// Renders in some ways, and compares with a render in memory.
fn assert_the_same_in(
    ways: &[Way],
    name: &str,
    bytes: &[u8],
    scene: &Scene,
    settings: &RenderSettings,
) -> RenderedImage {
    let reference = render(bytes, scene, settings, IN_MEMORY);
    assert_eq!(reference.report.waiting, None);
    let black = reference.film.pixels().iter().filter(|pixel| **pixel == [0.0; 3]).count();
    assert!(black < reference.film.pixels().len() / 2, "{name}: there is something to see");
    for (number, way) in ways.iter().copied().enumerate() {
        let settings = RenderSettings { tile_size: [32, 7, 16, 8, 64][number], ..*settings };
        let image = render(bytes, scene, &settings, way);
        assert!(image.film.is_complete() && image.report.outcome == Outcome::Complete);
        assert!(image.film.pixels() == reference.film.pixels(), "{name}, {way:?}");
        assert!(image.film.statistics() == reference.film.statistics(), "{name}, {way:?}");
        if settings.adaptive.is_none() {
            // Adaptive tiles look around themselves, so tiles of other sizes take other samples.
            assert_eq!(image.report.effects, reference.report.effects, "{name}, {way:?}");
        }
        let waiting = image.report.waiting.expect("rays can wait");
        assert_eq!(waiting.loader_threads, way.loaders);
        if way.slots.is_some() {
            assert!(image.report.trace.suspended_peak > 0, "{name}, {way:?}: some wait");
        }
    }
    reference
}

fn settings() -> RenderSettings {
    RenderSettings { keep_statistics: true, work_budget: 100, ..RenderSettings::new(24, 19) }
}

#[test]
fn mirrors_glass_and_shadows_are_the_same() {
    let plain = gears(|_| {});
    let bytes = compiled(&plain);
    let scene = with_lamps(view());
    assert_the_same_in(&TIGHT, "as they are, in two and three slots", &bytes, &scene, &settings());
    let image = assert_the_same("as they are", &bytes, &scene, &settings());
    let effects = &image.report.effects;
    assert!(effects.reflection_rays > 0 && effects.transmission_rays > 0 && effects.shadow_segments > 0);

    // A ray that splits at every surface, and is cut by its work budget.
    let glass = gears(|record| {
        if is_coloured(record) {
            (record.opacity, record.refractive_index) = (0.1, 1.5);
        }
    });
    let glass = compiled(&glass);
    let settings = RenderSettings { contribution_bound: 1e-6, ..settings() };
    let image = assert_the_same("glass", &glass, &scene, &settings);
    assert!(image.report.effects.work_cuts > 0, "{:?}", image.report.effects);

    // Shadows through many thin sheets; light is lost on the way.
    let veils = gears(|record| {
        if is_coloured(record) {
            (record.opacity, record.transmission) = (0.7, [0.5, 0.9, 0.7]);
        }
    });
    let veils = compiled(&veils);
    for contribution_bound in [1e-2, 0.0] {
        let settings = RenderSettings { contribution_bound, ..settings };
        let image = assert_the_same("veils", &veils, &scene, &settings);
        let lost = image.film.statistics().unwrap().iter().any(|pixel| pixel.lost > 0.0);
        assert!(lost);
    }
    // Nothing goes on from a hit.
    let matt = gears(|record| {
        *record =
            MaterialRecord { name: record.name.clone(), diffuse: [0.5; 3], ..MaterialRecord::default() };
    });
    assert_the_same("matt", &compiled(&matt), &scene, &settings);
    let unlit = view().with_ambient([0.3; 3]);
    assert_the_same("no lamps", &bytes, &unlit, &settings);
    let forced = RenderSettings { forced: EffectSet::ALL, ..settings };
    assert_the_same("forced", &bytes, &scene, &forced);
}

#[test]
fn sampled_effects_are_the_same() {
    let mesh = gears(|record| {
        if record.name.as_str() < "colour04" && is_coloured(record) {
            (record.opacity, record.refractive_index) = (0.2, 1.4);
        }
    });
    let bytes = compiled(&mesh);
    let lamp = LightShape::Sphere { center: Gears::LAMPS[0], radius: 0.5 };
    let scene = || {
        let mut scene = with_lamps(view())
            .with_light(Light::area(lamp, [3.0; 3]))
            .with_environment(Environment::Constant([0.3, 0.4, 0.5]))
            .with_finish("floor", Finish::rough(0.3));
        scene = scene.with_finish("colour01", Finish::rough(0.2));
        scene
    };
    let settings = RenderSettings { samples_per_pixel: 3, ..settings() };
    assert_the_same("rough, area, environment", &bytes, &scene(), &settings);
    let image = assert_the_same("interreflection", &bytes, &scene().with_interreflection(), &settings);
    assert!(image.report.effects.bounce_rays > 0);
    let roulette = RenderSettings { path_end: PathEnd::Roulette, contribution_bound: 0.05, ..settings };
    let image = assert_the_same("roulette", &bytes, &scene().with_interreflection(), &roulette);
    assert!(image.report.effects.roulette_ends > 0);
    let nested =
        scene().with_finish("colour00", Finish::nested(3)).with_finish("colour02", Finish::nested(2));
    let image = assert_the_same("nested", &bytes, &nested, &settings);
    assert!(image.report.effects.medium_rays > 0);
    let adaptive = RenderSettings {
        samples_per_pixel: 16,
        adaptive: Some(AdaptiveSampling { samples_min: 4, error: 0.02, confidence: 0.9 }),
        ..settings
    };
    let image = assert_the_same("adaptive", &bytes, &scene(), &adaptive);
    let samples: Vec<u32> = image.film.statistics().unwrap().iter().map(|pixel| pixel.samples).collect();
    assert!(samples.contains(&4) && samples.contains(&16));
}

#[test]
fn fewer_blocks_are_loaded() {
    let bytes = compiled(&gears(|_| {}));
    let scene = with_lamps(view());
    let settings = RenderSettings { keep_statistics: false, ..RenderSettings::new(96, 96) };
    let loads = |waiting, loaders| {
        let way = Way { slots: Some(6), threads: 1, waiting, loaders };
        render(&bytes, &scene, &settings, way).report
    };
    let without = loads(WaitingRays::Never, 0);
    assert!(without.blocks_touched > 40, "{}", without.blocks_touched);
    for loaders in [0, 1] {
        let with = loads(WaitingRays::Count(4096), loaders);
        assert_eq!(with.blocks_touched, without.blocks_touched);
        let [few, many] = [&with, &without].map(|report| report.trace.blocks_loaded);
        assert!(few * 3 < many, "{few} instead of {many} loads");
        // The more may wait, the fewer.
        let less = loads(WaitingRays::Count(200), loaders);
        assert!(few < less.trace.blocks_loaded, "{few}, {}", less.trace.blocks_loaded);
    }
}

#[test]
fn left_to_itself_a_render_waits_where_that_helps() {
    // So many blocks that places for rays are little beside them.
    let shape = Gears::new(4).unwrap();
    let mesh = Mesh { records: wheels(2, 1).records, ..Mesh::of(&shape) };
    let bytes = compile(&mesh, &CompileOptions::default(), Bytes::mib(512)).1;
    let scene = with_lamps(view()).with_interreflection();
    let settings = RenderSettings { contribution_bound: 0.1, ..RenderSettings::new(20, 20) };
    let render = |scene: &Scene, settings: &RenderSettings, way: Way| {
        let budget = MemoryBudget::new(Bytes::mib(512));
        render_in(&budget, source(&bytes), scene, settings, way, &mut |_| Control::Continue).unwrap()
    };
    let way = |slots| Way { slots, threads: 1, waiting: WaitingRays::Auto, loaders: 0 };
    let waits = |settings: &RenderSettings, way| render(&scene, settings, way).report.waiting;
    let reference = render(&scene, &settings, IN_MEMORY);
    let few = render(&scene, &settings, way(Some(60)));
    assert!(few.report.waiting.expect("few slots and rays that go anywhere").rays >= 1024);
    assert!(few.film.pixels() == reference.film.pixels());
    assert_eq!(waits(&settings, way(None)), None, "a slot for every block");
    assert_eq!(waits(&settings, way(Some(2))), None, "places would be more than the cache");
    let mirrors = render(&with_lamps(view()), &settings, way(Some(60)));
    assert!(mirrors.report.effects.reflection_rays > 0);
    assert_eq!(mirrors.report.waiting, None, "rays that follow each other");
    let costs = RenderSettings { keep_costs: true, ..settings };
    assert_eq!(waits(&costs, way(Some(60))), None, "costs of each pixel");
    let counted = Way { waiting: WaitingRays::Count(5000), ..way(Some(60)) };
    assert_eq!(waits(&costs, counted), None, "costs of each pixel");
    assert_eq!(waits(&settings, counted).map(|waiting| waiting.rays), Some(5000));

    // Where the budget has less room, fewer wait or none, and the picture is the same.
    let source = source(&bytes);
    let plain = RenderSettings { waiting: WaitingRays::Never, ..settings };
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = OctreeOptions { slots_max: Some(60), ..OctreeOptions::default() };
    let octree = LazyOctree::open(Arc::clone(&source), &budget, options).unwrap();
    let tight = |waiting| {
        let settings = RenderSettings { waiting, ..settings };
        let needed = Renderer::bytes_needed(&scene, source.model(), &plain, &Threads::One).unwrap();
        // Besides the picture, a mebibyte for the tracer.
        let left = budget.available().0 - needed.0 - (1 << 20);
        let _rest = budget.reserve(Bytes(left), "others").unwrap();
        let renderer = Renderer::new(&octree, &scene, &settings, &budget).unwrap();
        renderer.render(&Threads::One, &mut |_| Control::Continue)
    };
    let image = tight(WaitingRays::Auto).unwrap();
    let rays_of = |image: &RenderedImage| image.report.waiting.map_or(0, |waiting| waiting.rays);
    assert!(rays_of(&image) < rays_of(&few), "{} of {}", rays_of(&image), rays_of(&few));
    assert!(image.film.pixels() == reference.film.pixels());
    // Who wants so many is told.
    let refused = tight(WaitingRays::Count(1 << 16)).unwrap_err();
    assert!(
        matches!(refused, RenderError::Budget(_) | RenderError::Trace(TraceError::Budget(_))),
        "{refused}"
    );
    let none = RenderSettings { waiting: WaitingRays::Count(0), ..settings };
    assert!(matches!(none.validate(), Err(RenderError::Setting { .. })));
}

#[test]
fn a_cancelled_render_keeps_what_is_finished() {
    let bytes = compiled(&gears(|_| {}));
    let scene = with_lamps(view());
    let settings = RenderSettings { tile_size: 8, ..settings() };
    let whole = render(&bytes, &scene, &settings, IN_MEMORY);
    for (threads, loaders) in [(1, 0), (1, 1), (2, 2)] {
        let way = Way { slots: Some(8), threads, waiting: WaitingRays::Count(300), loaders };
        let budget = MemoryBudget::new(Bytes::mib(64));
        let mut last = None;
        let image = render_in(&budget, source(&bytes), &scene, &settings, way, &mut |progress| {
            assert!(progress.tiles <= progress.tiles_total && progress.samples <= progress.samples_total);
            last = Some(progress);
            if progress.tiles >= 3 { Control::Cancel } else { Control::Continue }
        })
        .unwrap();
        assert!(last.unwrap().tiles >= 3);
        assert_eq!(image.report.outcome, Outcome::Cancelled);
        let mut finished = 0;
        for y in 0..whole.film.height() {
            for x in 0..whole.film.width() {
                let is_finished = image.film.is_finished(x, y);
                let expected = if is_finished { whole.film.pixel(x, y) } else { [0.0; 3] };
                assert_eq!(image.film.pixel(x, y), expected);
                finished += u32::from(is_finished);
            }
        }
        assert!((3 * 3 * 8..24 * 19).contains(&finished), "{finished}");
        drop(image);
        assert_eq!(budget.used(), Bytes(0), "all is given back");
    }
}

#[test]
fn a_bad_block_ends_the_render_with_an_error() {
    let bytes = compiled(&gears(|_| {}));
    let scene = with_lamps(view());
    let reference = render(&bytes, &scene, &settings(), IN_MEMORY);
    let (mut failed, mut complete) = (0, 0);
    for seed in 0..12 {
        let way = WAYS[1 + seed as usize % 3];
        let loads = render(&bytes, &scene, &settings(), way).report.trace.blocks_loaded;
        let rate = 0.7 / loads as f64;
        let rates = match seed % 2 {
            0 => FaultRates { io_errors: rate, ..FaultRates::default() },
            _ => FaultRates { bit_flips: rate, ..FaultRates::default() },
        };
        let faulty = FaultySource::new(MemorySource::new(bytes.clone()).unwrap(), seed, rates);
        let budget = MemoryBudget::new(Bytes::mib(64));
        let result =
            render_in(&budget, Arc::new(faulty), &scene, &settings(), way, &mut |_| Control::Continue);
        match result {
            Ok(image) => {
                assert!(image.film.pixels() == reference.film.pixels(), "seed {seed}");
                complete += 1;
            }
            Err(RenderError::Trace(TraceError::Load(error))) => {
                assert!(error.to_string().contains("block "), "{error}");
                failed += 1;
            }
            Err(error) => panic!("seed {seed}: {error}"),
        }
        assert_eq!(budget.used(), Bytes(0), "all is given back");
    }
    assert!(failed > 0 && complete > 0, "{failed} failed, {complete} complete");
}

#[test]
fn a_lazy_model_is_the_same() {
    let mesh = gears(|_| {});
    let scene = with_lamps(view());
    let reference = render(&compiled(&mesh), &scene, &settings(), IN_MEMORY);
    for way in [WAYS[1], WAYS[3]] {
        let place = tempfile::tempdir().unwrap();
        let budget = MemoryBudget::new(Bytes::mib(128));
        let options = LazyOptions { compile: small_blocks(), cell_triangles: 256, ..LazyOptions::default() };
        let record = SourceRecord { file_bytes: 1, modified_ns: 2, fingerprint: 3 };
        let output = place.path().join("model.outcrop");
        let emit = |compiler: &mut Compiler<'_>| mesh.emit(compiler);
        let model =
            LazyModel::from_mesh(record, &output, &options, &budget, &mut |_| Control::Continue, emit)
                .unwrap();
        let image = render_in(&budget, Arc::new(model), &scene, &settings(), way, &mut |_| Control::Continue)
            .unwrap();
        assert!(image.film.pixels() == reference.film.pixels(), "{way:?}");
        assert!(image.report.trace.suspended_peak > 0);
    }
}

/// The rectangles of this size that a picture is cut into.
fn cut(settings: &RenderSettings, [width, height]: [u32; 2]) -> Vec<Region> {
    let mut regions = Vec::new();
    for y in (0..settings.height).step_by(height as usize) {
        for x in (0..settings.width).step_by(width as usize) {
            let (width, height) = (width.min(settings.width - x), height.min(settings.height - y));
            regions.push(Region { x, y, width, height });
        }
    }
    regions
}

fn paste(picture: &mut [[f32; 3]], settings: &RenderSettings, region: Region, pixels: &[[f32; 3]]) {
    assert_eq!(pixels.len() as u64, region.pixels());
    for (row, pixels) in (region.y..).zip(pixels.chunks_exact(region.width as usize)) {
        let start = (row * settings.width + region.x) as usize;
        picture[start..start + pixels.len()].copy_from_slice(pixels);
    }
}

/// A picture of regions, in an order of which no two neighbours follow each other; a region that fails or is stopped is rendered
/// again. Gives how often that was.
fn by_regions(
    source: Arc<dyn BlockSource>,
    scene: &Scene,
    settings: &RenderSettings,
    way: Way,
    sides: [u32; 2],
    stop: &AtomicBool,
) -> (Vec<[f32; 3]>, RegionCounters, u32) {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let settings = &RenderSettings { waiting: way.waiting, loader_threads: way.loaders, ..*settings };
    let threads = way.threads as u32;
    let needed = Renderer::regions_bytes(scene, source.model(), settings, threads).unwrap();
    let aside = budget.reserve(needed, "the regions").unwrap();
    let options = OctreeOptions { tracers_max: threads, slots_max: way.slots, ..OctreeOptions::default() };
    let octree = LazyOctree::open(source, &budget, options).unwrap();
    drop(aside);
    let renderer = Renderer::new(&octree, scene, settings, &budget).unwrap();
    let regions = cut(settings, sides);
    let parts = renderer
        .with_regions(threads, |by| {
            assert_eq!(by.rays_wait(), matches!(way.waiting, WaitingRays::Count(_)));
            let part = |number: usize| {
                let mut renderer = by.renderer(stop).unwrap();
                let (mut again, mut before, mut done) = (0, RegionCounters::default(), Vec::new());
                for index in (number..regions.len()).step_by(way.threads) {
                    let region = regions[index * 7 % regions.len()];
                    let pixels = loop {
                        match renderer.render(region) {
                            Ok(Some(pixels)) => break pixels.to_vec(),
                            Ok(None) => stop.store(false, Ordering::Relaxed),
                            Err(RenderError::Trace(TraceError::Load(_))) => {}
                            Err(error) => panic!("{error}"),
                        }
                        again += 1;
                        assert!(again < 1000);
                    };
                    done.push((region, pixels));
                    // Nothing that was counted is forgotten.
                    let after = renderer.counters();
                    assert!(after.effects.samples >= before.effects.samples + region.pixels());
                    assert!(after.trace.blocks_loaded >= before.trace.blocks_loaded);
                    before = after;
                }
                (done, before, again)
            };
            std::thread::scope(|scope| {
                let part = &part;
                let threads: Vec<_> =
                    (0..way.threads).map(|number| scope.spawn(move || part(number))).collect();
                threads.into_iter().map(|thread| thread.join().unwrap()).collect::<Vec<_>>()
            })
        })
        .unwrap();
    assert!(budget.peak() <= budget.limit());
    let mut picture = vec![[-1.0; 3]; settings.width as usize * settings.height as usize];
    let (mut counters, mut again) = (RegionCounters::default(), 0);
    for (done, own, own_again) in parts {
        done.iter().for_each(|(region, pixels)| paste(&mut picture, settings, *region, pixels));
        counters.trace.blocks_loaded += own.trace.blocks_loaded;
        counters.trace.suspended_peak = counters.trace.suspended_peak.max(own.trace.suspended_peak);
        counters.loads.in_flight_peak = counters.loads.in_flight_peak.max(own.loads.in_flight_peak);
        again += own_again;
    }
    (picture, counters, again)
}

#[test]
fn regions_are_the_same() {
    // 7 and the number of regions of each cut have no common factor.
    let bytes = compiled(&gears(|_| {}));
    let plain = RenderSettings { tile_size: 16, samples_per_pixel: 2, ..settings() };
    let adaptive = AdaptiveSampling { samples_min: 4, error: 0.02, confidence: 0.9 };
    let sampled = RenderSettings {
        samples_per_pixel: 16,
        adaptive: Some(adaptive),
        keep_statistics: false,
        contribution_bound: 0.05,
        ..plain
    };
    let mirrors = with_lamps(view());
    let diffuse = with_lamps(view()).with_interreflection();
    let never = AtomicBool::new(false);
    for (scene, settings) in [(&mirrors, &plain), (&diffuse, &sampled)] {
        let reference = render(&bytes, scene, settings, IN_MEMORY);
        for (number, way) in WAYS.into_iter().enumerate() {
            let sides = [[16, 16], [5, 4], [16, 9], [8, 8], [13, 16]][number];
            // Adaptive tiles look around themselves, so regions of other sizes take other samples.
            let mut expected = reference.film.pixels().to_vec();
            if settings.adaptive.is_some() {
                let in_order = Way { waiting: WaitingRays::Never, ..IN_MEMORY };
                expected = by_regions(source(&bytes), scene, settings, in_order, sides, &never).0;
            }
            let (picture, counters, again) = by_regions(source(&bytes), scene, settings, way, sides, &never);
            assert!(picture == expected, "{way:?}");
            assert_eq!(again, 0);
            assert!(way.slots.is_none() || counters.trace.suspended_peak > 0, "{way:?}");
            assert!((way.loaders > 0) || counters.loads.in_flight_peak == 0, "{way:?}");
        }
    }
}

#[test]
fn regions_load_fewer_blocks_when_their_rays_wait() {
    let bytes = compiled(&gears(|_| {}));
    let scene = with_lamps(view());
    let settings = RenderSettings { keep_statistics: false, tile_size: 64, ..RenderSettings::new(96, 96) };
    let never = AtomicBool::new(false);
    let loads = |waiting, side| {
        let way = Way { slots: Some(6), threads: 1, waiting, loaders: 0 };
        by_regions(source(&bytes), &scene, &settings, way, [side; 2], &never).1.trace.blocks_loaded
    };
    let (many, few) = (loads(WaitingRays::Never, 64), loads(WaitingRays::Count(4096), 64));
    assert!(few * 2 < many, "{few} instead of {many} loads");
    // The smaller the region, the fewer share a load.
    let more = loads(WaitingRays::Count(4096), 8);
    assert!(few < more, "{few}, {more}");
}

/// A source that has somebody stop at some of its reads.
struct Stopping {
    source: MemorySource,
    stop: Arc<AtomicBool>,
    reads: AtomicU64,
}

impl BlockSource for Stopping {
    fn model(&self) -> &Arc<outcrop::model::Model> {
        self.source.model()
    }

    fn read_block(
        &self,
        block: outcrop::units::BlockId,
        into: &mut Vec<u8>,
    ) -> Result<(), outcrop::error::SourceError> {
        if [40, 400, 1000].contains(&self.reads.fetch_add(1, Ordering::Relaxed)) {
            self.stop.store(true, Ordering::Relaxed);
        }
        self.source.read_block(block, into)
    }
}

#[test]
fn a_region_that_was_stopped_or_failed_can_be_rendered_again() {
    let bytes = compiled(&gears(|_| {}));
    let scene = with_lamps(view());
    let settings = RenderSettings { tile_size: 16, ..settings() };
    let reference = render(&bytes, &scene, &settings, IN_MEMORY);
    for way in [WAYS[1], WAYS[2]] {
        let stop = Arc::new(AtomicBool::new(false));
        let source = MemorySource::new(bytes.clone()).unwrap();
        let stopping = Stopping { source, stop: Arc::clone(&stop), reads: AtomicU64::new(0) };
        let (picture, counters, again) =
            by_regions(Arc::new(stopping), &scene, &settings, way, [8, 8], &stop);
        assert!(picture == reference.film.pixels(), "{way:?}");
        assert!(again > 0, "{way:?}: it was stopped");

        // About one in each region.
        let rate = 5.0 / counters.trace.blocks_loaded as f64;
        let rates = FaultRates { io_errors: rate, bit_flips: rate, ..FaultRates::default() };
        let faulty = FaultySource::new(MemorySource::new(bytes.clone()).unwrap(), 3, rates);
        let never = AtomicBool::new(false);
        let (picture, _, again) = by_regions(Arc::new(faulty), &scene, &settings, way, [8, 8], &never);
        assert!(picture == reference.film.pixels(), "{way:?}");
        assert!(again > 0, "{way:?}: it failed");
    }
}
