//! A picture in steps: it is the one that is made at once, on any number of threads and in any tiles, and takes no sample twice.

use super::invariance::{settings, still_life};
use super::*;
use crate::render::draft::Draft;
use crate::render::{AdaptiveSampling, Film};

fn adaptive(samples_min: u32, error: f64) -> RenderSettings {
    RenderSettings {
        samples_per_pixel: 64,
        adaptive: Some(AdaptiveSampling { samples_min, error, confidence: 0.95 }),
        keep_statistics: true,
        work_budget: 1 << 14,
        ..settings()
    }
}

/// A picture that goes on, and the samples that it took so far.
struct Steps {
    stage: Stage,
    mesh: Arc<Mesh>,
    budget: MemoryBudget,
    samples: u64,
}

impl Steps {
    fn new(settings: &RenderSettings) -> Steps {
        let (mesh, scene) = still_life();
        let plan = mesh.plan(&scene, settings);
        let mut stage = Stage::new(&scene, &mesh.materials, &plan, settings);
        let budget = MemoryBudget::new(Bytes::mib(64));
        stage.draft = Some(Draft::new(settings, 3, &budget).unwrap());
        Steps { stage, mesh: Arc::new(mesh), budget, samples: 0 }
    }

    fn draft(&self) -> &Draft {
        self.stage.draft.as_ref().unwrap()
    }

    fn step(
        &mut self,
        least: u32,
        error: f64,
        threads: &Threads,
        rays_left: u64,
    ) -> Result<Film, RenderError> {
        self.draft().set_least(least);
        let mesh = &self.mesh;
        let naive = || Ok(Naive { mesh: mesh.clone(), counters: TraceCounters::default(), rays_left });
        let go_on = &mut |_| Control::Continue;
        let picture = picture(&self.stage, threads, &self.budget, &naive, &|_| Some(error), go_on)?;
        self.samples += picture.totals.effects.primary_rays;
        Ok(picture.film)
    }
}

fn assert_same(found: &Film, expected: &Film, what: &str) {
    assert!(found.is_complete() && found.pixels() == expected.pixels(), "{what}");
    assert!(found.statistics() == expected.statistics(), "{what}");
    assert!(found.costs() == expected.costs(), "{what}");
}

#[test]
fn steps_end_where_one_picture_does() {
    let (mesh, scene) = still_life();
    for (samples_min, tile_size, batch_samples, threads, keep_costs) in [
        (1, 16, 1024, Threads::One, false),
        (2, 8, 7, Threads::Count(3), false),
        (4, 16, 1024, Threads::Count(2), false),
        (4, 5, 64, Threads::One, true),
    ] {
        let name = format!("from {samples_min}, tiles of {tile_size}");
        let with = |error: f64| RenderSettings {
            tile_size,
            batch_samples,
            keep_costs,
            ..adaptive(samples_min, error)
        };
        let mut steps = Steps::new(&with(0.0));
        // The same few samples everywhere on the way.
        for samples in [1, 2, 4].into_iter().filter(|samples| *samples <= samples_min) {
            let film = steps.step(samples, f64::MAX, &threads, u64::MAX).unwrap();
            // A picture of a single sample has that in the middle.
            if samples > 1 {
                let fixed = RenderSettings { samples_per_pixel: samples, adaptive: None, ..with(0.0) };
                assert_same(&film, &render(&mesh, &scene, &fixed).film, &format!("{name}: {samples}"));
            }
        }
        steps.draft().look_around();
        let mut most = 0;
        for error in [f64::MAX, 0.5, 0.1, 0.1, 0.04] {
            let film = steps.step(samples_min, error, &threads, u64::MAX).unwrap();
            assert_same(&film, &render(&mesh, &scene, &with(error)).film, &format!("{name}: to {error}"));
            let samples = film.statistics().unwrap().iter().map(|pixel| u64::from(pixel.samples));
            most = samples.clone().max().unwrap();
            assert_eq!(steps.samples, samples.sum::<u64>(), "{name}: a sample was taken twice");
        }
        assert!(most >= 16, "{name}: {most} samples at most");
    }
}

#[test]
fn a_step_that_fails_leaves_what_was_there() {
    let settings = adaptive(4, 0.1);
    let mut steps = Steps::new(&settings);
    let before = steps.step(2, f64::MAX, &Threads::One, u64::MAX).unwrap();
    assert!(steps.step(4, f64::MAX, &Threads::One, 50).is_err());
    // Tiles that were finished may have gone on.
    let (mesh, scene) = still_life();
    let fixed = RenderSettings { samples_per_pixel: 4, adaptive: None, ..settings };
    let film = steps.step(4, f64::MAX, &Threads::One, u64::MAX).unwrap();
    assert_same(&film, &render(&mesh, &scene, &fixed).film, "after a failure");
    assert!(before.pixels() != film.pixels());
}

#[test]
fn what_is_kept_is_drawn_from_the_budget() {
    let settings = adaptive(4, 0.1);
    let needed = Draft::bytes_needed(&settings, 2);
    let budget = MemoryBudget::new(needed);
    let draft = Draft::new(&settings, 2, &budget).unwrap();
    assert_eq!(budget.used(), needed);
    assert!(Draft::new(&settings, 2, &budget).is_err());
    drop(draft);
    assert_eq!(budget.used(), Bytes(0));
}
