//! What effects cost: in their own scenes, and forced on one that has no use for them.

use std::error::Error;
use std::sync::Arc;
use std::time::Instant;

use outcrop::compile::CompileOptions;
use outcrop::octree::OctreeOptions;
use outcrop::render::{Control, PathEnd, RenderReport, RenderSettings, Renderer, Threads};
use outcrop::scene::{Effect, EffectSet, Scene};
use outcrop::{BlockSource, LazyOctree, MemoryBudget};

use crate::mesh::Mesh;
use crate::scenes::{self, Entry};

/// Exact counts, per pixel but for blocks.
#[derive(Clone, Copy, Default)]
pub struct Counts {
    pub rays: f64,
    pub box_tests: f64,
    pub triangle_tests: f64,
    /// Distinct ones that rays entered, of blocks of 4 KiB.
    pub blocks: u64,
    /// Of attributes and in pictures.
    pub lookups: f64,
    pub random_numbers: f64,
}

impl Counts {
    fn of(report: &RenderReport) -> Counts {
        let pixels = f64::from(report.width) * f64::from(report.height);
        let effects = &report.effects;
        let lookups = effects.attribute_lookups
            + effects.texture_reads
            + effects.cutout_tests
            + effects.bump_reads
            + effects.finish_reads;
        Counts {
            rays: effects.rays() as f64 / pixels,
            box_tests: report.trace.box_tests as f64 / pixels,
            triangle_tests: report.trace.triangle_tests as f64 / pixels,
            blocks: report.blocks_touched,
            lookups: (lookups + effects.forced_lookups) as f64 / pixels,
            random_numbers: effects.random_numbers as f64 / pixels,
        }
    }
}

/// One scene with and without something.
pub struct Comparison {
    pub what: String,
    pub without: Counts,
    pub with: Counts,
    /// CPU time with over without, each pair of runs by itself: the least, the median, the greatest.
    pub time: [f64; 3],
}

/// A mesh in small blocks, and its scene.
struct Subject {
    source: Arc<dyn BlockSource>,
    budget: MemoryBudget,
}

impl Subject {
    fn new(mesh: &Mesh, budget: &MemoryBudget) -> Result<Subject, Box<dyn Error>> {
        let options = CompileOptions { block_bytes: 4 << 10, ..CompileOptions::default() };
        Ok(Subject { source: Arc::new(mesh.compile_with(&options)?), budget: budget.clone() })
    }

    fn open(&self) -> Result<LazyOctree, Box<dyn Error>> {
        let options = OctreeOptions { slots_max: Some(1024), ..OctreeOptions::default() };
        Ok(LazyOctree::open(Arc::clone(&self.source), &self.budget, options)?)
    }

    /// What is counted, the picture, and the plan's effects.
    fn counted(&self, (scene, settings): (&Scene, &RenderSettings)) -> Result<Picture, Box<dyn Error>> {
        // An octree of its own counts the blocks that are touched.
        let octree = self.open()?;
        let renderer = Renderer::new(&octree, scene, settings, &self.budget)?;
        let image = renderer.render(&Threads::One, &mut |_| Control::Continue)?;
        let (counts, needed) = (Counts::of(&image.report), image.report.plan.needed());
        Ok(Picture { counts, pixels: image.film.pixels().to_vec(), needed })
    }

    /// CPU time of `with` over that of `without` with all blocks in memory, in pairs of runs that take turns to be first.
    fn time(
        &self,
        without: (&Scene, &RenderSettings),
        with: (&Scene, &RenderSettings),
    ) -> Result<[f64; 3], Box<dyn Error>> {
        const ROUNDS: usize = 7;
        /// The clock of CPU time may only move every few thousandths of a second.
        const SECONDS_MIN: f64 = 0.1;
        let octree = self.open()?;
        let repeated =
            |(scene, settings): (&Scene, &RenderSettings), times: u32| -> Result<f64, Box<dyn Error>> {
                let renderer = Renderer::new(&octree, scene, settings, &self.budget)?;
                let start = cpu_seconds();
                for _ in 0..times {
                    renderer.render(&Threads::One, &mut |_| Control::Continue)?;
                }
                Ok(cpu_seconds() - start)
            };
        // Blocks, attributes and tiles come in.
        repeated(with, 1)?;
        repeated(without, 1)?;
        let start = Instant::now();
        repeated(without, 1)?;
        let times = (SECONDS_MIN / start.elapsed().as_secs_f64()).ceil().clamp(1.0, 100.0) as u32;
        let run = |what| repeated(what, times);
        let mut ratios = Vec::new();
        for round in 0..ROUNDS {
            let (base, more) = if round % 2 == 0 {
                let base = run(without)?;
                (base, run(with)?)
            } else {
                let more = run(with)?;
                (run(without)?, more)
            };
            ratios.push(more / base);
        }
        ratios.sort_by(f64::total_cmp);
        Ok([ratios[0], ratios[ROUNDS / 2], ratios[ROUNDS - 1]])
    }
}

struct Picture {
    counts: Counts,
    pixels: Vec<[f32; 3]>,
    needed: EffectSet,
}

fn small(settings: &RenderSettings) -> RenderSettings {
    RenderSettings { width: 96, height: 72, samples_per_pixel: 4, ..*settings }
}

/// What `effect` adds to its own scene.
pub fn added(
    entry: &Entry,
    settings: &RenderSettings,
    effect: Effect,
    budget: &MemoryBudget,
) -> Result<Comparison, Box<dyn Error>> {
    let subject = Subject::new(&entry.mesh, budget)?;
    let settings = small(settings);
    let mut less = RenderSettings { switched_off: EffectSet::EMPTY.with(effect), ..settings };
    if effect == Effect::Antialiasing {
        less.samples_per_pixel = 1;
    }
    let (without, with) = ((&entry.scene, &less), (&entry.scene, &settings));
    let pictures = [subject.counted(without)?, subject.counted(with)?];
    if pictures[0].pixels == pictures[1].pixels || !pictures[1].needed.contains(effect) {
        return Err(format!("{}: {} does not show", entry.name, effect.name()).into());
    }
    let [without_counts, with_counts] = pictures.map(|picture| picture.counts);
    Ok(Comparison {
        what: effect.name().to_string(),
        without: without_counts,
        with: with_counts,
        time: subject.time(without, with)?,
    })
}

/// What each effect costs where it is forced on bricks in direct light, and all of them together. Lights and shadows, which these
/// do call for, on bricks in ambient light.
pub fn forced(budget: &MemoryBudget) -> Result<Vec<Comparison>, Box<dyn Error>> {
    let entry = scenes::bricks()?;
    let subject = Subject::new(&entry.mesh, budget)?;
    let dim = Scene::new(*entry.scene.camera()).with_ambient([0.3; 3]);
    let settings = small(&RenderSettings { path_end: PathEnd::Cut, ..RenderSettings::new(1, 1) });
    let mut rows = Vec::new();
    let singles = Effect::ALL.into_iter().filter(|effect| *effect != Effect::Antialiasing);
    let sets = singles.map(|effect| (effect.name().to_string(), EffectSet::EMPTY.with(effect)));
    for (what, set) in sets.chain([("all of them".to_string(), EffectSet::ALL)]) {
        let is_lit = !(set == EffectSet::EMPTY.with(Effect::DirectLight)
            || set == EffectSet::EMPTY.with(Effect::Shadows));
        let scene = if is_lit { &entry.scene } else { &dim };
        let more = RenderSettings { forced: set, ..settings };
        let (without, with) = ((scene, &settings), (scene, &more));
        let pictures = [subject.counted(without)?, subject.counted(with)?];
        let is_called_for = set != EffectSet::ALL
            && Effect::ALL
                .into_iter()
                .any(|effect| set.contains(effect) && pictures[0].needed.contains(effect));
        if pictures[0].pixels != pictures[1].pixels || is_called_for {
            return Err(format!("{what}: forcing it shows, or the scene calls for it").into());
        }
        let [without_counts, with_counts] = pictures.map(|picture| picture.counts);
        rows.push(Comparison {
            what,
            without: without_counts,
            with: with_counts,
            time: subject.time(without, with)?,
        });
    }
    Ok(rows)
}

/// CPU time of this thread (Linux); elsewhere the clock's.
fn cpu_seconds() -> f64 {
    let nanoseconds = std::fs::read_to_string("/proc/thread-self/schedstat")
        .ok()
        .and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(
        || {
            let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            since.map_or(0.0, |time| time.as_secs_f64())
        },
        |nanoseconds| nanoseconds * 1e-9,
    )
}
