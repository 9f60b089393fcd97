//! Pictures of instances: what is written out by hand looks the same, and nothing about memory, threads or kernels shows.

#[path = "support/compiling.rs"]
mod compiling;

use std::sync::Arc;

use compiling::{Mesh, Vertices, compile};
use outcrop::compile::{CompileOptions, Control, compile_file};
use outcrop::geom::Affine;
use outcrop::instance::{Instance, InstanceTriangle, Instances};
use outcrop::model::MaterialRecord;
use outcrop::octree::{LeafLayout, OctreeOptions};
use outcrop::procedural::Icosphere;
use outcrop::render::{RenderSettings, RenderedImage, Renderer, Threads};
use outcrop::scene::{Camera, Effect, EffectSet, Environment, Finish, Light, LightShape, Scene};
use outcrop::simd::SimdLevel;
use outcrop::source::{DiskSource, MemorySource};
use outcrop::units::{Bytes, TriangleId};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

/// Coordinates in steps of 2^-12: f32 keeps them where they are moved to.
fn rounded(mesh: Mesh) -> Mesh {
    let corners = (0..mesh.triangles.len()).flat_map(|triangle| mesh.corners(triangle));
    let vertices: Vec<[f32; 3]> =
        corners.map(|corner| corner.map(|x| ((x * 4096.0).round() / 4096.0) as f32)).collect();
    let triangles = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    Mesh { vertices: Vertices::Float32(vertices), triangles, ..mesh }
}

/// Balls of glass, of brass and of clay, each a model; and a floor.
fn models() -> Vec<Mesh> {
    let ball = |radius, level, record: MaterialRecord| {
        let mesh = rounded(Mesh::of(&Icosphere::new(radius, [0.25, 0.0, 0.0], level).unwrap()));
        Mesh { records: vec![record], ..mesh }
    };
    let named = |name: &str| MaterialRecord { name: name.to_string(), ..MaterialRecord::default() };
    let glass = MaterialRecord {
        diffuse: [0.05; 3],
        opacity: 0.1,
        transmission: [0.7, 0.9, 0.8],
        refractive_index: 1.5,
        ..named("glass")
    };
    let brass =
        MaterialRecord { specular: [0.8, 0.7, 0.4], mirror: true, diffuse: [0.1; 3], ..named("brass") };
    let clay = MaterialRecord { diffuse: [0.7, 0.4, 0.3], ..named("clay") };
    let floor = Mesh::new(
        Vertices::Float32(vec![[-8.0, -8.0, -1.0], [8.0, -8.0, -1.0], [8.0, 8.0, -1.0], [-8.0, 8.0, -1.0]]),
        vec![[0, 1, 2], [0, 2, 3]],
    );
    let floor = Mesh { records: vec![MaterialRecord { diffuse: [0.6; 3], ..named("floor") }], ..floor };
    vec![ball(1.0, 3, glass), ball(0.75, 3, brass), ball(0.5, 2, clay), floor]
}

/// By maps that are exact on such coordinates: turned by right angles, mirrored, doubled, moved.
fn places() -> Vec<Instance> {
    let turned = |axis, degrees| Affine::rotation(axis, degrees);
    let at = |x, y, z| Affine::translation([x, y, z]);
    let (x, z) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let mirrored = Affine::scale([-1.0, 1.0, 1.0]);
    let maps = [
        (0, turned(z, 90.0).then(&at(-2.0, 0.0, 0.0))),
        // A mirrored ball of glass has its inside inside.
        (0, mirrored.then(&turned(x, 90.0)).then(&at(0.0, 0.5, 0.25))),
        (1, at(2.0, 1.0, 0.0)),
        (3, Affine::IDENTITY),
        (2, Affine::scale([2.0; 3]).then(&at(1.0, -2.0, 0.0))),
        (2, Affine::scale([1.0, -1.0, 0.5]).then(&at(-1.0, -2.0, -0.5))),
        (1, mirrored.then(&turned(z, 180.0)).then(&at(-3.0, 2.0, 0.0))),
        // Two in one place.
        (2, at(-1.0, -1.0, 1.0)),
        (2, at(-1.0, -1.0, 1.0)),
    ];
    maps.map(|(model, map)| Instance { model, map }).to_vec()
}

/// All instances as one mesh, in their order.
fn written_out(models: &[Mesh], places: &[Instance]) -> Mesh {
    let (mut vertices, mut materials) = (Vec::new(), Vec::new());
    for instance in places {
        let mesh = &models[instance.model as usize];
        let [[a, b, c, _], [d, e, f, _], [g, h, i, _]] = instance.map.rows();
        let mirrors = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0;
        for triangle in 0..mesh.triangles.len() {
            let mut corners = mesh.corners(triangle).map(|corner| {
                let moved = instance.map.point(corner);
                moved.map(|x| {
                    assert_eq!(f64::from(x as f32), x, "the map is exact");
                    x as f32
                })
            });
            if mirrors {
                corners.swap(1, 2);
            }
            vertices.extend(corners);
            materials.push(instance.model as u16);
        }
    }
    let triangles = (0..vertices.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
    let records = models.iter().map(|mesh| mesh.records[0].clone()).collect();
    Mesh { materials, records, ..Mesh::new(Vertices::Float32(vertices), triangles) }
}

fn source(mesh: &Mesh, block_bytes: u32) -> Arc<dyn BlockSource> {
    let options = CompileOptions { block_bytes, ..CompileOptions::default() };
    Arc::new(MemorySource::new(compile(mesh, &options, Bytes::mib(64)).1).unwrap())
}

fn scene() -> Scene {
    let camera = Camera::pinhole([1.0, -9.0, 4.0], [0.0, 0.0, -0.25], [0.0, 0.0, 1.0], 40.0).unwrap();
    let lamp = LightShape::Sphere { center: [3.0, -4.0, 6.0], radius: 0.5 };
    Scene::new(camera)
        .with_light(Light::point([-4.0, -4.0, 6.0], [0.5; 3]))
        .with_light(Light::area(lamp, [10.0; 3]))
        .with_environment(Environment::Constant([0.3, 0.4, 0.5]))
        .with_finish("brass", Finish::rough(0.2))
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 4, ..RenderSettings::new(72, 48) }
}

fn of_instances(
    sources: &[Arc<dyn BlockSource>],
    settings: &RenderSettings,
    options: &OctreeOptions,
    threads: usize,
) -> RenderedImage {
    let budget = MemoryBudget::new(Bytes::mib(128));
    let options = OctreeOptions { tracers_max: threads as u32, ..*options };
    let instances = Instances::open(sources, places(), &budget, &options).unwrap();
    let renderer = Renderer::over_instances(&instances, &scene(), settings, &budget).unwrap();
    renderer.render(&Threads::Count(threads), &mut |_| Control::Continue).unwrap()
}

fn of_model(source: Arc<dyn BlockSource>, settings: &RenderSettings) -> RenderedImage {
    let budget = MemoryBudget::new(Bytes::mib(128));
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    let renderer = Renderer::new(&octree, &scene(), settings, &budget).unwrap();
    renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap()
}

#[test]
fn instances_look_like_what_is_written_out() {
    let models = models();
    let sources: Vec<_> = models.iter().map(|mesh| source(mesh, 4 << 10)).collect();
    let whole = source(&written_out(&models, &places()), 16 << 10);
    let expected = of_model(whole, &settings());
    let found = of_instances(&sources, &settings(), &OctreeOptions::default(), 1);
    assert_eq!(found.film.pixels(), expected.film.pixels());
    assert_eq!(found.report.plan.explain(), expected.report.plan.explain());
    let (found, expected) = (&found.report.effects, &expected.report.effects);
    assert_eq!(found, expected);
    assert!(found.transmission_rays > 500 && found.glossy_rays > 100, "{found:?}");
}

#[test]
fn nothing_but_the_scene_shows() {
    let models = models();
    let reference = {
        let sources: Vec<_> = models.iter().map(|mesh| source(mesh, 64 << 10)).collect();
        of_instances(&sources, &settings(), &OctreeOptions::default(), 1)
    };
    let base = OctreeOptions::default();
    let combinations = [
        (4 << 10, OctreeOptions { slots_max: Some(2), ..base }, 2, 32),
        (16 << 10, OctreeOptions { simd: Some(SimdLevel::Portable), ..base }, 1, 16),
        (4 << 10, OctreeOptions { leaf_layout: LeafLayout::Indexed, ..base }, 3, 8),
    ];
    for (block_bytes, options, threads, tile_size) in combinations {
        let sources: Vec<_> = models.iter().map(|mesh| source(mesh, block_bytes)).collect();
        let settings = RenderSettings { tile_size, ..settings() };
        let image = of_instances(&sources, &settings, &options, threads);
        assert_eq!(image.film.pixels(), reference.film.pixels(), "{block_bytes} {threads}");
        assert_eq!(image.report.effects, reference.report.effects);
    }
}

#[test]
fn the_next_frame_loads_nothing_again() {
    let models = models();
    let sources: Vec<_> = models.iter().map(|mesh| source(mesh, 4 << 10)).collect();
    let budget = MemoryBudget::new(Bytes::mib(128));
    let mut instances = Instances::open(&sources, places(), &budget, &OctreeOptions::default()).unwrap();
    let mut frame = |step: f64| {
        let moved = |instance: &Instance| Instance {
            map: instance.map.then(&Affine::translation([0.0, 0.25 * step, 0.0])),
            ..*instance
        };
        instances.place(places().iter().map(moved).collect()).unwrap();
        let renderer = Renderer::over_instances(&instances, &scene(), &settings(), &budget).unwrap();
        renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap()
    };
    let first = frame(0.0);
    // What the first frame did not see, the second may load, and the third not again.
    let second = frame(1.0);
    assert_ne!(first.film.pixels(), second.film.pixels());
    let touched = second.report.blocks_touched;
    assert_eq!(first.report.trace.blocks_loaded, first.report.blocks_touched);
    assert_eq!(second.report.trace.blocks_loaded, touched - first.report.blocks_touched);
    let third = frame(0.0);
    assert_eq!(third.report.trace.blocks_loaded, 0);
    assert_eq!(third.film.pixels(), first.film.pixels());
}

/// A glowing square that moves by its own width: the longer it is before a place, the brighter that is.
#[test]
fn what_moves_while_the_shutter_is_open_is_blurred() {
    let square = Mesh::new(
        Vertices::Float32(vec![[0.0, -2.0, 0.0], [1.0, -2.0, 0.0], [1.0, 2.0, 0.0], [0.0, 2.0, 0.0]]),
        vec![[0, 1, 2], [0, 2, 3]],
    );
    let glow = MaterialRecord { diffuse: [0.0; 3], emission: [1.0; 3], ..MaterialRecord::default() };
    let sources = [source(&Mesh { records: vec![glow], ..square }, 4 << 10)];
    let budget = MemoryBudget::new(Bytes::mib(64));
    let at = |x: f64| Affine::translation([x, 0.0, 0.0]);
    let places = vec![Instance { model: 0, map: at(0.0) }, Instance { model: 0, map: at(2.5) }];
    let options = OctreeOptions { tracers_max: 2, ..Default::default() };
    let mut instances = Instances::open(&sources, places, &budget, &options).unwrap();
    // Three units across; 30 pixels.
    let camera = Camera::orthographic([1.5, 0.0, 5.0], [1.5, 0.0, 0.0], [0.0, 1.0, 0.0], 1.0).unwrap();
    let scene = Scene::new(camera);
    let settings = RenderSettings { samples_per_pixel: 256, ..RenderSettings::new(30, 10) };
    let render = |instances: &Instances, settings: &RenderSettings, threads: usize| {
        let renderer = Renderer::over_instances(instances, &scene, settings, &budget).unwrap();
        renderer.render(&Threads::Count(threads), &mut |_| Control::Continue).unwrap()
    };
    let rest = render(&instances, &settings, 1);
    assert!(!rest.report.plan.has(Effect::MotionBlur) && rest.report.effects.shutter_rays == 0);
    instances.move_while_open(&[(0, at(1.0))]).unwrap();
    let blurred = render(&instances, &settings, 1);
    assert!(blurred.report.plan.explain().contains("motion blur: instances move"));
    assert_eq!(blurred.report.effects.shutter_rays, blurred.report.effects.samples);
    for column in 0..30u32 {
        let x = (f64::from(column) + 0.5) / 10.0;
        // It is there from the time when its right border has come until its left one has.
        let share = match x {
            x if x < 1.0 => x,
            x if x < 2.0 => 2.0 - x,
            x if x < 2.5 => 0.0,
            _ => 1.0,
        };
        // Beside borders the filter takes in what is next to the pixel.
        if (x - 2.5).abs() < 0.16 {
            continue;
        }
        for row in 2..8 {
            let found = f64::from(blurred.film.pixel(column, row)[0]);
            assert!((found - share).abs() < 0.06, "{x}: {found}, not {share}");
        }
    }
    // Only the scene shows; and what does not move, or is not to, is at rest, to the bit.
    let tiles = RenderSettings { tile_size: 3, batch_samples: 100, ..settings };
    assert_eq!(render(&instances, &tiles, 2).film.pixels(), blurred.film.pixels());
    let off = RenderSettings { switched_off: EffectSet::EMPTY.with(Effect::MotionBlur), ..settings };
    assert_eq!(render(&instances, &off, 1).film.pixels(), rest.film.pixels());
    let forced = RenderSettings { forced: EffectSet::ALL, ..settings };
    assert_eq!(render(&instances, &forced, 1).film.pixels(), blurred.film.pixels());
    instances.move_while_open(&[(0, at(0.0))]).unwrap();
    assert_eq!(render(&instances, &settings, 1).film.pixels(), rest.film.pixels());
}

/// Glass, rough metal, lamps of all kinds, nested bodies and shadows through glass, all moving together with the camera: as if all were at
/// rest.
#[test]
fn rays_of_every_kind_have_the_time_of_their_sample() {
    let sources: Vec<_> = models().iter().map(|mesh| source(mesh, 16 << 10)).collect();
    let budget = MemoryBudget::new(Bytes::mib(128));
    let mut instances = Instances::open(&sources, places(), &budget, &OctreeOptions::default()).unwrap();
    // Lamps far away light the same wherever the scene moves.
    let view =
        |x: f64| Camera::pinhole([1.0 + x, -9.0, 4.0], [x, 0.0, -0.25], [0.0, 0.0, 1.0], 40.0).unwrap();
    let scene = |camera| {
        Scene::new(camera)
            .with_light(Light::directional([0.5, 0.4, -1.0], [0.8; 3]))
            .with_environment(Environment::Constant([0.3, 0.4, 0.5]))
            .with_finish("brass", Finish::rough(0.2))
            .with_finish("glass", Finish::nested(1))
    };
    let settings =
        RenderSettings { samples_per_pixel: 4, contribution_bound: 1e-3, ..RenderSettings::new(48, 32) };
    let render = |instances: &Instances, scene: &Scene| {
        let renderer = Renderer::over_instances(instances, scene, &settings, &budget).unwrap();
        renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap()
    };
    let rest = render(&instances, &scene(view(0.0)));
    // By a power of two, so that hardly anything rounds otherwise.
    let ends: Vec<(usize, Affine)> = places()
        .iter()
        .enumerate()
        .map(|(number, place)| (number, place.map.then(&Affine::translation([64.0, 0.0, 0.0]))))
        .collect();
    instances.move_while_open(&ends).unwrap();
    let moving = render(&instances, &scene(view(0.0).moving_to(&view(64.0)).unwrap()));
    let effects = &moving.report.effects;
    assert!(effects.shutter_rays == effects.samples && effects.transmission_rays > 500, "{effects:?}");
    // Rounding sends a ray past an edge here and there; a ray of another time would miss everything.
    let far = |a: &[f32; 3], b: &[f32; 3]| (0..3).any(|channel| (a[channel] - b[channel]).abs() > 0.01);
    let differing = rest.film.pixels().iter().zip(moving.film.pixels()).filter(|(a, b)| far(a, b)).count();
    assert!(differing < 30, "{differing} of {}", rest.film.pixels().len());
}

#[test]
fn layers_name_instances() {
    let sources: Vec<_> = models().iter().map(|mesh| source(mesh, 16 << 10)).collect();
    let budget = MemoryBudget::new(Bytes::mib(128));
    let instances = Instances::open(&sources, places(), &budget, &OctreeOptions::default()).unwrap();
    let renderer = Renderer::over_instances(&instances, &scene(), &settings(), &budget).unwrap();
    let layers = renderer.layers(&mut |_| Control::Continue).unwrap();
    let mut seen = vec![0; places().len()];
    for pixel in layers.pixels().iter().flatten() {
        let InstanceTriangle { instance, triangle } = InstanceTriangle::of(pixel.triangle);
        let placed = &instances.instances()[instance as usize];
        assert!(triangle < TriangleId(sources[placed.model as usize].model().triangle_count));
        assert_eq!(pixel.material.0, instances.first_material(placed.model));
        seen[instance as usize] += 1;
    }
    // Of the two in one place the first is seen.
    assert_eq!(seen[8], 0);
    assert!(seen[..8].iter().all(|count| *count > 5), "{seen:?}");
}

/// A sheet whose normals at the corners lean over; as text, so that they are stored as any file's.
#[test]
fn normals_turn_with_their_instance() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sheet.obj");
    // Four triangles around the middle: turned by a right angle or mirrored, the sheet is the same set of triangles.
    let text = "v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nv 0 0 0\nvn -1 -1 2\nvn 1 -1 2\nvn 1 1 2\nvn -1 1 2\nvn 0 0 1\n\
        f 1//1 2//2 5//5\nf 2//2 3//3 5//5\nf 3//3 4//4 5//5\nf 4//4 1//1 5//5\n";
    std::fs::write(&path, text).unwrap();
    let compiled = folder.path().join("sheet.outcrop");
    let budget = MemoryBudget::new(Bytes::mib(64));
    compile_file(&path, &compiled, &CompileOptions::default(), &budget, &mut |_| Control::Continue).unwrap();
    let source: Arc<dyn BlockSource> = Arc::new(DiskSource::open(&compiled).unwrap());
    let settings = RenderSettings::new(24, 24);
    // The same sheet, camera and lamp, as they are and as a whole turned and scaled.
    let maps = [
        (Affine::IDENTITY, Affine::IDENTITY),
        (Affine::scale([-1.0, 1.0, 1.0]), Affine::IDENTITY),
        (Affine::rotation([0.0, 0.0, 1.0], 90.0), Affine::IDENTITY),
        (
            Affine::rotation([1.0, 2.0, 3.0], 50.0).then(&Affine::scale([3.0; 3])),
            Affine::rotation([1.0, 2.0, 3.0], 50.0).then(&Affine::scale([3.0; 3])),
        ),
    ];
    let mut pictures = Vec::new();
    for (map, world) in maps {
        let instances = Instances::open(
            &[Arc::clone(&source)],
            vec![Instance { model: 0, map }],
            &budget,
            &OctreeOptions::default(),
        )
        .unwrap();
        let up = world.point([0.0, 1.0, 0.0]);
        let eye = world.point([0.0, 0.0, 4.0]);
        let camera = Camera::pinhole(eye, world.point([0.0; 3]), up, 40.0).unwrap();
        let scene = Scene::new(camera).with_light(Light::point(world.point([0.0, 0.0, 2.0]), [1.0; 3]));
        let renderer = Renderer::over_instances(&instances, &scene, &settings, &budget).unwrap();
        let image = renderer.render(&Threads::One, &mut |_| Control::Continue).unwrap();
        assert!(image.report.effects.smooth_hits > 100);
        pictures.push(image.film.pixels().to_vec());
    }
    for picture in &pictures[1..] {
        for (found, expected) in picture.iter().flatten().zip(pictures[0].iter().flatten()) {
            assert!((found - expected).abs() < 1e-4, "{found} {expected}");
        }
    }
    // Flat shading would be another picture: brightest where the lamp is nearest, without the lean.
    let octree = LazyOctree::open(source, &budget, OctreeOptions::default()).unwrap();
    let camera = Camera::pinhole([0.0, 0.0, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 40.0).unwrap();
    let scene = Scene::new(camera).with_light(Light::point([0.0, 0.0, 2.0], [1.0; 3]));
    let plain = Renderer::new(&octree, &scene, &settings, &budget).unwrap();
    let plain = plain.render(&Threads::One, &mut |_| Control::Continue).unwrap();
    for (found, expected) in pictures[0].iter().flatten().zip(plain.film.pixels().iter().flatten()) {
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    }
}
