//! A second look at pixels: it goes on where the first ended, on any number of threads.

use glam::Vec3;

use super::invariance::{settings, still_life};
use super::*;
use crate::render::SECOND_SET;
use crate::render::resample::{Resampled, SampledPixel, resample};

/// Pixels here and there with the samples of a picture's first and second doubling, and one with more than a batch.
fn pixels() -> Vec<SampledPixel> {
    let settings = settings();
    let scattered = (0..settings.width * settings.height)
        .step_by(7)
        .map(|index| (index, if index % 2 == 0 { 4 } else { 8 }));
    let all = scattered.chain([(5, 64)]);
    let width = settings.width;
    all.map(|(index, samples)| SampledPixel { x: index % width, y: index / width, first: samples, samples })
        .collect()
}

fn again(
    pixels: &[SampledPixel],
    settings: &RenderSettings,
    threads: &Threads,
    rays_left: u64,
    stop: &mut (dyn FnMut() -> Control + Send),
) -> Result<Option<Resampled>, RenderError> {
    let (mesh, scene) = still_life();
    let plan = EffectPlan::of_materials(&scene, &mesh.materials, &settings.effect_options());
    let stage = Stage::new(&scene, &mesh.materials, &plan, settings);
    let mesh = Arc::new(mesh);
    let naive = || Ok(Naive { mesh: mesh.clone(), counters: TraceCounters::default(), rays_left });
    resample(&stage, pixels, threads, &naive, stop)
}

#[test]
fn further_samples_are_those_of_a_longer_picture() {
    let (mesh, scene) = still_life();
    let film = |samples_per_pixel| {
        let settings = RenderSettings { samples_per_pixel, adaptive: None, ..settings() };
        render(&mesh, &scene, &settings).film
    };
    let films = [4, 8, 16, 64, 128].map(|samples| (samples, film(samples)));
    let of = |samples: u32, pixel: &SampledPixel| {
        let (_, film) = films.iter().find(|(count, _)| *count == samples).unwrap();
        film.pixel(pixel.x, pixel.y)
    };
    let long = RenderSettings { samples_per_pixel: 128, ..settings() };
    let mut counted = Vec::new();
    for (threads, batch_samples) in
        [(Threads::One, 1024), (Threads::Count(3), 1024), (Threads::One, 24), (Threads::Count(2), 1)]
    {
        let settings = RenderSettings { batch_samples, ..long };
        let found =
            again(&pixels(), &settings, &threads, u64::MAX, &mut || Control::Continue).unwrap().unwrap();
        assert_eq!(found.means.len(), pixels().len());
        for (pixel, mean) in pixels().iter().zip(&found.means) {
            let (first, both) = (of(pixel.samples, pixel), of(2 * pixel.samples, pixel));
            for channel in 0..3 {
                // The second half of twice the samples.
                let expected = 2.0 * f64::from(both[channel]) - f64::from(first[channel]);
                assert!((mean[channel] - expected).abs() < 1e-6, "{pixel:?}: {mean}, not {expected}");
            }
        }
        counted.push(found.effects);
    }
    assert!(counted[0].rays() > 0 && counted.iter().all(|effects| *effects == counted[0]));
}

/// A second set is as good as the first and tells nothing of it: over many pixels the difference of both has the squares of both errors.
#[test]
fn a_second_set_has_nothing_to_do_with_the_first() {
    let (mesh, scene) = still_life();
    let settings = RenderSettings { adaptive: None, samples_per_pixel: 512, ..settings() };
    let truth = render(&mesh, &scene, &settings).film;
    let all = |first: u32, samples: u32| -> Vec<SampledPixel> {
        let places = (0..settings.width * settings.height)
            .map(|index| [index % settings.width, index / settings.width]);
        places.map(|[x, y]| SampledPixel { x, y, first, samples }).collect()
    };
    let means = |first: u32| {
        let go_on = &mut || Control::Continue;
        again(&all(first, 8), &settings, &Threads::One, u64::MAX, go_on).unwrap().unwrap().means
    };
    let truth: Vec<DVec3> = truth.pixels().iter().map(|pixel| Vec3::from(*pixel).as_dvec3()).collect();
    let square =
        |a: &[DVec3], b: &[DVec3]| -> f64 { a.iter().zip(b).map(|(a, b)| (*a - *b).length_squared()).sum() };
    let [first, behind, second] = [0, 8, SECOND_SET].map(means);
    let (own, other) = (square(&first, &truth), square(&second, &truth));
    assert!((0.7..1.4).contains(&(other / own)), "{own} and {other}");
    let between = square(&first, &second) / (own + other);
    assert!((0.85..1.15).contains(&between), "{between}");
    // Those behind the first of the same set complement them.
    let behind = square(&first, &behind) / (own + square(&behind, &truth));
    assert!(behind > between, "{behind} and {between}");
}

#[test]
fn a_second_look_can_be_stopped_and_fails_as_its_queries_do() {
    let long = RenderSettings { samples_per_pixel: 128, batch_samples: 16, ..settings() };
    for threads in [Threads::One, Threads::Count(2)] {
        let mut calls = 0;
        let stopped = again(&pixels(), &long, &threads, u64::MAX, &mut || {
            calls += 1;
            if calls == 3 { Control::Cancel } else { Control::Continue }
        });
        assert!(stopped.unwrap().is_none());
        assert!(again(&pixels(), &long, &threads, 50, &mut || Control::Continue).is_err());
    }
}
