//! What must not show in the picture (I2), and how renders end.

use super::*;
use crate::render::{Filter, Progress};
use crate::scene::{Effect, EffectSet, Light};

/// A bit of everything: matt ground, mirror, glass, a veil; a point light and a sun.
pub(super) fn still_life() -> (Mesh, Scene) {
    let veil = MaterialRecord { opacity: 0.4, transmission: [0.9, 0.6, 0.8], ..matt(0.6) };
    let glass = MaterialRecord { specular: [0.3; 3], shininess: 33.3, ..clear(1.5) };
    let mesh = Mesh::new([matt(0.7), mirror(0.8), glass, veil])
        .sheet(0, [-5.0, -1.0, -5.0], [0.0, 0.0, 10.0], [10.0, 0.0, 0.0])
        .cuboid(1, [-1.5, -1.0, -2.0], [-0.5, 1.0, -1.0])
        .cuboid(2, [-0.3, -0.8, -0.5], [0.6, 0.4, 0.5])
        .cuboid(3, [0.8, -0.9, -1.0], [1.6, 0.8, 0.4]);
    let camera = Camera::pinhole([1.0, 1.5, 6.0], [0.0; 3], [0.0, 1.0, 0.0], 35.0).unwrap();
    let scene = Scene::new(camera)
        .with_background([0.3, 0.4, 0.6])
        .with_ambient([0.05; 3])
        .with_light(Light::point([3.0, 4.0, 2.0], [0.7; 3]))
        .with_light(Light::directional([0.3, -1.0, -0.4], [0.5, 0.45, 0.4]));
    (mesh, scene)
}

pub(super) fn settings() -> RenderSettings {
    RenderSettings { samples_per_pixel: 3, work_budget: 60, ..RenderSettings::new(37, 29) }
}

#[test]
fn tiles_batches_and_threads_do_not_show() {
    let (mesh, scene) = still_life();
    let reference = render(&mesh, &scene, &settings());
    assert!(reference.totals.effects.shadow_segments > 0 && reference.totals.effects.work_cuts > 0);
    let pool = Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap());
    for (tile_size, batch_samples, threads) in [
        (8, 1024, Threads::One),
        (64, 7, Threads::One),
        (16, 1, Threads::Count(2)),
        (8, 64, Threads::Count(3)),
        (32, 100, Threads::Pool(Arc::clone(&pool))),
        (4096, 1 << 16, Threads::One),
    ] {
        let varied = RenderSettings { tile_size, batch_samples, ..settings() };
        let picture =
            render_until(&mesh, &scene, &varied, &threads, u64::MAX, &mut |_| Control::Continue).unwrap();
        assert!(picture.film.pixels() == reference.film.pixels(), "{tile_size} {batch_samples} {threads:?}");
        assert_eq!(picture.totals.effects, reference.totals.effects);
        assert_eq!(picture.totals.trace, reference.totals.trace);
        assert_eq!(picture.totals.tiles as usize, varied.grid().tile_count());
    }
}

#[test]
fn samples_filter_and_seed_do_show() {
    let (mesh, scene) = still_life();
    let reference = render(&mesh, &scene, &settings());
    for other in [
        RenderSettings { seed: 1, ..settings() },
        RenderSettings { filter: Filter::Box, ..settings() },
        RenderSettings { samples_per_pixel: 2, ..settings() },
    ] {
        assert!(render(&mesh, &scene, &other).film.pixels() != reference.film.pixels());
    }
}

#[test]
fn forcing_every_effect_changes_no_bit() {
    let (everything, lit) = still_life();
    let (_, scene) = still_life();
    let dark = Scene::new(*scene.camera()).with_background([0.3, 0.4, 0.6]).with_ambient([0.4; 3]);
    let with = |materials: [MaterialRecord; 4]| Mesh { materials: materials.to_vec(), ..everything.clone() };
    let bricks = with([matt(0.2), matt(0.4), matt(0.6), matt(0.8)]);
    let mirrors = with([matt(0.2), mirror(0.4), mirror(0.6), matt(0.8)]);
    let veils = with([matt(0.2), clear(1.0), matt(0.6), clear(1.0)]);
    for (name, mesh, scene) in [
        ("everything", &everything, &lit),
        ("everything, dark", &everything, &dark),
        ("bricks", &bricks, &lit),
        ("bricks, dark", &bricks, &dark),
        ("mirrors", &mirrors, &lit),
        ("veils", &veils, &lit),
    ] {
        for samples_per_pixel in [1, 2] {
            let planned = RenderSettings { samples_per_pixel, ..settings() };
            let forced = RenderSettings { forced: EffectSet::ALL, ..planned };
            let (planned, forced) = (render(mesh, scene, &planned), render(mesh, scene, &forced));
            assert!(planned.film.pixels() == forced.film.pixels(), "{name}");
            assert_eq!(planned.totals.effects.forced_rays, 0);
            assert!(forced.totals.effects.forced_rays > 0, "{name}");
            let [a, b] = [planned, forced].map(|picture| picture.totals.effects);
            assert_eq!((a.reflection_rays, a.transmission_rays), (b.reflection_rays, b.transmission_rays));
        }
    }
}

#[test]
fn effects_that_the_scene_does_not_call_for_make_no_ray() {
    let (everything, scene) = still_life();
    let bricks = Mesh { materials: vec![matt(0.5); 4], ..everything };
    let effects = render(&bricks, &scene, &settings()).totals.effects;
    assert_eq!(
        (effects.reflection_rays, effects.transmission_rays, effects.shadow_segments, effects.forced_rays),
        (0, 0, 0, 0)
    );
    assert!(effects.shadow_rays > 0);
    // Switching effects off makes the same of the scene that has them all.
    let (everything, scene) = still_life();
    let off = Effect::ALL.into_iter().collect();
    let settings = RenderSettings { switched_off: off, ..settings() };
    let effects = render(&everything, &scene, &settings).totals.effects;
    assert_eq!(effects.rays(), effects.primary_rays);
}

#[test]
fn a_cancelled_render_keeps_what_is_finished() {
    let (mesh, scene) = still_life();
    let whole = render(&mesh, &scene, &settings());
    let settings = RenderSettings { tile_size: 8, ..settings() };
    for threads in [Threads::One, Threads::Count(2)] {
        let mut last = None;
        let picture =
            render_until(&mesh, &scene, &settings, &threads, u64::MAX, &mut |progress: Progress| {
                assert!(progress.tiles <= progress.tiles_total && progress.samples <= progress.samples_total);
                last = Some(progress);
                if progress.tiles >= 5 { Control::Cancel } else { Control::Continue }
            })
            .unwrap();
        assert!(last.unwrap().tiles >= 5);
        assert!(picture.totals.is_cancelled && !picture.film.is_complete());
        let mut finished = 0;
        for y in 0..picture.film.height() {
            for x in 0..picture.film.width() {
                let expected = if picture.film.is_finished(x, y) { whole.film.pixel(x, y) } else { [0.0; 3] };
                assert_eq!(picture.film.pixel(x, y), expected);
                finished += u64::from(picture.film.is_finished(x, y));
            }
        }
        assert!((3 * 64..37 * 29).contains(&finished));
    }
}

#[test]
fn an_error_in_mid_render_ends_it() {
    let (mesh, scene) = still_life();
    for threads in [Threads::One, Threads::Count(2)] {
        for rays_left in [0, 1000, 5000] {
            let error =
                render_until(&mesh, &scene, &settings(), &threads, rays_left, &mut |_| Control::Continue)
                    .map(|_| ())
                    .unwrap_err();
            assert!(matches!(error, RenderError::Trace(TraceError::Load(_))), "{error}");
        }
    }
}

#[test]
fn a_small_budget_is_an_error_and_senseless_settings_are_too() {
    let (mesh, scene) = still_life();
    let plan = EffectPlan::of_materials(&scene, &mesh.materials, &settings().effect_options());
    let stage = Stage::new(&scene, &mesh.materials, &plan, &settings());
    let mesh = Arc::new(mesh);
    let naive = || Ok(Naive { mesh: mesh.clone(), counters: TraceCounters::default(), rays_left: u64::MAX });
    let budget = MemoryBudget::new(Bytes::kib(64));
    let result = picture(&stage, &Threads::One, &budget, &naive, &|_| None, &mut |_| Control::Continue);
    assert!(matches!(result.map(|_| ()), Err(RenderError::Budget(_))));
    assert_eq!(budget.used(), Bytes(0));

    for bad in [
        RenderSettings { width: 0, ..settings() },
        RenderSettings { width: 1 << 20, height: 1 << 20, ..settings() },
        RenderSettings { samples_per_pixel: 0, ..settings() },
        RenderSettings { contribution_bound: f64::NAN, ..settings() },
        RenderSettings { work_budget: 0, ..settings() },
        RenderSettings { tile_size: 0, ..settings() },
        RenderSettings { batch_samples: 0, ..settings() },
    ] {
        assert!(matches!(bad.validate(), Err(RenderError::Setting { .. })), "{bad:?}");
    }
}
