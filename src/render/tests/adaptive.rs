//! Adaptive sampling: still one image (I2), and its statistics hold.

use super::invariance::{settings, still_life};
use super::*;
use crate::render::AdaptiveSampling;

fn adaptive() -> RenderSettings {
    RenderSettings {
        samples_per_pixel: 64,
        adaptive: Some(AdaptiveSampling { samples_min: 4, error: 0.05, confidence: 0.95 }),
        keep_statistics: true,
        work_budget: 1 << 14,
        ..settings()
    }
}

#[test]
fn tiles_batches_threads_and_statistics_do_not_show() {
    let (mesh, scene) = still_life();
    let reference = render(&mesh, &scene, &adaptive());
    let counts: Vec<u32> = reference.film.statistics().unwrap().iter().map(|pixel| pixel.samples).collect();
    for samples in [4, 16, 64] {
        assert!(counts.contains(&samples), "no pixel has {samples} samples: {counts:?}");
    }
    for (tile_size, batch_samples, threads) in [
        (8, 1024, Threads::One),
        (64, 7, Threads::One),
        (16, 1, Threads::Count(2)),
        (1, 64, Threads::Count(3)),
        (4096, 1 << 12, Threads::One),
    ] {
        let varied = RenderSettings { tile_size, batch_samples, ..adaptive() };
        let picture =
            render_until(&mesh, &scene, &varied, &threads, u64::MAX, &mut |_| Control::Continue).unwrap();
        assert!(picture.film.pixels() == reference.film.pixels(), "{tile_size} {batch_samples} {threads:?}");
        assert!(picture.film.statistics() == reference.film.statistics(), "{tile_size} {batch_samples}");
    }
    let without = render(&mesh, &scene, &RenderSettings { keep_statistics: false, ..adaptive() });
    assert!(without.film.pixels() == reference.film.pixels() && without.film.statistics().is_none());
}

#[test]
fn a_pixel_of_n_samples_is_that_of_n_fixed_samples() {
    let (mesh, scene) = still_life();
    let adaptive = render(&mesh, &scene, &adaptive());
    let statistics = adaptive.film.statistics().unwrap();
    for samples_per_pixel in [4, 8, 32, 64] {
        let fixed = RenderSettings { samples_per_pixel, adaptive: None, ..self::adaptive() };
        let fixed = render(&mesh, &scene, &fixed);
        let kept = fixed.film.statistics().unwrap();
        assert!(kept.iter().all(|pixel| pixel.samples == samples_per_pixel));
        let mut same = 0;
        for (pixel, statistics) in statistics.iter().enumerate() {
            if statistics.samples == samples_per_pixel {
                assert_eq!(adaptive.film.pixels()[pixel], fixed.film.pixels()[pixel]);
                assert_eq!(statistics.half_difference, kept[pixel].half_difference);
                same += 1;
            }
        }
        assert!(same > 0, "no pixel has {samples_per_pixel} samples");
    }
}

#[test]
fn pixels_are_as_good_as_they_say_and_even_ones_stop_at_once() {
    let (mesh, scene) = still_life();
    let settings = RenderSettings { samples_per_pixel: 256, ..adaptive() };
    let picture = render(&mesh, &scene, &settings);
    let reference = render(
        &mesh,
        &scene,
        &RenderSettings {
            samples_per_pixel: 2048,
            adaptive: None,
            keep_statistics: false,
            seed: 9,
            ..settings
        },
    );
    let adaptive = settings.adaptive.unwrap();
    let (mut misses, mut even) = (0, 0);
    for ((found, statistics), truth) in
        picture.film.pixels().iter().zip(picture.film.statistics().unwrap()).zip(reference.film.pixels())
    {
        let off =
            (0..3).map(|channel| f64::from((found[channel] - truth[channel]).abs())).fold(0.0, f64::max);
        let is_done = adaptive.quantile() * f64::from(statistics.deviation) <= adaptive.error;
        assert!(is_done || statistics.samples == 256);
        misses += u32::from(is_done && off > adaptive.error);
        even += u32::from(statistics.samples == 4);
    }
    let pixels = picture.film.pixels().len() as u32;
    assert!(misses * 20 <= pixels, "{misses} of {pixels} pixels are off by more than they say");
    assert!(even * 3 > pixels, "{even} of {pixels} stop at once");
}

#[test]
fn what_is_cut_off_is_bounded() {
    let (mut mesh, scene) = still_life();
    // Glass without highlights: a surface that is lossless and lit has a bound of as many lamps as rays.
    mesh.materials[2].specular = [0.0; 3];
    let fixed = RenderSettings { adaptive: None, samples_per_pixel: 2, ..adaptive() };
    let whole = render(&mesh, &scene, &RenderSettings { contribution_bound: 1e-6, ..fixed });
    let rest = whole.film.statistics().unwrap().iter().map(|pixel| f64::from(pixel.lost)).fold(0.0, f64::max);
    assert!(rest < 1e-2, "{rest}");
    let mut lost_before = 0.0;
    // The last one cuts by work, too.
    for (contribution_bound, work_budget) in
        [(1e-4, 1 << 14), (1e-3, 1 << 14), (1e-2, 1 << 14), (0.2, 1 << 14), (1e-6, 12)]
    {
        let cut = render(&mesh, &scene, &RenderSettings { contribution_bound, work_budget, ..fixed });
        let (mut lost_sum, mut off_sum) = (0.0, 0.0);
        for ((found, statistics), truth) in
            cut.film.pixels().iter().zip(cut.film.statistics().unwrap()).zip(whole.film.pixels())
        {
            for (found, truth) in found.iter().zip(truth) {
                let off = f64::from(truth - found);
                assert!(
                    off >= -rest - 1e-6 && off <= f64::from(statistics.lost) + 1e-6,
                    "{off} is missing, {} was said, bound {contribution_bound}",
                    statistics.lost
                );
                off_sum += off;
            }
            lost_sum += f64::from(statistics.lost);
        }
        assert!(off_sum > 0.0 && (lost_sum > lost_before || work_budget == 12));
        lost_before = lost_sum;
    }
}

#[test]
fn thresholds_by_tile_are_obeyed() {
    let (mesh, scene) = still_life();
    let settings = RenderSettings { tile_size: 8, ..adaptive() };
    let plan = EffectPlan::of_materials(&scene, &mesh.materials, &settings.effect_options());
    let stage = Stage::new(&scene, &mesh.materials, &plan, &settings);
    let mesh = Arc::new(mesh);
    let naive = || Ok(Naive { mesh: mesh.clone(), counters: TraceCounters::default(), rays_left: u64::MAX });
    let steered = |threads: &Threads, of: &(dyn Fn(crate::units::TileId) -> Option<f64> + Sync)| {
        let budget = MemoryBudget::new(Bytes::mib(64));
        picture(&stage, threads, &budget, &naive, of, &mut |_| Control::Continue).unwrap().film
    };
    let [tight, loose] = [0.01, 1e9].map(|error| steered(&Threads::One, &move |_| Some(error)));
    let order = stage.grid.hilbert_order();
    for threads in [Threads::One, Threads::Count(2)] {
        let mixed = steered(&threads, &|tile| Some(if tile.0 % 2 == 0 { 0.01 } else { 1e9 }));
        for (tile, cell) in order.iter().enumerate() {
            let area = stage.grid.area(*cell);
            let like = if tile % 2 == 0 { &tight } else { &loose };
            for y in area.y..area.y + area.height {
                for x in area.x..area.x + area.width {
                    assert_eq!(mixed.pixel(x, y), like.pixel(x, y));
                }
            }
        }
    }
    assert!(loose.statistics().unwrap().iter().all(|pixel| pixel.samples == 4));
}

#[test]
fn senseless_sampling_is_refused() {
    let good = adaptive().adaptive.unwrap();
    for (adaptive, samples_per_pixel) in [
        (AdaptiveSampling { samples_min: 3, ..good }, 64),
        (AdaptiveSampling { samples_min: 0, ..good }, 64),
        (good, 48),
        (good, 2),
        (AdaptiveSampling { error: -1.0, ..good }, 64),
        (AdaptiveSampling { error: f64::NAN, ..good }, 64),
        (AdaptiveSampling { confidence: 1.0, ..good }, 64),
        (AdaptiveSampling { confidence: 0.5, ..good }, 64),
    ] {
        let settings = RenderSettings { adaptive: Some(adaptive), samples_per_pixel, ..settings() };
        assert!(matches!(settings.validate(), Err(RenderError::Setting { .. })), "{settings:?}");
    }
    assert!(adaptive().validate().is_ok());
}
