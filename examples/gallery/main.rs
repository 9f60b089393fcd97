//! Renders small scenes in code, one for each effect and some with several, and writes a page about what each costs.

#[path = "../common/mod.rs"]
mod common;
mod instances;
mod mesh;
mod page;
mod scenes;
mod surfaces;

use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use common::arguments::{self, Arguments};
use instances::Making;
use outcrop::octree::OctreeOptions;
use outcrop::render::{Control, PathEnd, RenderSettings, RenderedImage, Renderer, Threads};
use outcrop::scene::{Effect, EffectSet};
use outcrop::units::Bytes;
use outcrop::{LazyOctree, MemoryBudget};
use page::{Costs, Page, Run};
use scenes::Entry;

const HELP: &str = "\
gallery: renders one small scene per effect, and says what each effect costs

    cargo run --release --example gallery -- [OPTION]...

    -o, --output FOLDER   where pictures and README.md go (docs/gallery)
    --only NAME           one picture; its part of the page goes to standard output
    --size WxH            of the pictures (240x180)
    --quick               tiny pictures and no measurement: shows that everything works
    --threads N           for the pictures (2); costs are measured on one
";

struct Options {
    output: PathBuf,
    only: Option<String>,
    size: [u32; 2],
    quick: bool,
    threads: usize,
}

fn main() -> ExitCode {
    arguments::run(run)
}

fn run(mut arguments: Arguments) -> Result<ExitCode, Box<dyn Error>> {
    let mut options = Options {
        output: PathBuf::from("docs/gallery"),
        only: None,
        size: [240, 180],
        quick: false,
        threads: 2,
    };
    while let Some(name) = arguments.option()? {
        match name.as_str() {
            "-o" | "--output" => options.output = arguments.path()?,
            "--only" => options.only = Some(arguments.text()?),
            "--size" => options.size = arguments.size()?,
            "--quick" => options.quick = true,
            "--threads" => options.threads = arguments.value()?,
            "-h" | "--help" => {
                print!("{HELP}");
                return Ok(ExitCode::SUCCESS);
            }
            _ => return Err(arguments.unknown()),
        }
    }
    std::fs::create_dir_all(&options.output)?;
    let budget = MemoryBudget::new(Bytes::mib(256));
    let mut page = Page::default();
    let mut found = false;
    for entry in scenes::all(&budget)? {
        if options.only.as_ref().is_some_and(|only| only != entry.name) {
            continue;
        }
        found = true;
        make(&options, entry, &budget, &mut page)?;
    }
    let making = Making {
        folder: &options.output,
        size: if options.quick { [32, 24] } else { options.size },
        quick: options.quick,
        threads: options.threads,
        budget: &budget,
    };
    let pictures: [(&str, Picture); 2] =
        [("instances", instances::forest), ("moving-instances", instances::moving)];
    for (name, picture) in pictures {
        if options.only.as_ref().is_none_or(|only| only == name) {
            found = true;
            picture(&making, page.more())?;
        }
    }
    if !found {
        return Err(format!("--only {}: there is no such picture", options.only.unwrap_or_default()).into());
    }
    match options.only {
        None => std::fs::write(options.output.join("README.md"), page.text())?,
        Some(_) => print!("{}", page.part()),
    }
    Ok(ExitCode::SUCCESS)
}

/// Makes pictures that are not of one mesh, and writes about them.
type Picture = fn(&Making<'_>, &mut String) -> Result<(), Box<dyn Error>>;

fn make(
    options: &Options,
    entry: Entry,
    budget: &MemoryBudget,
    page: &mut Page,
) -> Result<(), Box<dyn Error>> {
    let source = Arc::new(entry.mesh.compile()?);
    let octree_options =
        OctreeOptions { tracers_max: options.threads as u32, slots_max: Some(512), ..Default::default() };
    let octree = LazyOctree::open(source, budget, octree_options)?;
    let [width, height] = if options.quick { [32, 24] } else { options.size };
    let settings = RenderSettings {
        samples_per_pixel: if options.quick { 2 } else { entry.samples_per_pixel },
        path_end: PathEnd::Roulette,
        contribution_bound: 0.05,
        ..RenderSettings::new(width, height)
    };
    // Scenes without luck keep their exact cut.
    let settings = if is_lucky(&octree, &entry, &settings, budget)? {
        settings
    } else {
        RenderSettings { path_end: PathEnd::Cut, contribution_bound: 1e-3, ..settings }
    };
    let image = render(&octree, &entry, &settings, options.threads, budget)?;
    let file = format!("{}.png", entry.name);
    image.film.write(&options.output.join(&file))?;
    println!(
        "{}: {} rays in {:.1} s",
        options.output.join(&file).display(),
        image.report.effects.rays(),
        image.report.wall_seconds
    );
    let costs = match entry.effect {
        Some(effect) if !options.quick && options.only.is_none() => {
            Some(costs(&octree, &entry, &settings, effect, budget)?)
        }
        _ => None,
    };
    page.add(&entry, &file, &image.report, &settings, costs);
    Ok(())
}

/// Whether the scene calls for an effect that draws random numbers.
fn is_lucky(
    octree: &LazyOctree,
    entry: &Entry,
    settings: &RenderSettings,
    budget: &MemoryBudget,
) -> Result<bool, Box<dyn Error>> {
    Ok(Renderer::new(octree, &entry.scene, settings, budget)?.plan().has_sampled_effects())
}

fn render(
    octree: &LazyOctree,
    entry: &Entry,
    settings: &RenderSettings,
    threads: usize,
    budget: &MemoryBudget,
) -> Result<RenderedImage, Box<dyn Error>> {
    let renderer = Renderer::new(octree, &entry.scene, settings, budget)?;
    Ok(renderer.render(&Threads::Count(threads), &mut |_| Control::Continue)?)
}

/// What the effect adds to its scene, and what it would cost to trace every effect and multiply by zero: CPU seconds of the
/// best of three interleaved runs on one thread.
fn costs(
    octree: &LazyOctree,
    entry: &Entry,
    settings: &RenderSettings,
    effect: Effect,
    budget: &MemoryBudget,
) -> Result<Costs, Box<dyn Error>> {
    let planned = RenderSettings { width: 64, height: 48, samples_per_pixel: 4, ..*settings };
    let without = RenderSettings { switched_off: EffectSet::EMPTY.with(effect), ..planned };
    let forced = RenderSettings { forced: EffectSet::ALL, ..planned };
    let mut runs = [Run::default(); 3];
    let mut pictures = Vec::new();
    for round in 0..3 {
        for (run, settings) in runs.iter_mut().zip([&without, &planned, &forced]) {
            let start = cpu_seconds();
            let image = render(octree, entry, settings, 1, budget)?;
            let seconds = cpu_seconds() - start;
            let effects = &image.report.effects;
            *run = Run {
                rays_per_sample: effects.rays() as f64 / effects.samples as f64,
                seconds: if round == 0 { seconds } else { run.seconds.min(seconds) },
            };
            pictures.push(image.film.pixels().to_vec());
        }
    }
    // The check of the measurement: forced work does not show, and the effect does.
    if pictures[1] != pictures[2] || pictures[0] == pictures[1] {
        return Err(
            format!("{}: the pictures with, without and forced are not as they must be", entry.name).into()
        );
    }
    let [without, planned, forced] = runs;
    Ok(Costs { effect, without, planned, forced })
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
