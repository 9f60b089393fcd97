//! Every effect: absent at no cost, present to effect, and the same picture however much is forced.

use super::*;
use crate::model::{ImageMap, MaterialImages};
use crate::render::EffectCounters;
use crate::scene::{Effect, EffectSet, Environment, EnvironmentImage, Finish, Lens, Light, LightShape};
use crate::texture::{Encoding, ImageKey, PixelImage, Textures};

/// A room with something of each kind, described by one material per body.
pub(super) struct Case {
    pub effect: Effect,
    pub mesh: Mesh,
    pub scene: Scene,
    pub settings: RenderSettings,
}

fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 2, work_budget: 64, ..RenderSettings::new(14, 11) }
}

fn camera() -> Camera {
    Camera::pinhole([1.0, 1.5, 6.0], [0.0; 3], [0.0, 1.0, 0.0], 35.0).unwrap()
}

fn named(name: &str, record: MaterialRecord) -> MaterialRecord {
    MaterialRecord { name: name.to_string(), ..record }
}

/// Three boxes on a ground, of these materials.
fn boxes(materials: [MaterialRecord; 4]) -> Mesh {
    Mesh::new(materials)
        .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
        .cuboid(1, [-1.5, -1.0, -2.0], [-0.5, 1.0, -1.0])
        .cuboid(2, [-0.3, -0.8, -0.5], [0.6, 0.4, 0.5])
        .cuboid(3, [0.3, -0.5, -1.0], [1.6, 0.8, 0.3])
}

fn bricks() -> Mesh {
    boxes([0.2, 0.4, 0.6, 0.8].map(matt))
}

fn sunny() -> Scene {
    Scene::new(camera())
        .with_background([0.3, 0.4, 0.6])
        .with_ambient([0.05; 3])
        .with_light(Light::directional([0.3, -1.0, -0.4], [0.5, 0.45, 0.4]))
}

/// A chequer of 8 x 8 squares on 64 x 64 texels; a disc of which the rest is not there; waves, as heights and as normals.
pub(super) fn pictures() -> Arc<Textures> {
    let image = |texel: &dyn Fn(u32, u32) -> [u8; 4]| PixelImage {
        width: 64,
        height: 64,
        texels: (0..64 * 64).map(|index| texel(index % 64, index / 64)).collect(),
    };
    let key = |name: &str, encoding| ImageKey { path: name.into(), encoding };
    let chequer = |x: u32, y: u32| {
        if (x / 8 + y / 8).is_multiple_of(2) { [240, 200, 60, 255] } else { [20, 60, 160, 255] }
    };
    let is_in = |x: u32, y: u32| (x as i32 - 32).pow(2) + (y as i32 - 32).pow(2) < 26 * 26;
    let disc = |x, y| if is_in(x, y) { [60, 160, 40, 255] } else { [255, 0, 255, 0] };
    let wave = |x: u32| (127.5 + 127.5 * (f64::from(x) / 64.0 * std::f64::consts::TAU * 3.0).sin()) as u8;
    Textures::in_memory([
        (key("chequer", Encoding::Srgb), image(&chequer)),
        (key("disc", Encoding::Srgb), image(&disc)),
        (key("mask", Encoding::Linear), image(&|x, y| [if is_in(x, y) { 255 } else { 0 }; 4])),
        (key("waves", Encoding::Linear), image(&|x, _| [wave(x), wave(x), wave(x), 255])),
        (key("dents", Encoding::Linear), image(&|x, y| [wave(x), wave(y), 230, 255])),
        // From smooth to rough, and metal where the waves are high.
        (key("finish", Encoding::Linear), image(&|x, y| [0, 4 * y as u8, wave(x), 255])),
    ])
    .unwrap()
}

pub(super) fn with_images(record: MaterialRecord, images: MaterialImages) -> MaterialRecord {
    MaterialRecord { images: Some(Box::new(images)), ..record }
}

/// With a picture of roughness and metalness.
pub(super) fn finished(record: MaterialRecord, images: MaterialImages) -> MaterialRecord {
    let map = || Some(ImageMap::new("finish"));
    with_images(record, MaterialImages { roughness: map(), metalness: map(), ..images })
}

/// Metal, or what pictures make of it.
pub(super) fn metal(reflectance: f32) -> MaterialRecord {
    MaterialRecord {
        metalness: 1.0,
        roughness: 1.0,
        specular: [0.04; 3],
        exponent_by_roughness: true,
        ..matt(reflectance)
    }
}

/// A ground and two upright cards of these materials, all with texture coordinates.
fn cards(materials: [MaterialRecord; 3]) -> Mesh {
    Mesh::new(materials)
        .card(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0], 6.0)
        .card(1, [-1.5, -1.0, -0.5], [2.0, 0.0, 0.3], [0.0, 2.0, 0.0], 1.0)
        .card(2, [-0.5, -1.0, 0.5], [2.0, 0.0, -0.3], [0.0, 2.0, 0.0], 2.0)
}

/// Two coarse spheres on a ground, the first with normals.
fn spheres([first, second]: [MaterialRecord; 2]) -> Mesh {
    Mesh::new([matt(0.5), first, second])
        .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
        .sphere(1, [-0.7, 0.0, 0.0], 0.8, 1, true)
        .sphere(2, [0.9, 0.0, -0.3], 0.8, 1, true)
}

fn glowing(emission: [f32; 3]) -> MaterialRecord {
    MaterialRecord { emission, ..matt(0.2) }
}

pub(super) fn panel() -> Light {
    let shape =
        LightShape::Rectangle { corner: [-1.0, 3.0, -1.0], edges: [[2.0, 0.0, 0.0], [0.0, 0.0, 2.0]] };
    Light::area(shape, [2.0, 1.8, 1.5])
}

/// A sky with a small sun.
fn sky() -> Environment {
    let pixels = (0..32 * 16).map(|index| match (index % 32, index / 32) {
        (10, 3) => [60.0, 55.0, 50.0],
        (_, 0..8) => [0.4, 0.5, 0.7],
        _ => [0.1, 0.08, 0.05],
    });
    let budget = MemoryBudget::new(Bytes::mib(1));
    Environment::image(Arc::new(EnvironmentImage::new(32, 16, pixels.collect(), &budget).unwrap()))
}

/// One scene for each effect, and the still life of today's effects.
pub(super) fn cases() -> Vec<Case> {
    let glass = || named("glass", clear(1.5));
    let chrome = || named("chrome", mirror(0.8));
    let smoke = MaterialRecord { transmission: [0.9, 0.6, 0.4], ..clear(1.2) };
    let lens = Lens { radius: 0.2, focus_distance: 5.0 };
    let end = Camera::pinhole([1.3, 1.5, 6.0], [0.2, 0.0, 0.0], [0.0, 1.0, 0.0], 35.0).unwrap();
    let case = |effect, mesh, scene| Case { effect, mesh, scene, settings: settings() };
    let diffuse =
        |name: &str| MaterialImages { diffuse: Some(ImageMap::new(name)), ..MaterialImages::default() };
    let mask = || MaterialImages { opacity: Some(ImageMap::new("mask")), ..MaterialImages::default() };
    let waves = || MaterialImages { bump: Some(ImageMap::new("waves")), ..MaterialImages::default() };
    let dents = || MaterialImages { normal: Some(ImageMap::new("dents")), ..MaterialImages::default() };
    let shiny = || MaterialRecord { specular: [0.5; 3], shininess: 20.0, mirror: true, ..matt(0.4) };
    let specular = || MaterialImages { specular: Some(ImageMap::new("chequer")), ..diffuse("chequer") };
    let glow = || MaterialImages { emission: Some(ImageMap::new("chequer")), ..MaterialImages::default() };
    let paint = || MaterialRecord { metalness: 0.0, ..metal(0.5) };
    let pane = || MaterialRecord { opacity: 0.25, refractive_index: 1.4, ..metal(0.6) };
    vec![
        case(
            Effect::FinishMaps,
            cards([
                finished(metal(0.8), MaterialImages::default()),
                finished(paint(), MaterialImages::default()),
                finished(MaterialRecord { metalness: 0.5, ..shiny() }, diffuse("disc")),
            ]),
            sunny().with_textures(pictures()),
        ),
        case(
            Effect::FinishMaps,
            cards([
                finished(metal(0.8), diffuse("chequer")),
                finished(pane(), MaterialImages::default()),
                finished(MaterialRecord { metalness: 0.0, ..pane() }, dents()),
            ]),
            sunny()
                .with_light(panel())
                .with_environment(sky())
                .with_interreflection()
                .with_textures(pictures()),
        ),
        case(
            Effect::Textures,
            cards([with_images(glowing([0.9, 0.6, 0.2]), glow()), matt(0.5), mirror(0.5)]),
            sunny().with_textures(pictures()),
        ),
        case(
            Effect::Textures,
            cards([with_images(matt(0.8), diffuse("chequer")), matt(0.5), with_images(shiny(), specular())]),
            sunny().with_textures(pictures()),
        ),
        case(
            Effect::Textures,
            cards([with_images(matt(0.8), diffuse("chequer")), glass(), chrome()]),
            sunny()
                .with_light(panel())
                .with_environment(sky())
                .with_interreflection()
                .with_finish("chrome", Finish::rough(0.4))
                .with_textures(pictures()),
        ),
        case(
            Effect::AlphaCutouts,
            cards([matt(0.5), with_images(matt(0.8), diffuse("disc")), with_images(mirror(0.7), mask())]),
            sunny().with_textures(pictures()),
        ),
        case(
            Effect::AlphaCutouts,
            cards([matt(0.5), with_images(clear(1.0), mask()), with_images(clear(1.4), mask())]),
            sunny().with_light(panel()).with_interreflection().with_textures(pictures()),
        ),
        case(
            Effect::BumpMaps,
            cards([
                with_images(matt(0.8), waves()),
                with_images(shiny(), dents()),
                with_images(clear(1.5), waves()),
            ]),
            sunny().with_light(panel()).with_textures(pictures()),
        ),
        case(Effect::Emission, boxes([matt(0.5), glowing([0.9, 0.6, 0.2]), matt(0.4), matt(0.3)]), sunny()),
        case(
            Effect::Emission,
            boxes([matt(0.5), chrome(), glowing([2.0, 0.5, 0.5]), glass()]),
            sunny().with_interreflection(),
        ),
        case(Effect::DirectLight, bricks(), sunny()),
        case(Effect::Shadows, bricks(), sunny()),
        case(Effect::AreaLight, bricks(), Scene::new(camera()).with_light(panel())),
        case(
            Effect::AreaLight,
            boxes([matt(0.5), glass(), chrome(), matt(0.2)]),
            sunny().with_light(panel()),
        ),
        case(Effect::EnvironmentLight, bricks(), Scene::new(camera()).with_environment(sky())),
        case(
            Effect::EnvironmentLight,
            bricks(),
            Scene::new(camera()).with_environment(Environment::Constant([0.5, 0.6, 0.7])),
        ),
        case(Effect::Reflection, boxes([matt(0.5), chrome(), matt(0.3), mirror(0.4)]), sunny()),
        case(
            Effect::GlossyReflection,
            boxes([matt(0.5), chrome(), matt(0.3), mirror(0.4)]),
            sunny().with_light(panel()).with_finish("chrome", Finish::rough(0.5)),
        ),
        case(Effect::Transmission, boxes([matt(0.5), glass(), clear(1.0), matt(0.3)]), sunny()),
        case(
            Effect::RoughRefraction,
            boxes([matt(0.5), matt(0.4), glass(), matt(0.3)]),
            sunny().with_light(panel()).with_finish("glass", Finish::rough(0.4)),
        ),
        case(Effect::Absorption, boxes([matt(0.5), smoke.clone(), matt(0.2), smoke.clone()]), sunny()),
        case(
            Effect::NestedMedia,
            boxes([matt(0.5), matt(0.4), glass(), named("water", smoke)]),
            sunny().with_finish("glass", Finish::nested(2)).with_finish("water", Finish::nested(1)),
        ),
        case(Effect::Interreflection, bricks(), sunny().with_interreflection()),
        case(
            Effect::Interreflection,
            boxes([matt(0.5), chrome(), glass(), matt(0.7)]),
            sunny().with_light(panel()).with_environment(sky()).with_interreflection(),
        ),
        case(Effect::DepthOfField, bricks(), sunny().with_camera(camera().with_lens(lens).unwrap())),
        case(Effect::MotionBlur, bricks(), sunny().with_camera(camera().moving_to(&end).unwrap())),
        Case {
            settings: RenderSettings { samples_per_pixel: 4, ..settings() },
            ..case(Effect::Antialiasing, bricks(), sunny())
        },
        case(Effect::SmoothNormals, spheres([matt(0.6), matt(0.4)]), sunny()),
        case(
            Effect::SmoothNormals,
            spheres([chrome(), glass()]),
            sunny().with_light(panel()).with_environment(sky()).with_interreflection(),
        ),
    ]
}

/// What an effect did; none for those without work of their own.
fn work_of(effect: Effect, counters: &EffectCounters) -> Option<u64> {
    Some(match effect {
        Effect::DirectLight | Effect::Antialiasing => return None,
        Effect::Shadows => counters.shadow_rays + counters.shadow_segments,
        Effect::AreaLight => counters.area_light_samples + counters.light_crossings,
        Effect::EnvironmentLight => counters.environment_samples,
        Effect::Reflection => counters.reflection_rays,
        Effect::GlossyReflection => counters.glossy_rays,
        Effect::Transmission => counters.transmission_rays,
        Effect::RoughRefraction => counters.frosted_rays,
        Effect::Absorption => counters.absorbed_segments,
        Effect::NestedMedia => counters.medium_rays + counters.passed_surfaces + counters.medium_overflows,
        Effect::Interreflection => counters.bounce_rays,
        Effect::DepthOfField => counters.lens_rays,
        Effect::MotionBlur => counters.shutter_rays,
        Effect::SmoothNormals => counters.smooth_hits,
        Effect::Textures => counters.texture_reads,
        Effect::AlphaCutouts => counters.cutout_tests + counters.cutouts_passed + counters.cutout_rays,
        Effect::BumpMaps => counters.bump_reads,
        Effect::Emission => counters.glowing_hits,
        Effect::FinishMaps => counters.finish_reads,
    })
}

/// Whether the effect draws random numbers.
fn is_sampled(effect: Effect) -> bool {
    use Effect::*;
    matches!(
        effect,
        AreaLight
            | EnvironmentLight
            | GlossyReflection
            | RoughRefraction
            | Interreflection
            | DepthOfField
            | MotionBlur
    )
}

#[test]
fn every_effect_has_a_scene() {
    let covered: EffectSet = cases().iter().map(|case| case.effect).collect();
    assert_eq!(covered, EffectSet::ALL);
}

#[test]
fn an_effect_works_only_in_scenes_that_call_for_it() {
    for case in cases() {
        let plan = case.mesh.plan(&case.scene, &case.settings);
        assert!(plan.has(case.effect), "{}", plan.explain());
        let counters = render(&case.mesh, &case.scene, &case.settings).totals.effects;
        for effect in Effect::ALL {
            let Some(work) = work_of(effect, &counters) else { continue };
            let context = format!("{effect:?} in the scene of {:?}: {counters:?}", case.effect);
            assert!(plan.has(effect) || work == 0, "{context}");
            assert!(effect != case.effect || work > 0, "{context}");
        }
        let draws = Effect::ALL.into_iter().any(|effect| is_sampled(effect) && plan.has(effect));
        assert_eq!(counters.random_numbers > 0, draws, "{:?}: {counters:?}", case.effect);
        // Each number belongs to an effect of the plan.
        let mut numbers = counters.roulette_numbers;
        for effect in Effect::ALL {
            let drawn = counters.numbers_of(effect);
            let draws = plan.has(effect) && is_sampled(effect);
            assert!(draws || drawn == 0, "{effect:?} in the scene of {:?}: {counters:?}", case.effect);
            assert!(!draws || effect != case.effect || drawn > 0, "{:?}: {counters:?}", case.effect);
            numbers += drawn;
        }
        assert_eq!(counters.random_numbers, numbers, "{:?}: {counters:?}", case.effect);
        assert_eq!(counters.roulette_numbers, 0, "nothing ends by roulette here");
        let forced = (counters.forced_rays, counters.forced_lookups);
        assert_eq!((forced, counters.medium_overflows), ((0, 0), 0));
        let details = [
            Effect::SmoothNormals,
            Effect::Textures,
            Effect::AlphaCutouts,
            Effect::BumpMaps,
            Effect::FinishMaps,
        ];
        let needs_attributes = details.into_iter().any(|effect| plan.has(effect));
        assert_eq!(counters.attribute_lookups > 0, needs_attributes, "{:?}: {counters:?}", case.effect);
    }
}

#[test]
fn leaving_an_effect_out_changes_the_picture_and_stops_its_work() {
    for case in cases() {
        let with = render(&case.mesh, &case.scene, &case.settings);
        let mut settings = case.settings;
        settings.switched_off = settings.switched_off.with(case.effect);
        if case.effect == Effect::Antialiasing {
            settings.samples_per_pixel = 1;
        }
        let without = render(&case.mesh, &case.scene, &settings);
        assert!(with.film.pixels() != without.film.pixels(), "{:?}", case.effect);
        assert!(
            work_of(case.effect, &without.totals.effects).is_none_or(|work| work == 0),
            "{:?}",
            case.effect
        );
    }
}

#[test]
fn forcing_every_effect_changes_no_bit_of_any_scene() {
    for case in cases() {
        let planned = render(&case.mesh, &case.scene, &case.settings);
        let forced =
            render(&case.mesh, &case.scene, &RenderSettings { forced: EffectSet::ALL, ..case.settings });
        assert!(planned.film.pixels() == forced.film.pixels(), "{:?}", case.effect);
        assert!(forced.totals.effects.forced_rays > 0);
        // And one by one.
        for effect in Effect::ALL {
            let settings = RenderSettings { forced: EffectSet::EMPTY.with(effect), ..case.settings };
            let forced = render(&case.mesh, &case.scene, &settings);
            assert!(planned.film.pixels() == forced.film.pixels(), "{effect:?} in {:?}", case.effect);
        }
    }
}

/// What is forced is done, not skipped: in a scene that calls for none of them, each effect of surfaces reads attributes and pictures at
/// every hit as it would where it counts, and lamps that are not there are asked.
#[test]
fn forced_effects_do_their_work() {
    let (mesh, scene) = (bricks(), sunny());
    let forced = |scene: &Scene, effect| {
        let settings = RenderSettings { forced: EffectSet::EMPTY.with(effect), ..settings() };
        render(&mesh, scene, &settings).totals.effects
    };
    let plain = render(&mesh, &scene, &settings()).totals.effects;
    // Attributes, and nothing else.
    let hits = forced(&scene, Effect::SmoothNormals).forced_lookups;
    assert!(hits > 150, "{hits}");
    // And a texel; and four of heights.
    assert_eq!(forced(&scene, Effect::Textures).forced_lookups, 2 * hits);
    assert_eq!(forced(&scene, Effect::FinishMaps).forced_lookups, 2 * hits);
    assert_eq!(forced(&scene, Effect::BumpMaps).forced_lookups, 5 * hits);
    // At hits of camera rays, and of the shadow rays that are blocked.
    let cut_outs = forced(&scene, Effect::AlphaCutouts);
    assert!(cut_outs.forced_lookups > 2 * hits && cut_outs.forced_rays > 0, "{cut_outs:?}");
    for effect in
        [Effect::SmoothNormals, Effect::Textures, Effect::BumpMaps, Effect::AlphaCutouts, Effect::FinishMaps]
    {
        let counters = forced(&scene, effect);
        let undone = EffectCounters { forced_lookups: 0, forced_rays: 0, ..counters };
        assert_eq!(undone, plain, "{effect:?} is counted as forced only");
    }
    // With pictures at hand, of which no material makes use, it is these that are read.
    let pictured = scene.clone().with_textures(pictures());
    assert_eq!(forced(&pictured, Effect::Textures).forced_lookups, 2 * hits);
    let dim = Scene::new(camera()).with_ambient([0.3; 3]);
    assert_eq!(render(&mesh, &dim, &settings()).totals.effects.shadow_rays, 0);
    assert_eq!(forced(&dim, Effect::DirectLight).shadow_rays, 0);
    assert_eq!(forced(&dim, Effect::Shadows).shadow_rays, hits);
}

#[test]
fn tiles_batches_and_threads_do_not_show_in_sampled_effects() {
    for case in cases() {
        let reference = render(&case.mesh, &case.scene, &case.settings);
        for (tile_size, batch_samples, threads) in
            [(4, 1024, Threads::One), (64, 3, Threads::One), (8, 17, Threads::Count(2))]
        {
            let varied = RenderSettings { tile_size, batch_samples, ..case.settings };
            let picture = render_until(&case.mesh, &case.scene, &varied, &threads, u64::MAX, &mut |_| {
                Control::Continue
            })
            .unwrap();
            assert!(picture.film.pixels() == reference.film.pixels(), "{:?} {tile_size}", case.effect);
            assert_eq!(picture.totals.effects, reference.totals.effects, "{:?}", case.effect);
        }
    }
}

#[test]
fn the_seed_shows_exactly_where_luck_has_a_part() {
    for case in cases() {
        let settings = RenderSettings { samples_per_pixel: 1, ..case.settings };
        let plan = case.mesh.plan(&case.scene, &settings);
        let draws = Effect::ALL.into_iter().any(|effect| is_sampled(effect) && plan.has(effect));
        let [a, b] = [1, 2].map(|seed| {
            let film = render(&case.mesh, &case.scene, &RenderSettings { seed, ..settings }).film;
            film.pixels().to_vec()
        });
        assert_eq!(a != b, draws, "{:?}", case.effect);
    }
}
