//! Pictures to a goal: the goal is met or said not to be, what is claimed holds against a reference, and recorded knobs give the same
//! picture again.

#[path = "support/compiled.rs"]
mod compiled;

use std::sync::Arc;
use std::time::Duration;

use compiled::compiled;
use outcrop::accuracy::{
    Certificate, Goal, GoalImage, GoalOptions, Knobs, Metric, Sampling, Verdict, render_to_goal,
    render_with_knobs,
};
use outcrop::compile::{CompileOptions, Control, PrecisionChoice, Threads};
use outcrop::error::RenderError;
use outcrop::geom::Precision;
use outcrop::octree::{OctreeOptions, Tier};
use outcrop::procedural::{Assembly, Gears, GlassStack, Icosphere, Shape, Terrain, Tessellation};
use outcrop::render::{Film, RenderSettings, Renderer, WaitingRays};
use outcrop::scene::{Camera, Light, LightShape, Scene};
use outcrop::source::MemorySource;
use outcrop::units::Bytes;
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

fn source(shape: &dyn Shape, precision: PrecisionChoice) -> Arc<dyn BlockSource> {
    let options = CompileOptions { precision, block_bytes: 16 << 10, ..CompileOptions::default() };
    Arc::new(MemorySource::new(compiled(shape, &options)).unwrap())
}

/// Gears and a stack of glass.
fn still_life() -> (Arc<dyn BlockSource>, Scene) {
    let gears = Gears::with_tessellation(1, Tessellation::new(1).unwrap()).unwrap();
    let shape = Assembly::new().with(gears, 1.0, [0.0; 3]).with(
        GlassStack::new(1, 0.3, 0.3, 1.3).unwrap(),
        0.3,
        [0.9, -0.9, 0.0],
    );
    let camera = Camera::pinhole(Gears::EYE, [0.0; 3], [0.0, 0.0, 1.0], 45.0).unwrap();
    let scene = Scene::new(camera)
        .with_background([0.1, 0.36, 0.75])
        .with_ambient([0.1; 3])
        .with_light(Light::point([2.0, -2.5, 2.5], [0.7; 3]))
        .with_light(Light::point([-2.0, 4.0, 3.0], [0.4; 3]));
    (source(&shape, PrecisionChoice::Auto), scene)
}

fn open(source: &Arc<dyn BlockSource>, tier: Tier) -> (LazyOctree, MemoryBudget) {
    let budget = MemoryBudget::new(Bytes::mib(256));
    let options = OctreeOptions { tracers_max: 4, slots_max: Some(64), tier, ..OctreeOptions::default() };
    (LazyOctree::open(Arc::clone(source), &budget, options).unwrap(), budget)
}

fn settings() -> RenderSettings {
    RenderSettings { tile_size: 16, ..RenderSettings::new(72, 60) }
}

/// Every metric is held against the truth, whichever the goal is about.
fn to_goal(octree: &LazyOctree, budget: &MemoryBudget, scene: &Scene, options: &GoalOptions) -> GoalImage {
    let go_on = &mut |_| Control::Continue;
    let options = GoalOptions { every_metric: true, ..*options };
    render_to_goal(octree, scene, &settings(), &options, &Threads::Count(2), budget, go_on).unwrap()
}

fn again(
    octree: &LazyOctree,
    budget: &MemoryBudget,
    scene: &Scene,
    knobs: &Knobs,
    threads: &Threads,
) -> Film {
    let go_on = &mut |_| Control::Continue;
    // As they would come out of a file.
    let read: Knobs = serde_json::from_str(&serde_json::to_string(knobs).unwrap()).unwrap();
    assert_eq!(read, *knobs);
    render_with_knobs(octree, scene, &settings(), &read, threads, budget, go_on).unwrap().film
}

fn reference(octree: &LazyOctree, budget: &MemoryBudget, scene: &Scene) -> Film {
    let settings =
        RenderSettings { samples_per_pixel: 1024, contribution_bound: 1e-4, seed: 77, ..settings() };
    let renderer = Renderer::new(octree, scene, &settings, budget).unwrap();
    renderer.render(&Threads::Count(2), &mut |_| Control::Continue).unwrap().into_complete().unwrap()
}

/// The error is what the certificate says or less, and the certificate is no idle one.
fn holds(certificate: &Certificate, found: &Film, reference: &Film) {
    for metric in Metric::ALL {
        let error = metric.distance(reference.pixels(), found.pixels(), found.width());
        let Some(bound) = certificate.error_bound(metric) else {
            // Nothing is said of the greatest error where pixels have few samples, which is so in goals about others only.
            let (Sampling::Fixed { samples: least } | Sampling::Adaptive { samples_min: least, .. }) =
                certificate.knobs.sampling;
            assert!(least < 4 && metric == Metric::Max, "{certificate}");
            assert!(!matches!(certificate.goal, Goal::MaxError { metric: Metric::Max, .. }));
            continue;
        };
        println!("{}: {error:.2e}, certified {bound:.2e}", metric.name());
        assert!(error <= bound, "{}: {error} above {bound}", metric.name());
        if metric != Metric::Max {
            assert!(bound < 4.0 * error, "{}: {error} far below {bound}", metric.name());
        }
    }
}

#[test]
fn error_goals_are_met_and_certificates_hold() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let used = budget.used();
    let reference = reference(&octree, &budget, &scene);
    let mut rays_before = 0;
    for (metric, bound) in
        [(Metric::Rmse, 0.02), (Metric::Rmse, 0.008), (Metric::Flip, 0.04), (Metric::Max, 0.2)]
    {
        let options = GoalOptions::new(Goal::MaxError { metric, bound });
        let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
        println!("{} {bound}: {certificate}", metric.name());
        assert_eq!(certificate.verdict, Verdict::Met);
        assert!(certificate.error_bound(metric).unwrap() <= bound);
        holds(&certificate, &image.film, &reference);
        assert!(
            certificate.geometry.is_visibility_exact
                && certificate.geometry.t_relative == Some(2f64.powi(-40))
        );
        // Half of the goal in RMSE, a quarter else, and what the probe did not see.
        let share = if metric == Metric::Rmse { 0.6 } else { 0.4 };
        assert!(certificate.cut_off.rmse <= share * bound, "{:?}", certificate.cut_off);
        // The same picture again, on one thread.
        let film = again(&octree, &budget, &scene, &certificate.knobs, &Threads::One);
        assert!(film.pixels() == image.film.pixels() && film.statistics() == image.film.statistics());
        if metric == Metric::Rmse {
            assert!(certificate.counters.effects.rays() > rays_before, "half the error comes at a price");
            rays_before = certificate.counters.effects.rays();
        }
        drop((image, film));
    }
    drop(reference);
    assert_eq!(budget.used(), used, "everything reserved is given back");
}

/// A goal that two samples of each pixel keep gets two, and four if it takes these; nothing stops early, and so nothing is checked.
/// In FLIP single samples may do, and a few more; as one alone says nothing of its error, a check does.
#[test]
fn easy_goals_get_few_samples() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let reference = reference(&octree, &budget, &scene);
    for (metric, bound) in [(Metric::Rmse, 0.06), (Metric::Flip, 0.12)] {
        let options = GoalOptions::new(Goal::MaxError { metric, bound });
        let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
        println!("{} {bound}: {certificate}", metric.name());
        assert_eq!(certificate.verdict, Verdict::Met);
        if metric == Metric::Flip {
            let Sampling::Adaptive { samples_min: 1, .. } = certificate.knobs.sampling else {
                panic!("{certificate}")
            };
            assert!(certificate.samples_mean < 1.5 && certificate.check.is_some(), "{certificate}");
        } else {
            assert_eq!(certificate.check, None);
            assert_eq!(certificate.knobs.sampling, Sampling::Fixed { samples: 2 });
        }
        let error = metric.distance(reference.pixels(), image.film.pixels(), image.film.width());
        assert!(error <= certificate.error_bound(metric).unwrap());
        // The same picture again.
        let film = again(&octree, &budget, &scene, &certificate.knobs, &Threads::One);
        assert!(film.pixels() == image.film.pixels());
    }
}

#[test]
fn a_check_of_single_samples_is_told_in_words() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let options = GoalOptions::new(Goal::MaxError { metric: Metric::Flip, bound: 1e3 });
    let (settings, go_on) = (RenderSettings::new(12, 10), &mut |_| Control::Continue);
    let found = render_to_goal(&octree, &scene, &settings, &options, &Threads::One, &budget, go_on).unwrap();
    assert_eq!(found.certificate.check.map(|check| check.bias), Some(f64::INFINITY));
    let text = found.certificate.to_string();
    assert!(text.contains("further samples, which show an error") && !text.contains("inf"), "{text}");
}

/// Small features everywhere: pixels look finished by chance, and the certificate must know.
#[test]
fn noise_does_not_fool_the_certificate() {
    let source = source(&Terrain::new(150, 1).unwrap(), PrecisionChoice::Auto);
    let scene = Scene::automatic(&source.model().bounds, 1.2);
    let (octree, budget) = open(&source, Tier::Certified);
    let reference = reference(&octree, &budget, &scene);
    for bound in [0.01, 0.005] {
        let options = GoalOptions::new(Goal::MaxError { metric: Metric::Rmse, bound });
        let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
        println!("{bound}: {certificate}");
        assert_eq!(certificate.verdict, Verdict::Met);
        // Two of each pixel, or four: no pixel stopped because its samples happened to agree, and the halves tell.
        let Some(check) = certificate.check else {
            assert!(matches!(certificate.knobs.sampling, Sampling::Fixed { .. }));
            holds(&certificate, &image.film, &reference);
            continue;
        };
        let share = check.samples as f64 / (certificate.samples_mean * image.film.pixels().len() as f64);
        // A sample, not the whole picture.
        assert!(check.pixels >= 200 && check.bias > 0.5 && share < 0.25, "{check:?}, {share}");
        holds(&certificate, &image.film, &reference);
    }
}

/// What is called met is met, and all three bounds hold, for one picture after the other; a single one may be lucky.
#[test]
fn bounds_hold_as_often_as_they_say() {
    let source = source(&Terrain::new(300, 1).unwrap(), PrecisionChoice::Auto);
    let scene = Scene::automatic(&source.model().bounds, 1.2);
    let (octree, budget) = open(&source, Tier::Certified);
    let reference = reference(&octree, &budget, &scene);
    const RUNS: u64 = 10;
    for (metric, bound) in [(Metric::Rmse, 0.01), (Metric::Flip, 0.02), (Metric::Max, 0.1)] {
        let (mut held, mut said, mut met) = ([0; 3], [0; 3], 0);
        for seed in 1..=RUNS {
            let goal = Goal::MaxError { metric, bound };
            let options = GoalOptions { every_metric: true, ..GoalOptions::new(goal) };
            let settings = RenderSettings { seed, ..settings() };
            let go_on = &mut |_| Control::Continue;
            let GoalImage { image, certificate } =
                render_to_goal(&octree, &scene, &settings, &options, &Threads::Count(2), &budget, go_on)
                    .unwrap();
            let error = |of: Metric| of.distance(reference.pixels(), image.film.pixels(), image.film.width());
            for ((held, said), of) in held.iter_mut().zip(&mut said).zip(Metric::ALL) {
                // Of the greatest error nothing is said where pixels have few samples.
                if let Some(bound) = certificate.error_bound(of) {
                    *said += 1u32;
                    *held += u32::from(error(of) <= bound);
                }
            }
            if certificate.verdict == Verdict::Met {
                met += 1;
                assert!(error(metric) <= bound, "{} {bound} with seed {seed}: {certificate}", metric.name());
            }
        }
        println!("{} {bound}: {met} of {RUNS} met, {held:?} of {said:?} bounds hold", metric.name());
        // At 95 %, two misses of ten happen once in ten times.
        let is_held = |(held, said): (&u32, &u32)| held + 2 >= *said;
        assert!(held.iter().zip(&said).all(is_held), "{}: {held:?} of {said:?}", metric.name());
        for (said, of) in said.into_iter().zip(Metric::ALL) {
            assert!(
                u64::from(said) == RUNS || of == Metric::Max && metric != Metric::Max,
                "{}: {said}",
                of.name()
            );
        }
        assert!(met >= 8, "{}: {met} of {RUNS} met", metric.name());
    }
}

/// Rays may wait for blocks while a picture goes on, and the picture does not show it, nor who made it.
#[test]
fn rays_may_wait_and_threads_do_not_show() {
    let source = source(&Terrain::new(60, 1).unwrap(), PrecisionChoice::Auto);
    let scene = Scene::automatic(&source.model().bounds, 1.2).with_interreflection();
    let go_on = &mut |_| Control::Continue;
    let mut found: Option<GoalImage> = None;
    for (waiting, threads) in [
        (WaitingRays::Never, Threads::One),
        (WaitingRays::Never, Threads::Count(3)),
        (WaitingRays::Count(200), Threads::Count(2)),
    ] {
        let (octree, budget) = open(&source, Tier::Certified);
        let settings = RenderSettings { waiting, width: 40, height: 32, ..settings() };
        let options = GoalOptions::new(Goal::MaxError { metric: Metric::Rmse, bound: 0.01 });
        let goal = render_to_goal(&octree, &scene, &settings, &options, &threads, &budget, go_on).unwrap();
        assert_eq!(goal.image.report.waiting.is_some(), waiting != WaitingRays::Never);
        let Some(first) = &found else {
            assert!(goal.certificate.samples_mean > 4.0, "more than one step: {}", goal.certificate);
            found = Some(goal);
            continue;
        };
        assert_eq!(goal.certificate.knobs, first.certificate.knobs);
        assert!(goal.image.film.pixels() == first.image.film.pixels());
        assert!(goal.image.film.statistics() == first.image.film.statistics());
        assert_eq!(goal.certificate.estimates, first.certificate.estimates);
        assert_eq!(goal.certificate.counters.effects, first.certificate.counters.effects);
    }
}

#[test]
fn what_is_proven_of_luck_is_proven_in_expectation() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let options = GoalOptions::new(Goal::MaxError { metric: Metric::Rmse, bound: 0.1 });
    let lamp = LightShape::Sphere { center: [2.0, -2.5, 2.5], radius: 0.2 };
    let with_lamp = scene.clone().with_light(Light::area(lamp, [5.0; 3]));
    for (scene, is_sampled) in [(scene, false), (with_lamp, true)] {
        let certificate = to_goal(&octree, &budget, &scene, &options).certificate;
        assert_eq!(certificate.cut_off.in_expectation, is_sampled);
        let text = certificate.to_string();
        assert_eq!(text.contains("proven in expectation: light cut off"), is_sampled, "{text}");
    }
}

#[test]
fn what_the_clock_chose_is_recorded() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let mut samples_before = 0.0;
    for milliseconds in [1, 500, 2000] {
        let options = GoalOptions::new(Goal::MaxTime(Duration::from_millis(milliseconds)));
        let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
        println!("{milliseconds} ms: {certificate}\n{:?}", certificate.knobs.sampling);
        for threads in [Threads::One, Threads::Count(3)] {
            let film = again(&octree, &budget, &scene, &certificate.knobs, &threads);
            assert!(film.pixels() == image.film.pixels(), "{milliseconds} ms on {threads:?}");
        }
        // No assertion on time itself; but no time at all cannot be met, and more time is used.
        if milliseconds == 1 {
            assert!(matches!(certificate.verdict, Verdict::NotMet { .. }), "{certificate}");
            assert!(matches!(certificate.knobs.sampling, Sampling::Fixed { samples: 1 }));
            assert!(certificate.estimates.is_empty());
        }
        assert!(certificate.samples_mean > samples_before);
        samples_before = certificate.samples_mean;
    }
}

#[test]
fn exact_cuts_nothing_and_wants_certain_hits() {
    let shape = Icosphere::new(1.0, [1e6, 0.0, 0.0], 3).unwrap();
    let source = source(&shape, PrecisionChoice::Lattice { exponent: -10 });
    let camera = Camera::pinhole([1e6 + 4.0, 0.5, 0.3], [1e6, 0.0, 0.0], [0.0, 0.0, 1.0], 40.0).unwrap();
    let scene =
        Scene::new(camera).with_ambient([0.3; 3]).with_light(Light::directional([-1.0, 0.2, -0.4], [0.5; 3]));
    let options = GoalOptions::new(Goal::Exact);
    for tier in [Tier::Certified, Tier::Exact, Tier::Fast] {
        let (octree, budget) = open(&source, tier);
        let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
        assert_eq!(certificate.verdict == Verdict::Met, tier != Tier::Fast, "{certificate}");
        assert_eq!(certificate.geometry.is_visibility_exact, tier != Tier::Fast);
        assert_eq!((certificate.cut_off.rmse, certificate.cut_off.max), (0.0, 0.0));
        assert_eq!(certificate.knobs.contribution_bound, 0.0);
        // Half a step of the lattice, and what it is in the picture.
        assert!(matches!(certificate.geometry.precision, Precision::Lattice(_)));
        assert_eq!(certificate.geometry.vertex, 2f64.powi(-11));
        assert!((0.01..1.0).contains(&certificate.geometry.vertex_pixels.unwrap()));
        assert_eq!(image.film.statistics().unwrap()[0].samples, 1);
    }
    let known = GoalOptions { vertex_error: Some(1e-5), ..options };
    let (octree, budget) = open(&source, Tier::Certified);
    assert_eq!(to_goal(&octree, &budget, &scene, &known).certificate.geometry.vertex, 1e-5);
}

#[test]
fn what_cannot_be_met_says_so() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let goal = Goal::MaxError { metric: Metric::Rmse, bound: 5e-4 };
    let options = GoalOptions { samples_max: 8, ..GoalOptions::new(goal) };
    let GoalImage { image, certificate } = to_goal(&octree, &budget, &scene, &options);
    let Verdict::NotMet { reason } = &certificate.verdict else { panic!("{certificate}") };
    assert!(reason.contains("the most samples allowed, 8"), "{reason}");
    assert!(image.film.is_complete() && certificate.error_bound(Metric::Rmse).unwrap() > 5e-4);
    // FLIP takes time, and is estimated where it is asked for.
    let go_on = &mut |_| Control::Continue;
    let alone =
        render_to_goal(&octree, &scene, &settings(), &options, &Threads::One, &budget, go_on).unwrap();
    assert!(alone.certificate.error_bound(Metric::Rmse).is_some());
    assert_eq!(alone.certificate.estimate(Metric::Flip), None);
    assert!(certificate.samples_mean > 4.0 && certificate.samples_mean <= 8.0);
}

#[test]
fn goals_can_be_cancelled_and_tell_how_far_they_are() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let used = budget.used();
    let options = GoalOptions::new(Goal::MaxError { metric: Metric::Rmse, bound: 0.01 });
    let run = |progress: &mut (dyn FnMut(outcrop::accuracy::GoalProgress) -> Control + Send)| {
        render_to_goal(&octree, &scene, &settings(), &options, &Threads::Count(2), &budget, progress)
    };
    // While the contribution bound is chosen: at the first look, and at the second.
    for calls in [1, 2] {
        let mut left = calls;
        let error = run(&mut |progress| {
            assert_eq!(progress.attempt, 0);
            left -= 1;
            if left == 0 { Control::Cancel } else { Control::Continue }
        });
        assert!(matches!(error.map(|_| ()), Err(RenderError::Cancelled)));
    }
    // In the picture.
    let GoalImage { image, certificate } = run(&mut |progress| {
        assert!(progress.progress.samples <= progress.progress.samples_total);
        if progress.attempt == 1 && progress.progress.tiles >= 3 {
            Control::Cancel
        } else {
            Control::Continue
        }
    })
    .unwrap();
    assert_eq!(certificate.verdict, Verdict::Cancelled);
    assert!(!image.film.is_complete() && certificate.estimates.is_empty());
    drop(image);
    assert_eq!(budget.used(), used);
}

/// Also where it comes with a step's last tile.
#[test]
fn one_word_cancels_whenever_it_is_said() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let options = GoalOptions::new(Goal::MaxError { metric: Metric::Rmse, bound: 0.02 });
    let settings = RenderSettings { tile_size: 16, ..RenderSettings::new(24, 20) };
    let run = |stop_at: usize| {
        let mut calls = 0;
        let result =
            render_to_goal(&octree, &scene, &settings, &options, &Threads::One, &budget, &mut |_| {
                calls += 1;
                if calls == stop_at { Control::Cancel } else { Control::Continue }
            });
        (calls, result.map(|found| found.certificate.verdict))
    };
    let (calls, verdict) = run(usize::MAX);
    assert!(verdict.unwrap() == Verdict::Met && calls > 10, "{calls}");
    for stop_at in 1..calls {
        let (asked, result) = run(stop_at);
        assert_eq!(asked, stop_at, "asked again: {result:?}");
        assert!(
            matches!(result, Err(RenderError::Cancelled) | Ok(Verdict::Cancelled)),
            "{stop_at}: {result:?}"
        );
    }
}

#[test]
fn senseless_goals_and_foreign_knobs_are_refused() {
    let (source, scene) = still_life();
    let (octree, budget) = open(&source, Tier::Certified);
    let exact = GoalOptions::new(Goal::Exact);
    let error = |bound| GoalOptions::new(Goal::MaxError { metric: Metric::Max, bound });
    for bad in [
        error(0.0),
        error(f64::NAN),
        GoalOptions::new(Goal::MaxTime(Duration::ZERO)),
        GoalOptions { confidence: 1.0, ..exact },
        GoalOptions { confidence: 1.0 - 1e-10, ..exact },
        GoalOptions { samples_max: 3, ..exact },
        GoalOptions { vertex_error: Some(-1.0), ..exact },
    ] {
        let go_on = &mut |_| Control::Continue;
        let result = render_to_goal(&octree, &scene, &settings(), &bad, &Threads::One, &budget, go_on);
        assert!(matches!(result.map(|_| ()), Err(RenderError::Setting { .. })), "{bad:?}");
    }
    // Before anything is worked out from it.
    let side = u32::MAX;
    for bad in [RenderSettings { tile_size: 0, ..settings() }, RenderSettings::new(side, side)] {
        for goal in [Goal::MaxTime(Duration::from_secs(1)), Goal::Exact] {
            let (goal, go_on) = (GoalOptions::new(goal), &mut |_| Control::Continue);
            let result = render_to_goal(&octree, &scene, &bad, &goal, &Threads::One, &budget, go_on);
            assert!(matches!(result.map(|_| ()), Err(RenderError::Setting { .. })), "{bad:?}");
        }
    }
    let knobs = to_goal(&octree, &budget, &scene, &exact).certificate.knobs;
    let foreign = Knobs { tier: Tier::Fast, ..knobs };
    let go_on = &mut |_| Control::Continue;
    let result = render_with_knobs(&octree, &scene, &settings(), &foreign, &Threads::One, &budget, go_on);
    assert!(result.map(|_| ()).unwrap_err().to_string().contains("open it with that tier"));
}

#[test]
fn what_is_reserved_is_what_is_said() {
    let (source, scene) = still_life();
    for goal in [
        Goal::MaxError { metric: Metric::Flip, bound: 0.1 },
        Goal::MaxTime(Duration::from_millis(300)),
        Goal::Exact,
    ] {
        let options = GoalOptions::new(goal);
        let threads = Threads::Count(2);
        let needed =
            outcrop::accuracy::bytes_needed(&scene, source.model(), &settings(), &options, &threads).unwrap();
        let (octree, _) = open(&source, Tier::Certified);
        let budget = MemoryBudget::new(needed);
        let go_on = &mut |_| Control::Continue;
        render_to_goal(&octree, &scene, &settings(), &options, &threads, &budget, go_on).unwrap();
        assert!(budget.peak() <= needed, "{} of {needed}", budget.peak());
    }
}
