//! The naive twin's picture against the octree's, and what the report says.

use std::path::Path;

use super::effects::{cases, finished, metal, pictures, with_images};
use super::invariance::{settings, still_life};
use super::*;
use crate::LazyOctree;
use crate::block::Codec;
use crate::block::attributes::{normal_bits, normal_of_bits};
use crate::cache::CacheStats;
use crate::compile::{CompileOptions, Compiler, PrecisionChoice};
use crate::import::{CornerIndices, MeshSink, NO_INDEX, VertexBatch};
use crate::model::{ImageMap, MaterialImages};
use crate::octree::OctreeOptions;
use crate::render::{Outcome, Renderer};
use crate::scene::{Effect, EffectSet, Environment, Finish, Lens, Light, LightShape};
use crate::source::{BlockSource, DiskSource, MemorySource};

/// Compiles `mesh` with every vertex of its own, in its own order.
fn compile(mesh: &Mesh, path: &Path, block_bytes: u32, codec: Codec) {
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = CompileOptions {
        block_bytes,
        codec,
        precision: PrecisionChoice::Float32,
        ..CompileOptions::default()
    };
    let mut progress = |_| Control::Continue;
    let mut compiler = Compiler::new(path, options, &budget, &mut progress).unwrap();
    let ids: Vec<MaterialId> =
        mesh.materials.iter().map(|record| compiler.material(record.clone()).unwrap()).collect();
    let (mut uv_count, mut normal_count) = (0, 0);
    for ((vertices, material), first) in mesh.triangles.iter().zip((0u32..).step_by(3)) {
        compiler.vertices(VertexBatch::Float64(vertices)).unwrap();
        let (triangle, id) = ([[first, first + 1, first + 2]], ids[usize::from(*material)]);
        let Some(attributes) = mesh.attributes.get(first as usize / 3) else {
            compiler.triangles(&triangle, id).unwrap();
            continue;
        };
        let mut corners = [[NO_INDEX; 3]; 2];
        if let Some(values) = &attributes.uvs {
            corners[0] = [0, 1, 2].map(|corner| uv_count + corner);
            uv_count += 3;
            compiler.texture_coordinates(values).unwrap();
        }
        if let Some(values) = attributes.normals {
            corners[1] = [0, 1, 2].map(|corner| normal_count + corner);
            normal_count += 3;
            compiler.normals(&values.map(|normal| normal.map(|x| x as f32))).unwrap();
        }
        let corners = CornerIndices { uvs: Some(&corners[..1]), normals: Some(&corners[1..]) };
        compiler.triangles_with_attributes(&triangle, corners, id).unwrap();
    }
    compiler.finish().unwrap();
}

/// The still life in f32, on a ground of many small triangles so that there are many blocks.
fn large_still_life() -> (Mesh, Scene) {
    let (mesh, scene) = still_life();
    let mut large = Mesh::new(mesh.materials);
    const STEPS: i32 = 24;
    for x in 0..STEPS {
        for z in 0..STEPS {
            let corner = [-6.0 + 0.5 * f64::from(x), -1.0, -6.0 + 0.5 * f64::from(z)];
            large = large.sheet(0, corner, [0.0, 0.0, 0.5], [0.5, 0.0, 0.0]);
        }
    }
    large.triangles.extend(mesh.triangles.into_iter().skip(2));
    for (vertices, _) in &mut large.triangles {
        *vertices = vertices.map(|vertex| vertex.map(|x| f64::from(x as f32)));
    }
    (large, scene)
}

#[test]
fn the_octree_gives_the_naive_picture_for_any_blocks_cache_source_and_threads() {
    let (mesh, scene) = large_still_life();
    let reference = render(&mesh, &scene, &settings());
    let directory = tempfile::tempdir().unwrap();
    for (index, (block_bytes, codec, slots_max, threads)) in [
        (4 << 10, Codec::Lz4, None, Threads::One),
        (4 << 10, Codec::Raw, Some(2), Threads::One),
        (4 << 10, Codec::Lzo, Some(3), Threads::Count(2)),
        (64 << 10, Codec::Lz4, None, Threads::Count(2)),
    ]
    .into_iter()
    .enumerate()
    {
        let path = directory.path().join(format!("{index}.outcrop"));
        compile(&mesh, &path, block_bytes, codec);
        let source: Arc<dyn BlockSource> = if index % 2 == 0 {
            Arc::new(DiskSource::open(&path).unwrap())
        } else {
            Arc::new(MemorySource::new(std::fs::read(&path).unwrap()).unwrap())
        };
        let budget = MemoryBudget::new(Bytes::mib(64));
        let needed = Renderer::bytes_needed(&scene, source.model(), &settings(), &threads).unwrap();
        let reserved = budget.reserve(needed, "the render").unwrap();
        let options = OctreeOptions { tracers_max: 2, slots_max, ..OctreeOptions::default() };
        let octree = LazyOctree::open(source, &budget, options).unwrap();
        drop(reserved);
        let renderer = Renderer::new(&octree, &scene, &settings(), &budget).unwrap();
        let image = renderer.render(&threads, &mut |_| Control::Continue).unwrap();
        assert!(image.film.pixels() == reference.film.pixels(), "{block_bytes} {codec:?} {slots_max:?}");

        let report = &image.report;
        assert_eq!(report.effects, reference.totals.effects);
        // The octree counts every query that the effects made.
        assert_eq!(report.trace.rays, report.effects.rays());
        assert_eq!(report.outcome, Outcome::Complete);
        assert_eq!(report.tiles_finished, report.tiles_total);
        assert!(report.blocks_touched >= 1 && report.blocks_touched <= report.blocks_total);
        assert!(report.trace.blocks_loaded >= report.blocks_touched);
        assert!(slots_max.is_some() || report.loads_per_touched_block() == 1.0);
        assert!(report.budget_peak <= Bytes::mib(64) && report.memory == needed);
        let json: serde_json::Value = serde_json::from_str(&report.to_json()).unwrap();
        assert_eq!(json["effects"]["primary_rays"], 37 * 29 * 3);
        assert_eq!(json["complete"], true);
        assert_eq!(json["plan"].as_array().unwrap().len(), Effect::ALL.len());
    }
}

#[test]
fn the_octree_gives_the_naive_picture_for_every_effect() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("effects.outcrop");
    for case in cases() {
        let mut mesh = case.mesh;
        for (vertices, _) in &mut mesh.triangles {
            *vertices = vertices.map(|vertex| vertex.map(|x| f64::from(x as f32)));
        }
        // What a file keeps of normals.
        let normals = mesh.attributes.iter_mut().filter_map(|attributes| attributes.normals.as_mut());
        for normal in normals.flatten() {
            *normal = normal_of_bits(normal_bits(normal.map(|x| x as f32)).unwrap());
        }
        let reference = render(&mesh, &case.scene, &case.settings);
        compile(&mesh, &path, 4 << 10, Codec::Lz4);
        let budget = MemoryBudget::new(Bytes::mib(64));
        let options = OctreeOptions { tracers_max: 2, slots_max: Some(3), ..OctreeOptions::default() };
        let octree = LazyOctree::open(Arc::new(DiskSource::open(&path).unwrap()), &budget, options).unwrap();
        let renderer = Renderer::new(&octree, &case.scene, &case.settings, &budget).unwrap();
        let image = renderer.render(&Threads::Count(2), &mut |_| Control::Continue).unwrap();
        assert!(image.film.pixels() == reference.film.pixels(), "{:?}", case.effect);
        assert_eq!(image.report.effects, reference.totals.effects);
        assert_eq!(image.report.trace.rays, image.report.effects.rays(), "{:?}", case.effect);
    }
}

/// Rays that no effect calls for would load blocks: a view past the model loads none, and a view of matt bricks loads
/// no more without shadows than its primary rays need.
#[test]
fn effects_left_out_load_no_block() {
    let (mesh, scene) = large_still_life();
    // A glass that no block uses calls for nothing.
    let materials = [vec![matt(0.5); 4], vec![clear(1.5)]].concat();
    let bricks = Mesh { materials, ..mesh };
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bricks.outcrop");
    compile(&bricks, &path, 4 << 10, Codec::Lz4);
    // A keyhole: a few pixels of ground far from everything else.
    let camera = Camera::orthographic([5.0, 9.0, -5.0], [5.0, 0.0, -5.0], [0.0, 0.0, 1.0], 0.2).unwrap();
    let keyhole = Scene::new(camera).with_lights(scene.lights().iter().copied());
    let loads = |settings: RenderSettings| {
        let budget = MemoryBudget::new(Bytes::mib(64));
        let source = Arc::new(DiskSource::open(&path).unwrap());
        let options = OctreeOptions { slots_max: Some(4), ..OctreeOptions::default() };
        let octree = LazyOctree::open(source, &budget, options).unwrap();
        let renderer = Renderer::new(&octree, &keyhole, &settings, &budget).unwrap();
        assert!(!renderer.plan().has(Effect::Transmission), "{}", renderer.plan().explain());
        let image = renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap();
        let film: Vec<_> = image.film.pixels().to_vec();
        (film, image.report.trace.blocks_loaded)
    };
    let small = RenderSettings::new(4, 4);
    let off: EffectSet = Effect::ALL.into_iter().collect();
    let (_, primary_only) = loads(RenderSettings { switched_off: off, ..small });
    let (planned, planned_loads) = loads(small);
    let (forced, forced_loads) = loads(RenderSettings { forced: EffectSet::ALL, ..small });
    assert!(primary_only <= planned_loads && planned_loads <= forced_loads);
    assert!(planned == forced);
    assert_eq!(primary_only, 1);
}

/// Three storeys of many small tiles: a floor (material 0), a ceiling (1) and a basement (2). The middle of the floor is seen at a
/// slant, so that what leaves it meets blocks that the camera does not.
fn storeys(floor: MaterialRecord) -> Mesh {
    const STEPS: i32 = 24;
    let mut mesh = Mesh::new([floor, matt(0.5), matt(0.5)]);
    for (material, y) in [(0, 0.0), (1, 3.0), (2, -3.0)] {
        for (x, z) in (0..STEPS).flat_map(|x| (0..STEPS).map(move |z| (x, z))) {
            let corner = [-6.0 + 0.5 * f64::from(x), y, -6.0 + 0.5 * f64::from(z)];
            mesh = mesh.card(material, corner, [0.0, 0.0, 0.5], [0.5, 0.0, 0.0], 1.0);
        }
    }
    mesh
}

/// Which blocks an effect makes rays reach: more with it, and without it just those of the same geometry in a scene that has no
/// cause of it: no lamp, no material but matt ones, no lens.
#[test]
fn an_effect_left_out_touches_no_block_and_reads_no_page_and_no_tile() {
    let directory = tempfile::tempdir().unwrap();
    let settings = RenderSettings { samples_per_pixel: 4, work_budget: 64, ..RenderSettings::new(8, 8) };
    let eye = [-1.5, 1.2, 2.5];
    let camera = || Camera::pinhole(eye, [-0.5, 0.0, 0.5], [0.0, 1.0, 0.0], 8.0).unwrap();
    // Bright, so that rays are worth following.
    let bright = |camera| Scene::new(camera).with_background([1.0; 3]);
    let empty = || bright(camera());
    let touched = |name: &str, mesh: &Mesh, scene: &Scene, switched_off: EffectSet| {
        let path = directory.path().join(name);
        if !path.exists() {
            compile(mesh, &path, 4 << 10, Codec::Lz4);
        }
        let budget = MemoryBudget::new(Bytes::mib(64));
        let source = Arc::new(DiskSource::open(&path).unwrap());
        let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
        let settings = RenderSettings { switched_off, ..settings };
        let renderer = Renderer::new(&octree, scene, &settings, &budget).unwrap();
        let plan = renderer.plan().needed();
        let report = renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap().report;
        let loads = |stats: Option<CacheStats>| stats.map_or(0, |stats| stats.misses);
        let details = [loads(renderer.attribute_stats()), loads(renderer.texture_stats())];
        (plan, report.blocks_touched, report.blocks_total, details)
    };
    let (plan, plain, total, details) = touched("matt", &storeys(matt(0.5)), &empty(), EffectSet::EMPTY);
    assert_eq!((plan, details), (EffectSet::EMPTY.with(Effect::Antialiasing), [0, 0]));
    assert!((1..10).contains(&plain) && total > 20, "{plain} of {total}");

    let named = |name: &str, record: MaterialRecord| MaterialRecord { name: name.to_string(), ..record };
    let lens = Lens { radius: 0.5, focus_distance: 1.0 };
    let end = Camera::pinhole([1.5, 1.2, 2.5], [3.5, 0.0, 0.5], [0.0, 1.0, 0.0], 8.0).unwrap();
    let panel = LightShape::Rectangle { corner: [1.0, 5.0, 1.0], edges: [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] };
    let disc = |map: &str| MaterialImages { diffuse: Some(ImageMap::new(map)), ..MaterialImages::default() };
    let waves = MaterialImages { bump: Some(ImageMap::new("waves")), ..MaterialImages::default() };
    let smoke = MaterialRecord { transmission: [0.5; 3], ..clear(1.5) };
    let sun = Light::directional([-1.0, -1.5, -1.0], [1.0; 3]);
    // The effect, whether it makes rays of its own, the floor, the scene.
    let cases = [
        (Effect::DirectLight, true, matt(0.5), empty().with_light(sun)),
        (Effect::Shadows, true, matt(0.5), empty().with_light(sun)),
        (Effect::AreaLight, true, matt(0.5), empty().with_light(Light::area(panel, [1.0; 3]))),
        (
            Effect::EnvironmentLight,
            true,
            matt(0.5),
            empty().with_environment(Environment::Constant([1.0; 3])),
        ),
        (Effect::Reflection, true, mirror(0.8), empty()),
        (
            Effect::GlossyReflection,
            true,
            named("chrome", mirror(0.8)),
            empty().with_finish("chrome", Finish::rough(0.6)),
        ),
        (Effect::Transmission, true, clear(1.0), empty()),
        (
            Effect::RoughRefraction,
            true,
            named("glass", clear(1.3)),
            empty().with_finish("glass", Finish::rough(0.6)),
        ),
        (Effect::Absorption, false, smoke, empty()),
        (Effect::Interreflection, true, matt(0.5), empty().with_interreflection()),
        (Effect::DepthOfField, true, matt(0.5), bright(camera().with_lens(lens).unwrap())),
        (Effect::MotionBlur, true, matt(0.5), bright(camera().moving_to(&end).unwrap())),
        (Effect::Textures, false, with_images(matt(0.5), disc("chequer")), empty().with_textures(pictures())),
        (Effect::AlphaCutouts, true, with_images(matt(0.5), disc("disc")), empty().with_textures(pictures())),
        (Effect::BumpMaps, false, with_images(matt(0.5), waves), empty().with_textures(pictures())),
        (Effect::Emission, false, MaterialRecord { emission: [1.0; 3], ..matt(0.5) }, empty()),
        (
            Effect::FinishMaps,
            false,
            finished(metal(0.8), MaterialImages::default()),
            empty().with_textures(pictures()),
        ),
    ];
    for (number, (effect, makes_rays, floor, scene)) in cases.into_iter().enumerate() {
        let (name, mesh) = (number.to_string(), storeys(floor));
        // What it makes possible goes with it; what makes it possible does not.
        let (plan, with, ..) = touched(&name, &mesh, &scene, EffectSet::EMPTY);
        assert!(plan.contains(effect), "{effect:?}");
        assert!(if makes_rays { with > plain } else { with >= plain }, "{effect:?}: {with}, {plain}");
        let basis: &[Effect] = match effect {
            // Which have their own rays.
            Effect::GlossyReflection | Effect::FinishMaps => &[Effect::Reflection],
            Effect::RoughRefraction | Effect::Absorption => &[Effect::Transmission, Effect::Reflection],
            _ => &[],
        };
        let off = basis.iter().fold(EffectSet::EMPTY.with(effect), |off, basis| off.with(*basis));
        // A picture with holes is one with colours as well.
        let off = if effect == Effect::AlphaCutouts { off.with(Effect::Textures) } else { off };
        let off = if effect == Effect::Textures { off.with(Effect::AlphaCutouts) } else { off };
        let (plan, without, blocks, details) = touched(&name, &mesh, &scene, off);
        assert!(!plan.contains(effect), "{effect:?}");
        assert_eq!((without, blocks, details), (plain, total, [0, 0]), "{effect:?}");
    }
}

#[test]
fn a_damaged_block_ends_the_render() {
    let (mesh, scene) = large_still_life();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("damaged.outcrop");
    compile(&mesh, &path, 4 << 10, Codec::Lz4);
    let mut bytes = std::fs::read(&path).unwrap();
    let model = MemorySource::new(bytes.clone()).unwrap().model().clone();
    for block in &model.blocks {
        bytes[block.offset as usize + block.stored_bytes as usize / 2] ^= 0x10;
    }
    let budget = MemoryBudget::new(Bytes::mib(64));
    let source = Arc::new(MemorySource::new(bytes).unwrap());
    let options = OctreeOptions { slots_max: Some(8), tracers_max: 2, ..OctreeOptions::default() };
    let octree = LazyOctree::open(source, &budget, options).unwrap();
    let renderer = Renderer::new(&octree, &scene, &settings(), &budget).unwrap();
    for threads in [Threads::One, Threads::Count(2)] {
        let error = renderer.render(&threads, &mut |_| Control::Continue).map(|_| ()).unwrap_err();
        assert!(error.to_string().contains("is damaged"), "{error}");
    }
}

#[test]
fn a_cancelled_render_is_not_complete() {
    let (mesh, scene) = large_still_life();
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cancelled.outcrop");
    compile(&mesh, &path, 64 << 10, Codec::Lz4);
    let budget = MemoryBudget::new(Bytes::mib(64));
    let options = OctreeOptions { slots_max: Some(8), ..OctreeOptions::default() };
    let octree = LazyOctree::open(Arc::new(DiskSource::open(&path).unwrap()), &budget, options).unwrap();
    let renderer = Renderer::new(&octree, &scene, &settings(), &budget).unwrap();
    let image = renderer.render(&Threads::One, &mut |_| Control::Cancel).unwrap();
    assert_eq!(image.report.outcome, Outcome::Cancelled);
    assert!(image.report.tiles_finished < image.report.tiles_total);
    assert!(matches!(image.into_complete(), Err(RenderError::Cancelled)));
}
